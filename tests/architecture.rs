//! The rules of ARCHITECTURE.md, checked on the sources themselves.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Every room with the rooms it may know.
const MAY_KNOW: [(&str, &[&str]); 9] = [
    ("mesh", &[]),
    ("centerline", &["mesh"]),
    ("output", &["centerline", "mesh"]),
    ("phantom", &["centerline", "mesh"]),
    ("compare", &["output", "centerline", "mesh"]),
    ("jobs", &["output", "centerline", "mesh"]),
    ("outbound", &["jobs"]),
    ("http", &["outbound", "jobs", "output", "centerline", "mesh"]),
    ("cli", &["http", "outbound", "jobs", "compare", "phantom", "output", "centerline", "mesh"]),
];

/// Crates (and parts of std) with the only rooms that may name them.
const ONLY_IN: [(&str, &[&str]); 28] = [
    ("zstd", &["jobs"]),
    ("axum", &["http"]),
    ("tower", &["http"]),
    ("tower_http", &["http"]),
    ("hyper_util", &["http"]),
    ("tokio_rustls", &["http"]),
    ("reqwest", &["outbound", "cli"]),
    ("jsonwebtoken", &["http"]),
    ("utoipa_axum", &["http"]),
    ("utoipa", &["http", "output"]),
    ("sqlx", &["jobs"]),
    ("rustix", &["jobs"]),
    ("object_store", &["jobs"]),
    ("tokio", &["jobs", "outbound", "http", "cli"]),
    ("futures", &["jobs", "outbound", "http", "cli"]),
    ("tracing", &["jobs", "outbound", "http", "cli"]),
    ("opentelemetry", &["jobs", "cli"]),
    ("opentelemetry_sdk", &["jobs", "cli"]),
    ("opentelemetry_otlp", &["cli"]),
    ("clap", &["cli"]),
    ("toml", &["cli"]),
    ("indicatif", &["cli"]),
    // The library has no I/O, no clock and no settings of its own.
    ("std::fs", &["jobs", "outbound", "http", "cli"]),
    ("std::net", &["jobs", "outbound", "http", "cli"]),
    ("std::env", &["jobs", "outbound", "http", "cli"]),
    ("std::process", &["jobs", "outbound", "http", "cli"]),
    ("std::time", &["jobs", "outbound", "http", "cli"]),
    ("std::thread", &["jobs", "outbound", "http", "cli"]),
];

/// Lines that a source file may have.
const MOST_LINES: usize = 400;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The Rust files under a folder of the project, sorted.
fn sources(folder: &str) -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![root().join(folder)]);
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

fn name(path: &Path) -> String {
    path.strip_prefix(root()).unwrap().display().to_string()
}

/// A file's code without its comments, and the names of its modules from the crate's root on.
fn code(path: &Path) -> (String, Vec<String>) {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    let modules = path.strip_prefix(root().join("src")).unwrap().with_extension("");
    let mut modules: Vec<_> = modules.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    modules.retain(|module| !["mod", "lib", "main"].contains(&module.as_str()));
    (lines.collect::<Vec<_>>().join("\n"), modules)
}

/// A file's code without its unit tests, which may do as they like.
fn product(path: &Path) -> String {
    if path.file_name().unwrap() == "tests.rs" {
        return String::new();
    }
    let (code, _) = code(path);
    code.split("#[cfg(test)]\nmod tests {").next().unwrap().to_owned()
}

fn is_word(character: char) -> bool {
    character.is_alphanumeric() || character == '_'
}

/// The text behind each `path::` that is not the tail of a longer name or path.
fn behind<'a>(code: &'a str, path: &str) -> Vec<&'a str> {
    let begins = |at: usize| !code[..at].ends_with(|before: char| is_word(before) || before == ':');
    let found = code.match_indices(path).filter(|(at, _)| begins(*at));
    found.filter_map(|(at, _)| code[at + path.len()..].strip_prefix("::")).collect()
}

/// The first names of what a `use` or a path goes on with: `a::b`, or `{a::b, c}`.
fn heads(text: &str) -> Vec<&str> {
    let word = |text: &'_ str| text.find(|character| !is_word(character)).unwrap_or(text.len());
    let Some(list) = text.strip_prefix('{') else { return vec![&text[..word(text)]] };
    let (mut depth, mut begin, mut heads) = (0, 0, Vec::new());
    for (at, character) in list.char_indices() {
        match character {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                let item = list[begin..at].trim();
                heads.push(&item[..word(item)]);
                begin = at + 1;
                if character == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    heads
}

/// The names at the crate's root that a file reaches for.
fn reaches(code: &str, modules: &[String]) -> BTreeSet<String> {
    let out = vec!["super"; modules.len()].join("::");
    let mut found: Vec<&str> = ["crate", "rosaline"].iter().flat_map(|path| behind(code, path)).collect();
    if !out.is_empty() {
        found.extend(behind(code, &out));
    }
    found.into_iter().flat_map(heads).map(str::to_owned).collect()
}

#[test]
fn the_names_behind_crate_and_super_are_found() {
    let code = "use crate::{mesh::{Units, weld}, http};\nuse super::super::jobs::Job;\n\
                fn f() { crate::cli::main(); subcrate::output(); super::near(); }";
    let modules = ["centerline".to_owned(), "tips".to_owned()];
    let names: Vec<_> = reaches(code, &modules).into_iter().collect();
    assert_eq!(names, ["cli", "http", "jobs", "mesh"]);
    assert!(behind("a::tokio::b; my_tokio::c; nottokio", "tokio").is_empty());
    assert_eq!(behind("use tokio::net;", "tokio"), ["net;"]);
}

#[test]
fn every_room_is_known() {
    let folders = fs::read_dir(root().join("src")).unwrap().map(|entry| entry.unwrap().path());
    let found: BTreeSet<_> = folders
        .filter(|path| path.is_dir())
        .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
        .collect();
    assert_eq!(found, MAY_KNOW.iter().map(|(room, _)| (*room).to_owned()).collect());
}

#[test]
fn the_arrows_point_inward() {
    let mut wrong = Vec::new();
    for (room, known) in MAY_KNOW {
        for path in sources(&format!("src/{room}")) {
            let (code, modules) = code(&path);
            for other in reaches(&code, &modules) {
                let is_room = MAY_KNOW.iter().any(|(room, _)| *room == other);
                if is_room && other != room && !known.contains(&other.as_str()) {
                    wrong.push(format!("{} knows {other}", name(&path)));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn crates_stay_in_their_rooms() {
    let mut wrong = Vec::new();
    for (room, _) in MAY_KNOW {
        for path in sources(&format!("src/{room}")) {
            let code = product(&path);
            for (known, rooms) in ONLY_IN {
                if !rooms.contains(&room) && !behind(&code, known).is_empty() {
                    wrong.push(format!("{} uses {known}", name(&path)));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_library_prints_nothing() {
    let mut wrong = Vec::new();
    for path in sources("src") {
        let code = product(&path);
        for word in ["println!", "eprintln!", "print!", "eprint!", "dbg!", "todo!", "unimplemented!"] {
            if code.contains(word) {
                wrong.push(format!("{} has {word}", name(&path)));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn files_stay_short() {
    let mut long = Vec::new();
    for path in ["src", "tests", "benches", "examples"].into_iter().flat_map(sources) {
        let lines = fs::read_to_string(&path).unwrap().lines().count();
        if lines > MOST_LINES {
            long.push(format!("{} has {lines} lines", name(&path)));
        }
    }
    assert!(long.is_empty(), "{long:#?}");
}

/// The links of a document, and the paths in its backticks, that are this project's own.
fn paths_in(document: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(document)).unwrap();
    let links = text.split("](").skip(1).map(|rest| rest.split(')').next().unwrap());
    let links = links.filter(|link| !link.contains("://"));
    let parts = ["src/", "tests/", "scripts/", "benches/", "examples/", "docs/", "samples/", ".ci/"];
    let quoted = text.split('`').skip(1).step_by(2);
    let quoted = quoted.filter(|quote| parts.iter().any(|part| quote.starts_with(part)));
    links.chain(quoted).map(|path| path.split_whitespace().next().unwrap().to_owned()).collect()
}

#[test]
fn the_documents_name_files_that_are_there() {
    for document in ["README.md", "ARCHITECTURE.md"] {
        let paths = paths_in(document);
        assert!(!paths.is_empty(), "{document} names no file");
        for path in paths {
            assert!(root().join(&path).exists(), "{document} names {path}, which is not there");
        }
    }
}

#[test]
fn the_map_names_every_module() {
    let map = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let mut missing = Vec::new();
    for (room, _) in MAY_KNOW {
        for path in sources(&format!("src/{room}")) {
            let module = path.file_stem().unwrap().to_str().unwrap();
            let is_own = path.parent().unwrap() == root().join("src").join(room);
            if is_own && module != "mod" && !map.contains(&format!("`{module}`")) {
                missing.push(name(&path));
            }
        }
    }
    assert!(missing.is_empty(), "ARCHITECTURE.md does not name {missing:#?}");
}

#[test]
fn the_table_of_promises_names_tests_that_there_are() {
    let text = fs::read_to_string(root().join("docs/reliability.md")).unwrap();
    let (_, table) = text.split_once("## What shows which promise").unwrap();
    let is_test = |word: &&str| {
        word.matches('_').count() > 2 && word.chars().all(|one| one == '_' || one.is_ascii_lowercase())
    };
    let named: Vec<&str> = table.split('`').skip(1).step_by(2).filter(is_test).collect();
    assert!(named.len() > 50, "{}", named.len());
    let files = ["src", "tests"].map(sources).concat();
    let code: String = files.iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    for test in named {
        assert!(code.contains(&format!("fn {test}()")), "{test}");
    }
}

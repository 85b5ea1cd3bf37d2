//! The real binary: extract, compare and phantom.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use rosaline::centerline::TABLE;
use rosaline::output::read_json;
use serde_json::Value;

fn rosaline(folder: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rosaline")).current_dir(folder).args(words).output().unwrap()
}

/// Runs, and fails the test with stderr when the exit code is not 0.
fn done(folder: &Path, words: &[&str]) -> Output {
    let output = rosaline(folder, words);
    assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
    output
}

/// The one line on stderr of a run that ends with exit code 1.
fn failure(folder: &Path, words: &[&str]) -> String {
    let output = rosaline(folder, words);
    let line = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words:?}: {line}");
    assert!(output.stdout.is_empty(), "{words:?}");
    assert_eq!(line.lines().count(), 1, "{line}");
    assert!(line.starts_with("rosaline: "), "{line}");
    line
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn files(folder: &Path) -> Vec<String> {
    let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
    let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

/// A folder with the phantom of a bifurcation.
fn bifurcation() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["phantom", "bifurcation", "--seed", "3", "-o", "vessel"]);
    folder
}

#[test]
fn a_phantom_is_extracted_and_measured_against_its_line() {
    let folder = bifurcation();
    let folder = folder.path();
    assert_eq!(files(folder), ["vessel.json", "vessel.stl"]);
    let output = done(folder, &["extract", "vessel.stl", "-o", "line.json"]);
    assert_eq!(text(&output.stdout), "");
    assert!(!text(&output.stderr).contains('%'), "no progress bar off a terminal");
    assert_eq!(files(folder), ["line.json", "vessel.json", "vessel.stl"]);

    let document = read_json(&fs::read(folder.join("line.json")).unwrap()).unwrap();
    assert_eq!(document.source.name, None, "a file's name may tell of a patient");
    for (given, name) in [
        ("case 7", Some("case 7")),
        ("../ward/doe.stl", Some("doe.stl")),
        ("a/", None),
        ("../..", None),
        ("..doe", Some("..doe")),
    ] {
        done(folder, &["extract", "vessel.stl", "-o", "named.json", "--name", given]);
        let named = read_json(&fs::read(folder.join("named.json")).unwrap()).unwrap();
        assert_eq!(named.source.name.as_deref(), name);
    }
    fs::remove_file(folder.join("named.json")).unwrap();
    for given in ["", &"x".repeat(256)] {
        let line = failure(folder, &["extract", "vessel.stl", "-o", "named.json", "--name", given]);
        assert!(line.contains("a name has 1 to 255 characters"), "{line}");
    }
    assert_eq!((document.source.format.as_str(), document.units.as_str()), ("stl", "mm"));
    let truth = read_json(&fs::read(folder.join("vessel.json")).unwrap()).unwrap();
    assert_eq!(document.source.sha256, truth.source.sha256);
    assert_eq!(document.source.vertices, truth.source.vertices);
    assert!((document.source.diagonal - truth.source.diagonal).abs() < 1e-4);
    assert_eq!(truth.method.preset, "phantom");

    let output = done(folder, &["compare", "vessel.json", "line.json", "--json"]);
    let measures: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(measures["tips"], serde_json::json!({"truth": 3, "result": 3}));
    assert_eq!(measures["parts"]["result"], 1);
    let percent = measures["o_mean"]["percent"].as_f64().unwrap();
    let absolute = measures["o_mean"]["absolute"].as_f64().unwrap();
    assert!(percent > 0.0 && percent < 0.1, "{percent}");
    assert!((absolute / truth.source.diagonal * 100.0 - percent).abs() < 1e-9);
    let table = text(&done(folder, &["compare", "vessel.json", "line.json"]).stdout);
    for name in ["O_max", "O_mean", "O_var", "missed", "cover", "excess", "radius", "tips", "loops", "parts"]
    {
        assert!(table.lines().any(|line| line.starts_with(name)), "{name}: {table}");
    }
}

#[test]
fn the_extension_chooses_the_format_and_threads_change_no_byte() {
    let folder = bifurcation();
    let folder = folder.path();
    for name in ["a.json", "a.glb", "a.GLTF", "a.vtp"] {
        done(folder, &["extract", "vessel.stl", "-o", name, "--threads", "1"]);
        let single = fs::read(folder.join(name)).unwrap();
        done(folder, &["extract", "vessel.stl", "-o", name, "--threads", "3"]);
        assert_eq!(fs::read(folder.join(name)).unwrap(), single, "{name}");
    }
    assert!(fs::read(folder.join("a.glb")).unwrap().starts_with(b"glTF"));
    let gltf: Value = serde_json::from_slice(&fs::read(folder.join("a.GLTF")).unwrap()).unwrap();
    assert_eq!(gltf["asset"]["version"], "2.0");
    assert_eq!(gltf["meshes"][0]["primitives"].as_array().unwrap().len(), 3);
    let same: Value =
        serde_json::from_slice(&done(folder, &["compare", "a.json", "a.vtp", "--json"]).stdout).unwrap();
    assert!(same["o_max"]["absolute"].as_f64().unwrap() < 1e-12 && same["tips"]["result"] == 3, "{same}");
}

#[test]
fn verbose_tells_what_was_found_and_how_long_each_stage_took() {
    let folder = bifurcation();
    let output = done(folder.path(), &["extract", "vessel.stl", "-o", "line.json", "-v"]);
    let told = text(&output.stderr);
    assert!(told.contains("3 branches, 3 ends, "), "{told}");
    for stage in rosaline::centerline::Stage::ALL {
        assert!(told.lines().any(|line| line.starts_with(stage.name()) && line.ends_with(" s")), "{told}");
    }
    for part in ["reading", "writing", "total"] {
        assert!(told.lines().any(|line| line.starts_with(part)), "{told}");
    }
}

#[test]
fn times_come_as_json_for_a_program() {
    let folder = bifurcation();
    let output =
        done(folder.path(), &["extract", "vessel.stl", "-o", "line.json", "-v", "--timings", "json"]);
    let told: Value = serde_json::from_slice(&output.stderr).unwrap();
    assert_eq!((&told["branches"], &told["ends"], &told["units"]), (&3.into(), &3.into(), &"mm".into()));
    let seconds = told["seconds"].as_object().unwrap();
    let stages = rosaline::centerline::Stage::ALL.map(|stage| stage.name());
    let all: Vec<&str> = ["reading"].into_iter().chain(stages).chain(["writing"]).collect();
    let sum: f64 = all.iter().map(|stage| seconds[*stage].as_f64().unwrap()).sum();
    let total = seconds["total"].as_f64().unwrap();
    assert!((sum - total).abs() < 1e-6 && seconds["tips"].as_f64().unwrap() > 0.0, "{told}");
    let line = failure(folder.path(), &["extract", "vessel.stl", "-o", "line.json", "--timings", "json"]);
    assert!(line.contains("--verbose"), "{line}");
}

#[test]
fn units_and_parameters_go_into_the_result() {
    let folder = bifurcation();
    let words = ["extract", "vessel.stl", "-o", "line.json", "--units", "cm", "--tip_height", "1.25"];
    done(folder.path(), &words);
    let document: Value =
        serde_json::from_slice(&fs::read(folder.path().join("line.json")).unwrap()).unwrap();
    assert_eq!(document["units"], "cm");
    assert_eq!(document["method"]["preset"], "default");
    assert_eq!(document["method"]["parameters"]["tip_height"], 1.25);
    assert_eq!(document["method"]["parameters"]["smoothing"], false);
    assert_eq!(document["warnings"], serde_json::json!([]));
    // The coordinates are the mesh's own, whatever the unit is called.
    assert!((document["source"]["diagonal"].as_f64().unwrap() - 50.0).abs() < 20.0);
    let line = failure(folder.path(), &["compare", "vessel.json", "line.json"]);
    assert!(line.contains("in mm and the result in cm"), "{line}");
}

#[test]
fn a_parameter_that_the_preset_does_not_use_is_a_warning() {
    let folder = bifurcation();
    let told = done(folder.path(), &["extract", "vessel.stl", "-o", "line.json", "--omega", "0.8"]);
    let told = text(&told.stderr);
    assert!(told.contains("warning: unused-parameter: omega "), "{told}");
    let document = read_json(&fs::read(folder.path().join("line.json")).unwrap()).unwrap();
    assert!(!document.method.parameters.contains_key("omega"));
}

#[test]
fn help_lists_every_parameter_with_unit_range_and_default() {
    let help = text(&done(Path::new("."), &["extract", "--help"]).stdout);
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    for spec in TABLE {
        assert!(help.contains(&format!("--{}", spec.name)), "{}", spec.name);
        assert!(help.contains(spec.doc), "{}", spec.name);
    }
    assert!(help.contains("[unit: diagonal; 0.0005 to 0.2; default: 0.025; preset paper only]"), "{help}");
    let help = text(&done(Path::new("."), &["phantom", "--help"]).stdout);
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(help.contains("in voxels [default: 0, and 0.2 for --noise alone]"), "{help}");
}

#[test]
fn a_failure_is_one_line_and_leaves_no_file() {
    let folder = bifurcation();
    let folder = folder.path();
    fs::write(folder.join("picture.png"), b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR").unwrap();
    fs::write(folder.join("empty.stl"), b"").unwrap();
    let whole = fs::read(folder.join("vessel.stl")).unwrap();
    fs::write(folder.join("half.stl"), &whole[..whole.len() / 2]).unwrap();
    fs::write(folder.join("kept.json"), b"an older result").unwrap();
    fs::write(folder.join("mesh.stl.gz"), b"\x1f\x8b\x08\0\0\0\0\0\0\x03").unwrap();
    let before = files(folder);
    for (words, expected) in [
        (vec!["nothing.stl", "-o", "out.json"], "cannot read nothing.stl"),
        (vec!["picture.png", "-o", "out.json"], "PNG"),
        (vec!["empty.stl", "-o", "out.json"], "empty"),
        (
            vec!["mesh.stl.gz", "-o", "out.json"],
            "gzip-compressed data, not a mesh that is read here; unpack it",
        ),
        (vec!["vessel.json", "-o", "out.json"], "vessel.json is a centerline, the result of an extraction"),
        (vec!["half.stl", "-o", "kept.json"], "ends early"),
        (vec!["vessel.stl", "-o", "out.obj"], ".json, .glb, .gltf or .vtp"),
        (vec!["vessel.stl", "-o", "out"], ".json, .glb, .gltf or .vtp"),
        (vec!["vessel.stl", "-o", "no/such/out.json"], "its folder does not exist"),
        (vec!["vessel.stl", "-o", "out.json", "--mu", "3"], "0.05 to 0.95"),
        (vec!["vessel.stl", "-o", "out.json", "--omega", "nan"], "0.34 to 0.999"),
    ] {
        let words: Vec<_> = ["extract"].into_iter().chain(words).collect();
        let line = failure(folder, &words);
        assert!(line.contains(expected), "{words:?}: {line}");
        assert_eq!(files(folder), before, "{words:?}");
    }
    assert_eq!(fs::read(folder.join("kept.json")).unwrap(), b"an older result");
    let line = failure(folder, &["compare", "vessel.json", "picture.png"]);
    assert!(line.contains("picture.png"), "{line}");
    let line = failure(folder, &["compare", "vessel.json", "vessel.stl"]);
    assert!(line.contains("neither JSON nor XML") && line.contains("-o LINE.json"), "{line}");
    failure(folder, &["phantom", "tree", "--voxel=9", "-o", "coarse"]);
    let line = failure(folder, &["phantom", "bigtree", "--coarse", "-o", "coarse"]);
    assert!(
        line.contains("a voxel of 1.05 mm is too coarse") && line.contains("leave --coarse out"),
        "{line}"
    );
    failure(folder, &["phantom", "tube", "-o", "no/such/prefix"]);
    assert_eq!(files(folder), before);
}

#[test]
fn wrong_arguments_are_one_line_too() {
    for (words, expected) in [
        (vec![], "subcommand"),
        (vec!["extrct"], "unrecognized subcommand 'extrct'; a similar subcommand exists: 'extract'"),
        (vec!["extract"], "<MESH>"),
        (vec!["extract", "a.stl"], "--output <OUT>"),
        (vec!["extract", "a.stl", "-o", "b.json", "--preset", "best"], "paper"),
        (vec!["extract", "a.stl", "-o", "b.json", "--units", "furlong"], "mm, cm, m, um or in"),
        (
            vec!["extract", "a.stl", "-o", "b.json", "--omga", "0.8"],
            "found; a similar argument exists: '--omega'; ",
        ),
        (vec!["extract", "a.stl", "-o", "b.json", "--smoothing", "true"], "as --smoothing=BOOL"),
        (vec!["extract", "a.stl", "-o", "b.json", "--threads", "-1"], "give a whole number, 0 or more"),
        (
            vec!["phantom", "tree", "-o", "a", "--noise", "-1"],
            "'-1' is no argument; a value of --noise is tied to it, as --noise=VOXELS",
        ),
        (vec!["phantom", "tree", "-o", "a", "--noise", "-0.4"], "'-0.4' is no argument; a value of --noise"),
        (vec!["phantom", "tree", "-o", "a", "--noise=-1"], "noise of -1 voxels is not a number from 0 to 1"),
        (vec!["phantom", "tree", "-o", "a", "--voxel", "-1"], "a voxel of -1 mm is not a length"),
        (vec!["phantom", "tree", "-o", "a", "-x"], "unexpected argument '-x' found; --help"),
        (vec!["serve", "--workers", "-1"], "give a whole number, 1 or more"),
        (vec!["serve", "--tls-cert", "a"], "--tls-cert needs --tls-key beside it"),
        (vec!["phantom", "octopus", "-o", "a"], "octopus"),
        (vec!["phantom", "tree", "-o", "a", "--coarse", "--voxel", "1"], "--voxel"),
        (vec!["compare", "a.json"], "RESULT"),
        (vec!["serve", "--max-upload", "much"], "whole number"),
        (vec!["extract", "a.stl", "-o", "b.json", "--threads", "many"], "give a whole number, 0 or more"),
        (vec!["phantom", "tree", "-o", "a", "--seed", "1.5"], "give a whole number, 0 or more"),
        (vec!["phantom", "tree", "-o", "a", "--voxel", "small"], "give a number, 0.4 for example"),
        (vec!["serve", "--threads", "1", "--workers", "2"], "fewer workers"),
    ] {
        let line = failure(Path::new("."), &words);
        assert!(line.contains(expected) && !line.contains("Usage"), "{words:?}: {line}");
    }
    for words in [["--version", ""], ["--help", ""], ["extract", "--help"]] {
        let words: Vec<_> = words.into_iter().filter(|word| !word.is_empty()).collect();
        let output = done(Path::new("."), &words);
        assert!(text(&output.stdout).contains("rosaline") && output.stderr.is_empty(), "{words:?}");
    }
}

#[test]
fn phantoms_have_the_faults_that_were_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let make = |name: &str, more: &[&str]| {
        let words: Vec<_> =
            ["phantom", "tube", "--seed", "2", "-o", name].iter().chain(more).copied().collect();
        done(folder, &words);
        let document: Value =
            serde_json::from_slice(&fs::read(folder.join(format!("{name}.json"))).unwrap()).unwrap();
        (fs::read(folder.join(format!("{name}.stl"))).unwrap(), document)
    };
    let (clean, line) = make("v1.5-clean", &[]);
    assert_eq!(line["source"]["openings"], 0);
    assert_eq!(line["method"]["parameters"]["seed"], 2.0);
    assert_eq!(make("again", &[]).0, clean);
    for (name, words, parameter, value) in [
        ("noise", vec!["--noise"], "noise", Value::from(0.2)),
        ("rough", vec!["--noise=0.4"], "noise", Value::from(0.4)),
        ("stair", vec!["--stair"], "stair", Value::from(true)),
        ("coarse", vec!["--coarse"], "voxel", Value::from(3.0 * 0.4)),
        ("voxel", vec!["--voxel", "0.7"], "voxel", Value::from(0.7)),
        ("open", vec!["--open"], "open", Value::from(true)),
    ] {
        let (surface, document) = make(name, &words);
        assert_ne!(surface, clean, "{name}");
        assert_eq!(document["method"]["parameters"][parameter], value, "{name}");
        assert_eq!(document["branches"], line["branches"], "{name}");
        assert_eq!(document["source"]["openings"], if name == "open" { 2 } else { 0 }, "{name}");
    }
}

/// People are told that there is nothing; programs read an empty list, as before.
#[test]
fn an_empty_list_is_told_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    for (what, hint) in [("keys", "keys add NAME"), ("webhooks", "webhooks add NAME")] {
        // Nothing is made by looking, and a folder that is not there has no empty list.
        for data in [&[][..], &["--data", "nope"]] {
            for act in [&["list"][..], &["rotate", "pacs"]] {
                let line = failure(folder.path(), &[&[what], act, data].concat());
                assert!(line.contains("there is no data folder") && line.contains("--data"), "{line}");
            }
        }
        assert!(files(folder.path()).is_empty());
        let named = failure(folder.path(), &[what, "list", &format!("--{what}"), "nope.json"]);
        assert!(named.contains("nope.json is not there") && named.contains(hint), "{named}");
    }
    fs::create_dir(folder.path().join("data")).unwrap();
    for (what, hint) in [("keys", "keys add NAME"), ("webhooks", "webhooks add NAME")] {
        let output = done(folder.path(), &[what, "list"]);
        assert!(output.stdout.is_empty() && text(&output.stderr).contains(hint), "{what}: {output:?}");
        let output = done(folder.path(), &[what, "list", "--data", "data"]);
        assert!(text(&output.stderr).contains("--data data' "), "{output:?}");
    }
}

#[test]
fn what_is_made_where_nobody_said_is_told_to_be_there() {
    let folder = tempfile::tempdir().unwrap();
    let key = ["keys", "add", "pacs", "--scope", "read"];
    let output = done(folder.path(), &key);
    assert!(text(&output.stdout).starts_with("rosaline_"));
    assert!(
        text(&output.stderr).contains("what was added is in data/keys.json; a service with another --data"),
        "{output:?}"
    );
    let output = done(folder.path(), &[&key[..], &["--data", "other"]].concat());
    let made = text(&output.stderr).contains("there was no data folder other");
    assert!(made && folder.path().join("other/keys.json").is_file(), "{output:?}");
    let again = done(folder.path(), &["keys", "add", "viewer", "--scope", "read", "--data", "other"]);
    assert!(again.stderr.is_empty(), "{again:?}");
}

/// It may be right, as its key may be made later: then it is told, and the target is added all the same.
#[test]
fn a_target_for_an_owner_whom_nobody_knows_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["keys", "add", "pacs", "--scope", "read", "--data", "data"]);
    done(folder.path(), &["keys", "add", "old", "--scope", "read", "--data", "data"]);
    done(folder.path(), &["keys", "revoke", "old", "--data", "data"]);
    let url = ["--url", "http://127.0.0.1:1/", "--data", "data"];
    for (owner, doubt) in [
        ("pacs", ""),
        ("old", ""),
        ("https://login.example#anna", ""),
        ("nobody", "warning: no key in data/keys.json has the name 'nobody'"),
    ] {
        let words = ["webhooks", "add", &owner.replace([':', '/', '#'], "."), "--owner", owner];
        let said = text(&done(folder.path(), &[&words[..], &url].concat()).stderr);
        assert!(said.contains(doubt) && said.is_empty() == doubt.is_empty(), "{owner}: {said}");
    }
    let words = ["webhooks", "add", "more", "--owner", "pacs", "--keys", "elsewhere.json"];
    let said = text(&done(folder.path(), &[&words[..], &url].concat()).stderr);
    assert!(said.contains("no key in elsewhere.json"), "{said}");
    failure(folder.path(), &[&["webhooks", "add", "x", "--owner", ""][..], &url].concat());
    assert_eq!(text(&done(folder.path(), &["webhooks", "list"]).stdout).lines().count(), 5);
}

#[test]
fn a_line_as_glb_is_refused_with_what_is_read() {
    let folder = bifurcation();
    let folder = folder.path();
    for (name, what) in [("line.glb", "a GLB"), ("line.gltf", "a glTF")] {
        done(folder, &["extract", "vessel.stl", "-o", name]);
        let line = failure(folder, &["compare", "vessel.json", name]);
        assert!(line.contains(name) && line.contains(&format!("this is {what};")), "{line}");
        assert!(line.contains("results/centerline.json") && line.contains(".vtp"), "{line}");
    }
}

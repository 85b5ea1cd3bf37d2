//! The README's commands, run as they are printed.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[path = "common/service.rs"]
#[allow(dead_code, reason = "shared with the tests of the service, which use all of it")]
mod service;

use std::fs;
use std::path::Path;
use std::process::Command;

use rosaline::centerline::{POINTS, ParameterKind, TABLE};
use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::output::{ResultDocument, read_json};
use serde_json::Value;
use service::Service;

const RELEASE: &str = "target/release/rosaline";
const ADDRESS: &str = "http://127.0.0.1:8080";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn readme() -> String {
    fs::read_to_string(root().join("README.md")).unwrap()
}

/// The README's blocks for a shell, one after the other.
fn shell_blocks(text: &str) -> String {
    let blocks = text.split("```sh\n").skip(1);
    blocks.map(|rest| rest.split("```").next().unwrap()).collect()
}

fn document(path: &Path) -> ResultDocument {
    read_json(&fs::read(path).unwrap()).unwrap()
}

/// The README's result is that of its sample, shortened.
fn assert_is_shown_by_the_readme(result: &ResultDocument) {
    let text = readme();
    let json = text.split("```json\n").nth(1).unwrap().split("```").next().unwrap();
    let shown: Value = serde_json::from_str(json).unwrap();
    let whole = serde_json::to_value(result).unwrap();
    for member in ["schema", "units", "method", "warnings"] {
        assert_eq!(shown[member], whole[member], "{member}");
    }
    for (name, value) in shown["source"].as_object().unwrap() {
        let found = &whole["source"][name];
        match name.as_str() {
            "sha256" => {
                assert!(found.as_str().unwrap().starts_with(value.as_str().unwrap().trim_end_matches('.')))
            }
            "diagonal" => {
                assert!((found.as_f64().unwrap() - value.as_f64().unwrap()).abs() < 0.005, "{found}")
            }
            _ => assert_eq!(found, value, "{name}"),
        }
    }
}

#[test]
fn the_documents_list_every_parameter_as_the_table_has_it() {
    let document = fs::read_to_string(root().join("docs/method.md")).unwrap();
    let begin = document.find("\n## Parameters\n").unwrap();

    for spec in TABLE {
        let word = |value: f64| match spec.kind {
            ParameterKind::Number { .. } => value.to_string(),
            ParameterKind::Flag => (value != 0.0).to_string(),
        };
        let range = match spec.kind {
            ParameterKind::Number { min, max } => format!("{min} to {max}"),
            ParameterKind::Flag => "true or false".to_owned(),
        };
        let (default, paper) = (spec.default.map_or("not used".to_owned(), word), word(spec.paper));
        let row =
            format!("| `{}` | {} | {range} | {default} | {paper} | {} |", spec.name, spec.unit, spec.doc);
        assert!(document[begin..].contains(&row), "docs/method.md lacks: {row}");
    }
    for spec in POINTS {
        let most = if spec.most > 1 { format!("up to {}", spec.most) } else { "1".to_owned() };
        let row = format!("| `{}` | {most} | {} |", spec.name, spec.doc);
        assert!(document[begin..].contains(&row), "docs/method.md lacks: {row}");
    }
}

#[test]
fn the_commands_do_what_the_readme_says() {
    if Command::new("curl").arg("--version").output().is_err() {
        println!("skipped: curl is not installed");
        return;
    }
    let blocks = shell_blocks(&readme());
    assert!(blocks.contains(ADDRESS) && blocks.contains(RELEASE), "{blocks}");
    let service = Service::start(&[]);
    let commands = blocks.replace(RELEASE, env!("CARGO_BIN_EXE_rosaline")).replace(ADDRESS, &service.url);
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(root().join("samples"), folder.path().join("samples")).unwrap();

    let output = Command::new("sh").args(["-euxc", &commands]).current_dir(folder.path()).output().unwrap();
    let (answers, trace) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success(), "{trace}{answers}");
    assert!(answers.contains(r#""status":"successful""#), "{answers}");
    let [posted, extracted, _known] =
        ["line.json", "tree-line.json", "vessel.json"].map(|name| document(&folder.path().join(name)));
    assert_eq!(posted.branches, extracted.branches);
    assert_eq!(posted.nodes, extracted.nodes);
    assert_is_shown_by_the_readme(&posted);
    for name in ["line.glb", "tree-line.glb"] {
        assert!(fs::read(folder.path().join(name)).unwrap().starts_with(b"glTF"), "{name}");
    }
}

#[test]
fn the_sample_is_what_its_command_makes() {
    let text = readme();
    let begin = text.find(&format!("{RELEASE} phantom tree")).unwrap();
    let command = text[begin..].split('`').next().unwrap();
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("samples")).unwrap();
    let words = command.split_whitespace().skip(1);
    let made =
        Command::new(env!("CARGO_BIN_EXE_rosaline")).args(words).current_dir(folder.path()).status().unwrap();
    assert!(made.success(), "{command}");

    let mesh = |folder: &Path| {
        let bytes = fs::read(folder.join("samples/tree.stl")).unwrap();
        read(&bytes, Hint::default(), &Limits::default()).unwrap().0
    };
    let (shipped, made) = (mesh(root()), mesh(folder.path()));
    assert_eq!(shipped.triangles, made.triangles);
    let apart = shipped.vertices.iter().zip(&made.vertices).map(|(a, b)| (a - b).norm());
    assert!(apart.fold(0.0, f64::max) < 1e-4, "the same but for the rounding of other machines");
    let lines = [root(), folder.path()].map(|folder| document(&folder.join("samples/tree.json")));
    assert_eq!(lines[0].branches.len(), lines[1].branches.len());
    let radii =
        |line: &ResultDocument| line.nodes.iter().map(|node| node.equivalent_radius).collect::<Vec<_>>();
    assert_eq!(radii(&lines[0]).len(), radii(&lines[1]).len());
    assert!(
        radii(&lines[0]).iter().zip(radii(&lines[1])).all(|(a, b)| (a - b).abs() < 1e-4),
        "of this version"
    );
}

//! The README's commands, run as they are printed.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "common/service.rs"]
#[allow(dead_code, reason = "shared with the tests of the service, which use all of it")]
mod service;

use std::fs;
use std::path::Path;
use std::process::Command;

use rosaline::mesh::format::{Hint, Limits, read};
use rosaline::output::{ResultDocument, read_json};
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
}

//! The Khronos validator and three.js, where their packages are installed.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// The script and its folder of packages; `None` after a line that says what is missing.
pub fn checker() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/gltf");
    if !folder.join("node_modules/three").exists() || !folder.join("node_modules/gltf-validator").exists() {
        println!("skipped: run `npm ci` in scripts/gltf for the Khronos validator and three.js");
        return None;
    }
    if Command::new("node").arg("--version").output().is_err() {
        println!("skipped: node is not installed");
        return None;
    }
    Some(folder.join("check.mjs"))
}

/// What both say of each file, after a check that the validator finds nothing in any.
pub fn checked(script: &Path, files: &[PathBuf]) -> Vec<Value> {
    let output = Command::new("node").arg(script).args(files).output().unwrap();
    let complaint = String::from_utf8_lossy(&output.stderr);
    let text = String::from_utf8_lossy(&output.stdout);
    let reports: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(reports.len(), files.len(), "{complaint}");
    for report in &reports {
        assert_eq!(report["messages"], serde_json::json!([]), "{}", report["file"]);
    }
    assert!(output.status.success(), "{complaint}");
    reports
}

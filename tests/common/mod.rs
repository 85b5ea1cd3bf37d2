//! What several integration tests need.

use std::path::PathBuf;

/// The folder of shared meshes and phantoms beside the project; without it a test skips.
pub fn shared() -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared");
    if !folder.is_dir() {
        println!("skipped: ../shared is not beside the project");
        return None;
    }
    Some(folder)
}

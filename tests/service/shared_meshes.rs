//! The shared meshes and phantoms, posted over HTTP.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::common;
use crate::service::Service;
use crate::submission::assert_fits;

/// Every surface in a shared folder: the other files are centerlines.
fn surfaces(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = entries
        .filter(|path| matches!(path.extension().and_then(|text| text.to_str()), Some("stl" | "vtp")))
        .filter(|path| !path.to_string_lossy().contains("centerlines"))
        .collect();
    files.sort();
    files
}

#[tokio::test]
async fn every_shared_surface_ends_successful() {
    let Some(shared) = common::shared() else { return };
    let service = Service::start(&[]);
    let mut jobs = Vec::new();
    for path in surfaces(&shared.join("meshes")).into_iter().chain(surfaces(&shared.join("phantoms"))) {
        let job = service.accepted("", std::fs::read(&path).unwrap()).await;
        jobs.push((path.file_name().unwrap().to_owned(), job));
    }
    assert!(jobs.len() > 20, "{jobs:?}");
    for (name, job) in &jobs {
        let status = service.ended(job).await;
        assert_eq!(status["status"], "successful", "{name:?}: {status}");
        let response = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
        let result: Value = response.json().await.unwrap();
        assert_fits("ResultDocument", &result);
        assert!(!result["branches"].as_array().unwrap().is_empty(), "{name:?}");
        let response = service.get(&format!("{job}/results/centerline.glb")).send().await.unwrap();
        let glb = response.bytes().await.unwrap();
        let glb = gltf::Gltf::from_slice(&glb).unwrap();
        assert!(glb.blob.is_some());
        let lines = glb.meshes().flat_map(|mesh| mesh.primitives().collect::<Vec<_>>()).count();
        assert_eq!(lines, result["branches"].as_array().unwrap().len(), "{name:?}");
    }
}

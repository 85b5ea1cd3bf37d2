//! The shared meshes and phantoms, posted over HTTP.

use std::path::{Path, PathBuf};

use rosaline::compare::{Line, measure};
use serde_json::Value;

use crate::service::Service;
use crate::submission::assert_fits;
use crate::{common, gltf_checker};

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

/// Phantoms with the figures that they are held to.
const EXACT: [&str; 6] = ["tube", "bifurcation", "tree", "trifurcation", "stenosis", "parallel"];

/// A phantom's result against its known line: what it misses, if anything.
fn faults(truth: &Path, result: &[u8]) -> Option<String> {
    let known = Line::read(&std::fs::read(truth).unwrap()).unwrap();
    let measures = measure(&known, &Line::read(result).unwrap()).unwrap();
    let name = truth.file_name().unwrap().to_str().unwrap().strip_suffix(".gt.json").unwrap();
    let (mean, max) = (measures.o_mean.percent, measures.o_max.percent);
    let near = !EXACT.contains(&name) || (mean <= 0.1 && max <= 1.0);
    let told = format!(
        "{name}: O_mean {mean:.4} %, O_max {max:.4} %, tips {:?}, loops {:?}, parts {:?}",
        measures.tips, measures.loops, measures.parts
    );
    println!("{told}");
    (!measures.same_topology() || !near).then_some(told)
}

#[tokio::test]
async fn every_shared_surface_ends_successful_and_every_phantom_as_near_as_promised() {
    let Some(shared) = common::shared() else { return };
    let service = Service::start(&[]);
    let mut jobs = Vec::new();
    for path in surfaces(&shared.join("meshes")).into_iter().chain(surfaces(&shared.join("phantoms"))) {
        let job = service.accepted("", std::fs::read(&path).unwrap()).await;
        jobs.push((path, job));
    }
    assert!(jobs.len() > 20, "{jobs:?}");
    let folder = tempfile::tempdir().unwrap();
    let (mut files, mut far, mut measured) = (Vec::new(), Vec::new(), 0);
    for (path, job) in &jobs {
        let name = path.file_name().unwrap().to_str().unwrap();
        let status = service.ended(job).await;
        assert_eq!(status["status"], "successful", "{name}: {status}");
        let response = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
        let json = response.bytes().await.unwrap();
        let result: Value = serde_json::from_slice(&json).unwrap();
        assert_fits("ResultDocument", &result);
        assert!(!result["branches"].as_array().unwrap().is_empty(), "{name}");
        let truth = path.with_extension("gt.json");
        if truth.is_file() {
            measured += 1;
            far.extend(faults(&truth, &json));
        }
        let response = service.get(&format!("{job}/results/centerline.glb")).send().await.unwrap();
        let glb = response.bytes().await.unwrap();
        files.push(folder.path().join(format!("{name}.glb")));
        std::fs::write(files.last().unwrap(), &glb).unwrap();
        let glb = gltf::Gltf::from_slice(&glb).unwrap();
        assert!(glb.blob.is_some());
        let lines = glb.meshes().flat_map(|mesh| mesh.primitives().collect::<Vec<_>>()).count();
        assert_eq!(lines, result["branches"].as_array().unwrap().len(), "{name}");
    }
    assert!(measured >= EXACT.len(), "{measured} phantoms");
    assert!(far.is_empty(), "{}", far.join("\n"));
    if let Some(script) = gltf_checker::checker() {
        gltf_checker::checked(&script, &files);
    }
}

//! The queue with the real runner: meshes in, centerlines out.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::{TryStreamExt, stream};
use jobs_fakes::{ended, running, settings};
use rosaline::centerline::{CancelToken, Control, Parameters, Preset, Progress, Stage, extract};
use rosaline::jobs::extraction::Extraction;
use rosaline::jobs::{FileName, FormatHint, Job, JobId, JobService, JobSpec, JobStatus, Settings};
use rosaline::mesh::Units;
use rosaline::mesh::format::{Limits, write_stl_binary};
use rosaline::output::{OutputFormat, read_json};
use rosaline::phantom::{self, Kind};
use sha2::{Digest, Sha256};

async fn submit(service: &JobService, bytes: &[u8], spec: JobSpec) -> Job {
    let body = stream::iter([Ok(Bytes::copy_from_slice(bytes))]);
    service.submit(service.upload(body, u64::MAX).await.unwrap(), spec).await.unwrap()
}

async fn read(service: &JobService, id: JobId, format: OutputFormat) -> Vec<u8> {
    let artifact = service.result(id, format).await.unwrap();
    let reader = service.open_result(&artifact, None).await.unwrap();
    reader.try_collect::<Vec<Bytes>>().await.unwrap().concat()
}

fn stl(kind: Kind) -> Vec<u8> {
    let phantom = phantom::generate(kind, 1, &phantom::Settings::of(kind)).unwrap();
    let mut bytes = Vec::new();
    write_stl_binary(&phantom.mesh, &mut bytes).unwrap();
    bytes
}

/// The results of a job on pools of this many threads.
async fn results(threads: usize, bytes: &[u8], spec: &JobSpec) -> Vec<Vec<u8>> {
    let dir = tempfile::tempdir().unwrap();
    let settings = Settings {
        threads_per_worker: NonZeroUsize::new(threads).unwrap(),
        ..settings(&dir.path().join("data"), 1)
    };
    let service = JobService::open(settings, Arc::new(Extraction::default())).await.unwrap();
    let job = submit(&service, bytes, spec.clone()).await;
    let done = ended(&service, job.id).await;
    assert_eq!((done.status, done.error), (JobStatus::Successful, None));
    let mut results = Vec::new();
    for format in OutputFormat::ALL {
        results.push(read(&service, job.id, format).await);
    }
    service.shutdown(Duration::from_secs(5)).await;
    results
}

#[tokio::test(flavor = "multi_thread")]
async fn a_vessel_becomes_its_centerline_in_every_format_and_the_same_on_any_pool() {
    let mesh = stl(Kind::Bifurcation);
    let mut parameters = Parameters::of(Preset::Default);
    parameters.set("tip_height", "1.25").unwrap();
    let spec = JobSpec {
        hint: FormatHint { extension: Some("stl".into()), content_type: Some("model/stl".into()) },
        name: Some(FileName::new("aorta.stl")),
        units: Units::Centimetres,
        parameters: (&parameters).into(),
        ..JobSpec::default()
    };
    let one = results(1, &mesh, &spec).await;
    let document = read_json(&one[0]).unwrap();
    assert_eq!((document.branches.len(), document.nodes.len()), (3, 4));
    assert_eq!((document.units.as_str(), document.source.format.as_str()), ("cm", "stl"));
    assert_eq!(document.source.name.as_deref(), Some("aorta.stl"));
    let sha256: String = Sha256::digest(&mesh).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(document.source.sha256, sha256);
    let document = serde_json::to_value(&document).unwrap();
    assert_eq!(document["method"]["parameters"]["tip_height"], 1.25);
    assert_eq!(&one[1][..4], b"glTF");
    let gltf: serde_json::Value = serde_json::from_slice(&one[2]).unwrap();
    assert_eq!(gltf["asset"]["version"], "2.0");
    assert_eq!(results(3, &mesh, &spec).await, one, "the same bytes on one thread and on three");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_meshes_fail_with_their_reason_and_the_service_lives_on() {
    let dir = tempfile::tempdir().unwrap();
    let limits = Limits { triangles: 1_000_000, ..Limits::default() };
    let runner = Arc::new(Extraction::new(limits));
    let service = JobService::open(settings(dir.path(), 1), runner).await.unwrap();
    let good = stl(Kind::Tube);
    let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    let mut lying = good.clone();
    lying[80..84].copy_from_slice(&20_000_000_u32.to_le_bytes());
    let mut nan = good.clone();
    nan[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    let flat = b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n".to_vec();
    for (bytes, statuses) in [
        (Vec::new(), [400, 400]),
        (png, [415, 415]),
        (good[..good.len() / 2].to_vec(), [400, 400]),
        (lying, [400, 413]),
        (nan, [422, 422]),
        (flat, [422, 422]),
    ] {
        let job = submit(&service, &bytes, JobSpec::default()).await;
        let failed = ended(&service, job.id).await;
        let failure = failed.error.unwrap();
        println!("{failure:?}");
        assert!(failed.status == JobStatus::Failed && statuses.contains(&failure.status), "{failure:?}");
        assert!(!failure.code.is_empty() && failure.code != "internal-error");
    }
    let mut spec = JobSpec::default();
    spec.parameters.values.insert("of_a_later_version".into(), 1.0);
    let job = submit(&service, &good, spec).await;
    let failure = ended(&service, job.id).await.error.unwrap();
    assert_eq!((failure.code.as_str(), failure.status), ("stale-parameters", 422));
    let job = submit(&service, &good, JobSpec::default()).await;
    assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dismissed_extraction_frees_its_worker_soon() {
    let dir = tempfile::tempdir().unwrap();
    let service = JobService::open(settings(dir.path(), 1), Arc::new(Extraction::default())).await.unwrap();
    let mesh = stl(Kind::Bigtree);
    let job = submit(&service, &mesh, JobSpec::default()).await;
    let began = Instant::now();
    assert_eq!(ended(&service, job.id).await.status, JobStatus::Successful);
    let whole = began.elapsed();
    let mut slowest = Duration::ZERO;
    for tenths in 1..10 {
        let job = submit(&service, &mesh, JobSpec::default()).await;
        running(&service, job.id).await;
        tokio::time::sleep(whole * tenths / 12).await;
        let began = Instant::now();
        service.remove(job.id).await.unwrap();
        // The one worker takes this job when the dismissed one has stopped.
        let next = submit(&service, b"", JobSpec::default()).await;
        ended(&service, next.id).await;
        slowest = slowest.max(began.elapsed());
    }
    println!("bigtree takes {whole:?}; dismissed to next job done, slowest of 9: {slowest:?}");
    assert!(slowest < Duration::from_secs(1), "{slowest:?}");
    service.shutdown(Duration::from_secs(5)).await;
}

/// Three tubes, of which each goes through the stages after the one before.
#[test]
fn components_share_the_progress_by_their_vertices() {
    let tube = phantom::generate(Kind::Tube, 1, &phantom::Settings::of(Kind::Tube)).unwrap().mesh;
    let mut mesh = tube.clone();
    for copy in 1..3_u32 {
        let first = u32::try_from(mesh.vertices.len()).unwrap();
        let aside = 1000.0 * f64::from(copy);
        mesh.vertices.extend(tube.vertices.iter().map(|p| nalgebra::Point3::new(p.x + aside, p.y, p.z)));
        mesh.triangles.extend(tube.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
    }
    let ends = std::sync::Mutex::new(Vec::new());
    let progress = |Progress { stage, part, .. }: Progress| {
        let mut ends = ends.lock().unwrap();
        let end = if stage == Stage::Preparation { 0.0 } else { part.overall(1.0) };
        if ends.last() != Some(&end) {
            ends.push(end);
        }
    };
    let control = Control::new(CancelToken::new(), &progress);
    let found = extract(&mesh, &Parameters::default(), &control).unwrap();
    assert_eq!(found.centerline.branches.len(), 3);
    let ends = ends.into_inner().unwrap();
    let expected = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0];
    assert!(ends.len() == 4 && ends.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{ends:?}");
}

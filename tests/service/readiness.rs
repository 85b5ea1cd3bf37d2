//! Whether requests should come now, and what is answered while the operator's files cannot be read.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use serde_json::Value;

use crate::meshes;
use crate::service::{Service, command, problem, without_settings};
use crate::small_disk::SmallDisk;
use crate::tls::logged;

/// What `rosaline` prints.
fn told(data: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    let output = command.env("ROSALINE_DATA", data).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

/// It is not ready, and the only reason says this; no folder of the machine is told to whoever asks.
async fn unready(service: &Service, reason: &str) {
    let response = service.get("/readyz").send().await.unwrap();
    assert!(response.headers().contains_key("retry-after"));
    let body = problem(response, 503, "not-ready").await;
    let reasons = body["reasons"].as_array().unwrap();
    assert!(reasons.len() == 1 && reasons[0].as_str().unwrap().contains(reason), "{body}");
    assert!(!body.to_string().contains(service.data().to_str().unwrap()), "{body}");
    assert_eq!(service.get("/healthz").send().await.unwrap().status(), 200);
}

#[tokio::test]
async fn readiness_says_why_not() {
    let service = Service::start(&[]);
    let (blobs, away) = (service.data().join("blobs"), service.data().join("away"));
    std::fs::rename(&blobs, &away).unwrap();
    let response = service.get("/readyz").send().await.unwrap();
    assert!(response.headers().contains_key("retry-after"));
    let body = problem(response, 503, "not-ready").await;
    assert!(!body["reasons"].as_array().unwrap().is_empty(), "{body}");
    assert_eq!(service.get("/healthz").send().await.unwrap().status(), 200);
    std::fs::rename(&away, &blobs).unwrap();
    service.assert_alive().await;
}

#[tokio::test]
async fn a_disk_without_room_is_not_ready() {
    let service = Service::start(&["--min-free", "100000GiB"]);
    unready(&service, "MiB are free on the data folder's disk").await;
    drop(service);
    let Some(disk) = SmallDisk::mount() else { return };
    let data = disk.path().join("data");
    let service = Service::start(&["--min-free", "2MiB", "--data", data.to_str().unwrap()]);
    service.assert_alive().await;
    disk.fill();
    let response = service.get("/readyz").send().await.unwrap();
    let body = problem(response, 503, "not-ready").await;
    assert!(body["detail"].as_str().unwrap().contains("free space on it"), "{body}");
    disk.free();
    service.assert_alive().await;
}

#[tokio::test]
async fn a_data_folder_that_cannot_be_written_is_not_ready() {
    let service = Service::start(&[]);
    // In the way of the file that is tried, also for a user who may write everywhere.
    let probe = service.data().join("probe");
    std::fs::create_dir(&probe).unwrap();
    unready(&service, "the data folder cannot be written").await;
    std::fs::remove_dir(&probe).unwrap();
    service.assert_alive().await;
}

/// A valid key is not called wrong, and one that was revoked does not come alive.
#[tokio::test]
async fn keys_that_cannot_be_read_are_a_fault_of_the_service() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = told(data.path(), &["keys", "add", "pacs", "--scope", "submit,read"]);
    let revoked = told(data.path(), &["keys", "add", "left", "--scope", "submit,read"]);
    told(data.path(), &["keys", "revoke", "left"]);
    let service = Service::start_on(data.clone(), &[]);
    let list = |key: &str| service.get("/v1/jobs").bearer_auth(key).send();
    let file = data.path().join("keys.json");
    let good = std::fs::read(&file).unwrap();
    let damages: [fn(&Path); 2] =
        [|file| std::fs::write(file, "{").unwrap(), |file| std::fs::remove_file(file).unwrap()];
    for damage in damages {
        assert_eq!(list(&key).await.unwrap().status(), 200);
        problem(list(&revoked).await.unwrap(), 401, "unauthenticated").await;
        service.assert_alive().await;
        damage(&file);
        let told = service.log().matches("not ready").count();
        for _ in 0..3 {
            unready(&service, "the file of the keys cannot be read").await;
        }
        logged(&service, "not ready", told + 1).await;
        assert_eq!(service.log().matches("not ready").count(), told + 1, "once, not at each probe");
        for key in [&key, &revoked] {
            let response = list(key).await.unwrap();
            assert!(response.headers().contains_key("retry-after"));
            problem(response, 503, "keys-unavailable").await;
        }
        let request = service.post("/v1/jobs").bearer_auth(&key).body(meshes::small());
        problem(request.send().await.unwrap(), 503, "keys-unavailable").await;
        problem(service.get("/v1/jobs").send().await.unwrap(), 401, "unauthenticated").await;
        assert!(service.log().contains("no key is let in"), "{}", service.log());
        std::fs::write(&file, &good).unwrap();
    }
    assert_eq!(list(&key).await.unwrap().status(), 200);
    problem(list(&revoked).await.unwrap(), 401, "unauthenticated").await;
    service.assert_alive().await;
}

/// Starts the service as a user whose right to read a file can be taken away; `None` where that cannot be tried.
pub fn as_a_user(data: &Arc<tempfile::TempDir>, arguments: &[&str]) -> Option<Service> {
    use std::os::unix::process::CommandExt;

    const NOBODY: u32 = 65534;
    let mut command = command(data.path());
    command.args(arguments);
    let files = std::fs::read_dir(data.path()).unwrap().map(|entry| entry.unwrap().path());
    let mut all = files.chain([data.path().to_owned()]);
    if all.all(|path| std::os::unix::fs::chown(path, Some(NOBODY), Some(NOBODY)).is_ok()) {
        let mut tried = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        if tried.arg("--version").uid(NOBODY).gid(NOBODY).output().is_err() {
            eprintln!("skipped: another user may not run the program");
            return None;
        }
        command.uid(NOBODY).gid(NOBODY);
    }
    Some(Service::try_start(&mut command, data.clone()).unwrap())
}

/// The file's bytes and its time of change stay the same.
#[tokio::test]
async fn a_right_that_is_taken_away_counts_at_once_for_keys_and_readiness() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let key = told(data.path(), &["keys", "add", "pacs", "--scope", "submit,read"]);
    let Some(service) = as_a_user(&data, &[]) else { return };
    let file = data.path().join("keys.json");
    let allow = |mode: u32| {
        std::fs::set_permissions(&file, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
    };
    let list = || service.get("/v1/jobs").bearer_auth(&key).send();
    for _ in 0..3 {
        assert_eq!(list().await.unwrap().status(), 200);
        service.assert_alive().await;
        allow(0o000);
        problem(list().await.unwrap(), 503, "keys-unavailable").await;
        unready(&service, "the file of the keys cannot be read").await;
        allow(0o600);
        service.assert_alive().await;
    }
}

#[tokio::test]
async fn webhook_targets_that_cannot_be_read_are_not_ready() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    told(data.path(), &["webhooks", "add", "pacs", "--url", "http://127.0.0.1:9/"]);
    let service = Service::start_on(data.clone(), &[]);
    service.assert_alive().await;
    let file = data.path().join("webhooks.json");
    let good = std::fs::read(&file).unwrap();
    std::fs::write(&file, "{").unwrap();
    unready(&service, "the file of the webhook targets cannot be read").await;
    std::fs::remove_file(&file).unwrap();
    unready(&service, "the file of the webhook targets cannot be read").await;
    std::fs::write(&file, &good).unwrap();
    service.assert_alive().await;
    let ready: Value = service.get("/readyz").send().await.unwrap().json().await.unwrap();
    assert_eq!(ready["status"], "ready");
}

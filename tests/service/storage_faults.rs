//! A full disk, a disk that is read-only, and one that is away.

use std::process::Command;
use std::sync::Arc;

use crate::meshes;
use crate::service::{Service, problem};
use crate::small_disk::SmallDisk;

/// Settings that put the data onto `disk`.
fn on(disk: &SmallDisk) -> [String; 2] {
    ["--data".to_owned(), disk.path().join("data").to_str().unwrap().to_owned()]
}

fn start(arguments: &[String]) -> Service {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    Service::start_on(Arc::new(tempfile::tempdir().unwrap()), &arguments)
}

#[tokio::test]
async fn on_a_full_disk_jobs_can_be_purged_and_the_service_starts() {
    let Some(disk) = SmallDisk::mount() else { return };
    let mut service = start(&on(&disk));
    let (first, second) =
        (service.accepted("", meshes::small()).await, service.accepted("", meshes::small()).await);
    for job in [&first, &second] {
        assert_eq!(service.ended(job).await["status"], "successful");
    }
    disk.fill();
    problem(service.submit("", meshes::large()).await, 507, "storage-full").await;
    assert_eq!(service.status(&first).await["status"], "successful");
    assert_eq!(service.delete(&first).send().await.unwrap().status(), 204);
    problem(service.get(&first).send().await.unwrap(), 404, "job-not-found").await;

    // What that freed is filled too.
    disk.fill();
    service.kill();
    drop(service);
    let service = start(&on(&disk));
    assert_eq!(service.status(&second).await["status"], "successful");
    problem(service.get(&first).send().await.unwrap(), 404, "job-not-found").await;
    disk.fill();
    assert_eq!(service.delete(&second).send().await.unwrap().status(), 204);
    disk.free();
    let next = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&next).await["status"], "successful");
}

fn mount(arguments: &[&str]) -> bool {
    Command::new("mount").args(arguments).output().is_ok_and(|output| output.status.success())
}

#[tokio::test]
async fn a_read_only_disk_is_no_fault_of_the_client_and_no_purge() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let blobs = data.path().join("blobs");
    std::fs::create_dir(&blobs).unwrap();
    let folder = blobs.to_str().unwrap().to_owned();
    if !mount(&["-t", "tmpfs", "-o", "size=8m", "tmpfs", &folder]) {
        println!("skipped: a tmpfs cannot be mounted here");
        return;
    }
    let service = Service::start_on(data.clone(), &[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let files = service.files();
    assert!(mount(&["-o", "remount,ro", &folder]));

    let response = service.submit("", meshes::small()).await;
    assert!(response.headers().contains_key("retry-after"));
    problem(response, 503, "storage-unavailable").await;
    let response = service.delete(&job).send().await.unwrap();
    problem(response, 503, "storage-unavailable").await;
    assert_eq!(service.files(), files);
    assert_eq!(service.status(&job).await["status"], "successful", "its files are there, so is its row");

    // Also after a restart, which ends the purge once it can.
    let service = service.restart(&[]);
    assert_eq!(service.status(&job).await["status"], "successful");
    problem(service.get(&format!("{job}/results/centerline")).send().await.unwrap(), 410, "job-purged").await;
    assert!(mount(&["-o", "remount,rw", &folder]));
    let service = service.restart(&[]);
    problem(service.get(&job).send().await.unwrap(), 404, "job-not-found").await;
    service.assert_no_files().await;
    drop(service);
    Command::new("umount").arg("--lazy").arg(&folder).status().unwrap();
}

#[tokio::test]
async fn a_disk_that_is_away_purges_nothing() {
    let service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let (blobs, away) = (service.data().join("blobs"), service.data().join("away"));
    std::fs::rename(&blobs, &away).unwrap();
    problem(service.delete(&job).send().await.unwrap(), 503, "storage-unavailable").await;
    std::fs::rename(&away, &blobs).unwrap();
    assert!(!service.files().is_empty());
    assert_eq!(service.delete(&job).send().await.unwrap().status(), 204);
    service.assert_no_files().await;
}

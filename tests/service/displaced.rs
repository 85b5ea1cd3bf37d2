//! A data folder that is moved, replaced or unmounted while the service runs, a database that is gone, and outages of the
//! storage while jobs wait.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use crate::meshes;
use crate::readiness::as_a_user;
use crate::service::{Service, command, problem};
use crate::small_disk::SmallDisk;

/// It is not ready for this reason, and takes and removes nothing.
async fn refuses(service: &Service, job: &str, reason: &str) {
    // First, as a request may be what finds it.
    let response = service.submit("", meshes::small()).await;
    assert!(response.headers().contains_key("retry-after"));
    problem(response, 503, "storage-unavailable").await;
    problem(service.delete(job).send().await.unwrap(), 503, "storage-unavailable").await;
    let body = problem(service.get("/readyz").send().await.unwrap(), 503, "not-ready").await;
    let reasons = body["reasons"].as_array().unwrap();
    assert!(reasons.len() == 1 && reasons[0].as_str().unwrap().contains(reason), "{body}");
    let log = service.log_with("no job is taken, run or purged until then").await;
    assert!(log.contains("no job is taken, run or purged until then"), "{log}");
}

/// A service on a folder within a folder, and a job that has ended there.
async fn with_a_job(parent: &Arc<tempfile::TempDir>) -> (Service, String) {
    let data = parent.path().join("data");
    let service = Service::start_on(parent.clone(), &["--data", data.to_str().unwrap()]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    (service, job)
}

/// Names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[tokio::test]
async fn a_data_folder_that_is_moved_or_replaced_takes_nothing_until_it_is_back() {
    let parent = Arc::new(tempfile::tempdir().unwrap());
    let (service, job) = with_a_job(&parent).await;
    let (data, moved) = (parent.path().join("data"), parent.path().join("moved"));
    fs::rename(&data, &moved).unwrap();
    let kept = names(&moved.join("blobs"));
    refuses(&service, &job, "the data folder of this service is no longer in its place").await;
    assert!(!data.join("blobs").exists());
    fs::create_dir_all(data.join("blobs")).unwrap();
    refuses(&service, &job, "in the place of the data folder").await;
    problem(
        service.get(&format!("{job}/results/centerline")).send().await.unwrap(),
        503,
        "storage-unavailable",
    )
    .await;
    // Nor does the audit trail begin anew there.
    assert_eq!(names(&data), ["blobs"]);
    assert!(names(&data.join("blobs")).is_empty());
    assert_eq!(names(&moved.join("blobs")), kept);

    fs::remove_dir_all(&data).unwrap();
    fs::rename(&moved, &data).unwrap();
    service.assert_alive().await;
    let next = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&next).await["status"], "successful");
    assert_eq!(service.delete(&job).send().await.unwrap().status(), 204);
    let next = next.rsplit('/').next().unwrap();
    assert_eq!(names(&data.join("blobs")), [next]);
}

#[tokio::test]
async fn a_disk_that_is_unmounted_takes_nothing() {
    let Some(disk) = SmallDisk::mount() else { return };
    let data = disk.path().to_str().unwrap();
    let service =
        Service::start_on(Arc::new(tempfile::tempdir().unwrap()), &["--data", data, "--min-free", "1MiB"]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    assert!(Command::new("umount").args(["--lazy", data]).status().unwrap().success());
    refuses(&service, &job, "the data folder").await;
    assert!(names(disk.path()).is_empty(), "{:?}", names(disk.path()));
}

/// A disk that comes back is the folder of the start again: nothing has to be started anew.
#[tokio::test]
async fn a_disk_that_is_unmounted_and_mounted_again_goes_on() {
    let Some(disk) = SmallDisk::mount() else { return };
    let place = Arc::new(tempfile::tempdir().unwrap());
    let data = place.path().to_str().unwrap();
    let mount = || Command::new("mount").arg("--bind").arg(disk.path()).arg(data).status().unwrap();
    let unmount = || Command::new("umount").args(["--lazy", data]).status().unwrap();
    assert!(mount().success());
    let service = Service::start_on(place.clone(), &["--data", data, "--min-free", "1MiB"]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    assert!(unmount().success());
    refuses(&service, &job, "the data folder").await;
    assert!(mount().success());
    service.assert_alive().await;
    let next = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&next).await["status"], "successful");
    let result = service.get(&format!("{job}/results/centerline")).send().await.unwrap();
    assert_eq!(result.status(), 200);
    drop(service);
    assert!(unmount().success());
}

#[tokio::test]
async fn a_database_that_is_gone_takes_nothing_and_no_start_removes_the_files_of_its_jobs() {
    let parent = Arc::new(tempfile::tempdir().unwrap());
    let (mut service, job) = with_a_job(&parent).await;
    let (data, away) = (parent.path().join("data"), parent.path().join("away"));
    let blobs = data.join("blobs").join(job.rsplit('/').next().unwrap());
    let kept = names(&blobs);
    fs::create_dir(&away).unwrap();
    let of_database = |name: &String| name.starts_with("jobs.sqlite");
    let files: Vec<String> = names(&data).into_iter().filter(of_database).collect();
    let move_all = |from: &Path, to: &Path| {
        files.iter().for_each(|name| fs::rename(from.join(name), to.join(name)).unwrap());
    };
    move_all(&data, &away);
    refuses(&service, &job, "the job database of this service is no longer in its place").await;
    service.kill();
    drop(service);

    for empty in [false, true] {
        if empty {
            fs::write(data.join("jobs.sqlite"), "").unwrap();
        }
        let start = Service::try_start(command(parent.path()).arg("--data").arg(&data), parent.clone());
        let said = start.err().unwrap();
        assert!(said.contains("put the database back") && said.contains("--data"), "{said}");
        assert_eq!(names(&blobs), kept);
    }
    move_all(&away, &data);
    let service = Service::start_on(parent.clone(), &["--data", data.to_str().unwrap()]);
    let result = service.get(&format!("{job}/results/centerline")).send().await.unwrap();
    assert_eq!(result.status(), 200);
}

/// A job that runs, some that wait, and the folder of their meshes taken away.
async fn outage(service: &Service) -> (String, Vec<String>) {
    let first = service.backlog(1, &meshes::large()).await.remove(0);
    let mut jobs = Vec::new();
    for _ in 0..5 {
        jobs.push(service.accepted("", meshes::small()).await);
    }
    service.running().await;
    fs::rename(service.data().join("blobs"), service.data().join("away")).unwrap();
    (first, jobs)
}

async fn all_end_well(service: &Service, jobs: &[String]) {
    for job in jobs {
        let status = service.ended(job).await;
        assert_eq!(status["status"], "successful", "{status}");
    }
}

#[tokio::test]
async fn an_outage_of_the_storage_fails_no_job_that_waits() {
    let service = Service::start(&["--workers", "1"]);
    let (first, jobs) = outage(&service).await;
    // Its place is free for the others.
    assert_eq!(service.delete(&first).send().await.unwrap().status(), 200);
    tokio::time::sleep(Duration::from_secs(2)).await;
    for job in &jobs {
        assert_eq!(service.status(job).await["status"], "accepted");
    }
    fs::rename(service.data().join("away"), service.data().join("blobs")).unwrap();
    all_end_well(&service, &jobs).await;
}

#[tokio::test]
async fn a_service_whose_storage_is_away_stops_in_order() {
    let mut service = Service::start(&["--workers", "1", "--grace", "1s"]);
    let (first, mut jobs) = outage(&service).await;
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    fs::rename(service.data().join("away"), service.data().join("blobs")).unwrap();
    jobs.push(first);
    all_end_well(&service.restart(&[]), &jobs).await;
}

/// A mesh whose reading fails for a while is waited for, and its job can be cancelled meanwhile.
#[tokio::test]
async fn a_mesh_that_cannot_be_read_for_a_while_is_not_lost() {
    let data = Arc::new(tempfile::tempdir().unwrap());
    let Some(service) = as_a_user(&data, &["--workers", "2"]) else { return };
    let allow = |job: &str, mode: u32| {
        let folder = service.data().join("blobs").join(job.rsplit('/').next().unwrap());
        fs::set_permissions(folder, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
    };
    let long = service.backlog(4, &meshes::large()).await;
    let (read, cancelled) =
        (service.accepted("", meshes::small()).await, service.accepted("", meshes::small()).await);
    allow(&read, 0o000);
    allow(&cancelled, 0o000);
    for job in &long {
        service.delete(job).send().await.unwrap();
    }
    // Longer than five tries took.
    for job in [&read, &cancelled] {
        service.until(job, |status| status["status"] == "running").await;
    }
    tokio::time::sleep(Duration::from_secs(4)).await;
    for job in [&read, &cancelled] {
        assert_eq!(service.status(job).await["status"], "running");
    }
    assert_eq!(service.delete(&cancelled).send().await.unwrap().status(), 200);
    let next = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&next).await["status"], "successful", "its worker is free again");
    allow(&read, 0o700);
    assert_eq!(service.ended(&read).await["status"], "successful");
    allow(&cancelled, 0o700);
}

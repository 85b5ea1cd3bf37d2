//! Starting and not starting.

use std::process::{Command, Stdio};

use crate::meshes;
use crate::service::{Service, command, without_settings};

/// Runs a service that must not start; what it says on stderr.
fn refused(mut command: Command) -> String {
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.is_empty());
    let text = String::from_utf8(output.stderr).unwrap();
    let last = text.lines().last().unwrap().to_owned();
    assert!(last.starts_with("rosaline: "), "{text}");
    last
}

#[tokio::test]
async fn wrong_settings_end_with_one_line() {
    let service = Service::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let mut taken = command(folder.path());
    taken.args(["--listen", service.address()]);
    let line = refused(taken);
    assert!(line.contains(service.address()) && line.contains("--listen"), "{line}");

    let line = refused(command(&service.data()));
    assert!(line.contains("another"), "a second service on one folder: {line}");
    service.assert_alive().await;

    let file = folder.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let line = refused(command(&file));
    assert!(line.contains("data folder"), "{line}");
}

#[tokio::test]
async fn settings_come_from_the_environment_too() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    command.arg("serve").env("ROSALINE_LISTEN", "nowhere").env("ROSALINE_DATA", folder.path());
    let line = refused(command);
    assert!(line.contains("nowhere"), "{line}");
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    let output = command.arg("serve").env("ROSALINE_MAX_UPLOAD", "much").output().unwrap();
    assert_eq!(output.status.code(), Some(1), "an argument that cannot be read");
    assert!(String::from_utf8_lossy(&output.stderr).contains("--max-upload"));
}

#[tokio::test]
async fn the_data_folder_is_created_and_the_log_can_be_json() {
    let parent = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let deep = parent.path().join("a/b");
    let service = Service::start_on(parent, &["--log-format", "json", "--data", deep.to_str().unwrap()]);
    let job = service.accepted("?name=doe_jane.stl", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    assert!(deep.join("jobs.sqlite").is_file());
    let log = service.log();
    assert!(log.lines().all(|line| serde_json::from_str::<serde_json::Value>(line).is_ok()), "{log}");
    assert!(log.contains("\"route\":\"/v1/jobs/{id}\""), "{log}");
    assert!(log.contains(job.rsplit('/').next().unwrap()) && !log.contains("doe"), "{log}");
}

#[tokio::test]
async fn the_health_command_asks_the_service() {
    let service = Service::start(&[]);
    let health = |listen: &str| {
        Command::new(env!("CARGO_BIN_EXE_rosaline")).args(["health", "--listen", listen]).output().unwrap()
    };
    assert!(health(service.address()).status.success());
    let port = service.address().rsplit(':').next().unwrap().to_owned();
    assert!(health(&format!("0.0.0.0:{port}")).status.success(), "as a container has it in ROSALINE_LISTEN");
    // What its file says of the address is enough, and what is not the address's goes by it.
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("rosaline.toml");
    std::fs::write(&config, format!("max-queue = 7\nlisten = \"{}\"\n", service.address())).unwrap();
    let by_file = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        command.arg("health").args(more).env("ROSALINE_CONFIG", &config).output().unwrap()
    };
    assert!(by_file(&[]).status.success());
    // A service that is not ready is alive.
    let (blobs, away) = (service.data().join("blobs"), service.data().join("away"));
    std::fs::rename(&blobs, &away).unwrap();
    assert!(String::from_utf8_lossy(&by_file(&[]).stderr).contains("is not ready"));
    assert!(by_file(&["--alive"]).status.success());
    std::fs::rename(&away, &blobs).unwrap();
    std::fs::write(&config, "lisetn = \"127.0.0.1:1\"\n").unwrap();
    assert!(String::from_utf8_lossy(&by_file(&[]).stderr).contains("no setting 'lisetn'"));
    let address = service.address().to_owned();
    drop(service);
    let output = health(&address);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains(&address));
}

/// The database holds names of files, which are patient data.
#[cfg(unix)]
#[tokio::test]
async fn nobody_else_reads_what_the_service_keeps() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};

    let parent = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let data = parent.path().join("data");
    // Whatever the user's umask is; the folders of both are new.
    let mut shell = Command::new("sh");
    shell.args(["-c", "umask 000; exec \"$0\" serve --listen 127.0.0.1:0", env!("CARGO_BIN_EXE_rosaline")]);
    without_settings(&mut shell);
    shell.env("ROSALINE_DATA", &data).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let service = Service::try_start(&mut shell, parent.clone()).unwrap();
    let job = service.accepted("?name=doe_jane.stl", meshes::small()).await;
    service.ended(&job).await;
    let mode = |name: &str| std::fs::metadata(data.join(name)).unwrap().mode() & 0o777;
    assert_eq!(mode(""), 0o700);
    let names = ["jobs.sqlite", "jobs.sqlite-wal", "jobs.sqlite-shm"];
    for name in names.into_iter().chain(["audit.jsonl"]) {
        assert_eq!(mode(name), 0o600, "{name}");
    }
    let job_folder = format!("blobs/{}", job.rsplit('/').next().unwrap());
    let mut kept = vec!["lock".to_owned(), "reserve".to_owned(), format!("{job_folder}/input")];
    let run = std::fs::read_dir(data.join(&job_folder)).unwrap().map(|entry| entry.unwrap().path());
    let run = run.filter(|path| path.is_dir()).last().unwrap();
    let results = std::fs::read_dir(&run).unwrap().map(|entry| entry.unwrap().path());
    kept.extend(results.map(|path| path.strip_prefix(&data).unwrap().to_str().unwrap().to_owned()));
    assert!(kept.len() >= 6, "{kept:?}");
    for name in kept {
        assert_eq!(mode(&name), 0o600, "{name}");
    }
    // One of a version that left it open; killed, so that its log is there.
    drop(service);
    for name in names {
        std::fs::set_permissions(data.join(name), PermissionsExt::from_mode(0o644)).unwrap();
    }
    let service = Service::start_on(parent, &["--data", data.to_str().unwrap()]);
    assert_eq!(service.status(&job).await["status"], "successful");
    for name in names {
        assert_eq!(mode(name), 0o600, "{name}");
    }
}

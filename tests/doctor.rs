//! `rosaline doctor`: what is wrong is found, and a running service is left alone.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
#[path = "common/meshes.rs"]
mod meshes;
#[allow(dead_code)]
#[path = "common/service.rs"]
mod service;
#[allow(dead_code)]
#[path = "common/small_disk.rs"]
mod small_disk;

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use service::Service;
use sqlx::{AnyConnection, Connection};

/// `rosaline doctor`, without settings from this process's environment.
fn doctor(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    service::without_settings(&mut command);
    command.arg("doctor").env("ROSALINE_LISTEN", "127.0.0.1:0").env("ROSALINE_DATA", data);
    command
}

/// What it says, and whether all is well.
fn asked(command: &mut Command) -> (bool, String) {
    let output = command.output().unwrap();
    let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.success(), said.concat())
}

/// It is found wrong, and a line says this.
fn wrong(command: &mut Command, what: &str) {
    let (well, said) = asked(command);
    assert!(!well, "{said}");
    let lines = said.lines().filter(|line| line.starts_with("WRONG"));
    let found: Vec<&str> = lines.filter(|line| line.contains(what)).collect();
    assert_eq!(found.len(), 1, "{what}: {said}");
    assert!(found[0].contains("; "), "and what to do: {said}");
}

async fn changed(data: &Path, sql: &'static str) {
    sqlx::any::install_default_drivers();
    let url = format!("sqlite://{}", data.join("jobs.sqlite").display());
    let mut store = AnyConnection::connect(&url).await.unwrap();
    sqlx::query(sql).execute(&mut store).await.unwrap();
    store.close().await.unwrap();
}

/// A folder that a service has used.
async fn used() -> tempfile::TempDir {
    let mut service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    service.terminate();
    service.wait();
    let data = tempfile::tempdir().unwrap();
    fs::set_permissions(data.path(), fs::Permissions::from_mode(0o700)).unwrap();
    for name in ["jobs.sqlite", "audit.jsonl", "lock"] {
        fs::copy(service.data().join(name), data.path().join(name)).unwrap();
    }
    for file in service.files() {
        let copy = data.path().join(file.strip_prefix(service.data()).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::copy(file, copy).unwrap();
    }
    data
}

#[tokio::test]
async fn a_good_folder_is_well_and_is_left_as_it_was() {
    let data = used().await;
    let names = || {
        let mut names: Vec<_> =
            fs::read_dir(data.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = (names(), fs::read(data.path().join("jobs.sqlite")).unwrap());
    let (well, said) = asked(&mut doctor(data.path()));
    assert!(well && !said.contains("WRONG"), "{said}");
    assert!(said.contains("whole: 1 job\n"), "{said}");
    assert_eq!((names(), fs::read(data.path().join("jobs.sqlite")).unwrap()), before);
    let (well, said) = asked(&mut doctor(&data.path().join("new")));
    assert!(well && said.contains("the first start creates it"), "{said}");
    assert!(!data.path().join("new").exists());
}

#[tokio::test]
async fn a_running_service_is_not_disturbed() {
    let service = Service::start(&[]);
    fs::set_permissions(service.data(), fs::Permissions::from_mode(0o700)).unwrap();
    let job = service.accepted("", meshes::small()).await;
    let address = service.address().to_owned();
    for _ in 0..3 {
        let (well, said) = asked(doctor(&service.data()).args(["--listen", &address]));
        assert!(well && said.contains("a service uses this data folder now"), "{said}");
        assert!(said.contains("by the service as it seems"), "{said}");
    }
    assert_eq!(service.ended(&job).await["status"], "successful");
    service.assert_alive().await;
    // That no key is needed is all that it warns of.
    let log = service.log();
    assert_eq!((log.matches("ERROR").count(), log.matches("WARN").count()), (0, 1), "{log}");
}

#[tokio::test]
async fn a_database_that_is_gone_is_told() {
    let data = used().await;
    for name in ["jobs.sqlite", "jobs.sqlite-wal", "jobs.sqlite-shm"] {
        fs::remove_file(data.path().join(name)).ok();
    }
    wrong(&mut doctor(data.path()), "put the database back");
    fs::remove_dir_all(data.path().join("blobs")).unwrap();
    let (well, said) = asked(&mut doctor(data.path()));
    assert!(well && said.contains("the first start creates it"), "{said}");
}

#[tokio::test]
async fn a_folder_that_cannot_be_used_is_told() {
    let data = used().await;
    wrong(&mut doctor(Path::new("/proc/rosaline")), "the data folder /proc/rosaline");
    wrong(&mut doctor(&data.path().join("lock")), "is not a folder");
    fs::set_permissions(data.path(), fs::Permissions::from_mode(0o755)).unwrap();
    wrong(&mut doctor(data.path()), "can be read by other users");
    let Some(disk) = small_disk::SmallDisk::mount() else { return };
    fs::set_permissions(disk.path(), fs::Permissions::from_mode(0o700)).unwrap();
    disk.fill();
    wrong(&mut doctor(disk.path()), "cannot be written");
    disk.free();
    assert!(asked(doctor(disk.path()).args(["--max-upload", "1MiB", "--min-free", "1MiB"])).0);
    // Of the 8 MiB, what is left beside the room for a full disk is no matter of readiness.
    assert!(asked(doctor(disk.path()).args(["--max-upload", "1MiB", "--min-free", "6MiB"])).0);
    wrong(doctor(disk.path()).args(["--max-upload", "1MiB"]), "--min-free is 64");
    wrong(
        doctor(disk.path()).args(["--min-free", "1MiB"]),
        "GiB are free on the data folder's disk and one mesh may have 1.0",
    );
}

#[tokio::test]
async fn a_database_that_cannot_be_used_is_told() {
    let data = used().await;
    changed(data.path(), "UPDATE jobs SET created = created + 100000000000").await;
    wrong(&mut doctor(data.path()), "ahead of this machine's clock");
    let data = used().await;
    changed(data.path(), "UPDATE jobs SET created = created - 864000000").await;
    let (well, said) = asked(&mut doctor(data.path()));
    assert!(well && said.contains("no job came for 10 days"), "{said}");
    let data = used().await;
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                 VALUES (9999, 'later', TRUE, x'00', 0)";
    changed(data.path(), newer).await;
    wrong(&mut doctor(data.path()), "of a newer version");
    changed(data.path(), "DELETE FROM _sqlx_migrations WHERE version > 6").await;
    let (well, said) = asked(&mut doctor(data.path()));
    assert!(well && said.contains("the next start brings it to"), "{said}");
    // A page in the middle.
    let file = data.path().join("jobs.sqlite");
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2 / 4096 * 4096;
    bytes[middle..middle + 4096].fill(0x5a);
    fs::write(&file, &bytes).unwrap();
    wrong(&mut doctor(data.path()), "the job database");
    fs::write(&file, b"not a database, for longer than its header is long, so that it is read as one")
        .unwrap();
    wrong(&mut doctor(data.path()), "cannot be read");
}

#[tokio::test]
async fn results_that_are_missing_or_cut_short_are_told() {
    let data = used().await;
    let job = fs::read_dir(data.path().join("blobs")).unwrap().next().unwrap().unwrap().path();
    let runs = fs::read_dir(&job).unwrap().map(|entry| entry.unwrap().path());
    let file = runs.filter(|path| path.is_dir()).last().unwrap().join("centerline.glb");
    let good = fs::read(&file).unwrap();
    fs::write(&file, &good[..good.len() / 2]).unwrap();
    let id = job.file_name().unwrap().to_str().unwrap();
    wrong(&mut doctor(data.path()), &format!("the results of job {id} are missing or have another length"));
    fs::remove_file(&file).unwrap();
    wrong(&mut doctor(data.path()), "the results of job");
    fs::write(&file, &good).unwrap();
    assert!(asked(&mut doctor(data.path())).0);
}

#[tokio::test]
async fn keys_and_addresses_that_do_not_fit_are_told() {
    let data = used().await;
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    wrong(doctor(data.path()).args(["--listen", &address]), "cannot be listened on");
    wrong(doctor(data.path()).args(["--listen", "nowhere"]), "is no address");
    wrong(doctor(data.path()).args(["--listen", "0.0.0.0:0"]), "without a key");
    let (well, said) = asked(doctor(data.path()).args(["--listen", "0.0.0.0:0", "--insecure"]));
    assert!(well && said.contains("as --insecure says"), "{said}");
    let mut keys = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    keys.args(["keys", "add", "pacs", "--scope", "read", "--data"]).arg(data.path());
    assert!(keys.output().unwrap().status.success());
    let (well, said) = asked(doctor(data.path()).args(["--listen", "0.0.0.0:0"]));
    assert!(well && said.contains("1 key is in force") && said.contains("in the clear"), "{said}");
    let file = data.path().join("keys.json");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
    wrong(&mut doctor(data.path()), "the key file");
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    let mut keys = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    keys.args(["keys", "revoke", "pacs", "--data"]).arg(data.path());
    assert!(keys.output().unwrap().status.success());
    wrong(&mut doctor(data.path()), "every key is revoked");
    wrong(&mut doctor(data.path()), &format!("keys add NAME --scope submit,read --keys {}'", file.display()));
    fs::write(&file, "{").unwrap();
    wrong(&mut doctor(data.path()), "nobody is let in");
    wrong(doctor(data.path()).args(["--keys", "/nowhere/keys.json"]), "--keys /nowhere/keys.json");
    let (_, said) = asked(doctor(data.path()).args(["--keys", "/nowhere/k.json", "--listen", "0.0.0.0:0"]));
    let line = said.lines().find(|line| line.contains("without a key")).unwrap();
    assert!(line.contains("--keys /nowhere/k.json'") && !line.contains("--data"), "{line}");
    fs::remove_file(&file).unwrap();
    assert!(asked(&mut doctor(data.path())).0, "its jobs belong to nobody");
    changed(data.path(), "UPDATE jobs SET owner = 'pacs'").await;
    wrong(&mut doctor(data.path()), "belong to somebody");
    assert!(asked(doctor(data.path()).arg("--insecure")).0);
}

#[tokio::test]
async fn tokens_certificates_and_targets_that_do_not_fit_are_told() {
    let data = used().await;
    let file = |name: &str, text: &str| {
        let path = data.path().join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let issuer = ["--jwt-issuer", "https://id.example", "--jwt-audience", "rosaline", "--jwks"];
    let open = ["--listen", "0.0.0.0:0"];
    wrong(
        doctor(data.path()).args(issuer).arg(file("damaged.json", "{")).args(open),
        "the service does not start",
    );
    let (well, said) = asked(doctor(data.path()).args(issuer).arg("http://127.0.0.1:1/keys").args(open));
    let keys = "well   tokens of https://id.example are checked by the keys at http://127.0.0.1:1/keys; they were not asked for";
    assert!(well && said.contains(keys) && !said.contains("are let in"), "{said}");
    assert!(!said.contains("no key was made") && !said.contains("--insecure"), "{said}");
    let discovered = |issuer| ["--jwt-issuer", issuer, "--jwt-audience", "rosaline"];
    wrong(
        doctor(data.path()).args(discovered("http://127.0.0.1:1")),
        "no token of http://127.0.0.1:1 is let in",
    );
    wrong(doctor(data.path()).args(discovered("ward")), "say it with --jwks");
    let none = file("none.pem", "");
    wrong(doctor(data.path()).args(["--tls-cert", &none, "--tls-key", &none]), "holds no certificate");
    let expiring = |days: i64| {
        let mut parameters = rcgen::CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        parameters.not_after =
            time::OffsetDateTime::now_utc() + time::Duration::days(days) + time::Duration::HOUR;
        let key = rcgen::KeyPair::generate().unwrap();
        let cert = file("cert.pem", &parameters.self_signed(&key).unwrap().pem());
        let key = file("key.pem", &key.serialize_pem());
        asked(doctor(data.path()).args(["--tls-cert", &cert, "--tls-key", &key]))
    };
    assert!(expiring(40).0);
    for (days, word) in [(9, "in 9 days"), (-9, "has expired")] {
        let (well, said) = expiring(days);
        assert!(!well && said.contains("WRONG  the TLS certificate") && said.contains(word), "{said}");
    }
    wrong(doctor(data.path()).args(["--webhooks", "/nowhere/targets.json"]), "targets.json is not there");
    // One that cannot be looked at is not one that is not there, for the doctor as for a start.
    let long = data.path().join("x".repeat(300));
    wrong(doctor(data.path()).arg("--webhooks").arg(&long), "cannot be used");
    wrong(doctor(data.path()).arg("--keys").arg(&long), "cannot be used");
    file("webhooks.json", "{");
    wrong(&mut doctor(data.path()), "add the targets again");
}

#[tokio::test]
async fn limits_that_do_not_fit_are_told() {
    let data = used().await;
    wrong(doctor(data.path()).args(["--threads", "1", "--workers", "2"]), "2 workers");
    wrong(doctor(data.path()).args(["--audit", "/nowhere/audit.jsonl"]), "the audit trail");
    let (well, said) = asked(doctor(data.path()).args(["--max-memory", "100000GiB"]));
    assert!(well && said.contains("lower --max-memory"), "{said}");
    wrong(doctor(data.path()).args(["--max-upload", "1000000GiB"]), "are free on the data folder's disk");
    let (_, said) = asked(doctor(data.path()).args(["--max-upload", "1MiB", "--max-uploads", "1000000000"]));
    assert!(said.contains("note   ") && said.contains("of the largest meshes"), "{said}");
    // Of each a small file may be in memory.
    assert!(said.contains("or --max-uploads"), "{said}");
    let program = env!("CARGO_BIN_EXE_rosaline");
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -n 100; exec \"$0\" doctor --listen 127.0.0.1:0 --data \"$1\"", program]);
    wrong(shell.arg(data.path()), "files may be open");
}

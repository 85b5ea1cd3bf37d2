//! Results that change on the disk while they are sent.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::time::Duration;

use serde_json::Value;
use sha2::{Digest, Sha256};
use sqlx::{AnyConnection, Connection};

use crate::meshes;
use crate::service::{Service, problem};
use crate::tls::logged;

/// More than the buffers between the service and a client that stands still.
const LONG: usize = 32 << 20;

/// A job whose GLB is long, on the disk and in its row: its path, its file, and what is in it.
async fn with_long_result() -> (Service, String, PathBuf, Vec<u8>) {
    let mut service = Service::start(&[]);
    let job = service.accepted("", meshes::small()).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    service.terminate();
    service.wait();
    let is_glb = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "glb");
    let file = service.files().into_iter().find(is_glb).unwrap();
    let bytes: Vec<u8> = (0..LONG).map(|place| (place % 251) as u8).collect();
    std::fs::write(&file, &bytes).unwrap();
    sqlx::any::install_default_drivers();
    let url = format!("sqlite://{}", service.data().join("jobs.sqlite").display());
    let mut store = AnyConnection::connect(&url).await.unwrap();
    let text: String = sqlx::query_scalar("SELECT artifacts FROM jobs").fetch_one(&mut store).await.unwrap();
    let mut artifacts: Value = serde_json::from_str(&text).unwrap();
    let mut forms = artifacts.as_array_mut().unwrap().iter_mut();
    let glb = forms.find(|form| form["key"].as_str().unwrap().ends_with(".glb")).unwrap();
    glb["size"] = LONG.into();
    glb["sha256"] =
        Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>().into();
    let update = sqlx::query("UPDATE jobs SET artifacts = $1").bind(artifacts.to_string());
    update.execute(&mut store).await.unwrap();
    store.close().await.unwrap();
    (service.restart(&[]), format!("{job}/results/centerline.glb"), file, bytes)
}

/// The body that comes to a client that stands still for a while once it has begun, and is `meanwhile` away.
fn got(service: &Service, path: &str, more: &str, meanwhile: impl FnOnce()) -> Vec<u8> {
    let mut socket = TcpStream::connect(service.address()).unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n{more}\r\n");
    socket.write_all(request.as_bytes()).unwrap();
    let mut answer = vec![0; 64 << 10];
    socket.read_exact(&mut answer).unwrap();
    let head = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
    let text = String::from_utf8(answer[..head].to_vec()).unwrap().to_lowercase();
    assert!(text.starts_with("http/1.1 20") && text.contains(&format!("content-length: {LONG}")), "{text}");
    std::thread::sleep(Duration::from_millis(500));
    meanwhile();
    // It may be cut hard.
    socket.read_to_end(&mut answer).ok();
    answer.split_off(head + 4)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_changes_while_it_is_sent_is_never_sent_whole() {
    let (service, path, file, good) = with_long_result().await;
    let cut = |bytes: &[u8]| {
        let file = std::fs::File::options().write(true).open(&file).unwrap();
        std::os::unix::fs::FileExt::write_all_at(&file, bytes, (LONG - bytes.len()) as u64).unwrap();
    };
    let damages: [&dyn Fn(); 2] =
        [&|| cut(&[good[LONG - 1] ^ 1]), &|| std::fs::write(&file, &good[..LONG / 2]).unwrap()];
    for (more, count) in [("", 1), ("Range: bytes=0-\r\n", 3)] {
        assert!(got(&service, &path, more, || {}) == good, "one that does not change comes whole");
        for (place, damage) in damages.into_iter().enumerate() {
            let body = got(&service, &path, more, damage);
            assert!(body.len() < LONG && good.starts_with(&body), "{more} {}", body.len());
            // Its lines come through a pipe.
            logged(&service, "a result was cut short", count + place).await;
            assert_eq!(service.log().matches("a result was cut short").count(), count + place);
            let range = service.get(&path).header("range", "bytes=0-9").send().await.unwrap();
            problem(range, 500, "internal-error").await;
            problem(service.get(&path).send().await.unwrap(), 500, "internal-error").await;
            std::fs::write(&file, &good).unwrap();
        }
    }
    assert!(service.get(&path).send().await.unwrap().bytes().await.unwrap() == good);
}

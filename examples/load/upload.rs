//! One large upload to its 201, beside a file of the same bytes that is written and synced; one after the other.

use std::fs::File;
use std::io::Write;
use std::time::{Duration, Instant};

use super::service::Service;
use super::wire::Client;

const TURNS: usize = 9;

pub fn run(rings: u32) {
    let mesh = super::tube_stl(rings, 500);
    let service = Service::start();
    let mut client = Client::new(&service.address);
    let folder = tempfile::tempdir().unwrap();
    let (mut uploads, mut files) = (Vec::new(), Vec::new());
    for turn in 0..TURNS {
        let begin = Instant::now();
        let mut file = File::create(folder.path().join(turn.to_string())).unwrap();
        file.write_all(&mesh).unwrap();
        file.sync_all().unwrap();
        files.push(begin.elapsed());
        let begin = Instant::now();
        let answer = client.ask("POST /v1/jobs", &mesh).unwrap();
        uploads.push(begin.elapsed());
        assert_eq!(answer.status, 201);
        // Its run must not be in the way of the next turn.
        assert_eq!(client.ask(&format!("DELETE {}", answer.location), b"").unwrap().status, 200);
        std::thread::sleep(Duration::from_millis(300));
    }
    let mut ratios: Vec<f64> =
        uploads.iter().zip(&files).map(|(upload, file)| upload.as_secs_f64() / file.as_secs_f64()).collect();
    ratios.sort_by(f64::total_cmp);
    let median = |mut times: Vec<Duration>| {
        times.sort();
        times[TURNS / 2]
    };
    println!(
        "{} MB: upload to 201 {:?}, file written and synced {:?} (medians of {TURNS}); ratio {:.2} ({:.2} to {:.2})",
        mesh.len() / 1_000_000,
        median(uploads),
        median(files),
        ratios[TURNS / 2],
        ratios[0],
        ratios[TURNS - 1],
    );
}

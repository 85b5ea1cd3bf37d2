//! Many jobs, and a service that is killed again and again while they run: all end, each once.
//!
//! `scripts/soak` runs the long version.

use std::collections::BTreeSet;
use std::sync::{Arc, RwLock};
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::Value;

use crate::meshes;
use crate::service::Service;

const FLAGS: [&str; 2] = ["--workers", "2"];
/// Clients that send at the same time.
const CLIENTS: usize = 8;

/// Numbers that look random, the same ones each time (Knuth's MMIX generator).
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

/// Sends its share of the jobs, each until it is accepted; their paths.
async fn send(url: Arc<RwLock<String>>, jobs: Vec<usize>) -> Vec<String> {
    let (client, mesh) = (Client::new(), bytes::Bytes::from(meshes::stl(&meshes::tube(20, 12))));
    let mut paths = Vec::new();
    for job in jobs {
        let begin = Instant::now();
        loop {
            assert!(begin.elapsed() < STANDSTILL, "job {job} is not accepted");
            let base = url.read().unwrap().clone();
            let request =
                client.post(format!("{base}/v1/jobs")).header("idempotency-key", format!("job-{job}"));
            match request.header("content-type", "model/stl").body(mesh.clone()).send().await {
                Ok(response) if response.status() == 201 => {
                    paths.push(response.headers()["location"].to_str().unwrap().to_owned());
                    break;
                }
                // 409: the service has not yet seen that the first sender's connection is gone.
                Ok(response) => assert!([409, 503].contains(&response.status().as_u16()), "{response:?}"),
                Err(_) => {}
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    paths
}

/// How long nothing may come forward.
const STANDSTILL: Duration = Duration::from_secs(120);

/// Waits until so many jobs have ended.
async fn until_ended(service: &Service, jobs: usize) {
    let (mut most, mut since) = (0, Instant::now());
    loop {
        let now = ended(service).await;
        if now >= jobs {
            return;
        }
        if now > most {
            (most, since) = (now, Instant::now());
        }
        assert!(since.elapsed() < STANDSTILL, "{now} of {jobs} jobs ended, no more: {}", service.log());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Jobs that have ended, by `/metrics`.
async fn ended(service: &Service) -> usize {
    let text = service.get("/metrics").send().await.unwrap().text().await.unwrap();
    let of = |state: &str| {
        let name = format!("rosaline_jobs{{state=\"{state}\"}} ");
        let line = text.lines().find_map(|line| line.strip_prefix(&name)).unwrap();
        line.parse::<usize>().unwrap()
    };
    assert_eq!((of("failed"), of("dismissed")), (0, 0), "{}", service.log());
    of("successful")
}

async fn soak(jobs: usize, kills: u64) {
    let began = Instant::now();
    let mut service = Service::start(&FLAGS);
    let url = Arc::new(RwLock::new(service.url.clone()));
    let share = |client: usize| (client..jobs).step_by(CLIENTS).collect();
    let senders: Vec<_> = (0..CLIENTS).map(|client| tokio::spawn(send(url.clone(), share(client)))).collect();
    let mut random = Random(kills);
    let mut moments: Vec<usize> = (0..kills).map(|_| random.below(jobs as u64 * 9 / 10) as usize).collect();
    moments.sort_unstable();
    for moment in moments {
        until_ended(&service, moment).await;
        tokio::time::sleep(Duration::from_millis(random.below(200))).await;
        service.kill();
        service = service.restart(&FLAGS);
        *url.write().unwrap() = service.url.clone();
    }
    let paths = futures::future::join_all(senders).await.into_iter().flat_map(Result::unwrap);
    let paths: BTreeSet<String> = paths.collect();
    assert_eq!(paths.len(), jobs, "a job for each key");
    until_ended(&service, jobs).await;
    println!("{jobs} jobs, {kills} kills: {:.0} s", began.elapsed().as_secs_f64());
    inspect(&service, &paths).await;
}

/// Each job is listed once and is successful; each has its files and no others, and all have the same results.
async fn inspect(service: &Service, paths: &BTreeSet<String>) {
    let (mut listed, mut next) = (BTreeSet::new(), Some("/v1/jobs?limit=500".to_owned()));
    while let Some(page) = next {
        let list: Value = service.get(&page).send().await.unwrap().json().await.unwrap();
        for job in list["jobs"].as_array().unwrap() {
            assert_eq!(job["status"], "successful");
            assert!(listed.insert(job["links"][0]["href"].as_str().unwrap().to_owned()), "twice: {job}");
        }
        let links = list["links"].as_array().unwrap().iter();
        next = links
            .clone()
            .find(|link| link["rel"] == "next")
            .map(|link| link["href"].as_str().unwrap().to_owned());
    }
    assert_eq!(&listed, paths);
    let (mut inputs, mut results) = (0, BTreeSet::new());
    let files = service.files();
    for file in &files {
        assert!(!file.to_string_lossy().contains('#'), "{file:?} is half written");
        inputs += usize::from(file.ends_with("input"));
        if file.ends_with("centerline.json") {
            results.insert(std::fs::read(file).unwrap());
        }
    }
    assert_eq!((inputs, results.len()), (paths.len(), 1), "an input each, and the same result for each");
    assert_eq!(files.len(), 9 * paths.len(), "an input, four results, and two of them compressed twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hundred_jobs_and_four_kills() {
    soak(200, 4).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: scripts/soak"]
async fn ten_thousand_jobs_and_twenty_kills() {
    soak(10_000, 20).await;
}

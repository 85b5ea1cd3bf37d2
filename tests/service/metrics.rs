//! What `/metrics` tells, read as strictly as Prometheus' own `promtool check metrics` does.

use std::collections::{BTreeMap, BTreeSet};

use super::meshes;
use super::service::Service;

/// Samples of one service at most: no label may be a client's text.
const MOST_SAMPLES: usize = 600;

/// The samples by name and labels.
struct Metrics(BTreeMap<String, f64>);

impl Metrics {
    async fn of(service: &Service) -> Self {
        let response = service.get("/metrics").send().await.unwrap();
        let kind = response.headers()["content-type"].to_str().unwrap().to_owned();
        assert!(kind.starts_with("text/plain; version=0.0.4"), "{kind}");
        let text = response.text().await.unwrap();
        assert!(text.ends_with('\n'));
        Self::read(&text)
    }

    /// Panics where the text breaks a rule of the format or of its naming.
    fn read(text: &str) -> Self {
        let mut samples = BTreeMap::new();
        let mut families = BTreeSet::new();
        let (mut helped, mut family, mut kind) = (String::new(), String::new(), String::new());
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# HELP ") {
                let (name, help) = rest.split_once(' ').unwrap();
                assert!(help.ends_with('.'), "{line}");
                helped = name.to_owned();
            } else if let Some(rest) = line.strip_prefix("# TYPE ") {
                let (name, word) = rest.split_once(' ').unwrap();
                assert!(name == helped && families.insert(name.to_owned()), "{line}");
                assert!(["counter", "gauge", "histogram"].contains(&word), "{line}");
                assert_eq!(name.ends_with("_total"), word == "counter", "{line}");
                (family, kind) = (name.to_owned(), word.to_owned());
            } else {
                let (series, value) = line.rsplit_once(' ').unwrap();
                let name = series.split('{').next().unwrap();
                let suffix =
                    name.strip_prefix(&family).unwrap_or_else(|| panic!("{line} is not of {family}"));
                let suffixes: &[&str] =
                    if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
                assert!(suffixes.contains(&suffix), "{line}");
                assert!(name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'), "{line}");
                let value: f64 = value.parse().unwrap();
                assert!(value.is_finite() && value >= 0.0, "{line}");
                assert!(samples.insert(series.to_owned(), value).is_none(), "{line} is there twice");
            }
        }
        let metrics = Self(samples);
        metrics.check_histograms();
        assert!(metrics.0.len() <= MOST_SAMPLES);
        metrics
    }

    /// Buckets grow with their bounds, and the last is the count.
    fn check_histograms(&self) {
        let mut buckets: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
        for (series, count) in &self.0 {
            let Some((labels, bound)) = series.split_once("le=\"") else { continue };
            let bound = bound.trim_end_matches("\"}").replace("+Inf", "inf").parse().unwrap();
            let labels = labels.replacen("_bucket", "_count", 1);
            let labels = labels.trim_end_matches(['{', ',']).to_owned();
            buckets.entry(labels).or_default().push((bound, *count));
        }
        for (labels, mut buckets) in buckets {
            buckets.sort_by(|a, b| a.0.total_cmp(&b.0));
            assert!(buckets.is_sorted_by_key(|bucket| bucket.1), "{labels}: {buckets:?}");
            let closed = if labels.contains('{') { format!("{labels}}}") } else { labels };
            let last = buckets[buckets.len() - 1];
            assert_eq!((last.0, last.1), (f64::INFINITY, self.0[&closed]), "{closed}");
        }
    }

    fn at(&self, series: &str) -> f64 {
        *self.0.get(series).unwrap_or_else(|| panic!("{series} is not in {:?}", self.0.keys()))
    }
}

#[tokio::test]
async fn metrics_tell_of_jobs_stages_bytes_and_requests() {
    let service = Service::start(&["--workers", "1", "--threads", "1"]);
    let before = Metrics::of(&service).await;
    assert_eq!(before.at("rosaline_workers_busy"), 0.0);
    let size = meshes::small().len() as f64;
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    let paper = service.accepted("?preset=paper", meshes::small()).await;
    service.ended(&paper).await;
    service.submit("", meshes::small()[..200].to_vec()).await;
    service.get("/v1/jobs/nothing%22%0A").send().await.unwrap();
    let result = service.get(&format!("{job}/results/centerline.json")).send().await.unwrap();
    let sent = result.bytes().await.unwrap().len() as f64;

    let metrics = Metrics::of(&service).await;
    for (series, expected) in [
        ("rosaline_jobs{state=\"successful\"}", 2.0),
        ("rosaline_jobs{state=\"accepted\"}", 0.0),
        ("rosaline_jobs_ended_total{state=\"successful\"}", 2.0),
        ("rosaline_jobs_ended_total{state=\"failed\"}", 0.0),
        ("rosaline_queue_age_seconds", 0.0),
        ("rosaline_workers", 1.0),
        ("rosaline_threads", 1.0),
        ("rosaline_stage_seconds_count{preset=\"default\",stage=\"reading\"}", 1.0),
        ("rosaline_stage_seconds_count{preset=\"default\",stage=\"tips\"}", 1.0),
        ("rosaline_stage_seconds_count{preset=\"default\",stage=\"writing\"}", 1.0),
        ("rosaline_stage_seconds_count{preset=\"paper\",stage=\"thinning\"}", 1.0),
        ("rosaline_received_bytes_total", 2.0 * size + 200.0),
        ("rosaline_upload_bytes_total", 2.0 * size),
        ("rosaline_result_bytes_total", sent),
        ("rosaline_http_requests_total{method=\"POST\",route=\"/v1/jobs\",status=\"201\"}", 2.0),
        ("rosaline_http_requests_total{method=\"POST\",route=\"/v1/jobs\",status=\"400\"}", 1.0),
        ("rosaline_http_requests_total{method=\"GET\",route=\"/v1/jobs/{id}\",status=\"404\"}", 1.0),
        ("rosaline_http_request_seconds_count{route=\"/v1/jobs\"}", 3.0),
    ] {
        assert_eq!(metrics.at(series), expected, "{series}");
    }
    assert!(metrics.0.keys().any(|series| series.contains("_bucket{")));
    let all: f64 = metrics
        .0
        .iter()
        .filter(|(name, _)| name.starts_with("rosaline_stage_seconds_sum"))
        .map(|(_, value)| value)
        .sum();
    assert!(all > 0.0, "the stages took time");
}

#[tokio::test]
async fn metrics_tell_of_busy_workers_and_a_queue() {
    let service = Service::start(&["--workers", "1", "--threads", "1"]);
    service.backlog(3, &meshes::large()).await;
    service.running().await;
    let metrics = Metrics::of(&service).await;
    assert_eq!(metrics.at("rosaline_workers_busy"), 1.0);
    assert_eq!(metrics.at("rosaline_threads_busy"), 1.0);
    assert_eq!(metrics.at("rosaline_run_processes_resting"), 0.0);
    assert!(metrics.at("rosaline_jobs{state=\"accepted\"}") >= 1.0);
}

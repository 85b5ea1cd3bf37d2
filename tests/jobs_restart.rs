//! SIGKILL and crashes of a process with a job queue, and what the next process finds.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[allow(dead_code)] // Each test file uses its own part.
mod jobs_fakes;

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::TryStreamExt;
use jobs_fakes::{Script, ended, files, result_of, settings, submit};
use rosaline::jobs::store::{JobStore, ListQuery, SqlStore};
use rosaline::jobs::{
    Counts, IdSource, Job, JobId, JobService, JobSpec, JobStatus, StoredInput, SystemClock,
};
use rosaline::output::OutputFormat;

const DATA: &str = "ROSALINE_TEST_DATA";
const SCRIPTS: &str = "ROSALINE_TEST_SCRIPTS";

/// Not a test of its own: the process that the others kill. It opens the folder, submits its scripts, says
/// `accepted ID SCRIPT` after each, and works until it dies.
#[test]
fn child() {
    let (Ok(data), Ok(scripts)) = (std::env::var(DATA), std::env::var(SCRIPTS)) else { return };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let service = JobService::open(settings(Path::new(&data), 2), Script::new()).await.unwrap();
        println!("\nopen");
        for script in scripts.split(';').filter(|script| !script.is_empty()) {
            let job = submit(&service, script).await;
            println!("\naccepted {} {script}", job.id);
        }
        tokio::time::sleep(Duration::from_secs(60)).await;
    });
}

fn start(data: &Path, scripts: &str) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--nocapture"])
        .env(DATA, data)
        .env(SCRIPTS, scripts)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Kills the child after it has said `accepted` this often and a moment more; the jobs it accepted.
fn kill_after(mut child: Child, accepted: usize, moment: Duration) -> HashMap<JobId, String> {
    let mut said = HashMap::new();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let take = |line: String, said: &mut HashMap<JobId, String>| {
        if let Some((id, script)) = line.strip_prefix("accepted ").and_then(|rest| rest.split_once(' ')) {
            said.insert(id.parse().unwrap(), script.to_owned());
        }
    };
    while said.len() < accepted {
        take(lines.next().unwrap().unwrap(), &mut said);
    }
    std::thread::sleep(moment);
    // SIGKILL on Unix.
    child.kill().unwrap();
    child.wait().unwrap();
    // What it said before it died counts as well.
    lines.map_while(Result::ok).for_each(|line| take(line, &mut said));
    said
}

async fn read(service: &JobService, id: JobId, format: OutputFormat) -> Vec<u8> {
    let artifact = service.result(id, format).await.unwrap();
    let reader = service.open_result(&artifact, None).await.unwrap();
    reader.try_collect::<Vec<Bytes>>().await.unwrap().concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn sigkill_at_any_moment_loses_no_accepted_job() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let mut accepted = HashMap::new();
    for round in 0..8_u64 {
        let scripts: String = (0..60).map(|place| format!("sleep {} {round}.{place};", place % 7)).collect();
        let child = start(&data, &scripts);
        let count = [1, 13, 60, 30, 5, 45, 22, 60][round as usize];
        accepted.extend(kill_after(child, count, Duration::from_millis(round * 7)));
    }
    let script = Script::new();
    let service = JobService::open(settings(&data, 2), script.clone()).await.unwrap();
    let left = service.counts().await.unwrap();
    let mut given_up = 0;
    for (id, script) in &accepted {
        let job = ended(&service, *id).await;
        match job.status {
            JobStatus::Successful => {
                for format in OutputFormat::ALL {
                    assert_eq!(read(&service, *id, format).await, result_of(script, format));
                }
            }
            JobStatus::Failed => given_up += usize::from(job.error.unwrap().code == "crashed"),
            other => panic!("{id} is {other}"),
        }
    }
    println!(
        "{} jobs accepted over 8 kills, {left:?} at the last start, {given_up} given up",
        accepted.len()
    );
    assert!(accepted.len() >= 236 && given_up == 0);
    // Only files of jobs are left: an input each, and the results of the successful ones.
    let mut all = 0;
    let mut query = ListQuery { limit: 100, ..ListQuery::default() };
    loop {
        let page = service.list(query.clone()).await.unwrap();
        for job in &page.jobs {
            assert!(!ended(&service, job.id).await.status.is_active());
        }
        all += page.jobs.len();
        let Some(next) = page.next else { break };
        query.before = Some(next);
    }
    let Counts { successful, .. } = service.counts().await.unwrap();
    assert_eq!(files(&data.join("blobs")).len(), all + OutputFormat::ALL.len() * successful as usize);
    service.shutdown(Duration::from_secs(5)).await;
}

/// Whether the child gives a job up; `false` when it dies first, by itself.
async fn given_up(mut child: Child, data: &Path) -> bool {
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < Duration::from_secs(30), "neither");
        let url = format!("sqlite://{}?mode=ro", data.join("jobs.sqlite").display());
        let failed = match <sqlx::AnyConnection as sqlx::Connection>::connect(&url).await {
            Ok(mut store) => {
                let count = "SELECT COUNT(*) FROM jobs WHERE status = 'failed'";
                sqlx::query_scalar::<_, i64>(count).fetch_one(&mut store).await.unwrap_or(0)
            }
            Err(_) => 0,
        };
        if failed > 0 {
            child.kill().unwrap();
            child.wait().unwrap();
            return true;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    false
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_takes_the_process_down_is_given_up_and_its_neighbours_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    sqlx::any::install_default_drivers();
    let scripts = "sleep 200 a;abort;sleep 200 b;sleep 200 c;sleep 200 d";
    let mut deaths = 0;
    // Once beside its neighbours, perhaps once more on trial beside a fresh job, and three times alone.
    while !given_up(start(&data, if deaths == 0 { scripts } else { "" }), &data).await {
        deaths += 1;
    }
    assert!((3..=5).contains(&deaths), "{deaths}");
    let script = Script::new();
    let service = JobService::open(settings(&data, 2), script.clone()).await.unwrap();
    let jobs = service.list(ListQuery { limit: 10, ..ListQuery::default() }).await.unwrap().jobs;
    assert!((2..=5).contains(&jobs.len()), "the first child may die before it has submitted all");
    for job in &jobs {
        ended(&service, job.id).await;
    }
    assert_eq!(script.runs("abort"), 0);
    let counts = service.counts().await.unwrap();
    assert_eq!((counts.failed, counts.successful), (1, jobs.len() as u64 - 1));
    let failed = service
        .list(ListQuery { status: Some(JobStatus::Failed), limit: 10, ..ListQuery::default() })
        .await
        .unwrap();
    let error = failed.jobs[0].error.clone().unwrap();
    assert_eq!((error.code.as_str(), error.status), ("crashed", 500));
    assert!(error.detail.contains("3 times"), "{error}");
    service.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_process_on_the_folder_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let mut child = start(&data, "sleep 1");
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    while lines.next().unwrap().unwrap() != "open" {}
    let refused = JobService::open(settings(&data, 1), Script::new()).await.err().unwrap().to_string();
    assert!(refused.contains("in use by another rosaline process"), "{refused}");
    // The lock's file looks like one that a dead process left.
    std::fs::remove_file(data.join("lock")).unwrap();
    let refused = JobService::open(settings(&data, 1), Script::new()).await.err().unwrap().to_string();
    assert!(refused.contains("in use by another rosaline process"), "{refused}");
    child.kill().unwrap();
    child.wait().unwrap();
    JobService::open(settings(&data, 1), Script::new()).await.unwrap().shutdown(Duration::ZERO).await;
}

/// Every state that a kill can leave on disk, made by hand.
#[tokio::test(flavor = "multi_thread")]
async fn a_start_completes_or_removes_what_a_kill_left_half_done() {
    let dir = tempfile::tempdir().unwrap();
    let (data, ids) = (dir.path().join("data"), IdSource::new(Arc::new(SystemClock), None));
    let script = Script::new();
    let service = JobService::open(settings(&data, 1), script.clone()).await.unwrap();
    let done = submit(&service, "ok").await;
    ended(&service, done.id).await;
    service.shutdown(Duration::ZERO).await;
    drop(service);
    let blobs = data.join("blobs");
    let put = |name: String, text: &str| {
        let path = blobs.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    // Uploaded in part; uploaded whole but without a row; results written but not yet in the row.
    let (part, whole, ran) = (ids.next(), ids.next(), ids.next());
    put(format!("{part}/input#1"), "half of a me");
    put(format!("{whole}/input"), "ok without a row");
    put(format!("{ran}/input"), "ok again");
    put(format!("{ran}/oldlease/centerline.json"), "of a run that did not end");
    put(format!("{ran}/oldlease/centerline.glb#1"), "half of a resu");
    put("README".to_owned(), "not ours");
    let url = format!("sqlite://{}/jobs.sqlite?mode=rwc", data.display());
    let store = SqlStore::open(&url).await.unwrap();
    let input = StoredInput { key: format!("{ran}/input"), size: 8, sha256: "00".repeat(32) };
    store.insert(&Job::accepted(ran, input, JobSpec::default(), 1)).await.unwrap();
    let claimed = store.claim(&Default::default(), 2).await.unwrap().unwrap();
    assert_eq!((claimed.id, claimed.status), (ran, JobStatus::Running));
    store.close().await;

    let service = JobService::open(settings(&data, 1), script.clone()).await.unwrap();
    let job = ended(&service, ran).await;
    assert_eq!((job.status, job.attempts), (JobStatus::Successful, 2));
    assert_eq!(read(&service, ran, OutputFormat::Json).await, result_of("ok again", OutputFormat::Json));
    assert_eq!(read(&service, done.id, OutputFormat::Glb).await, result_of("ok", OutputFormat::Glb));
    let names = files(&blobs);
    assert_eq!(names.len(), 11, "two inputs, eight results and a file that is not ours: {names:?}");
    assert!(names.iter().all(|name| !name.contains('#') && !name.contains("oldlease")));
    assert_eq!(script.runs("ok without a row"), 0);
    assert!(submit(&service, "ok").await.id > ran, "ids go on from the newest stored one");
    service.shutdown(Duration::from_secs(5)).await;
}

//! The real service crashes, or gets an error, at every named point; nothing that it accepted is lost or doubled.
//!
//! `Operation::ALL` is the list: a new one that no wish here comes by fails the test.

mod client;
mod webhooks;

use std::process::Command;

use rosaline::jobs::faults::{Operation, VARIABLE};
use tempfile::TempDir;

use crate::meshes;
use crate::webhooks::metric;
use client::Client;

/// Where an operation is done.
#[derive(PartialEq)]
enum Where {
    Usual,
    /// Where jobs and meshes are kept for a short while.
    Retention,
    /// At a SIGTERM while a job runs.
    Stop,
    /// In the process of a run.
    Run,
    /// Where jobs' ends are told.
    Webhooks,
    /// In `rosaline keys`.
    Keys,
}

fn place(operation: Operation) -> Where {
    match operation {
        Operation::StoreInputRemoved
        | Operation::StoreEndedBy
        | Operation::StoreNoteExpired
        | Operation::StoreForgetExpired => Where::Retention,
        Operation::StoreListen
        | Operation::StoreReleaseDeliveries
        | Operation::StoreClaimDelivery
        | Operation::StoreSettleDelivery
        | Operation::StoreRevive
        | Operation::StoreForgetDead => Where::Webhooks,
        Operation::StoreRelease => Where::Stop,
        Operation::Method => Where::Run,
        Operation::OperatorFileWrite | Operation::OperatorFileSync | Operation::OperatorFileRename => {
            Where::Keys
        }
        _ => Where::Usual,
    }
}

fn operations(here: Where) -> impl Iterator<Item = Operation> {
    Operation::ALL.iter().copied().filter(move |operation| place(*operation) == here)
}

/// A fault there, after what leads there.
fn armed(operation: Operation, side: &str, action: &str) -> String {
    let fault = format!("{}:{side}:{action}", operation.name());
    match operation {
        // Only a claim of which nobody knows is undone.
        Operation::StoreUnclaim => format!("store-claim:after:error,{fault}"),
        _ => fault,
    }
}

/// A crash at each point of `operations`, each time in a process that goes on where the last one died.
async fn crash_at_each(flags: &'static [&'static str], operations: impl Iterator<Item = Operation>) {
    let mut client = Client::new(flags);
    assert!(client.start(""));
    let mut round = 0;
    for operation in operations {
        for side in ["before", "after"] {
            round += 1;
            let up = client.start(&armed(operation, side, "crash"));
            let died = up && {
                let before = client.pursue().await;
                if before.is_ok() {
                    client.wish(round);
                }
                before.is_err() || client.pursue().await.is_err() || client.waits_for_its_end().await
            };
            assert!(!up || died, "no process came by {operation:?} {side}");
        }
    }
    assert!(client.start(""));
    assert!(client.pursue().await.is_ok());
}

#[tokio::test]
async fn a_crash_at_any_point_loses_and_doubles_nothing() {
    crash_at_each(&[], operations(Where::Usual)).await;
}

#[tokio::test]
async fn a_crash_of_the_retention_loses_and_doubles_nothing() {
    crash_at_each(&["--keep-input", "0", "--keep-jobs", "1s"], operations(Where::Retention)).await;
}

#[tokio::test]
async fn an_error_at_any_point_is_borne() {
    let mut client = Client::new(&[]);
    let mut round = 0;
    // These keep the service from its start, which is told; the next start goes well.
    let fatal = [Operation::FolderCreate, Operation::StoreOpen, Operation::StoreRecover];
    for operation in operations(Where::Usual) {
        if fatal.contains(&operation) {
            for side in ["before", "after"] {
                assert!(!client.start(&armed(operation, side, "error")), "{operation:?} {side}");
            }
            continue;
        }
        round += 1;
        // One after the other, as it is tried again.
        let word = operation.name();
        let more = format!("{word}:before:full@2,{word}:after:error");
        assert!(client.start(&format!("{},{more}", armed(operation, "before", "error"))));
        client.wish(round);
        assert!(client.pursue().await.is_ok(), "{operation:?}: {}", client.service().log());
        assert!(client.came_by(operation).await, "no process came by {operation:?}");
    }
}

/// The worker's own task and the run, where a panic must cost no more than the job.
#[tokio::test]
async fn a_panic_at_any_point_of_a_job_is_borne() {
    let mut client = Client::new(&[]);
    let points = [
        Operation::Run,
        Operation::StoreClaim,
        Operation::StoreSucceed,
        Operation::StoreFail,
        Operation::ResultCommit,
        Operation::StoreInsert,
        Operation::StoreDismiss,
    ];
    for (round, operation) in points.into_iter().enumerate() {
        assert!(client.start(&armed(operation, "before", "panic")));
        client.wish(round);
        assert!(client.pursue().await.is_ok(), "{operation:?}: {}", client.service().log());
        assert!(client.came_by(operation).await, "no process came by {operation:?}");
    }
}

/// The commit may have happened when its error came: the job's end is counted all the same.
#[tokio::test]
async fn an_end_whose_commit_is_in_doubt_is_counted() {
    let mut client = Client::new(&[]);
    assert!(client.start(&armed(Operation::StoreSucceed, "after", "error")));
    let service = client.service();
    let job = service.accepted("", meshes::stl(&meshes::tube(20, 12))).await;
    assert_eq!(service.ended(&job).await["status"], "successful");
    metric(service, "rosaline_jobs_ended_total{state=\"successful\"} 1").await;
}

#[tokio::test]
async fn a_run_that_crashes_errs_or_panics_is_a_failed_job() {
    for operation in operations(Where::Run) {
        for (side, action, word) in [
            ("before", "crash", "crashed"),
            ("after", "crash", "crashed"),
            ("before", "panic", "internal-error"),
            ("after", "error", "internal-error"),
        ] {
            let mut client = Client::new(&["--max-crashes", "2"]);
            assert!(client.start(&armed(operation, side, action)));
            let job = client.service().accepted("", meshes::stl(&meshes::tube(20, 12))).await;
            let status = client.service().ended(&job).await;
            assert_eq!(status["error"]["type"], format!("urn:rosaline:problem:{word}"), "{status}");
            assert!(client.start(""));
            let retried = client.service().post(&format!("{job}/retry")).send().await.unwrap();
            assert_eq!(retried.status(), 200);
            assert_eq!(client.service().ended(&job).await["status"], "successful");
        }
    }
}

#[tokio::test]
async fn a_fault_while_jobs_are_put_back_loses_nothing() {
    for operation in operations(Where::Stop) {
        for (side, action) in
            [("before", "crash"), ("after", "crash"), ("before", "error"), ("after", "error")]
        {
            let mut client = Client::new(&["--grace", "0"]);
            assert!(client.start(&armed(operation, side, action)));
            let jobs = client.service().backlog(2, &meshes::large()).await;
            client.service().running().await;
            client.service().terminate();
            assert!(client.waits_for_its_end().await);
            assert!(client.service().log().contains("a fault was asked for here"));
            assert!(client.start(""));
            for job in &jobs {
                assert_eq!(client.service().ended(job).await["status"], "successful");
            }
        }
    }
}

#[test]
fn a_crash_while_keys_are_written_leaves_the_old_ones_or_the_new() {
    let keys = |data: &TempDir, fault: &str, arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        command.arg("keys").args(arguments).arg("--data").arg(data.path()).env(VARIABLE, fault);
        command.output().unwrap()
    };
    for operation in operations(Where::Keys) {
        for (side, action) in
            [("before", "crash"), ("after", "crash"), ("before", "full"), ("after", "error")]
        {
            let data = tempfile::tempdir().unwrap();
            assert!(keys(&data, "", &["add", "one", "--scope", "read"]).status.success());
            let output = keys(&data, &armed(operation, side, action), &["add", "two", "--scope", "read"]);
            assert!(!output.status.success(), "no process came by {operation:?} {side}");
            let list = keys(&data, "", &["list"]);
            let text = String::from_utf8(list.stdout).unwrap();
            let both = operation == Operation::OperatorFileRename && side == "after";
            assert_eq!(text.lines().count(), 1 + usize::from(both), "{operation:?} {side}: {text}");
            assert!(keys(&data, "", &["add", "three", "--scope", "read"]).status.success());
        }
    }
}

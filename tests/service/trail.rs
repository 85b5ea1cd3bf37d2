//! The audit trail and the metrics.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use reqwest::StatusCode;
use serde_json::Value;

use crate::service::{PATIENCE, Service};
use crate::{meshes, wire};

fn trail(service: &Service) -> Vec<Value> {
    let text = std::fs::read_to_string(service.data().join("audit.jsonl")).unwrap();
    assert!(!text.contains("doe"), "{text}");
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Event, action, outcome, user and job of a line.
fn told(line: &Value) -> (String, String, u64, String, Option<String>) {
    let event = &line["EventIdentification"];
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    assert!(event["EventDateTime"].as_str().unwrap().ends_with('Z'));
    assert_eq!(event["EventID"]["codeSystemName"], "DCM");
    let who = &line["ActiveParticipant"][0];
    assert_eq!(
        (&who["NetworkAccessPointID"], &who["NetworkAccessPointTypeCode"]),
        (&"127.0.0.1".into(), &"2".into())
    );
    (
        text(&event["EventID"]["originalText"]),
        text(&event["EventActionCode"]),
        event["EventOutcomeIndicator"].as_u64().unwrap(),
        text(&who["UserID"]),
        line["ParticipantObjectIdentification"][0]["ParticipantObjectID"].as_str().map(str::to_owned),
    )
}

#[tokio::test]
async fn who_did_what_to_which_job_is_told_and_stays_told() {
    let mut service = Service::start(&[]);
    let job = service.accepted("?name=doe.stl", meshes::small()).await;
    service.ended(&job).await;
    service.submit("?name=doe.stl", b"\x89PNG\r\n\x1a\n".to_vec()).await;
    // The same job, its id spelled otherwise.
    let spelled = job.replacen("/0", "/%30", 1);
    let result = service.get(&format!("{spelled}/results/centerline")).send().await.unwrap();
    assert_eq!(result.status(), 200);
    service.get("/v1/jobs").send().await.unwrap();
    service.post(&format!("{job}/retry")).send().await.unwrap();
    let first = trail(&service);
    service.kill();
    let service = service.restart(&[]);
    let mut keys = std::process::Command::new(env!("CARGO_BIN_EXE_rosaline"));
    let output =
        keys.args(["keys", "add", "pacs", "--scope", "submit,read", "--data"]).arg(service.data()).output();
    let key = String::from_utf8(output.unwrap().stdout).unwrap();
    service.delete(&job).send().await.unwrap();
    service.get("/v1/jobs").header("authorization", format!("Bearer {}", key.trim())).send().await.unwrap();

    let lines = trail(&service);
    assert_eq!(lines[..first.len()], first[..], "what was written stays");
    let id = job.rsplit('/').next().map(str::to_owned);
    let line = |event: &str, action: &str, outcome: u64, user: &str, job: &Option<String>| {
        (event.to_owned(), action.to_owned(), outcome, user.to_owned(), job.clone())
    };
    let expected = [
        line("Import", "C", 0, "anonymous", &id),
        line("Import", "C", 4, "anonymous", &None),
        line("Export", "R", 0, "anonymous", &id),
        line("Query", "E", 0, "anonymous", &None),
        line("DICOM Instances Accessed", "U", 4, "anonymous", &id),
        line("Security Alert", "E", 4, "anonymous", &id),
        line("Query", "E", 0, "pacs", &None),
    ];
    assert_eq!(lines.iter().map(told).collect::<Vec<_>>(), expected);
    assert!(!std::fs::read_to_string(service.data().join("audit.jsonl")).unwrap().contains(key.trim()));
}

#[tokio::test]
async fn a_client_that_hangs_up_is_told_of_too() {
    let service = Service::start(&["--workers", "1"]);
    let ids = async || -> BTreeSet<String> {
        let list: Value = service.get("/v1/jobs").send().await.unwrap().json().await.unwrap();
        list["jobs"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap().to_owned()).collect()
    };
    let leave = |request: &str, body: &[u8]| {
        // All of it, and away at once.
        wire::Client::new(service.address()).leave_after(request, body, usize::MAX).unwrap();
    };
    let mesh = meshes::small();
    for _ in 0..8 {
        leave("POST /v1/jobs", &mesh);
    }
    let imported = async |count: usize| -> BTreeSet<String> {
        let begin = Instant::now();
        loop {
            let lines = trail(&service);
            let imports = lines.iter().map(told).filter(|line| line.0 == "Import");
            let found: BTreeSet<String> = imports.filter_map(|line| line.4).collect();
            if found.len() >= count {
                return found;
            }
            assert!(begin.elapsed() < PATIENCE, "{lines:?}: {}", service.log());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let first = imported(8).await;
    // One that takes long enough to be cancelled on any machine.
    leave("POST /v1/jobs?preset=paper HTTP/1.1\r\nPrefer: wait=60\r\nX-Rest:", &meshes::large());
    let all = imported(9).await;
    assert_eq!(all, ids().await);
    // The one that was to be waited for is told of before its job's end.
    let last = all.difference(&first).next().unwrap().clone();
    let status = service.status(&format!("/v1/jobs/{last}")).await;
    assert!(matches!(status["status"].as_str(), Some("accepted" | "running")), "{status}");

    // What its client leaves before it is begun may be lost: it has no answer.
    let begin = Instant::now();
    let mut asked: Option<Instant> = None;
    loop {
        let answer = service.get(&format!("/v1/jobs/{last}")).send().await.unwrap();
        // Of two that come late the second purges what the first cancelled.
        if answer.status() == StatusCode::NOT_FOUND
            || answer.json::<Value>().await.unwrap()["status"] == "dismissed"
        {
            break;
        }
        // So not soon again.
        if asked.is_none_or(|asked| asked.elapsed() > Duration::from_secs(4)) {
            leave(&format!("DELETE /v1/jobs/{last}"), b"");
            asked = Some(Instant::now());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert!(begin.elapsed() < PATIENCE, "{}", service.log());
    }
    let deleted = |line: &Value| told(line).1 == "D" && told(line).4.as_ref() == Some(&last);
    let begin = Instant::now();
    while !trail(&service).iter().any(deleted) {
        assert!(begin.elapsed() < PATIENCE, "{:?}", trail(&service));
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn a_trail_whose_file_is_taken_away_goes_on_under_its_name() {
    let service = Service::start(&[]);
    let ask = async || assert!(service.get("/v1/jobs").send().await.unwrap().status().is_success());
    ask().await;
    let (path, moved) = (service.data().join("audit.jsonl"), service.data().join("audit.jsonl.1"));
    std::fs::rename(&path, &moved).unwrap();
    ask().await;
    ask().await;
    assert_eq!(trail(&service).len(), 2, "as logrotate does it");
    assert_eq!(std::fs::read_to_string(&moved).unwrap().lines().count(), 1);
    std::fs::remove_file(&path).unwrap();
    ask().await;
    assert_eq!(trail(&service).len(), 1);
    let log = service.log_with("is_removed=true").await;
    assert_eq!(log.matches("somebody moved or removed the audit trail's file").count(), 2, "{log}");
}

/// Who is not let in must not fill the disk; who is let in has every line.
#[tokio::test]
async fn refusals_of_one_address_are_summed_up() {
    let data = std::sync::Arc::new(tempfile::tempdir().unwrap());
    let mut keys = std::process::Command::new(env!("CARGO_BIN_EXE_rosaline"));
    let output = keys.args(["keys", "add", "pacs", "--scope", "read", "--data"]).arg(data.path()).output();
    let key = String::from_utf8(output.unwrap().stdout).unwrap();
    let mut service = Service::start_on(data, &[]);
    let list = async |key: &str| {
        let request = service.get("/v1/jobs").header("authorization", format!("Bearer {}", key.trim()));
        request.send().await.unwrap().status().as_u16()
    };
    for _ in 0..50 {
        assert_eq!((list("wrong").await, list("wrong").await, list(&key).await), (401, 401, 200));
    }
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    let lines = trail(&service);
    let queries = lines.iter().map(told).filter(|line| line.0 == "Query" && line.3 == "pacs").count();
    assert_eq!(queries, 50);
    let refused: Vec<&Value> = lines.iter().filter(|line| told(line).0 == "Security Alert").collect();
    assert!(refused.iter().all(|line| line["EventIdentification"]["EventOutcomeDescription"] == "401"));
    // A minute may end in between.
    assert!(refused.len() <= 42, "{}", refused.len());
    let count = |line: &&&Value| {
        let details = line["ParticipantObjectIdentification"][0]["ParticipantObjectDetail"].as_array()?;
        details.iter().find(|detail| detail["type"] == "Count")?["value"].as_str()?.parse::<usize>().ok()
    };
    let summed: usize = refused.iter().filter_map(|line| count(&line)).sum();
    let alone = refused.iter().filter(|line| count(line).is_none()).count();
    assert_eq!(alone + summed, 100, "none is passed over");
    assert!(alone >= 20, "{alone}");
}

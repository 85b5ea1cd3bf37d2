//! The file of webhook targets while the service runs: changed, damaged, lost, and its secrets exchanged.

use crate::meshes;
use crate::receiver::{Answer, Receiver};
use crate::service::{Service, command};
use crate::tls::logged;
use crate::webhooks::{QUICK, dead, done, folder, metric, nothing_waits, webhooks};

#[tokio::test]
async fn targets_are_taken_over_while_the_service_runs() {
    let (first, second) = (Receiver::start(&[]).await, Receiver::start(&[]).await);
    let data = folder();
    let service = Service::start_on(data.clone(), &QUICK);
    done(&data, &["add", "first", "--url", &first.url()]);
    logged(&service, "targets have changed", 1).await;
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    first.messages(1).await;
    // A damaged file changes nothing.
    let file = data.path().join("webhooks.json");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    logged(&service, "targets stay those before", 1).await;
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    first.messages(2).await;
    std::fs::write(&file, &whole).unwrap();
    logged(&service, "targets have changed", 2).await;
    done(&data, &["add", "second", "--url", &second.url()]);
    done(&data, &["remove", "first"]);
    logged(&service, "targets=1", 3).await;
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    second.messages(1).await;
    assert_eq!(first.came().len(), 2);

    for wrong in [
        vec!["add", "second", "--url", "http://127.0.0.1:1/"],
        vec!["add", "x", "--url", "ftp://127.0.0.1/"],
        vec!["add", "x", "--url", "http://127.0.0.1:1/", "--events", "begun"],
        vec!["add", "a b", "--url", "http://127.0.0.1:1/"],
        vec!["remove", "x"],
    ] {
        assert_eq!(webhooks(&data, &wrong).status.code(), Some(1), "{wrong:?}");
    }
}

#[tokio::test]
async fn a_file_that_is_lost_takes_no_target_away_and_gives_nothing_up() {
    let receiver = Receiver::start(&[Answer::Status(500)]).await;
    let data = folder();
    done(&data, &["add", "pacs", "--url", &receiver.url()]);
    let (file, aside) = (data.path().join("webhooks.json"), data.path().join("aside"));
    // What was refused once waits throughout.
    let slow = ["--webhook-retry", "1h"];
    let service = Service::start_on(data.clone(), &slow);
    let waiting = service.accepted("", meshes::small()).await;
    service.ended(&waiting).await;
    receiver.messages(1).await;
    // While it runs: those before stay.
    std::fs::rename(&file, &aside).unwrap();
    logged(&service, "targets stay those before", 1).await;
    assert!(service.log().contains("is not there; put it back"), "{}", service.log());
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    receiver.messages(2).await;
    // That it came is stored; otherwise it would come again.
    metric(&service, "rosaline_webhooks{state=\"waiting\"} 1").await;
    // Before it starts: nothing is sent, and nothing is given up.
    let service = service.restart(&slow);
    logged(&service, "nothing is sent until the file is back", 1).await;
    let job = service.accepted("", meshes::small()).await;
    service.ended(&job).await;
    metric(&service, "rosaline_webhooks{state=\"waiting\"} 2").await;
    std::fs::rename(&aside, &file).unwrap();
    receiver.messages(3).await;
    metric(&service, "rosaline_webhooks{state=\"waiting\"} 1").await;
    assert!(dead(&service).await.is_empty());
    // An operator who wants no targets removes them.
    done(&data, &["remove", "pacs"]);
    logged(&service, "targets=0", 1).await;
}

#[test]
fn a_file_that_was_named_and_is_not_there_is_refused_at_the_start() {
    let data = folder();
    let missing = data.path().join("elsewhere.json");
    let output = command(data.path()).arg("--webhooks").arg(&missing).output().unwrap();
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert!(line.contains("elsewhere.json is not there"), "{line}");
}

#[tokio::test]
async fn while_a_secret_is_exchanged_both_sign() {
    let receiver = Receiver::start(&[]).await;
    let data = folder();
    let first = done(&data, &["add", "pacs", "--url", &receiver.url()]);
    let service = Service::start_on(data.clone(), &QUICK);
    let mut came = 0;
    let mut next = async |changes: usize| {
        logged(&service, "targets have changed", changes).await;
        let job = service.accepted("", meshes::small()).await;
        service.ended(&job).await;
        came += 1;
        receiver.messages(came).await.remove(came - 1)
    };
    assert_eq!(next(0).await.signed_by(&[&first]), [true]);
    let second = done(&data, &["rotate", "pacs"]);
    let message = next(1).await;
    assert_eq!(message.signed_by(&[&first, &second]), [true, true]);
    assert_eq!(message.header("webhook-signature").split(' ').count(), 2);
    let third = done(&data, &["rotate", "pacs", "--overlap", "0"]);
    assert_eq!(next(2).await.signed_by(&[&first, &second, &third]), [false, false, true]);
    assert_eq!(webhooks(&data, &["rotate", "x"]).status.code(), Some(1));
    let log = service.log();
    assert!([first, second, third].iter().all(|secret| !log.contains(&secret[6..])), "{log}");
}

// Its receiver answers while the test waits for the service's end.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_stops_begins_no_further_message() {
    let receiver = Receiver::start(&[Answer::Slow(3_000); 4]).await;
    let data = folder();
    done(&data, &["add", "pacs", "--url", &receiver.url()]);
    let mut service = Service::start_on(data, &[]);
    for _ in 0..6 {
        let job = service.accepted("", meshes::small()).await;
        service.ended(&job).await;
    }
    receiver.messages(4).await;
    service.terminate();
    assert!(service.wait().success(), "{}", service.log());
    assert_eq!(receiver.came().len(), 4);
    let service = service.restart(&[]);
    receiver.messages(6).await;
    nothing_waits(&service).await;
    assert_eq!(receiver.came().len(), 6);
}

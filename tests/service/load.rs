//! Many clients at once, some of them slow or broken; `scripts/load mix` does it longer and with more.

use std::time::Duration;

use super::meshes;
use super::mix::{self, Act};
use super::service::Service;

#[tokio::test(flavor = "multi_thread")]
async fn clients_of_every_kind_get_documented_answers_only() {
    let service = Service::start(&[]);
    let address = service.address().to_owned();
    let run =
        move || mix::run(&address, &meshes::small(), 20, Duration::from_secs(4), Duration::from_millis(60));
    let report = tokio::task::spawn_blocking(run).await.unwrap();
    assert!(report.faults.is_empty(), "{:#?}", report.faults);
    for act in [Act::Upload, Act::SlowUpload, Act::Status, Act::Result, Act::Cancel, Act::BadUpload] {
        assert!(report.times.contains_key(&act), "{act:?} never came: {:?}", report.answers);
    }
    // No time that a busy machine could miss: an answer that hangs.
    assert!(report.within(Act::Status, 0.99) < Duration::from_secs(10));
    service.assert_alive().await;
}

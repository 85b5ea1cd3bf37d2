//! The signals that stop the service.

use std::future::Future;

use tokio::signal::unix::{SignalKind, signal};

use super::super::Failure;
use super::log::Log;

/// Ready at the first SIGTERM or SIGINT; a second one ends the process at once.
///
/// # Errors
/// The signals cannot be listened for.
pub(super) fn stop_signal(log: Log) -> Result<impl Future<Output = ()>, Failure> {
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    let mut next = async move || {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    };
    Ok(async move {
        next().await;
        tracing::info!("stopping: running jobs may finish, a second signal ends at once");
        tokio::spawn(async move {
            next().await;
            tracing::warn!("ended at once; jobs that ran are put back at the next start");
            log.finish();
            std::process::exit(1);
        });
    })
}

//! The signals that stop the service.

use std::future::Future;

use tokio::signal::unix::{Signal, SignalKind, signal};

use super::super::Failure;
use super::log::Log;

/// Ready at the first SIGTERM, SIGINT or SIGHUP; a further SIGTERM or SIGINT ends the process at once.
///
/// A further SIGHUP does not: service managers and closing terminals send it beside another signal, or twice.
///
/// # Errors
/// The signals cannot be listened for.
pub(super) fn stop_signal(log: Log) -> Result<impl Future<Output = ()>, Failure> {
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    let mut hangup = hangup()?;
    Ok(async move {
        tokio::select! {
            () = either(&mut terminate, &mut interrupt) => {}
            () = hung_up(&mut hangup) => {}
        }
        tracing::info!("stopping: running jobs may finish, a second signal ends at once");
        tokio::spawn(async move {
            either(&mut terminate, &mut interrupt).await;
            tracing::warn!("ended at once; jobs that ran are put back at the next start");
            log.finish();
            std::process::exit(1);
        });
    })
}

async fn either(one: &mut Signal, other: &mut Signal) {
    tokio::select! {
        _ = one.recv() => {}
        _ = other.recv() => {}
    }
}

/// `None` where whoever started the process had it ignore SIGHUP, as nohup does: that is to stay so.
fn hangup() -> Result<Option<Signal>, Failure> {
    let kind = SignalKind::hangup();
    Ok(if is_ignored(kind) { None } else { Some(signal(kind)?) })
}

async fn hung_up(hangup: &mut Option<Signal>) {
    match hangup {
        Some(hangup) => drop(hangup.recv().await),
        None => std::future::pending().await,
    }
}

/// As far as the system tells.
fn is_ignored(kind: SignalKind) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default();
    // The lowest bit is that of signal 1.
    ignored >> (kind.as_raw_value() - 1) & 1 == 1
}

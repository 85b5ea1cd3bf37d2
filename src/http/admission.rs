//! Whether there is room for one more job and one more upload.

use axum::http::header;
use tokio::sync::OwnedSemaphorePermit;

use super::App;
use super::access::Caller;
use super::problem::{Problem, QUEUE_FULL, TOO_MANY_JOBS, TOO_MANY_UPLOADS};

/// Seconds after which a client should try again.
const RETRY_AFTER: u32 = 10;

/// Asked before a mesh comes in, so that what cannot be taken is not sent. Requests at the same moment may each be
/// let in: the bounds hold but for those.
///
/// # Errors
/// 429 where the caller has as many active jobs as it may, 503 where the queue is full.
pub(super) async fn room(app: &App, caller: &Caller) -> Result<(), Problem> {
    let limits = app.limits();
    if let Some(owner) = caller.owner()
        && app.jobs().active_of(owner).await? >= limits.jobs_per_principal
    {
        let most = limits.jobs_per_principal;
        let detail = format!("{most} of your jobs wait or run; send the next when one of them has ended");
        return Err(later(Problem::new(&TOO_MANY_JOBS, detail).with("limit", most)));
    }
    if app.jobs().waiting().await? >= limits.queue {
        let detail = format!("{} jobs wait; try again when there are fewer", limits.queue);
        return Err(later(Problem::new(&QUEUE_FULL, detail).with("limit", limits.queue)));
    }
    Ok(())
}

/// A place among the uploads that come in; dropping it gives it back.
///
/// # Errors
/// 503 where all are taken.
pub(super) fn place(app: &App) -> Result<OwnedSemaphorePermit, Problem> {
    app.uploads().clone().try_acquire_owned().map_err(|_| {
        let most = app.limits().uploads;
        let detail = format!("{most} uploads come in already; try again when one has ended");
        later(Problem::new(&TOO_MANY_UPLOADS, detail).with("limit", most))
    })
}

fn later(problem: Problem) -> Problem {
    problem.header(header::RETRY_AFTER, RETRY_AFTER)
}

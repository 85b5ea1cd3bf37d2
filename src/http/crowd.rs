//! How many connections may be open, and what becomes of those past that.
//!
//! A connection past the limit is not left waiting: a request under `/v1` on it gets a 503 that says why, a probe or a
//! scrape its answer, and then it is closed. Where those are many too, the next wait to be accepted.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::App;
use super::access::is_of_api;
use super::problem::{Problem, TOO_MANY_CONNECTIONS};

/// The most connections past the limit that are open at once: this, and a quarter of the limit.
const STANDING: usize = 64;
/// How long one of them may be open, and how long it may take to say what it wants: who says nothing keeps a probe waiting.
pub(super) const HEARING: Duration = Duration::from_secs(5);
pub(super) const ASKING: Duration = Duration::from_secs(1);
/// Seconds after which a client should try again.
const RETRY_AFTER: u32 = 5;

/// The connections that may be open at once; clones share them.
#[derive(Debug, Clone)]
pub(super) struct Crowd {
    most: usize,
    seats: Arc<Semaphore>,
    standing: Arc<Semaphore>,
    most_standing: usize,
}

/// A connection's place; dropping it gives it back.
pub(super) struct Place {
    _permit: OwnedSemaphorePermit,
    is_seat: bool,
}

impl Place {
    /// Whether it is within the limit.
    pub(super) fn is_seat(&self) -> bool {
        self.is_seat
    }
}

impl Crowd {
    pub(super) fn new(most: usize) -> Self {
        let most = most.clamp(1, Semaphore::MAX_PERMITS);
        let standing = (most / 4).clamp(1, STANDING);
        let of = |places| Arc::new(Semaphore::new(places));
        Self { most, seats: of(most), standing: of(standing), most_standing: standing }
    }

    /// Whether one more may be accepted.
    pub(super) fn has_room(&self) -> bool {
        self.seats.available_permits() > 0 || self.standing.available_permits() > 0
    }

    /// A place for one more, where there is [room](Self::has_room).
    pub(super) fn take(&self) -> Option<Place> {
        let seat =
            self.seats.clone().try_acquire_owned().map(|permit| Place { _permit: permit, is_seat: true });
        let stand = || self.standing.clone().try_acquire_owned();
        seat.or_else(|_| stand().map(|permit| Place { _permit: permit, is_seat: false })).ok()
    }

    /// Connections within the limit that are open now.
    pub(super) fn seated(&self) -> usize {
        self.most - self.seats.available_permits()
    }

    /// Those past it.
    pub(super) fn standing(&self) -> usize {
        self.most_standing - self.standing.available_permits()
    }
}

/// The mark of a request on a connection past the limit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standing;

/// Answers what comes on a connection past the limit and is about jobs with a 503.
pub(super) async fn turn_away(State(app): State<App>, request: Request, next: Next) -> Response {
    if !is_of_api(request.uri().path()) || request.extensions().get::<Standing>().is_none() {
        return next.run(request).await;
    }
    let most = app.limits().connections;
    let detail = format!("{most} connections are open already; try again when there are fewer");
    let problem = Problem::new(&TOO_MANY_CONNECTIONS, detail).with("limit", most);
    problem.header(header::RETRY_AFTER, RETRY_AFTER).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_stand_where_all_are_seated_and_then_there_is_no_room() {
        let crowd = Crowd::new(8);
        let mut seated: Vec<Place> = (0..8).map(|_| crowd.take().unwrap()).collect();
        assert!(seated.iter().all(Place::is_seat) && crowd.has_room());
        let standing = [crowd.take().unwrap(), crowd.take().unwrap()];
        assert!(standing.iter().all(|place| !place.is_seat()));
        assert!(!crowd.has_room() && crowd.take().is_none());
        assert_eq!((crowd.seated(), crowd.standing()), (8, 2));
        // A seat is free though nobody may stand.
        seated.pop();
        assert!(crowd.has_room());
        seated.push(crowd.take().unwrap());
        assert!(seated.iter().all(Place::is_seat) && !crowd.has_room());
        drop(standing);
        assert!(crowd.has_room() && !crowd.take().unwrap().is_seat());
        seated.pop();
        assert!(crowd.take().unwrap().is_seat());
        assert_eq!(crowd.seated(), 7);
    }

    #[test]
    fn any_number_may_be_asked_for() {
        assert!(Crowd::new(1).has_room());
        assert_eq!(Crowd::new(usize::MAX).seated(), 0);
    }
}

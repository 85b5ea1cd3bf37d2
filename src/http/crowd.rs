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

/// Connections past the limit that are open at once: a quarter of the limit, within these.
const FEWEST: usize = 4;
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
}

/// A connection's place; dropping it gives it back.
pub(super) struct Place {
    _permit: OwnedSemaphorePermit,
    is_seat: bool,
    crowd: Crowd,
}

impl Place {
    /// A seat where one comes free at once: a client that asks on one connection after the other comes back before its last one
    /// has ended here.
    pub(super) async fn seated_soon(self) -> Self {
        /// Longer than a connection takes to end.
        const SOON: Duration = Duration::from_millis(100);
        if self.is_seat {
            return self;
        }
        match tokio::time::timeout(SOON, self.crowd.seats.clone().acquire_owned()).await {
            Ok(Ok(permit)) => Self { _permit: permit, is_seat: true, ..self },
            _ => self,
        }
    }

    /// Whether it is within the limit.
    pub(super) fn is_seat(&self) -> bool {
        self.is_seat
    }
}

impl Crowd {
    pub(super) fn new(most: usize) -> Self {
        let most = most.clamp(1, Semaphore::MAX_PERMITS);
        let of = |places| Arc::new(Semaphore::new(places));
        Self { most, seats: of(most), standing: of(most_standing(most)) }
    }

    /// Whether one more may be accepted.
    pub(super) fn has_room(&self) -> bool {
        self.seats.available_permits() > 0 || self.standing.available_permits() > 0
    }

    /// A place for one more, where there is [room](Self::has_room).
    pub(super) fn take(&self) -> Option<Place> {
        let seat = self.seats.clone().try_acquire_owned().map(|permit| (permit, true));
        let stand = |_| self.standing.clone().try_acquire_owned().map(|permit| (permit, false));
        let (permit, is_seat) = seat.or_else(stand).ok()?;
        Some(Place { _permit: permit, is_seat, crowd: self.clone() })
    }

    /// Connections within the limit that are open now.
    pub(super) fn seated(&self) -> usize {
        self.most - self.seats.available_permits()
    }

    /// Those past it.
    pub(super) fn standing(&self) -> usize {
        most_standing(self.most) - self.standing.available_permits()
    }
}

/// How many may stand where so many have a seat.
fn most_standing(seats: usize) -> usize {
    (seats / 4).clamp(FEWEST, STANDING)
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
        let crowd = Crowd::new(16);
        let mut seated: Vec<Place> = (0..16).map(|_| crowd.take().unwrap()).collect();
        assert!(seated.iter().all(Place::is_seat) && crowd.has_room());
        let standing = [(); 4].map(|()| crowd.take().unwrap());
        assert!(standing.iter().all(|place| !place.is_seat()));
        assert!(!crowd.has_room() && crowd.take().is_none());
        assert_eq!((crowd.seated(), crowd.standing()), (16, 4));
        // A seat is free though nobody may stand.
        seated.pop();
        assert!(crowd.has_room());
        seated.push(crowd.take().unwrap());
        assert!(seated.iter().all(Place::is_seat) && !crowd.has_room());
        drop(standing);
        assert!(crowd.has_room() && !crowd.take().unwrap().is_seat());
        seated.pop();
        assert!(crowd.take().unwrap().is_seat());
        assert_eq!(crowd.seated(), 15);
    }

    #[tokio::test]
    async fn who_stands_gets_the_seat_that_comes_free_at_once() {
        let crowd = Crowd::new(1);
        let (seated, standing) = (crowd.take().unwrap(), crowd.take().unwrap());
        assert!(!standing.is_seat());
        let (place, ()) = tokio::join!(standing.seated_soon(), async { drop(seated) });
        assert!(place.is_seat());
        assert_eq!((crowd.seated(), crowd.standing()), (1, 0));
        assert!(!crowd.take().unwrap().seated_soon().await.is_seat(), "none comes free");
    }

    #[test]
    fn any_number_may_be_asked_for() {
        assert!(Crowd::new(1).has_room());
        assert_eq!(Crowd::new(usize::MAX).seated(), 0);
    }
}

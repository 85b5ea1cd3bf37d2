//! Whether there is room for one more job and one more upload.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

use axum::http::header;
use tokio::sync::OwnedSemaphorePermit;

use super::App;
use super::access::Caller;
use super::audit::Peer;
use super::problem::{Problem, QUEUE_FULL, TOO_MANY_JOBS, TOO_MANY_OWN_UPLOADS, TOO_MANY_UPLOADS};

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

/// A place among the uploads that come in, and in its sender's share of them; dropping it gives both back.
pub(super) struct Place {
    _place: OwnedSemaphorePermit,
    _share: Share,
}

/// # Errors
/// 429 where the sender has its share already, 503 where all places are taken.
pub(super) fn place(app: &App, caller: &Caller, peer: Option<&Peer>) -> Result<Place, Problem> {
    let limits = app.limits();
    let sender = Sender::of(caller, peer);
    let share = app.shares().take(sender, limits.uploads_each).ok_or_else(|| {
        let most = limits.uploads_each;
        let detail =
            format!("{most} of your uploads come in already; send the next when one of them has ended");
        later(Problem::new(&TOO_MANY_OWN_UPLOADS, detail).with("limit", most))
    })?;
    let place = app.uploads().clone().try_acquire_owned().map_err(|_| {
        let most = limits.uploads;
        let detail = format!("{most} uploads come in already; try again when one has ended");
        later(Problem::new(&TOO_MANY_UPLOADS, detail).with("limit", most))
    })?;
    Ok(Place { _place: place, _share: share })
}

fn later(problem: Problem) -> Problem {
    problem.header(header::RETRY_AFTER, RETRY_AFTER)
}

/// Whose share an upload counts in: a principal's, or where nobody needs a key an address's.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Sender {
    Principal(String),
    /// Of IPv6 the network: one client has as many addresses in it as it likes (RFC 4291, section 2.5.4).
    Address(IpAddr),
    Unknown,
}

impl Sender {
    fn of(caller: &Caller, peer: Option<&Peer>) -> Self {
        match (caller.owner(), peer.map(|Peer(address)| address.to_canonical())) {
            (Some(name), _) => Sender::Principal(name.to_owned()),
            (None, Some(IpAddr::V6(address))) => {
                Sender::Address(Ipv6Addr::from(u128::from(address) >> 64 << 64).into())
            }
            (None, Some(address)) => Sender::Address(address),
            (None, None) => Sender::Unknown,
        }
    }
}

/// How many uploads of each sender come in now; clones share it.
#[derive(Clone, Default)]
pub(super) struct Shares(Arc<Mutex<HashMap<Sender, usize>>>);

impl Shares {
    fn take(&self, sender: Sender, most: usize) -> Option<Share> {
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = held.entry(sender.clone()).or_default();
        if *count >= most {
            return None;
        }
        *count += 1;
        Some(Share { shares: self.clone(), sender })
    }
}

/// One upload in its sender's share.
struct Share {
    shares: Shares,
    sender: Sender,
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut held = self.shares.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = held.get_mut(&self.sender) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.sender);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_a_principals_or_a_networks_and_come_back() {
        let of = |address: &str| Sender::of(&Caller::Anyone, Some(&Peer(address.parse().unwrap())));
        assert_eq!(of("2001:db8:1:2:3::4"), of("2001:db8:1:2:ffff::1"));
        assert_ne!(of("2001:db8:1:2::1"), of("2001:db8:1:3::1"));
        assert_eq!(of("::ffff:192.0.2.1"), of("192.0.2.1"));
        assert_ne!(of("192.0.2.1"), of("192.0.2.2"));
        let shares = Shares::default();
        let first = shares.take(of("192.0.2.1"), 1).unwrap();
        assert!(shares.take(of("192.0.2.1"), 1).is_none() && shares.take(of("192.0.2.2"), 1).is_some());
        drop(first);
        assert!(shares.take(of("192.0.2.1"), 1).is_some());
        assert!(shares.0.lock().unwrap().is_empty(), "who sends nothing is forgotten");
    }
}

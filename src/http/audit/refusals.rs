//! Refusals of one sender that come fast are summed up, so that who is not let in does not fill the disk.

use std::collections::{BTreeSet, HashMap};
use std::net::{IpAddr, Ipv6Addr};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use time::OffsetDateTime;

use super::{Occurrence, Peer};

/// Refusals of one sender in a minute that have a line each; those after them have one together.
pub(super) const LINES: u64 = 20;
/// Senders that are counted apart in a minute; the others are counted together.
const SENDERS: usize = 64;

/// Whose refusals are counted together.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) enum Sender {
    /// Of IPv6 the network: one client has as many addresses in it as it likes (RFC 4291, section 2.5.4). The user is there
    /// who is known and may not do what was asked for.
    One { address: Option<IpAddr>, user: Option<String> },
    /// Those beyond [`SENDERS`].
    Others,
}

impl Sender {
    fn of(occurrence: &Occurrence<'_>) -> Self {
        let address = occurrence.peer.map(|Peer(address)| match address.to_canonical() {
            IpAddr::V6(address) => Ipv6Addr::from(u128::from(address) >> 64 << 64).into(),
            address @ IpAddr::V4(_) => address,
        });
        Self::One { address, user: occurrence.user.map(str::to_owned) }
    }

    /// The address; of IPv6 that of the network with its length.
    pub(super) fn address(&self) -> Option<String> {
        match self {
            Self::One { address: Some(IpAddr::V6(network)), .. } => Some(format!("{network}/64")),
            Self::One { address, .. } => address.map(|address| address.to_string()),
            Self::Others => None,
        }
    }

    pub(super) fn user(&self) -> Option<&str> {
        match self {
            Self::One { user, .. } => user.as_deref(),
            Self::Others => Some("several"),
        }
    }
}

/// What is counted of one sender in a minute.
struct Count {
    lines: u64,
    sum: Option<Sum>,
}

/// Refusals that have one line together.
pub(super) struct Sum {
    pub(super) count: u64,
    pub(super) first: OffsetDateTime,
    pub(super) last: OffsetDateTime,
    pub(super) statuses: BTreeSet<StatusCode>,
}

/// The refusals of a minute.
pub(super) struct Refusals {
    minute: Duration,
    /// When the minute began, with its first refusal.
    begin: Option<Instant>,
    counts: HashMap<Sender, Count>,
}

impl Refusals {
    pub(super) fn new(minute: Duration) -> Self {
        Self { minute, begin: None, counts: HashMap::new() }
    }

    /// Counts a refusal; whether it has a line of its own. Those of a minute that has ended are to be taken before.
    pub(super) fn add(&mut self, occurrence: &Occurrence<'_>, now: Instant) -> bool {
        self.begin.get_or_insert(now);
        let mut sender = Sender::of(occurrence);
        if self.counts.len() >= SENDERS && !self.counts.contains_key(&sender) {
            sender = Sender::Others;
        }
        let count = self.counts.entry(sender).or_insert(Count { lines: 0, sum: None });
        if count.lines < LINES {
            count.lines += 1;
            return true;
        }
        let time = OffsetDateTime::now_utc();
        let sum =
            count.sum.get_or_insert(Sum { count: 0, first: time, last: time, statuses: BTreeSet::new() });
        sum.count += 1;
        sum.last = time;
        sum.statuses.insert(occurrence.status);
        false
    }

    /// What is to be told of the minute, once it has ended.
    pub(super) fn ended(&mut self, now: Instant) -> Vec<(Sender, Sum)> {
        if self.is_due(now) { self.take() } else { Vec::new() }
    }

    /// Whether the minute has ended.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.begin.is_some_and(|begin| now.saturating_duration_since(begin) >= self.minute)
    }

    #[cfg(test)]
    pub(super) fn is_empty(&self) -> bool {
        self.begin.is_none()
    }

    /// The same of a minute that has not ended.
    pub(super) fn take(&mut self) -> Vec<(Sender, Sum)> {
        self.begin = None;
        let mut sums: Vec<(Sender, Sum)> =
            self.counts.drain().filter_map(|(sender, count)| Some((sender, count.sum?))).collect();
        sums.sort_by_key(|(_, sum)| sum.first);
        sums
    }
}

#[cfg(test)]
mod tests {
    use axum::http::Method;

    use super::*;

    fn add(refusals: &mut Refusals, address: &str, user: Option<&str>, now: Instant) -> bool {
        let peer = Some(Peer(address.parse().unwrap()));
        let status = StatusCode::UNAUTHORIZED;
        let occurrence = Occurrence { method: &Method::GET, path: "/v1/jobs", status, user, peer, job: None };
        refusals.add(&occurrence, now)
    }

    #[test]
    fn a_senders_refusals_have_lines_and_then_a_sum_each_minute() {
        let minute = Duration::from_secs(60);
        let (mut refusals, begin) = (Refusals::new(minute), Instant::now());
        for round in 0..2 {
            let now = begin + minute * round;
            let lines = (0..50).filter(|_| add(&mut refusals, "192.0.2.1", None, now)).count();
            assert_eq!(lines as u64, LINES);
            assert!(add(&mut refusals, "192.0.2.1", Some("pacs"), now), "somebody known counts apart");
            assert!(
                add(&mut refusals, "192.0.2.2", None, now)
                    && add(&mut refusals, "::ffff:192.0.2.2", None, now)
            );
            for host in 0..u16::try_from(LINES).unwrap() {
                assert!(add(&mut refusals, &format!("2001:db8::{host:x}"), None, now));
            }
            assert!(!add(&mut refusals, "2001:db8::ffff", None, now), "a network counts as one");
            assert!(refusals.ended(now + minute - Duration::from_secs(1)).is_empty());
            let mut sums = refusals.ended(now + minute);
            sums.sort_by_key(|(_, sum)| sum.count);
            let told: Vec<_> =
                sums.iter().map(|(sender, sum)| (sender.address().unwrap(), sum.count)).collect();
            assert_eq!(told, [("2001:db8::/64".to_owned(), 1), ("192.0.2.1".to_owned(), 30)]);
        }
    }

    #[test]
    fn senders_beyond_a_number_are_counted_together() {
        let (mut refusals, now) = (Refusals::new(Duration::from_secs(60)), Instant::now());
        let lines = (0..10_000_u32).filter(|host| {
            let address = std::net::Ipv4Addr::from(*host).to_string();
            add(&mut refusals, &address, None, now)
        });
        assert_eq!(lines.count(), SENDERS + LINES as usize);
        assert_eq!(refusals.counts.len(), SENDERS + 1);
        let sums = refusals.take();
        assert_eq!(sums.len(), 1);
        assert_eq!((sums[0].1.count, &sums[0].0), (10_000 - SENDERS as u64 - LINES, &Sender::Others));
        assert!(refusals.take().is_empty() && refusals.counts.is_empty());
    }
}

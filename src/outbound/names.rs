//! Addresses of the hosts that requests go to.

use std::net::SocketAddr;

use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use tokio::sync::Semaphore;

/// Names that are looked up at the same time. A lookup keeps one of the threads that the disk works with until the
/// system answers, also when its request was given up: dead name servers must leave the others free.
static LOOKUPS: Semaphore = Semaphore::const_new(4);

/// The system's names, a few at a time.
pub(super) struct Names;

impl Resolve for Names {
    fn resolve(&self, name: Name) -> Resolving {
        Box::pin(async move {
            let place = LOOKUPS.acquire().await?;
            // On its own: who asked may go, the thread that looks stays taken.
            let lookup = tokio::spawn(async move {
                let found = tokio::net::lookup_host((name.as_str(), 0)).await;
                drop(place);
                found.map(Iterator::collect::<Vec<SocketAddr>>)
            });
            Ok(Box::new(lookup.await??.into_iter()) as Addrs)
        })
    }
}

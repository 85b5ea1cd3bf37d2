//! What is to be told, with commits that pass their points.

use std::sync::Arc;

use futures::FutureExt;

use super::store::{commit, failed};
use super::{Operation, Side, pass};
use crate::jobs::store::{DeliveryStore, StoreFuture};
use crate::jobs::{Delivery, DeliveryCounts, Lease, Listener, Told};

/// A store of deliveries in which commits can be made to fail. A new commit of the interface does not compile before it is
/// here.
pub struct FaultyDeliveries(pub Arc<dyn DeliveryStore>);

impl DeliveryStore for FaultyDeliveries {
    fn set_listeners<'a>(&'a self, listeners: &'a [Listener], now: i64) -> StoreFuture<'a, ()> {
        commit(Operation::StoreListen, self.0.set_listeners(listeners, now))
    }

    fn count_listeners(&self) -> StoreFuture<'_, u64> {
        self.0.count_listeners()
    }

    fn release_deliveries(&self, now: i64) -> StoreFuture<'_, u64> {
        commit(Operation::StoreReleaseDeliveries, self.0.release_deliveries(now))
    }

    fn is_due<'a>(&'a self, listener: &'a str, now: i64) -> StoreFuture<'a, bool> {
        self.0.is_due(listener, now)
    }

    fn claim_delivery<'a>(
        &'a self,
        listener: &'a str,
        lease: &'a Lease,
        now: i64,
        until: i64,
    ) -> StoreFuture<'a, Option<Delivery>> {
        async move {
            pass(Operation::StoreClaimDelivery, Side::Before).map_err(failed)?;
            let claimed = self.0.claim_delivery(listener, lease, now, until).await?;
            // One that got nothing has committed nothing.
            if claimed.is_some() {
                pass(Operation::StoreClaimDelivery, Side::After).map_err(failed)?;
            }
            Ok(claimed)
        }
        .boxed()
    }

    fn settle_delivery<'a>(
        &'a self,
        id: &'a str,
        lease: &'a Lease,
        told: &'a Told,
        now: i64,
    ) -> StoreFuture<'a, bool> {
        commit(Operation::StoreSettleDelivery, self.0.settle_delivery(id, lease, told, now))
    }

    fn dead<'a>(&'a self, before: Option<&'a str>, limit: u32) -> StoreFuture<'a, Vec<Delivery>> {
        self.0.dead(before, limit)
    }

    fn revive<'a>(&'a self, id: &'a str, now: i64) -> StoreFuture<'a, bool> {
        commit(Operation::StoreRevive, self.0.revive(id, now))
    }

    fn forget_dead(&self, time: i64) -> StoreFuture<'_, u64> {
        commit(Operation::StoreForgetDead, self.0.forget_dead(time))
    }

    fn count_deliveries(&self) -> StoreFuture<'_, DeliveryCounts> {
        self.0.count_deliveries()
    }
}

//! Faults at named points, for the tests that crash the real service there and see what the next start finds.
//!
//! Every write, sync, rename and commit passes a point before and after. `ROSALINE_FAULT` arms some of them:
//! `store-succeed:after:crash,input-write:before:full@2` aborts the process after a commit and fails the second write
//! with a full disk; each fault comes once. Only builds with debug assertions read the variable: `cargo test` has
//! them without a feature to forget, and in a release build a point is an empty function.

#[cfg(debug_assertions)]
mod armed;
#[cfg(debug_assertions)]
mod deliveries;
#[cfg(debug_assertions)]
mod store;

use std::io;

#[cfg(debug_assertions)]
pub(super) use deliveries::FaultyDeliveries;
#[cfg(debug_assertions)]
pub(super) use store::FaultyStore;

/// Environment variable with the faults to come.
pub const VARIABLE: &str = "ROSALINE_FAULT";

/// Declares what can fail, with its name, and the list of it all.
macro_rules! operations {
    ($($(#[$doc:meta])* $operation:ident = $name:literal;)+) => {
        /// Something that can fail, before and after it is done.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Operation {
            $($(#[$doc])* $operation,)+
        }

        impl Operation {
            /// Every one.
            pub const ALL: &[Operation] = &[$(Operation::$operation),+];

            /// Its word in [`VARIABLE`].
            pub fn name(self) -> &'static str {
                match self {
                    $(Operation::$operation => $name,)+
                }
            }
        }
    };
}

operations! {
    // The folder.
    FolderCreate = "folder-create";
    ReserveWrite = "reserve-write";
    // Files: a mesh's, then a result's. A commit is a sync, a rename and a sync of the folder.
    InputCreate = "input-create";
    InputWrite = "input-write";
    InputCommit = "input-commit";
    ResultCreate = "result-create";
    ResultWrite = "result-write";
    ResultCommit = "result-commit";
    FileDelete = "file-delete";
    // Commits of rows.
    StoreOpen = "store-open";
    StoreInsert = "store-insert";
    StoreClaim = "store-claim";
    StoreUnclaim = "store-unclaim";
    StoreProgress = "store-progress";
    StoreSucceed = "store-succeed";
    StoreFail = "store-fail";
    StoreRelease = "store-release";
    StoreRetry = "store-retry";
    StoreDismiss = "store-dismiss";
    StoreBeginPurge = "store-begin-purge";
    StoreDelete = "store-delete";
    StoreRecover = "store-recover";
    StoreInputRemoved = "store-input-removed";
    StoreEndedBy = "store-ended-by";
    StoreNoteExpired = "store-note-expired";
    StoreForgetExpired = "store-forget-expired";
    // Commits of what is to be told.
    StoreListen = "store-listen";
    StoreReleaseDeliveries = "store-release-deliveries";
    StoreClaimDelivery = "store-claim-delivery";
    StoreSettleDelivery = "store-settle-delivery";
    StoreRevive = "store-revive";
    StoreForgetDead = "store-forget-dead";
    // The run, in the service's process and in its own.
    Run = "run";
    Method = "method";
    // The audit trail and the keys.
    AuditWrite = "audit-write";
    AuditSync = "audit-sync";
    AuditRotate = "audit-rotate";
    OperatorFileWrite = "operator-file-write";
    OperatorFileSync = "operator-file-sync";
    OperatorFileRename = "operator-file-rename";
}

/// When an operation fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Before,
    After,
}

/// Passes a point: nothing happens, unless a fault is armed there.
///
/// # Errors
/// The fault, if it is an error.
pub fn pass(operation: Operation, side: Side) -> io::Result<()> {
    #[cfg(debug_assertions)]
    return armed::pass(operation, side);
    #[cfg(not(debug_assertions))]
    {
        let _ = (operation, side);
        Ok(())
    }
}

/// Does something that can fail between its two points.
pub fn between<T>(operation: Operation, action: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    pass(operation, Side::Before)?;
    let done = action()?;
    pass(operation, Side::After)?;
    Ok(done)
}

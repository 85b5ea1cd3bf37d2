//! The faults that were asked for.

use std::io;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::{Operation, Side, VARIABLE};

/// How long the line of a crash may take on its way.
const LOGGED: Duration = Duration::from_millis(100);

/// What happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    /// The process dies.
    Crash,
    /// The disk answers with an error.
    Error,
    /// The disk is full.
    Full,
    Panic,
}

#[derive(Debug)]
struct Fault {
    operation: Operation,
    side: Side,
    action: Action,
    /// At which passing it comes.
    at: u32,
    passed: AtomicU32,
}

static FAULTS: OnceLock<Vec<Fault>> = OnceLock::new();

/// `OPERATION:SIDE:ACTION`, with `@N` for the Nth passing.
fn fault(text: &str) -> Option<Fault> {
    let (what, at) = text.split_once('@').unwrap_or((text, "1"));
    let mut words = what.split(':');
    let (operation, side, action) = (words.next()?, words.next()?, words.next()?);
    Some(Fault {
        operation: *Operation::ALL.iter().find(|known| known.name() == operation)?,
        side: match side {
            "before" => Side::Before,
            "after" => Side::After,
            _ => return None,
        },
        action: match action {
            "crash" => Action::Crash,
            "error" => Action::Error,
            "full" => Action::Full,
            "panic" => Action::Panic,
            _ => return None,
        },
        at: at.parse().ok()?,
        passed: AtomicU32::new(0),
    })
}

fn faults() -> &'static [Fault] {
    FAULTS.get_or_init(|| {
        let text = std::env::var(VARIABLE).unwrap_or_default();
        let words = text.split(',').filter(|word| !word.is_empty());
        words
            .filter_map(|word| {
                let fault = fault(word);
                if fault.is_none() {
                    tracing::error!(word, "this is no fault");
                }
                fault
            })
            .collect()
    })
}

pub(super) fn pass(operation: Operation, side: Side) -> io::Result<()> {
    for fault in faults().iter().filter(|fault| (fault.operation, fault.side) == (operation, side)) {
        if fault.passed.fetch_add(1, Ordering::Relaxed) + 1 != fault.at {
            continue;
        }
        let Fault { action, .. } = fault;
        tracing::error!(fault = operation.name(), ?side, ?action, "a fault was asked for here");
        match action {
            Action::Crash => {
                // The log has a thread of its own, and tests read there that this was come by.
                std::thread::sleep(LOGGED);
                std::process::abort()
            }
            Action::Error => return Err(io::Error::other("a fault was asked for here")),
            Action::Full => return Err(io::ErrorKind::StorageFull.into()),
            #[expect(clippy::panic, reason = "it is what was asked for")]
            Action::Panic => panic!("a fault was asked for here"),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read() {
        let read = fault("store-succeed:after:crash@3").unwrap();
        let found = (read.operation, read.side, read.action, read.at);
        assert_eq!(found, (Operation::StoreSucceed, Side::After, Action::Crash, 3));
        for text in ["", "store-succeed", "store-succeed:after", "x:after:crash", "run:after:crash@x"] {
            assert!(fault(text).is_none(), "{text}");
        }
        for (place, operation) in Operation::ALL.iter().enumerate() {
            assert!(Operation::ALL[..place].iter().all(|other| other.name() != operation.name()));
        }
    }
}

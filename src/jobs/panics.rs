//! Panics in the log.

/// Logs every panic from now on by its place in the source alone.
///
/// The message stays out: it may quote a mesh, and so patient data. For the start of the service's process;
/// the hook is the process's.
pub fn log_panics_without_text() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(ToString::to_string).unwrap_or_default();
        let thread = std::thread::current();
        tracing::error!(place, thread = thread.name().unwrap_or_default(), "panic");
    }));
}

//! The log on stderr: lines wait in a bounded queue for a thread of their own, which writes them.
//!
//! So a reader that stalls, a disk that is full or a reader that is gone costs lines, and never the service: no request and no
//! job waits for the log. Lines that are lost are counted, and told of as soon as one can be written again.

use std::io::{self, ErrorKind, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use super::super::Failure;
use super::args::LogFormat;
use crate::http::LostLines;

/// Lines that may wait: some MiB.
const WAITING: usize = 4096;
/// How long the last lines may take on their way when the service ends.
const LAST: Duration = Duration::from_secs(1);
/// How often lost lines are told of at most while more are lost.
const PAUSE: Duration = Duration::from_secs(1);
/// Before the next try to write what another program that has this stderr made not wait.
const LATER: Duration = Duration::from_millis(10);

/// The log of this process; clones share it.
#[derive(Clone)]
pub(super) struct Log {
    lines: SyncSender<Vec<u8>>,
    /// Lines that were taken and are neither written nor lost yet.
    waiting: Arc<AtomicUsize>,
    lost: LostLines,
}

impl Log {
    /// Logs to stderr what `ROSALINE_LOG` asks for, `info` without it.
    ///
    /// # Errors
    /// `ROSALINE_LOG` is no filter, or the thread cannot be started.
    pub fn start(format: LogFormat) -> Result<Self, Failure> {
        let filter = match std::env::var("ROSALINE_LOG") {
            Ok(text) => EnvFilter::try_new(text).map_err(|error| {
                Failure::new(format!("ROSALINE_LOG is no filter: {error}; try info or debug"))
            })?,
            Err(_) => EnvFilter::new("info"),
        };
        let log = Self::to(io::stderr())?;
        // What cannot be logged must not be told by eprintln!, which panics where stderr cannot be written.
        let lines = tracing_subscriber::fmt().with_env_filter(filter).log_internal_errors(false);
        let lines = lines.with_writer(log.clone());
        let started = match format {
            LogFormat::Text => lines.with_ansi(io::IsTerminal::is_terminal(&io::stderr())).try_init(),
            LogFormat::Json => lines.json().try_init(),
        };
        started.map_err(|error| Failure::new(format!("the log cannot be started: {error}")))?;
        Ok(log)
    }

    fn to(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (lines, come) = sync_channel(WAITING);
        let log = Self { lines, waiting: Arc::default(), lost: LostLines::default() };
        let writer = Writer { out, is_cut: false, told: 0, told_at: None, waiting: log.waiting.clone() };
        let lost = log.lost.clone();
        std::thread::Builder::new().name("log".to_owned()).spawn(move || writer.write(&come, &lost))?;
        Ok(log)
    }

    /// How many lines were lost.
    pub fn lost(&self) -> LostLines {
        self.lost.clone()
    }

    /// Waits until all lines are written, not longer than [`LAST`]: a reader that stalls must not keep the process.
    pub fn finish(&self) {
        let begin = Instant::now();
        while self.waiting.load(Ordering::Acquire) > 0 && begin.elapsed() < LAST {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// A line comes as one write.
impl Write for &Log {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.waiting.fetch_add(1, Ordering::AcqRel);
        if self.lines.try_send(line.to_vec()).is_err() {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
            self.lost.add();
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = &'a Log;

    fn make_writer(&'a self) -> &'a Log {
        self
    }
}

/// The thread that writes.
struct Writer<W> {
    out: W,
    /// The last line was written in part: the next one must not be taken for its rest.
    is_cut: bool,
    /// How many lost lines were told of, and when.
    told: u64,
    told_at: Option<Instant>,
    waiting: Arc<AtomicUsize>,
}

impl<W: Write> Writer<W> {
    fn write(mut self, lines: &Receiver<Vec<u8>>, lost: &LostLines) {
        while let Ok(line) = lines.recv() {
            match self.line(&line) {
                Ok(()) => self.tell(lost.count()),
                Err(_) => lost.add(),
            }
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
    }

    /// Logs that lines were lost. That is a line as any other: where it is lost too, it is told with the next.
    fn tell(&mut self, lost: u64) {
        let is_last = self.waiting.load(Ordering::Acquire) == 1;
        if lost > self.told && (is_last || self.told_at.is_none_or(|told| told.elapsed() >= PAUSE)) {
            (self.told, self.told_at) = (lost, Some(Instant::now()));
            tracing::error!(
                lost,
                "lines of the log were lost since the start: they could not be written in time"
            );
        }
    }

    fn line(&mut self, line: &[u8]) -> io::Result<()> {
        if self.is_cut {
            self.all(b"\n")?;
            self.is_cut = false;
        }
        self.all(line)
    }

    fn all(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let whole = bytes.len();
        while !bytes.is_empty() {
            let error = match self.out.write(bytes) {
                Ok(0) => ErrorKind::WriteZero.into(),
                Ok(length) => {
                    bytes = &bytes[length..];
                    continue;
                }
                Err(error) => error,
            };
            match error.kind() {
                ErrorKind::Interrupted => {}
                ErrorKind::WouldBlock => std::thread::sleep(LATER),
                _ => {
                    self.is_cut |= bytes.len() < whole;
                    return Err(error);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Has room for so many bytes, and what was written.
    #[derive(Clone, Default)]
    struct Disk(Arc<Mutex<(usize, Vec<u8>)>>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let (room, written) = &mut *self.0.lock().unwrap();
            let length = bytes.len().min(*room);
            if length == 0 {
                return Err(ErrorKind::StorageFull.into());
            }
            *room -= length;
            written.extend_from_slice(&bytes[..length]);
            Ok(length)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_line_that_was_cut_is_not_glued_to_the_next() {
        let disk = Disk::default();
        let log = Log::to(disk.clone()).unwrap();
        let say = |line: &[u8], room: usize| {
            disk.0.lock().unwrap().0 = room;
            (&log).write_all(line).unwrap();
            log.finish();
        };
        say(b"first\n", 100);
        say(b"second\n", 3);
        say(b"third\n", 0);
        say(b"fourth\n", 100);
        assert_eq!(String::from_utf8_lossy(&disk.0.lock().unwrap().1), "first\nsec\nfourth\n");
        assert_eq!(log.lost().count(), 2);
    }
}

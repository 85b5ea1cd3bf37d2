//! The audit trail: who did what to which job, one JSON object a line, in a file that is only ever added to.
//!
//! The members are those of an audit message of DICOM PS3.15, section A.5 (RFC 3881). Written are submissions, results
//! that were handed out, lists, cancellations and purges, retries, webhooks that are sent again, and refusals for want of a key or a scope; polls of
//! a status are not. Refusals that come fast are summed up, by [`refusals`]; what was let in never is.

mod message;
mod refusals;

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::http::{Method, StatusCode};
use serde_json::Value;
use time::OffsetDateTime;
use tokio_util::sync::CancellationToken;

pub(super) use self::message::Occurrence;
use self::message::{Act, of_sum};
use self::refusals::{Refusals, Sender, Sum};
use crate::jobs::faults::{Operation, between};

/// How long refusals are counted before those without a line of their own are told.
const MINUTE: Duration = Duration::from_secs(60);
/// How often to look whether that is over.
const LOOK: Duration = Duration::from_secs(1);
/// How long the last lines may take when the service stops: a disk that hangs must not keep it.
const LAST: Duration = Duration::from_secs(5);

/// Where a request came from: the connection's other end.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// Whether the trail is told of such an answer.
pub(super) fn is_told(method: &Method, path: &str, status: StatusCode) -> bool {
    Act::of(method, path, status).is_some()
}

/// The file that is added to. One that has grown is set aside under the time of its last line and never touched again.
pub struct Trail {
    path: PathBuf,
    rotate_at: u64,
    file: Mutex<File>,
    /// That of the file, kept open: no other gets its numbers.
    folder: File,
    /// Whether it was in its place when it was looked at last.
    was_there: AtomicBool,
    refusals: Mutex<Refusals>,
}

impl Trail {
    /// # Errors
    /// When the file cannot be opened for adding.
    pub fn open(path: &Path, rotate_at: u64) -> io::Result<Self> {
        Self::with_minute(path, rotate_at, MINUTE)
    }

    fn with_minute(path: &Path, rotate_at: u64, minute: Duration) -> io::Result<Self> {
        let (file, folder) = (Mutex::new(open(path)?), File::open(folder_of(path))?);
        let (refusals, was_there) = (Mutex::new(Refusals::new(minute)), AtomicBool::new(true));
        Ok(Self { path: path.to_owned(), rotate_at, file, folder, was_there, refusals })
    }

    /// Adds a line, if this is to be told, and waits until it is on disk. A refusal may be told later, with others.
    pub(super) fn tell(&self, occurrence: &Occurrence<'_>) {
        let Some(act) = Act::of(occurrence.method, occurrence.path, occurrence.status) else { return };
        if act == Act::Refused {
            let now = Instant::now();
            self.tell_sums(now);
            if !self.refusals().add(occurrence, now) {
                return;
            }
        }
        self.write(&occurrence.message(act));
    }

    /// Tells of the refusals of a minute that has ended.
    fn tell_sums(&self, now: Instant) {
        let sums = self.refusals().ended(now);
        self.write_sums(&sums);
    }

    /// Tells of those that were not told yet.
    fn finish(&self) {
        let sums = self.refusals().take();
        self.write_sums(&sums);
    }

    fn write_sums(&self, sums: &[(Sender, Sum)]) {
        for (sender, sum) in sums {
            self.write(&of_sum(sender, sum));
        }
    }

    fn refusals(&self) -> MutexGuard<'_, Refusals> {
        self.refusals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, message: &Value) {
        if let Err(error) = self.add(&format!("{message}\n")) {
            // The request is answered all the same: a full disk must not keep jobs from being purged.
            tracing::error!(%error, "the audit trail cannot be added to");
        }
    }

    fn add(&self, line: &str) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let in_place = self.is_folder_in_place();
        if in_place && let Err(error) = self.follow(&mut file) {
            tracing::error!(%error, "the audit trail's file was moved or removed, and no other can be begun; it goes on in that one");
        }
        if in_place
            && file.metadata()?.len() >= self.rotate_at
            && let Err(error) = self.rotate(&mut file)
        {
            tracing::error!(%error, "the audit trail cannot be set aside; it goes on in its file");
        }
        // One write, so that a crash leaves no half of a line but the last.
        between(Operation::AuditWrite, || file.write_all(line.as_bytes()))?;
        between(Operation::AuditSync, || file.sync_data())
    }

    /// Whether the folder that the trail was begun in is where it was: in the place of one that was moved or unmounted
    /// nothing is begun. What has changed is logged once.
    fn is_folder_in_place(&self) -> bool {
        let of = |found: fs::Metadata| (found.dev(), found.ino());
        let held = self.folder.metadata().map(of).ok();
        let is_there = held.is_some() && fs::metadata(folder_of(&self.path)).map(of).ok() == held;
        if self.was_there.swap(is_there, Ordering::Relaxed) != is_there {
            match is_there {
                true => tracing::info!("the audit trail's folder is back"),
                false => tracing::error!(
                    "the audit trail's folder is not in its place; it goes on in the file that is open"
                ),
            }
        }
        is_there
    }

    /// Begins another file where somebody moved or removed the one that is open: nobody would look for lines there.
    fn follow(&self, file: &mut File) -> io::Result<()> {
        let held = file.metadata()?;
        match fs::metadata(&self.path) {
            Ok(named) if (named.dev(), named.ino()) == (held.dev(), held.ino()) => return Ok(()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        *file = open(&self.path)?;
        let is_removed = held.nlink() == 0;
        tracing::warn!(
            is_removed,
            "somebody moved or removed the audit trail's file; it goes on in another of its name"
        );
        Ok(())
    }

    fn rotate(&self, file: &mut File) -> io::Result<()> {
        let renamed = between(Operation::AuditRotate, || fs::rename(&self.path, self.aside()));
        // After an error it may be renamed all the same.
        if renamed.is_ok() || !self.path.exists() {
            *file = append(&self.path)?;
        }
        renamed
    }

    /// A name that no older part has.
    fn aside(&self) -> PathBuf {
        let stamp = OffsetDateTime::now_utc().unix_timestamp_nanos();
        self.path.with_extension(format!("{stamp}.jsonl"))
    }
}

/// Tells of summed up refusals at the end of each minute, until the service closes.
pub(super) async fn follow(trail: Arc<Trail>, closing: CancellationToken) {
    loop {
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            () = closing.cancelled() => return,
        }
        // Most of the time there is nothing, and no thread is woken for it.
        if trail.refusals().is_due(Instant::now()) {
            off_the_async_threads(&trail, |trail| trail.tell_sums(Instant::now())).await;
        }
    }
}

/// Tells what has not been told when nothing more comes.
pub(super) async fn finish(trail: Option<&Arc<Trail>>) {
    let Some(trail) = trail else { return };
    if tokio::time::timeout(LAST, off_the_async_threads(trail, Trail::finish)).await.is_err() {
        tracing::warn!("the audit trail cannot be added to in time: the last refusals may be missing");
    }
}

async fn off_the_async_threads(trail: &Arc<Trail>, action: impl FnOnce(&Trail) + Send + 'static) {
    let trail = trail.clone();
    if let Err(error) = tokio::task::spawn_blocking(move || action(&trail)).await {
        tracing::error!(%error, "the audit trail cannot be added to");
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

/// For adding. What a crash left of a line stays as it is; the next one must not be taken for its end.
fn open(path: &Path) -> io::Result<File> {
    let mut file = append(path)?;
    if !ends_a_line(path)? {
        file.write_all(b"\n")?;
    }
    Ok(file)
}

/// Whether the file is empty or ends with a newline.
fn ends_a_line(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    if file.metadata()?.len() == 0 {
        return Ok(true);
    }
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(last == *b"\n")
}

fn append(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.append(true).create(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tell(trail: &Trail, method: Method, path: &str, status: StatusCode) {
        trail.tell(&Occurrence { method: &method, path, status, user: Some("pacs"), peer: None, job: None });
    }

    fn lines(path: &Path) -> Vec<Value> {
        let text = fs::read_to_string(path).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// Of how many requests a line tells.
    fn count(line: &Value) -> u64 {
        let details = line["ParticipantObjectIdentification"][0]["ParticipantObjectDetail"].as_array();
        let count = details.and_then(|details| details.iter().find(|each| each["type"] == "Count"));
        count.map_or(1, |count| count["value"].as_str().unwrap().parse().unwrap())
    }

    #[test]
    fn a_trail_that_somebody_moves_or_removes_goes_on_under_its_name() {
        let dir = tempfile::tempdir().unwrap();
        let (path, moved) = (dir.path().join("audit.jsonl"), dir.path().join("audit.jsonl.1"));
        let trail = Trail::open(&path, 1 << 20).unwrap();
        let import = || tell(&trail, Method::POST, "/v1/jobs", StatusCode::CREATED);
        import();
        fs::rename(&path, &moved).unwrap();
        import();
        import();
        assert_eq!((lines(&moved).len(), lines(&path).len()), (1, 2));
        fs::remove_file(&path).unwrap();
        import();
        assert_eq!(lines(&path).len(), 1);
        // Another file under its name, as a copy that was put back.
        fs::copy(&moved, dir.path().join("copy")).unwrap();
        fs::rename(dir.path().join("copy"), &path).unwrap();
        import();
        assert_eq!(lines(&path).len(), 2);
        // Where no other can be begun, the one that is open has the line.
        fs::rename(&path, &moved).unwrap();
        fs::create_dir(&path).unwrap();
        import();
        assert_eq!(lines(&moved).len(), 3);
    }

    #[tokio::test]
    async fn the_sum_of_a_minute_is_told_when_it_ends_and_nothing_more_comes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        let trail = Arc::new(Trail::with_minute(&path, 1 << 20, LOOK / 2).unwrap());
        let closing = CancellationToken::new();
        let following = tokio::spawn(follow(trail.clone(), closing.clone()));
        for _ in 0..1000 {
            tell(&trail, Method::POST, "/v1/jobs", StatusCode::FORBIDDEN);
        }
        let begin = Instant::now();
        while !trail.refusals().is_empty() {
            assert!(begin.elapsed() < Duration::from_secs(60), "it is never told");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        closing.cancel();
        following.await.unwrap();
        assert_eq!(lines(&path).iter().map(count).sum::<u64>(), 1000);
    }

    #[test]
    fn refusals_have_a_sum_and_what_was_let_in_has_lines() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        let trail = Trail::open(&path, 1 << 20).unwrap();
        for _ in 0..100 {
            tell(&trail, Method::POST, "/v1/jobs", StatusCode::FORBIDDEN);
            tell(&trail, Method::POST, "/v1/jobs", StatusCode::CREATED);
            tell(&trail, Method::GET, "/v1/jobs/x", StatusCode::OK);
        }
        trail.tell_sums(Instant::now() + Duration::from_secs(3600));
        let lines = lines(&path);
        let of = |name: &str| -> Vec<&Value> {
            let is = |line: &&Value| line["EventIdentification"]["EventID"]["originalText"] == name;
            lines.iter().filter(is).collect()
        };
        assert_eq!(of("Import").len(), 100);
        let refused = of("Security Alert");
        // Some minutes may end in between.
        assert!(refused.len() < 100, "{}", refused.len());
        assert_eq!(refused.iter().map(|line| count(line)).sum::<u64>(), 100);
        assert!(refused.iter().all(|line| line["ActiveParticipant"][0]["UserID"] == "pacs"));
    }

    #[test]
    fn a_trail_is_set_aside_whole_and_polls_are_not_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("audit.jsonl");
        let trail = Trail::open(&path, 1000).unwrap();
        for _ in 0..20 {
            tell(&trail, Method::POST, "/v1/jobs", StatusCode::CREATED);
            tell(&trail, Method::GET, "/v1/jobs/x", StatusCode::OK);
        }
        let mut lines = Vec::new();
        let mut files = 0;
        for entry in fs::read_dir(dir.path()).unwrap() {
            files += 1;
            let text = fs::read_to_string(entry.unwrap().path()).unwrap();
            lines.extend(text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()));
        }
        assert!(files > 2, "{files}");
        assert_eq!(lines.len(), 20);
        assert!(lines.iter().all(|line| line["EventIdentification"]["EventActionCode"] == "C"));
        // A new process goes on where the last one was.
        let before = fs::read_to_string(&path).unwrap();
        tell(&Trail::open(&path, 1 << 20).unwrap(), Method::DELETE, "/v1/jobs/x", StatusCode::NOT_FOUND);
        let after = fs::read_to_string(&path).unwrap();
        assert!(after.starts_with(&before));
        // Nor is a line that a crash cut short touched, or glued to the next.
        append(&path).unwrap().write_all(b"{\"Event").unwrap();
        tell(&Trail::open(&path, 1 << 20).unwrap(), Method::DELETE, "/v1/jobs/x", StatusCode::NOT_FOUND);
        let after = fs::read_to_string(&path).unwrap();
        assert_eq!(after.lines().rev().nth(1), Some("{\"Event"));
        let last: Value = serde_json::from_str(after.lines().last().unwrap()).unwrap();
        assert_eq!(last["EventIdentification"]["EventOutcomeIndicator"], 4);
    }
}

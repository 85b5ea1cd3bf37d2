//! What a process answers, as it comes in pieces.

use std::io::{self, Error, ErrorKind};

use super::words::{LONGEST_LINE, Word};
use crate::centerline::Part;
use crate::jobs::runner::{Artifact, RunControl};
use crate::jobs::{JobFailure, JobStage};
use crate::output::OutputFormat;

/// How a run ended that a process answered for.
pub(super) struct Answer {
    pub(super) result: Result<Vec<Artifact>, JobFailure>,
    /// Whether the process may be given another run: not after a panic.
    pub(super) is_sound: bool,
}

/// Puts the pieces together.
pub(super) struct Hearing {
    /// Of the word that is heard.
    line: Vec<u8>,
    artifacts: Vec<Artifact>,
    /// Bytes of the last artifact that are still to come.
    due: usize,
    /// Bytes that artifacts may still have, all together.
    left: u64,
    has_begun: bool,
}

impl Hearing {
    /// Of results of `most` bytes: they were in the memory of the process, which has no more.
    pub(super) fn new(most: u64) -> Self {
        Self { line: Vec::new(), artifacts: Vec::new(), due: 0, left: most, has_begun: false }
    }

    /// Whether the process has said anything.
    pub(super) fn has_begun(&self) -> bool {
        self.has_begun
    }

    /// The answer once it is whole.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidData`] at what is no word, or too much.
    pub(super) fn hear(&mut self, mut bytes: &[u8], control: &RunControl) -> io::Result<Option<Answer>> {
        self.has_begun = true;
        while !bytes.is_empty() {
            if self.due > 0
                && let Some(artifact) = self.artifacts.last_mut()
            {
                let (piece, rest) = bytes.split_at(self.due.min(bytes.len()));
                artifact.bytes.extend_from_slice(piece);
                self.due -= piece.len();
                bytes = rest;
                continue;
            }
            let end = bytes.iter().position(|&byte| byte == b'\n').map(|end| end + 1);
            let (piece, rest) = bytes.split_at(end.unwrap_or(bytes.len()));
            self.line.extend_from_slice(piece);
            bytes = rest;
            if self.line.len() as u64 > LONGEST_LINE {
                return Err(invalid("a line of its answer has no end"));
            }
            if end.is_some() {
                let word = serde_json::from_slice(&self.line)?;
                self.line.clear();
                if let Some(answer) = self.word(word, control)? {
                    return Ok(Some(answer));
                }
            }
        }
        Ok(None)
    }

    fn word(&mut self, word: Word, control: &RunControl) -> io::Result<Option<Answer>> {
        let failed = |failure, is_sound| Some(Answer { result: Err(failure), is_sound });
        Ok(match word {
            Word::Begun => None,
            Word::Report { stage, fraction, before, share } => {
                let stage =
                    JobStage::named(&stage).ok_or_else(|| invalid("its answer has an unknown stage"))?;
                control.report_part(stage, fraction, Part { before, share });
                None
            }
            Word::Artifact { format, size } => {
                self.begin_artifact(&format, size)?;
                None
            }
            Word::Failed(failure) => failed(failure, true),
            Word::Panicked { place } => {
                tracing::error!(place, "panic");
                failed(JobFailure::panicked(), false)
            }
            Word::Done => Some(Answer { result: Ok(std::mem::take(&mut self.artifacts)), is_sound: true }),
        })
    }

    fn begin_artifact(&mut self, format: &str, size: u64) -> io::Result<()> {
        let format = OutputFormat::from_extension(format);
        let format = format.ok_or_else(|| invalid("its answer has a result of an unknown format"))?;
        let left = self.left.checked_sub(size).zip(usize::try_from(size).ok());
        let (left, due) = left.ok_or_else(|| invalid("its answer is larger than its memory"))?;
        (self.left, self.due) = (left, due);
        self.artifacts.push(Artifact { format, bytes: Vec::new() });
        Ok(())
    }
}

fn invalid(what: &'static str) -> Error {
    Error::new(ErrorKind::InvalidData, what)
}

//! Words and numbers of the text formats, straight from the file's bytes.

use super::{Format, ReadError};

/// White-space separated tokens; any of LF, CR and CR LF breaks a line.
#[derive(Clone)]
pub(super) struct Tokens<'a> {
    format: Format,
    /// For messages, where these bytes are but a part of the file.
    part: &'static str,
    bytes: &'a [u8],
    at: usize,
}

/// Whether a byte separates tokens.
fn is_space(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\n' | b'\r' | 0x0b | 0x0c)
}

fn is_line_break(byte: u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

impl<'a> Tokens<'a> {
    pub(super) fn new(format: Format, bytes: &'a [u8]) -> Self {
        let mark = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
        Tokens { format, part: "", bytes, at: mark }
    }

    /// From an offset on.
    pub(super) fn starting_at(format: Format, bytes: &'a [u8], at: usize) -> Self {
        Tokens { format, part: "", bytes, at }
    }

    /// A complete part of the file, named " of a ..." in messages.
    pub(super) fn part(format: Format, part: &'static str, bytes: &'a [u8], at: usize) -> Self {
        Tokens { format, part, bytes, at }
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next `length` bytes, whatever they are.
    #[inline]
    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], ReadError> {
        let taken = self.bytes[self.at..].get(..length).ok_or_else(|| self.ends())?;
        self.at += length;
        Ok(taken)
    }

    pub(super) fn advance(&mut self, bytes: usize) {
        self.at = (self.at + bytes).min(self.bytes.len());
    }

    pub(super) fn skip_space(&mut self) {
        while self.bytes.get(self.at).is_some_and(|&byte| is_space(byte)) {
            self.at += 1;
        }
    }

    /// Skips space and what some writers pad a file's end with.
    pub(super) fn skip_padding(&mut self) {
        while self.bytes.get(self.at).is_some_and(|&byte| is_space(byte) || matches!(byte, 0 | 0x1a)) {
            self.at += 1;
        }
    }

    pub(super) fn is_at_end(&self) -> bool {
        self.at >= self.bytes.len()
    }

    /// Whether a line or the file ends here.
    pub(super) fn is_at_line_end(&self) -> bool {
        self.bytes.get(self.at).is_none_or(|&byte| is_line_break(byte))
    }

    /// Whether `word` begins right here, in any case.
    pub(super) fn is_at(&self, word: &[u8]) -> bool {
        self.bytes[self.at..].get(..word.len()).is_some_and(|bytes| bytes.eq_ignore_ascii_case(word))
    }

    pub(super) fn skip_line(&mut self) {
        while !self.is_at_line_end() {
            self.at += 1;
        }
    }

    /// Steps over one line break, if here is one.
    pub(super) fn skip_line_break(&mut self) {
        self.at += match self.bytes[self.at..] {
            [b'\r', b'\n', ..] => 2,
            [b'\r' | b'\n', ..] => 1,
            _ => 0,
        };
    }

    /// The next token, or `None` at the end.
    pub(super) fn peek(&mut self) -> Option<&'a [u8]> {
        self.skip_space();
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(|&byte| is_space(byte)).unwrap_or(rest.len());
        (end > 0).then(|| &rest[..end])
    }

    /// Takes the next token; the file must not end here.
    pub(super) fn next(&mut self) -> Result<&'a [u8], ReadError> {
        let token = self.peek().ok_or_else(|| self.ends())?;
        self.at += token.len();
        Ok(token)
    }

    /// Takes the next token when it is `word`, in any case; the file must not end here.
    pub(super) fn take_if(&mut self, word: &str) -> Result<bool, ReadError> {
        let token = self.peek().ok_or_else(|| self.ends())?;
        let matches = token.eq_ignore_ascii_case(word.as_bytes());
        if matches {
            self.at += token.len();
        }
        Ok(matches)
    }

    pub(super) fn expect(&mut self, word: &'static str) -> Result<(), ReadError> {
        if self.take_if(word)? {
            return Ok(());
        }
        Err(self.broken_token(&format!("\"{word}\" is missing")))
    }

    pub(super) fn number(&mut self) -> Result<f64, ReadError> {
        let token = self.peek().ok_or_else(|| self.ends())?;
        let number = parse(token).ok_or_else(|| self.broken_token("there is no number"))?;
        self.at += token.len();
        Ok(number)
    }

    /// A number before the line's end.
    pub(super) fn number_in_line(&mut self) -> Result<f64, ReadError> {
        while self.bytes.get(self.at).is_some_and(|byte| matches!(byte, b' ' | b'\t')) {
            self.at += 1;
        }
        if self.is_at_line_end() && self.at < self.bytes.len() {
            return Err(self.malformed("a number is missing at the line's end"));
        }
        self.number()
    }

    /// An index; its range is the caller's to check.
    pub(super) fn integer(&mut self) -> Result<i64, ReadError> {
        let token = self.peek().ok_or_else(|| self.ends())?;
        let number = parse(token).ok_or_else(|| self.broken_token("there is no integer"))?;
        self.at += token.len();
        Ok(number)
    }

    /// The next token is not what it should be; at the file's end it is the half of one.
    fn broken_token(&mut self, what: &str) -> ReadError {
        let length = self.peek().map_or(0, <[u8]>::len);
        if self.part.is_empty() && self.at + length == self.bytes.len() {
            self.ends()
        } else {
            self.malformed(what)
        }
    }

    pub(super) fn ends(&self) -> ReadError {
        let detail = format!("the data stop at byte {}{}", self.bytes.len(), self.part);
        ReadError::Truncated { format: self.format, detail }
    }

    /// An error that says where the next token stands.
    pub(super) fn malformed(&self, what: &str) -> ReadError {
        let line = count_lines(&self.bytes[..self.at]) + 1;
        ReadError::Malformed {
            format: self.format,
            detail: format!("{what} at byte {}, line {line}{}", self.at, self.part),
        }
    }
}

/// A number or index in ASCII.
pub(super) fn parse<T: std::str::FromStr>(token: &[u8]) -> Option<T> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// Line breaks so far, CR LF counted once.
fn count_lines(bytes: &[u8]) -> usize {
    let breaks = bytes.iter().filter(|&&byte| is_line_break(byte)).count();
    breaks - bytes.windows(2).filter(|pair| pair == b"\r\n").count()
}

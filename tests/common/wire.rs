//! A client that may be slow, leave half-way, or find its connection closed: HTTP by hand over one socket.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// An answer.
pub struct Answer {
    pub status: u16,
    /// Empty without the header.
    pub location: String,
    pub body: Vec<u8>,
}

/// One connection, kept open.
pub struct Client {
    address: String,
    stream: Option<BufReader<TcpStream>>,
    /// Further lines of every request's head, each with its end.
    pub headers: &'static str,
}

impl Client {
    pub fn new(address: &str) -> Self {
        Self { address: address.to_owned(), stream: None, headers: "" }
    }

    fn stream(&mut self) -> io::Result<&mut BufReader<TcpStream>> {
        if self.stream.is_none() {
            let stream = TcpStream::connect(&self.address)?;
            stream.set_nodelay(true)?;
            // Longer than anything takes: a service that hangs is an error, not a hang here.
            stream.set_read_timeout(Some(Duration::from_secs(60)))?;
            self.stream = Some(BufReader::new(stream));
        }
        self.stream.as_mut().ok_or_else(|| io::ErrorKind::NotConnected.into())
    }

    /// Sends a request, `METHOD PATH` and its body, and reads the answer.
    pub fn ask(&mut self, request: &str, body: &[u8]) -> io::Result<Answer> {
        self.ask_slowly(request, body, body.len().max(1), Duration::ZERO)
    }

    /// [`Client::ask`], the body in pieces of so many bytes with pauses between.
    pub fn ask_slowly(
        &mut self,
        request: &str,
        body: &[u8],
        piece: usize,
        pause: Duration,
    ) -> io::Result<Answer> {
        let answer = self.try_ask(request, body, piece, pause);
        if answer.is_err() {
            self.stream = None;
        }
        answer
    }

    fn try_ask(&mut self, request: &str, body: &[u8], piece: usize, pause: Duration) -> io::Result<Answer> {
        let headers = self.headers;
        let reader = self.stream()?;
        let length = body.len();
        let head = format!("{request} HTTP/1.1\r\nHost: x\r\n{headers}Content-Length: {length}\r\n\r\n");
        reader.get_mut().write_all(head.as_bytes())?;
        for piece in body.chunks(piece) {
            reader.get_mut().write_all(piece)?;
            if !pause.is_zero() {
                std::thread::sleep(pause);
            }
        }
        let (answer, closes) = read(reader)?;
        if closes {
            self.stream = None;
        }
        Ok(answer)
    }

    /// Sends so many bytes of a request with a body and leaves.
    pub fn leave_after(&mut self, request: &str, body: &[u8], bytes: usize) -> io::Result<()> {
        let head = format!("{request} HTTP/1.1\r\nHost: x\r\nContent-Length: {}\r\n\r\n", body.len());
        let whole = [head.as_bytes(), body].concat();
        self.stream()?.get_mut().write_all(&whole[..bytes.min(whole.len())])?;
        self.stream = None;
        Ok(())
    }
}

/// An answer, and whether the service closes the connection.
fn read(reader: &mut BufReader<TcpStream>) -> io::Result<(Answer, bool)> {
    let mut line = String::new();
    if reader.read_line(&mut line)? == 0 {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let status = line.split(' ').nth(1).and_then(|word| word.parse().ok());
    let status: u16 = status.ok_or(io::ErrorKind::InvalidData)?;
    let (mut length, mut location, mut closes) = (0, String::new(), false);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let Some((name, value)) = line.trim_end().split_once(": ") else { break };
        match name.to_ascii_lowercase().as_str() {
            "content-length" => length = value.parse().map_err(|_| io::ErrorKind::InvalidData)?,
            "location" => location = value.to_owned(),
            "connection" => closes = value.eq_ignore_ascii_case("close"),
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body)?;
    Ok((Answer { status, location, body }, closes))
}

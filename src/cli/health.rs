//! `rosaline health`: the health check of a container image that has no curl.

use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::Failure;

/// Longer than any healthy service needs, shorter than Docker's default of 30 s.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Address of the service, as given to `serve --listen`.
    #[arg(long, env = "ROSALINE_LISTEN", default_value = "127.0.0.1:8080")]
    listen: String,
}

/// Asks `GET /readyz`; anything but 200 is a failure that quotes the status line.
pub fn run(args: Args) -> Result<(), Failure> {
    // A service that listens on every address answers on the loopback one.
    let address = args.listen.replacen("0.0.0.0", "127.0.0.1", 1).replacen("[::]", "[::1]", 1);
    let resolved = address
        .to_socket_addrs()?
        .next()
        .ok_or_else(|| Failure::new(format!("{address} has no address; give host:port")))?;
    let mut stream = TcpStream::connect_timeout(&resolved, PATIENCE)
        .map_err(|error| Failure::new(format!("no service answers on {address}: {error}")))?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    write!(stream, "GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.take(64 * 1024).read_to_end(&mut answer)?;
    let answer = String::from_utf8_lossy(&answer);
    let status = answer.lines().next().unwrap_or_default();
    if status.split(' ').nth(1) == Some("200") {
        return Ok(());
    }
    Err(Failure::new(format!("the service on {address} is not ready: it answered '{status}'")))
}

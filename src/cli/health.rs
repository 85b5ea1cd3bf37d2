//! `rosaline health`: the health check of a container image that has no curl.

use std::path::PathBuf;
use std::time::Duration;

use super::Failure;

/// Longer than any healthy service needs, shorter than Docker's default of 30 s.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Configuration file of the service, of which the settings below are read. Flags and variables go before it.
    #[arg(long, env = "ROSALINE_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Ask only whether it is alive: a service that is not ready may be at work on jobs, and a restart helps it little.
    #[arg(long)]
    alive: bool,
    /// Address of the service, as given to `serve --listen`.
    #[arg(long, env = "ROSALINE_LISTEN", default_value = "127.0.0.1:8080", value_name = "HOST:PORT")]
    listen: String,
    /// The certificate given to `serve --tls-cert`, where there is one: then the service is asked over TLS.
    #[arg(long, env = "ROSALINE_TLS_CERT", value_name = "FILE")]
    tls_cert: Option<PathBuf>,
}

/// Asks `GET /readyz`, or `/healthz`; anything but 200 is a failure that quotes the status.
pub fn run(args: Args) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(ask(args))
}

async fn ask(args: Args) -> Result<(), Failure> {
    // A service that listens on every address answers on the loopback one.
    let address = args.listen.replacen("0.0.0.0", "127.0.0.1", 1).replacen("[::]", "[::1]", 1);
    let scheme = if args.tls_cert.is_some() { "https" } else { "http" };
    let client = reqwest::Client::builder()
        .timeout(PATIENCE)
        .no_proxy()
        .redirect(reqwest::redirect::Policy::none())
        // The certificate's names are those that other machines use. Nothing secret is sent.
        .tls_danger_accept_invalid_certs(true)
        .build()?;
    let (path, state) = if args.alive { ("healthz", "alive") } else { ("readyz", "ready") };
    let answer = client.get(format!("{scheme}://{address}/{path}")).send().await;
    let answer = answer.map_err(|error| {
        let cause = Failure::from(error.without_url()).message;
        Failure::new(format!("no service answers on {scheme}://{address}: {cause}"))
    })?;
    let status = answer.status();
    if status == reqwest::StatusCode::OK {
        return Ok(());
    }
    // What a port that speaks TLS says to plain HTTP; no answer of the service's own is a text.
    let kind = answer.headers().get(reqwest::header::CONTENT_TYPE);
    let is_text = kind.is_some_and(|kind| kind.as_bytes().starts_with(b"text/plain"));
    if scheme == "http" && status == reqwest::StatusCode::BAD_REQUEST && is_text {
        return Err(Failure::new(format!(
            "the service on {address} speaks TLS, and was asked without; give its certificate with --tls-cert \
             (ROSALINE_TLS_CERT), or its configuration file with --config"
        )));
    }
    Err(Failure::new(format!("the service on {address} is not {state}: it answered '{status}'")))
}

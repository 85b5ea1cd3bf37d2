//! The service's settings: flags, environment variables of the same name, or a configuration file.

use std::num::{NonZeroU32, NonZeroU64, NonZeroUsize};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::builder::NonEmptyStringValueParser;

use super::super::numbers::positive;
use crate::http::access::JwksSource;
use crate::jobs::MAX_CRASHES;

#[derive(Debug, clap::Args)]
pub struct Service {
    #[command(flatten)]
    pub args: Args,
    /// Print every setting in force with where it comes from, as a configuration file, and end.
    #[arg(long)]
    pub print_config: bool,
}

#[derive(Debug, clap::Args)]
pub struct Args {
    /// Configuration file in TOML: its keys are the names of the flags below. Flags and variables go before it.
    #[arg(long, env = "ROSALINE_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, env = "ROSALINE_LISTEN", default_value = "127.0.0.1:8080", value_name = "HOST:PORT", value_parser = NonEmptyStringValueParser::new())]
    pub listen: String,
    /// Certificate of the service in PEM form, its chain after it; with it only TLS is spoken. Taken over again when
    /// it changes, as its key is.
    #[arg(long, env = "ROSALINE_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, in PEM form.
    #[arg(long, env = "ROSALINE_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Folder for the jobs' database and files; created where it is missing.
    #[arg(long, env = "ROSALINE_DATA", default_value = "data", value_name = "DIR")]
    pub data: PathBuf,
    /// Jobs that run at once, each on its share of the threads; at most one a thread [default: a quarter of the
    /// threads, at least 2 where there are 2].
    #[arg(long, env = "ROSALINE_WORKERS", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub workers: Option<NonZeroUsize>,
    /// Threads that compute, over all workers [default: one a core, at least one a worker].
    #[arg(long, env = "ROSALINE_THREADS", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub threads: Option<NonZeroUsize>,
    /// How often the process of a job's run may die, or the service while that job runs alone, before the job is failed
    /// instead of run again.
    #[arg(long, env = "ROSALINE_MAX_CRASHES", default_value_t = MAX_CRASHES, value_name = "N", value_parser = positive::<NonZeroU32>)]
    pub max_crashes: NonZeroU32,
    /// Largest mesh, in bytes or with KiB, MiB or GiB.
    #[arg(long, env = "ROSALINE_MAX_UPLOAD", default_value = "1GiB", value_name = "SIZE")]
    pub max_upload: Size,
    /// Triangles of the largest mesh; it may have half as many vertices and one in a hundred more. They bound the memory of a check.
    #[arg(long, env = "ROSALINE_MAX_TRIANGLES", default_value = "40000000", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub max_triangles: NonZeroUsize,
    /// Uploads that are read and checked at the same time, and as many small ones beside them; each takes its file's size
    /// and its mesh in memory.
    #[arg(long, env = "ROSALINE_VALIDATIONS", default_value = "2", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub validations: NonZeroUsize,
    /// File of the API keys, which `rosaline keys` makes [default: keys.json in the data folder]. Where there is one,
    /// every request needs a key.
    #[arg(long, env = "ROSALINE_KEYS", value_name = "FILE")]
    pub keys: Option<PathBuf>,
    /// Issuer of JWTs that are accepted beside keys, as their claim `iss` has it.
    #[arg(long, env = "ROSALINE_JWT_ISSUER", value_name = "ISSUER", requires = "jwt_audience", value_parser = NonEmptyStringValueParser::new())]
    pub jwt_issuer: Option<String>,
    /// What the claim `aud` of a JWT must name.
    #[arg(long, env = "ROSALINE_JWT_AUDIENCE", value_name = "AUDIENCE", requires = "jwt_issuer", value_parser = NonEmptyStringValueParser::new())]
    pub jwt_audience: Option<String>,
    /// The issuer's public keys (JWKS): a file, or an http or https URL, which is fetched again every 5 minutes and when
    /// a token names an unknown key [default: where the issuer says, an https URL, by OpenID Connect Discovery].
    #[arg(long, env = "ROSALINE_JWKS", value_name = "FILE|URL", requires = "jwt_issuer")]
    pub jwks: Option<JwksSource>,
    /// Listen on an address that others can reach although no key is needed.
    #[arg(long, env = "ROSALINE_INSECURE")]
    pub insecure: bool,
    /// File of the audit trail, which is only ever added to [default: audit.jsonl in the data folder].
    #[arg(long, env = "ROSALINE_AUDIT", value_name = "FILE")]
    pub audit: Option<PathBuf>,
    /// Size at which the audit trail is set aside and a new file begun.
    #[arg(long, env = "ROSALINE_AUDIT_ROTATE", default_value = "64MiB", value_name = "SIZE", value_parser = rotation)]
    pub audit_rotate: Size,
    /// Connections that may be open at the same time, as far as so many files may be open.
    #[arg(long, env = "ROSALINE_MAX_CONNECTIONS", default_value = "1024", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub max_connections: NonZeroUsize,
    /// Uploads that may come in at the same time.
    #[arg(long, env = "ROSALINE_MAX_UPLOADS", default_value = "256", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub max_uploads: NonZeroUsize,
    /// Uploads of one principal, or where no key is needed of one address (of IPv6 one /64), that may come in at the
    /// same time.
    #[arg(long, env = "ROSALINE_MAX_UPLOADS_EACH", default_value = "64", value_name = "N", value_parser = positive::<NonZeroUsize>)]
    pub max_uploads_each: NonZeroUsize,
    /// Jobs that may wait.
    #[arg(long, env = "ROSALINE_MAX_QUEUE", default_value = "100000", value_name = "N", value_parser = positive::<NonZeroU64>)]
    pub max_queue: NonZeroU64,
    /// Jobs of one principal that may wait or run.
    #[arg(long, env = "ROSALINE_MAX_JOBS_EACH", default_value = "10000", value_name = "N", value_parser = positive::<NonZeroU64>)]
    pub max_jobs_each: NonZeroU64,
    /// How long one run of a job may take.
    #[arg(long, env = "ROSALINE_MAX_RUN", default_value = "60m", value_name = "TIME", value_parser = lasting)]
    pub max_run: Span,
    /// Memory that one run of a job may have, beside its threads' stacks; one that needs more is failed.
    #[arg(long, env = "ROSALINE_MAX_MEMORY", default_value = "4GiB", value_name = "SIZE", value_parser = memory)]
    pub max_memory: Size,
    /// Room on the data folder's disk below which /readyz says that the service is not ready.
    #[arg(long, env = "ROSALINE_MIN_FREE", default_value = "64MiB", value_name = "SIZE")]
    pub min_free: Size,
    /// How long an ended job's mesh is kept, 0 for not at all [default: as long as the job].
    #[arg(long, env = "ROSALINE_KEEP_INPUT", value_name = "TIME")]
    pub keep_input: Option<Span>,
    /// How long an ended job and its results are kept [default: until they are deleted].
    #[arg(long, env = "ROSALINE_KEEP_JOBS", value_name = "TIME", value_parser = lasting)]
    pub keep_jobs: Option<Span>,
    /// How long an upload may stand still, in seconds or with s or m, before it is given up.
    #[arg(long, env = "ROSALINE_UPLOAD_IDLE", default_value = "30s", value_name = "TIME", value_parser = lasting)]
    pub upload_idle: Span,
    /// How long a client may take for the head of a request, or before its next one.
    #[arg(long, env = "ROSALINE_HEAD_TIMEOUT", default_value = "30s", value_name = "TIME", value_parser = lasting)]
    pub head_timeout: Span,
    /// File of the webhook targets, which `rosaline webhooks` makes [default: webhooks.json in the data folder].
    #[arg(long, env = "ROSALINE_WEBHOOKS", value_name = "FILE")]
    pub webhooks: Option<PathBuf>,
    /// How long to wait before a webhook is tried again that failed once; each further wait is three times as long, up
    /// to 12 h.
    #[arg(long, env = "ROSALINE_WEBHOOK_RETRY", default_value = "5s", value_name = "TIME", value_parser = lasting)]
    pub webhook_retry: Span,
    /// Tries after which a webhook is given up.
    #[arg(long, env = "ROSALINE_WEBHOOK_ATTEMPTS", default_value = "12", value_name = "N", value_parser = positive::<NonZeroU32>)]
    pub webhook_attempts: NonZeroU32,
    /// How long a target may take to answer a webhook.
    #[arg(long, env = "ROSALINE_WEBHOOK_TIMEOUT", default_value = "15s", value_name = "TIME", value_parser = lasting)]
    pub webhook_timeout: Span,
    /// How long running jobs may go on after SIGTERM, SIGINT or SIGHUP, in seconds or with s or m.
    #[arg(long, env = "ROSALINE_GRACE", default_value = "30s", value_name = "TIME")]
    pub grace: Span,
    /// Base URL of an OpenTelemetry collector (OTLP over HTTP) that gets traces [default: none are sent].
    #[arg(long, env = "OTEL_EXPORTER_OTLP_ENDPOINT", value_name = "URL", value_parser = collector)]
    pub otlp: Option<String>,
    /// Form of the log on stderr.
    #[arg(long, env = "ROSALINE_LOG_FORMAT", default_value = "text", value_name = "FORMAT")]
    pub log_format: LogFormat,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    Text,
    Json,
}

/// A number of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size(pub u64);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "a size is a whole number, alone or with KiB, MiB or GiB".to_owned();
        let (number, unit) = number_and_unit(text).ok_or_else(expected)?;
        let factor: u64 = match unit.to_ascii_lowercase().as_str() {
            "" | "b" => 1,
            "k" | "kib" => 1 << 10,
            "m" | "mib" => 1 << 20,
            "g" | "gib" => 1 << 30,
            _ => return Err(expected()),
        };
        number.checked_mul(factor).filter(|&bytes| bytes > 0).map(Size).ok_or_else(expected)
    }
}

/// Less is not enough for any mesh.
const LEAST_MEMORY: u64 = 64 << 20;

fn memory(text: &str) -> Result<Size, String> {
    let size: Size = text.parse()?;
    if size.0 < LEAST_MEMORY {
        return Err(format!("a run needs at least {} MiB", LEAST_MEMORY >> 20));
    }
    Ok(size)
}

/// Two lines of the audit trail.
const LEAST_ROTATION: u64 = 1 << 10;

fn rotation(text: &str) -> Result<Size, String> {
    let size: Size = text.parse()?;
    if size.0 < LEAST_ROTATION {
        return Err("each line would have a file of its own; give 1KiB or more".to_owned());
    }
    Ok(size)
}

/// The base URL of a collector of traces; an empty text, as the variable may have it, is none.
fn collector(text: &str) -> Result<String, &'static str> {
    let is_base = |url: reqwest::Url| {
        matches!(url.scheme(), "http" | "https") && url.query().is_none() && url.fragment().is_none()
    };
    if text.is_empty() || reqwest::Url::parse(text).is_ok_and(is_base) {
        return Ok(text.to_owned());
    }
    Err("traces go to the base URL of a collector, by http or https; give it, as http://127.0.0.1:4318")
}

/// A length of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span(pub Duration);

impl FromStr for Span {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "a time is a whole number of seconds, alone or with s, m, h or d".to_owned();
        let (number, unit) = number_and_unit(text).ok_or_else(expected)?;
        let factor = match unit {
            "" | "s" => 1,
            "m" => 60,
            "h" => 60 * 60,
            "d" => DAY,
            _ => return Err(expected()),
        };
        let seconds = number.checked_mul(factor).filter(|&seconds| seconds <= LONGEST);
        let seconds = seconds.ok_or_else(|| format!("a time may be {}d at most", LONGEST / DAY))?;
        Ok(Span(Duration::from_secs(seconds)))
    }
}

const DAY: u64 = 24 * 60 * 60;
/// A hundred years, in seconds: with much more, clocks overflow.
const LONGEST: u64 = 36_500 * DAY;

/// A length of time in which something is to happen: not 0, in which nothing does.
fn lasting(text: &str) -> Result<Span, String> {
    let span: Span = text.parse()?;
    if span.0.is_zero() {
        return Err("nothing can be done in no time; give 1s or more".to_owned());
    }
    Ok(span)
}

/// Splits `30s` into 30 and `s`.
fn number_and_unit(text: &str) -> Option<(u64, &str)> {
    let text = text.trim();
    let end = text.find(|character: char| !character.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    Some((number.parse().ok()?, unit.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!("1GiB".parse(), Ok(Size(1 << 30)));
        assert_eq!("200 mib".parse(), Ok(Size(200 << 20)));
        assert_eq!("4096".parse(), Ok(Size(4096)));
        for text in ["", "0", "-1", "1.5GiB", "12 apples", "99999999999999GiB"] {
            assert!(text.parse::<Size>().is_err(), "{text}");
        }
    }

    #[test]
    fn times() {
        assert_eq!("30s".parse(), Ok(Span(Duration::from_secs(30))));
        assert_eq!("2m".parse(), Ok(Span(Duration::from_secs(120))));
        assert_eq!("0".parse(), Ok(Span(Duration::ZERO)));
        assert_eq!("12h".parse(), Ok(Span(Duration::from_secs(43_200))));
        assert_eq!("30d".parse(), Ok(Span(Duration::from_secs(2_592_000))));
        assert_eq!("36500d".parse(), Ok(Span(Duration::from_secs(LONGEST))));
        for text in ["", "s", "-1", "1w", "36501d", "18446744073709551615", "18446744073709551615d"] {
            assert!(text.parse::<Span>().is_err(), "{text}");
        }
        assert!(lasting("1s").is_ok() && lasting("0").is_err() && lasting("0d").is_err());
    }
}

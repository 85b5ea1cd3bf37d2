//! `rosaline doctor`: looks whether the service would work with these settings, and says what to do where not.

use std::fs::OpenOptions;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use super::serve::{self, key_file, limits, settings, target_file};
use super::{Failure, Places};
use crate::http::access::{Discovery, Issuer, JwksSource, KeyError};
use crate::http::{Limits, Tls};
use crate::jobs::checkup::{self, Finding};
use crate::jobs::isolation::program;
use crate::jobs::{Clock, SystemClock};
use crate::outbound::webhooks::TargetError;

/// How long an issuer may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Prints a line a finding, for the settings of `rosaline serve`; a running service is not disturbed.
///
/// # Errors
/// When something is wrong.
pub fn run(args: serve::Args, places: Places<'_>) -> Result<(), Failure> {
    let in_use = checkup::is_in_use(&args.data);
    let now = SystemClock.now_ms();
    let mut found = checkup::folder(&args.data);
    found.push(room(&args));
    if in_use {
        found.push(Finding::Note("a service uses this data folder now".to_owned()));
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    found.extend(runtime.block_on(checkup::database(&args.data, now)));
    let has_owners = runtime.block_on(checkup::has_owners(&args.data)).unwrap_or(false);
    let (has_keys, keys) = keys_of(&args, has_owners);
    found.extend(keys);
    found.extend(runtime.block_on(issuer(&args)));
    found.extend(certificate(&args));
    found.extend(targets(&args));
    found.extend(address(&args, has_keys || args.jwt_issuer.is_some(), in_use, places));
    found.push(audit(&args));
    found.extend(bounds(&args, places));
    found.push(clock(now));
    found.push(descriptors(&limits(&args)));
    found.push(process());
    tell(&found)
}

/// What is wrong with settings, behind where they come from.
fn of(settings: &[&str], what: impl std::fmt::Display, places: Places<'_>) -> String {
    places(settings).map_or_else(|| what.to_string(), |places| format!("{places}: {what}"))
}

fn tell(found: &[Finding]) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    for finding in found {
        match finding {
            Finding::Well(what) => writeln!(out, "well   {what}")?,
            Finding::Note(what) => writeln!(out, "note   {what}")?,
            Finding::Wrong(what, todo) => writeln!(out, "WRONG  {what}; {todo}")?,
        }
    }
    match found.iter().filter(|finding| finding.is_wrong()).count() {
        0 => Ok(()),
        1 => Err(Failure::new("1 thing is wrong")),
        wrong => Err(Failure::new(format!("{wrong} things are wrong"))),
    }
}

/// Whether the largest uploads fit on the disk, beside the room that is kept for when it is full.
fn room(args: &serve::Args) -> Finding {
    let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    let all = match checkup::free(&args.data) {
        Ok(free) => free,
        Err(error) => return Finding::Note(format!("how much space is free is not known: {error}")),
    };
    let free = all.saturating_sub(checkup::ROOM as u64);
    let (largest, most) = (args.max_upload.0, args.max_uploads.get() as u64);
    let least = args.min_free.0;
    match free / largest {
        // As readiness reckons it.
        _ if all < least => Finding::wrong(
            format!("{} MiB are free on the data folder's disk and --min-free is {}", all >> 20, least >> 20),
            "free space: the service says that it is not ready",
        ),
        0 => Finding::wrong(
            format!(
                "{:.1} GiB are free on the data folder's disk and one mesh may have {:.1}",
                gib(free),
                gib(largest)
            ),
            "free space, or lower --max-upload",
        ),
        fitting if fitting < most => Finding::Note(format!(
            "{:.1} GiB are free on the data folder's disk: room for {fitting} of the largest meshes, of which {most} may come \
             in at once; those that find no room get a 507",
            gib(free)
        )),
        _ => Finding::Well(format!("{:.1} GiB are free on the data folder's disk", gib(free))),
    }
}

/// Whether there are keys, and what is to be said of them.
fn keys_of(args: &serve::Args, has_owners: bool) -> (bool, Vec<Finding>) {
    let file = key_file(args);
    let keys = match file.read() {
        Ok(None) => return (false, without_keys(args, file.path(), has_owners).into_iter().collect()),
        Err(error @ KeyError::Named { .. }) => {
            return (false, vec![Finding::wrong(error.to_string(), "the service does not start")]);
        }
        Ok(Some(keys)) => Ok(keys),
        Err(error) => Err(error),
    };
    let mut found: Vec<Finding> = checkup::secrecy(file.path(), "the key file", "600").into_iter().collect();
    found.push(match keys {
        Err(error) => Finding::wrong(
            error.to_string(),
            "nobody is let in: put a copy back, or remove it and make new keys",
        ),
        Ok(keys) => match keys.iter().filter(|key| key.revoked.is_none()).count() {
            0 => Finding::wrong(
                "every key is revoked: nobody is let in",
                format!(
                    "make one with 'rosaline keys add NAME --scope submit,read --keys {}'",
                    file.path().display()
                ),
            ),
            1 => Finding::Well("1 key is in force".to_owned()),
            active => Finding::Well(format!("{active} keys are in force")),
        },
    });
    (true, found)
}

/// What is to be said where there is no file of keys.
fn without_keys(args: &serve::Args, path: &Path, has_owners: bool) -> Option<Finding> {
    if args.jwt_issuer.is_some() {
        return None;
    }
    if has_owners && !args.insecure {
        let lost = KeyError::Lost { path: path.display().to_string() };
        return Some(Finding::wrong(lost.to_string(), "the service does not start"));
    }
    Some(Finding::Note("no key was made: whoever reaches the address may do everything".to_owned()))
}

/// Whether the issuer's keys can be read. A URL that was given is not asked; an issuer that is to say it is asked for it.
async fn issuer(args: &serve::Args) -> Option<Finding> {
    let (issuer, audience) = (args.jwt_issuer.as_ref()?, args.jwt_audience.as_ref()?);
    let Some(keys) = &args.jwks else { return Some(discovered(issuer).await) };
    Some(match Issuer::open(issuer, audience, Some(keys.clone())) {
        Ok(_) if keys.is_in_the_clear() => Finding::Note(
            "the issuer's keys come in the clear: whoever is in between can make tokens; use https"
                .to_owned(),
        ),
        Ok(_) => Finding::Well(match keys {
            JwksSource::File(_) => format!("tokens of {issuer} are let in"),
            JwksSource::Url(url) => {
                format!("tokens of {issuer} are checked by the keys at {url}; they were not asked for")
            }
        }),
        Err(error) => Finding::wrong(error.to_string(), "the service does not start: see to --jwks"),
    })
}

/// What an issuer says that is asked for its keys.
async fn discovered(issuer: &str) -> Finding {
    let discovery = match Discovery::of(issuer, PATIENCE) {
        Ok(discovery) => discovery,
        Err(error) => return Finding::wrong(error.to_string(), "the service does not start"),
    };
    match discovery.keys().await {
        Ok(keys) => {
            Finding::Well(format!("the issuer {issuer} names {keys} for its keys; they were not asked for"))
        }
        Err(error) => Finding::wrong(
            format!("no token of {issuer} is let in: {error}"),
            "a running service tries again by itself",
        ),
    }
}

/// Whether the certificate and its key can be used.
fn certificate(args: &serve::Args) -> Vec<Finding> {
    let (Some(cert), Some(key)) = (&args.tls_cert, &args.tls_key) else { return Vec::new() };
    let mut found: Vec<Finding> = checkup::secrecy(key, "the TLS key", "600").into_iter().collect();
    found.push(match Tls::open(cert, key) {
        Ok(tls) => match tls.expiry().and_then(|expiry| expiry.warning()) {
            Some(warning) => Finding::wrong(warning, "a running service takes it over"),
            None => Finding::Well("the TLS certificate and its key go together".to_owned()),
        },
        Err(error) => {
            Finding::wrong(error.to_string(), "the service does not start: see to --tls-cert and --tls-key")
        }
    });
    found
}

/// Whether the webhook targets can be read; none is asked.
fn targets(args: &serve::Args) -> Vec<Finding> {
    let file = target_file(args);
    let targets = match file.read() {
        Ok(None) => return Vec::new(),
        Err(error @ TargetError::Missing(_)) => {
            return vec![Finding::wrong(error.to_string(), "the service does not start")];
        }
        Ok(Some(targets)) => Ok(targets),
        Err(error) => Err(error),
    };
    // It holds the secrets that messages are signed with.
    let mut found: Vec<Finding> =
        checkup::secrecy(file.path(), "the file of webhook targets", "600").into_iter().collect();
    found.push(match targets {
        Ok(targets) => {
            Finding::Well(format!("webhook targets that are told of jobs' ends: {}", targets.len()))
        }
        Err(error) => Finding::wrong(
            error.to_string(),
            "the service does not start: put a copy back, or remove it and add the targets again",
        ),
    });
    found
}

fn address(args: &serve::Args, is_closed: bool, in_use: bool, places: Places<'_>) -> Vec<Finding> {
    let resolved = args.listen.to_socket_addrs().ok().and_then(|mut all| all.next());
    let Some(address) = resolved else {
        let what = format!("--listen {} is no address of this machine", args.listen);
        let what = of(&["listen"], what, places);
        return vec![Finding::wrong(what, "give HOST:PORT, 127.0.0.1:8080 for example")];
    };
    let mut found = vec![reach(address, is_closed, args)];
    found.push(match TcpListener::bind(address) {
        Ok(_) => Finding::Well(format!("{address} is free")),
        Err(_) if in_use => Finding::Well(format!("{address} is taken, by the service as it seems")),
        Err(error) => Finding::wrong(
            format!("{address} cannot be listened on: {error}"),
            "stop what listens there, or choose another with --listen",
        ),
    });
    found
}

/// Who can reach the address, and whether they should.
fn reach(address: SocketAddr, is_closed: bool, args: &serve::Args) -> Finding {
    match (address.ip().to_canonical().is_loopback(), is_closed, args.insecure) {
        (true, ..) => Finding::Well(format!("only this machine reaches {address}")),
        (false, true, _) if args.tls_cert.is_some() => {
            Finding::Well(format!("other machines reach {address}, over TLS and with a key or a token"))
        }
        (false, true, _) => Finding::Note(format!(
            "other machines reach {address}; their keys and meshes cross the network in the clear unless there is TLS before it"
        )),
        (false, false, true) => {
            Finding::Note(format!("other machines reach {address} and need no key, as --insecure says"))
        }
        (false, false, false) => Finding::wrong(
            format!("other machines would reach {address} without a key: the service does not start"),
            format!(
                "make a key with 'rosaline keys add NAME --scope submit,read {}', or listen on 127.0.0.1",
                match &args.keys {
                    Some(keys) => format!("--keys {}", keys.display()),
                    None => format!("--data {}", args.data.display()),
                }
            ),
        ),
    }
}

fn audit(args: &serve::Args) -> Finding {
    let path = args.audit.clone().unwrap_or_else(|| args.data.join("audit.jsonl"));
    let folder =
        path.parent().filter(|each| !each.as_os_str().is_empty()).map_or(PathBuf::from("."), Path::to_owned);
    let added = match path.exists() {
        true => OpenOptions::new().append(true).open(&path).map(drop),
        // A first start makes the data folder itself.
        false if folder.is_dir() || args.audit.is_none() => Ok(()),
        false => Err(std::io::ErrorKind::NotFound.into()),
    };
    match added {
        Ok(()) => Finding::Well(format!("the audit trail goes to {}", path.display())),
        Err(error) => Finding::wrong(
            format!("the audit trail {} cannot be added to: {error}", path.display()),
            "give it to the user that runs the service, or choose another with --audit",
        ),
    }
}

/// Whether the limits fit each other and the machine.
fn bounds(args: &serve::Args, places: Places<'_>) -> Vec<Finding> {
    let settings = match settings(args) {
        Ok(settings) => settings,
        Err(error) => {
            let what = of(&["workers", "threads"], error, places);
            return vec![Finding::wrong(what, "change --workers or --threads")];
        }
    };
    let runs = args.max_memory.0.saturating_mul(settings.workers.get() as u64);
    let wanted = runs.saturating_add(limits(args).checks());
    let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    let (workers, validations) = (settings.workers, args.validations);
    vec![match memory() {
        Some(memory) if wanted > memory => Finding::Note(format!(
            "{workers} runs and {validations} checks of uploads may take {:.1} GiB and this machine has {:.1}: the \
             largest meshes at once would be too much; lower --max-memory, --workers, --validations, --max-triangles, --max-upload or --max-uploads",
            gib(wanted),
            gib(memory)
        )),
        Some(memory) => {
            Finding::Well(format!("jobs take {:.1} of {:.1} GiB of memory at most", gib(wanted), gib(memory)))
        }
        None => Finding::Note("how much memory this machine has is not known".to_owned()),
    }]
}

/// Bytes of memory of this machine.
fn memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

fn clock(now_ms: i64) -> Finding {
    /// 2026-01-01: no machine that this runs on was set before.
    const LEAST_MS: i64 = 1_767_225_600_000;
    if now_ms < LEAST_MS {
        return Finding::wrong("this machine's clock is years behind", "set it, and keep it set by NTP");
    }
    Finding::Well("the clock is of this time".to_owned())
}

/// Whether there are files for all connections.
fn descriptors(limits: &Limits) -> Finding {
    let most = checkup::descriptors();
    let within = limits.within(most).connections;
    if within < limits.connections {
        let (connections, wanted) = (limits.connections, limits.files());
        let what = format!(
            "{most} files may be open at once, and --max-connections {connections} needs {wanted}: the service would allow {within}"
        );
        return Finding::wrong(what, "raise it (ulimit -Hn, LimitNOFILE) or lower --max-connections");
    }
    Finding::Well(format!("{most} files may be open at once"))
}

/// Runs are processes of their own.
fn process() -> Finding {
    let started = program().and_then(|program| Command::new(program).arg("--version").output());
    match started {
        Ok(output) if output.status.success() => Finding::Well("runs can be started".to_owned()),
        Ok(output) => Finding::wrong(
            format!("a run ends at its start: {}", output.status),
            "see to the limits of the user",
        ),
        Err(error) => {
            Finding::wrong(format!("a run cannot be started: {error}"), "let the service start processes")
        }
    }
}

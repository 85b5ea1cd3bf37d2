//! `rosaline serve`: the service with its store and workers in one process.

mod args;
mod log;
mod otlp;
mod stop;

use std::io::Write;
use std::net::SocketAddr;
use std::num::NonZeroU64;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;

use super::Failure;
use crate::http::access::{Gate, Issuer, JwksSource, KeyError, KeyFile, KeyRing};
use crate::http::audit::Trail;
use crate::http::{self, App, Limits, Tls};
use crate::jobs::checkup;
use crate::jobs::isolation::{Isolated, JOB_MEMORY};
use crate::jobs::{
    JobService, Retention, Settings, Spans, TooManyWorkers, keep_files_to_owner, log_panics_without_text,
};
use crate::mesh;
use crate::outbound::webhooks::{self, Schedule, TargetFile};

pub use args::{Args, Service, Span};
use log::Log;
use otlp::Exporter;
use stop::stop_signal;

/// Threads that write, sync and read files, at most: enough that syncs go to the disk together. Each keeps about a MiB.
const DISK_THREADS: usize = 16;
/// How long one of them waits for more to do before it ends and gives its memory back.
const DISK_REST: Duration = Duration::from_secs(2);

/// How long such a thread may take to end when the service has ended.
const DISK_END: Duration = Duration::from_secs(5);

/// Serves until SIGTERM, SIGINT or SIGHUP.
///
/// # Errors
/// The address is taken, the data folder cannot be used, or the threads cannot be started.
pub fn run(args: Args) -> Result<(), Failure> {
    let log = Log::start(args.log_format)?;
    let served = run_logged(args, &log);
    log.finish();
    served
}

fn run_logged(args: Args, log: &Log) -> Result<(), Failure> {
    check(&args)?;
    log_panics_without_text();
    keep_files_to_owner();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(DISK_THREADS)
        .thread_keep_alive(DISK_REST)
        .build()?;
    // Outside the runtime, which it would block when it is dropped.
    let exporter = Exporter::start(args.otlp.as_deref())?;
    let served = runtime.block_on(serve(args, exporter.spans(), log));
    drop(exporter);
    // A thread that waits for a file (of a network that is away) would keep the process for ever; all is stored by now.
    runtime.shutdown_timeout(DISK_END);
    served
}

/// Whether a service could start with these settings, as far as that is known without doing anything.
///
/// # Errors
/// What is wrong, with the first such setting.
pub fn check(args: &Args) -> Result<(), Failure> {
    let is_address = |(host, port): (&str, &str)| !host.is_empty() && port.parse::<u16>().is_ok();
    if !args.listen.rsplit_once(':').is_some_and(is_address) {
        let what = format!(
            "cannot listen on '{}', which is no HOST:PORT; give --listen one, 127.0.0.1:8080 for example",
            args.listen
        );
        return Err(Failure::of(&["listen"])(Failure::new(what)));
    }
    settings(args).map_err(Failure::of(&["workers", "threads"]))?;
    if let (Some(cert), Some(key)) = (&args.tls_cert, &args.tls_key) {
        Tls::open(cert, key).map_err(Failure::of(&["tls-cert", "tls-key"]))?;
    }
    // What is not named may yet come to be where it is looked for.
    if args.keys.is_some() {
        key_file(args).list().map_err(Failure::of(&["keys"]))?;
    }
    issuer(args)?;
    if args.webhooks.is_some() {
        target_file(args).list().map_err(Failure::of(&["webhooks"]))?;
    }
    Ok(())
}

/// The file of the API keys; one that was named must be there.
pub(super) fn key_file(args: &Args) -> KeyFile {
    args.keys.as_ref().map_or_else(|| KeyFile::new(args.data.join("keys.json")), KeyFile::named)
}

/// The file of the webhook targets; one that was named must be there.
pub(super) fn target_file(args: &Args) -> TargetFile {
    args.webhooks.as_ref().map_or_else(|| TargetFile::new(args.data.join("webhooks.json")), TargetFile::named)
}

async fn serve(args: Args, spans: Spans, log: &Log) -> Result<(), Failure> {
    let mut stop = pin!(stop_signal(log.clone())?);
    let (listener, app) = tokio::select! {
        started = start(&args, spans, log) => started?,
        () = &mut stop => return Ok(()),
    };
    http::serve(listener, app, stop, args.grace.0).await?;
    tracing::info!("stopped");
    Ok(())
}

/// The service, ready to be served.
async fn start(args: &Args, spans: Spans, log: &Log) -> Result<(TcpListener, App), Failure> {
    let listener = TcpListener::bind(&args.listen).await.map_err(|error| {
        let what = format!("cannot listen on {}: {error}; choose another address with --listen", args.listen);
        Failure::of(&["listen"])(Failure::new(what))
    })?;
    let address = listener.local_addr()?;
    let limits = fitting(limits(args));
    let gate = gate(args).await?;
    check_open(address, &gate, args)?;
    let pair = args.tls_cert.as_ref().zip(args.tls_key.as_ref());
    let tls = pair.map(|(cert, key)| Tls::open(cert, key)).transpose()?;
    let (is_plain, is_open) = (tls.is_none(), !gate.is_closed());
    let memory = NonZeroU64::new(limits.job_memory).unwrap_or(JOB_MEMORY);
    let runner = Arc::new(Isolated::new(limits.mesh, memory, args.max_crashes));
    let jobs = JobService::open(Settings { spans, ..settings(args)? }, runner).await?;
    let trail = trail(args)?;
    let webhooks = webhook_settings(args);
    webhooks::start(webhooks.clone(), &jobs).await?;
    let app = App::new(jobs, limits, Some(gate), Some(trail), tls, Some(webhooks), log.lost())?;
    announce(address, is_plain)?;
    warn(address, is_plain, is_open);
    tracing::info!(%address, "ready");
    Ok((listener, app))
}

/// The service's bounds.
pub(super) fn limits(args: &Args) -> Limits {
    Limits {
        upload_bytes: args.max_upload.0,
        upload_idle: args.upload_idle.0,
        head: args.head_timeout.0,
        connections: args.max_connections.get(),
        validations: args.validations.get(),
        uploads: args.max_uploads.get(),
        uploads_each: args.max_uploads_each.get(),
        queue: args.max_queue.get(),
        jobs_per_principal: args.max_jobs_each.get(),
        run: args.max_run.0,
        job_memory: args.max_memory.0,
        mesh: mesh::format::Limits::of_triangles(args.max_triangles.get()),
        ..Limits::default()
    }
}

/// With as many connections as this process may have.
fn fitting(wanted: Limits) -> Limits {
    let (files, raised) = checkup::raise_descriptors();
    if let Err(error) = raised {
        tracing::warn!(%error, files, "the limit of open files cannot be raised");
    }
    let limits = wanted.within(files);
    if limits.connections < wanted.connections {
        tracing::warn!(
            files,
            connections = limits.connections,
            "fewer connections than --max-connections, as so few files may be open: raise it (ulimit -Hn, LimitNOFILE) \
             or lower --max-connections"
        );
    }
    limits
}

fn trail(args: &Args) -> Result<Trail, Failure> {
    let path = args.audit.clone().unwrap_or_else(|| args.data.join("audit.jsonl"));
    Trail::open(&path, args.audit_rotate.0).map_err(|error| {
        Failure::new(format!(
            "cannot add to the audit trail {}: {error}; choose another with --audit",
            path.display()
        ))
    })
}

/// For people and for scripts that asked for port 0; a closed stdout leaves nobody to tell, and one that is not read keeps a
/// thread of its own.
fn announce(address: SocketAddr, is_plain: bool) -> std::io::Result<()> {
    let scheme = if is_plain { "http" } else { "https" };
    let say = move || drop(writeln!(std::io::stdout(), "listening on {scheme}://{address}"));
    std::thread::Builder::new().spawn(say)?;
    Ok(())
}

/// Says who may read along, and who may come in.
fn warn(address: SocketAddr, is_plain: bool, is_open: bool) {
    if is_plain && !is_local(address) {
        tracing::warn!(%address, "without TLS keys and meshes cross the network in the clear: set --tls-cert and --tls-key");
    }
    if is_open {
        tracing::warn!(%address, "no key is needed: whoever reaches this address may see, make and delete every job");
    }
}

/// Who is let in: the holders of keys, and of tokens where an issuer is set.
async fn gate(args: &Args) -> Result<Gate, Failure> {
    let keys = KeyRing::of(key_file(args)).map_err(Failure::of(&["keys"]))?;
    let issuer = issuer(args)?;
    if args.jwks.as_ref().is_some_and(JwksSource::is_in_the_clear) {
        tracing::warn!(
            "the issuer's keys come in the clear: whoever is in between can make tokens; use https"
        );
    }
    let gate = Gate::new(keys, issuer);
    if !gate.is_closed() && !args.insecure && has_owners(args).await? {
        return Err(KeyError::Lost { path: args.data.join("keys.json").display().to_string() }.into());
    }
    Ok(gate)
}

fn issuer(args: &Args) -> Result<Option<Issuer>, Failure> {
    let (Some(issuer), Some(audience)) = (&args.jwt_issuer, &args.jwt_audience) else { return Ok(None) };
    let opened = Issuer::open(issuer, audience, args.jwks.clone());
    Ok(Some(opened.map_err(Failure::of(if args.jwks.is_some() { &["jwks"] } else { &["jwt-issuer"] }))?))
}

async fn has_owners(args: &Args) -> Result<bool, Failure> {
    checkup::has_owners(&args.data).await.map_err(|error| {
        let data = args.data.display();
        Failure::new(format!(
            "the job database in {data} cannot be read: {error}; 'rosaline doctor' says what to do"
        ))
    })
}

fn is_local(address: SocketAddr) -> bool {
    address.ip().to_canonical().is_loopback()
}

/// Refuses to let others in without authentication, unless that is asked for.
fn check_open(address: SocketAddr, gate: &Gate, args: &Args) -> Result<(), Failure> {
    if gate.is_closed() {
        return Ok(());
    }
    if !is_local(address) && !args.insecure {
        let data = args.data.display();
        return Err(Failure::new(format!(
            "on {address} others could use this service, and no key is needed for it: make one with 'rosaline keys \
             add NAME --scope submit,read --data {data}', accept tokens with --jwt-issuer, listen on 127.0.0.1, or let \
             everybody in with --insecure"
        )));
    }
    Ok(())
}

fn webhook_settings(args: &Args) -> webhooks::Settings {
    webhooks::Settings {
        file: target_file(args),
        schedule: Schedule { first: args.webhook_retry.0, attempts: args.webhook_attempts },
        timeout: args.webhook_timeout.0,
    }
}

pub(super) fn settings(args: &Args) -> Result<Settings, TooManyWorkers> {
    let retention =
        Retention { input: args.keep_input.map(|span| span.0), job: args.keep_jobs.map(|span| span.0) };
    let settings = Settings {
        max_crashes: args.max_crashes,
        run_limit: args.max_run.0,
        retention,
        least_free: args.min_free.0,
        ..Settings::new(&args.data)
    };
    settings.on(args.threads, args.workers)
}

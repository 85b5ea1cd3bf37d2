//! The command line: one module a subcommand.

mod compare;
mod config;
mod doctor;
mod extract;
mod files;
mod health;
mod keys;
mod misuse;
mod numbers;
mod openapi;
mod operator_place;
mod parameters;
mod phantom;
mod progress;
mod serve;
mod webhooks;
mod work;

use std::error::Error;
use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;
use std::sync::mpsc;
use std::time::Duration;

use clap::{ArgAction, CommandFactory, FromArgMatches, Parser, Subcommand};

use config::Config;

/// How long the line that says why may take on its way.
const LAST_LINE: Duration = Duration::from_secs(1);

/// Centerlines of blood vessels from their surface meshes.
#[derive(Debug, Parser)]
#[command(name = "rosaline", version, about, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the HTTP service, with its store and workers in this one process.
    Serve(Box<serve::Service>),
    /// Extract the centerline of one mesh.
    Extract(extract::Args),
    /// Measure how far a centerline is from the true one.
    Compare(compare::Args),
    /// Make a vessel mesh from a known centerline.
    Phantom(phantom::Args),
    /// Say who may use the service.
    Keys(keys::Args),
    /// Say who is told of the ends of jobs.
    Webhooks(webhooks::Args),
    /// Look whether the service would work with these settings: exit code 0 when nothing is wrong.
    Doctor(Box<serve::Args>),
    /// Ask a running service whether it is ready, or alive: exit code 0 when it is.
    Health(health::Args),
    /// Work off one job, of which stdin tells: the service starts this.
    #[command(hide = true)]
    Work(work::Args),
    /// Print the OpenAPI document of the service.
    #[command(hide = true)]
    Openapi(openapi::Args),
}

/// Why a subcommand failed, as the one line that the user reads.
#[derive(Debug)]
pub struct Failure {
    message: String,
    /// The settings that it comes from, where they may stand in a configuration file.
    settings: &'static [&'static str],
}

impl Failure {
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), settings: &[] }
    }

    /// What goes wrong as these settings are what they are.
    pub fn of<E: Into<Self>>(settings: &'static [&'static str]) -> impl FnOnce(E) -> Self {
        move |error| Self { settings, ..error.into() }
    }
}

/// Any error becomes its message, followed by those of its sources that it does not quote itself.
impl<E: Error> From<E> for Failure {
    fn from(error: E) -> Self {
        let mut line = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            let text = cause.to_string();
            if !line.contains(&text) {
                line = format!("{line}: {text}");
            }
            source = cause.source();
        }
        Self::new(line)
    }
}

/// Parses the arguments, runs the subcommand, and prints a failure as one line on stderr.
///
/// Exit codes: 0 done, 1 not done, wrong arguments included.
pub fn main() -> ExitCode {
    match asked(std::env::args_os().collect()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure { message, .. }) => {
            let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
            complain(format!("rosaline: {line}"));
            ExitCode::FAILURE
        }
    }
}

/// Says why this process ends on stderr. A closed one leaves nobody to tell, and one that nobody reads must not keep the process.
fn complain(line: String) {
    let (done, is_done) = mpsc::channel::<()>();
    let say = |line: &str| writeln!(std::io::stderr(), "{line}");
    let copy = line.clone();
    let said = std::thread::Builder::new().spawn(move || {
        let _done = done;
        say(&copy).ok();
    });
    match said {
        Ok(_) => drop(is_done.recv_timeout(LAST_LINE)),
        Err(_) => drop(say(&line)),
    }
}

/// Does what the arguments ask for, with what a configuration file says besides.
fn asked(arguments: Vec<OsString>) -> Result<(), Failure> {
    let command = command();
    let config = Config::of(&command, &arguments)?;
    let places = |settings: &[&str]| config.places_of(settings, &command, &arguments);
    done(&command, &config, &arguments, &places).map_err(|failure| match places(failure.settings) {
        Some(places) => Failure::new(format!("{places}: {}", failure.message)),
        None => failure,
    })
}

/// Where these settings come from, as far as they are no flags among the arguments.
type Places<'a> = &'a dyn Fn(&[&str]) -> Option<String>;

fn done(
    command: &clap::Command,
    config: &Config,
    arguments: &[OsString],
    places: Places<'_>,
) -> Result<(), Failure> {
    let all = config.added_to(command, arguments.to_vec());
    let parsed = command
        .clone()
        .try_get_matches_from(all)
        .and_then(|matches| Ok((Cli::from_arg_matches(&matches)?, matches)));
    match parsed {
        Ok((Cli { command: Command::Serve(service) }, matches)) if service.print_config => {
            let matches = matches.subcommand().map_or(&matches, |(_, matches)| matches);
            std::io::stdout().write_all(config.in_force(command, arguments, matches).as_bytes())?;
            // What a service would not start with is to be known before.
            serve::check(&service.args)
        }
        Ok((cli, _)) => run(cli, places),
        Err(error) => misuse::told(&error, config, command, arguments).map_or(Ok(()), Err),
    }
}

/// The arguments; a number below 0 is a value of every flag, for the flag's own words to refuse.
fn command() -> clap::Command {
    Cli::command().mut_subcommands(|each| {
        each.mut_args(|arg| {
            let is_number = arg.get_long().is_some()
                && matches!(arg.get_action(), ArgAction::Set)
                && !arg.is_require_equals_set();
            if is_number { arg.allow_negative_numbers(true) } else { arg }
        })
    })
}

fn run(cli: Cli, places: Places<'_>) -> Result<(), Failure> {
    match cli.command {
        Command::Serve(service) => serve::run(service.args),
        Command::Extract(args) => extract::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Phantom(args) => phantom::run(args),
        Command::Keys(args) => keys::run(args),
        Command::Webhooks(args) => webhooks::run(args),
        Command::Doctor(args) => doctor::run(*args, places),
        Command::Health(args) => health::run(args),
        Command::Work(args) => work::run(args),
        Command::Openapi(args) => openapi::run(args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        command().debug_assert();
    }
}

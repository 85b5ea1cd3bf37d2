//! The command line: one module a subcommand.

mod compare;
mod config;
mod doctor;
mod extract;
mod files;
mod health;
mod keys;
mod numbers;
mod openapi;
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

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use config::Config;

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
pub struct Failure(String);

impl Failure {
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
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
        Self(line)
    }
}

/// Parses the arguments, runs the subcommand, and prints a failure as one line on stderr.
///
/// Exit codes: 0 done, 1 not done, wrong arguments included.
pub fn main() -> ExitCode {
    match asked(std::env::args_os().collect()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(message)) => {
            let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
            // A closed stderr leaves nobody to tell.
            let _ = writeln!(std::io::stderr(), "rosaline: {line}");
            ExitCode::FAILURE
        }
    }
}

/// Does what the arguments ask for, with what a configuration file says besides.
fn asked(arguments: Vec<OsString>) -> Result<(), Failure> {
    let command = Cli::command();
    let config = Config::of(&command, &arguments)?;
    let all = config.added_to(&command, arguments.clone());
    let parsed = command
        .clone()
        .try_get_matches_from(all)
        .and_then(|matches| Ok((Cli::from_arg_matches(&matches)?, matches)));
    match parsed {
        Ok((Cli { command: Command::Serve(service) }, matches)) if service.print_config => {
            let matches = matches.subcommand().map_or(&matches, |(_, matches)| matches);
            std::io::stdout().write_all(config.in_force(&command, &arguments, matches).as_bytes())?;
            // What a service would not start with is to be known before.
            serve::check(&service.args)
        }
        Ok((cli, _)) => run(cli),
        Err(error) => misused(&error, config.place_of(&error, &command, &arguments)).map_or(Ok(()), Err),
    }
}

fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Serve(service) => serve::run(service.args),
        Command::Extract(args) => extract::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Phantom(args) => phantom::run(args),
        Command::Keys(args) => keys::run(args),
        Command::Webhooks(args) => webhooks::run(args),
        Command::Doctor(args) => doctor::run(*args),
        Command::Health(args) => health::run(args),
        Command::Work(args) => work::run(args),
        Command::Openapi(args) => openapi::run(args),
    }
}

/// What is wrong with the arguments, without clap's usage and hints for people; help and version, which are
/// no failures to clap's callers, are printed. `place`: the variable or the line of a configuration file that it comes from.
fn misused(error: &clap::Error, place: Option<String>) -> Option<Failure> {
    use clap::error::ErrorKind::{
        DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, DisplayVersion, TooManyValues,
    };
    use clap::error::{ContextKind, ContextValue};
    match error.kind() {
        DisplayHelp | DisplayVersion => {
            // A closed stdout leaves nobody to tell.
            let _ = error.print();
            None
        }
        DisplayHelpOnMissingArgumentOrSubcommand => {
            Some(Failure::new("a subcommand is missing; rosaline --help lists them"))
        }
        TooManyValues => {
            let flag = match error.get(ContextKind::InvalidArg) {
                Some(ContextValue::String(flag)) => flag,
                _ => "this flag",
            };
            Some(Failure::new(format!("{flag} takes no value; give it alone, or leave it out")))
        }
        _ => {
            let text = error.to_string();
            let end =
                ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|mark| text.find(mark)).min();
            let what = text[..end.unwrap_or(text.len())].trim_start_matches("error: ").trim();
            let place = place.map_or(String::new(), |place| format!("{place}: "));
            Some(Failure::new(format!("{place}{what}; --help lists what can be given")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        Cli::command().debug_assert();
    }
}

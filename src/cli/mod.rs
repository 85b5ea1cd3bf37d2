//! The command line: one module a subcommand.

mod compare;
mod doctor;
mod extract;
mod files;
mod health;
mod keys;
mod openapi;
mod parameters;
mod phantom;
mod progress;
mod serve;
mod webhooks;
mod work;

use std::error::Error;
use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

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
    Serve(Box<serve::Args>),
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
    /// Ask a running service whether it is ready: exit code 0 when it is.
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
    let outcome = match Cli::try_parse() {
        Ok(cli) => run(cli),
        Err(error) => misused(&error).map_or(Ok(()), Err),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(message)) => {
            let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
            // A closed stderr leaves nobody to tell.
            let _ = writeln!(std::io::stderr(), "rosaline: {line}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Serve(args) => serve::run(*args),
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
/// no failures to clap's callers, are printed.
fn misused(error: &clap::Error) -> Option<Failure> {
    use clap::error::ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand, DisplayVersion};
    match error.kind() {
        DisplayHelp | DisplayVersion => {
            // A closed stdout leaves nobody to tell.
            let _ = error.print();
            None
        }
        DisplayHelpOnMissingArgumentOrSubcommand => {
            Some(Failure::new("a subcommand is missing; rosaline --help lists them"))
        }
        _ => {
            let text = error.to_string();
            let end =
                ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|mark| text.find(mark)).min();
            let what = text[..end.unwrap_or(text.len())].trim_start_matches("error: ").trim();
            Some(Failure::new(format!("{what}; --help lists what can be given")))
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        super::Cli::command().debug_assert();
    }
}

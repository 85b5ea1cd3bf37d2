//! `rosaline keys`: who may use the service.

use std::io::Write;
use std::path::PathBuf;

use clap::Subcommand;

use super::Failure;
use super::operator_place::OperatorPlace;
use crate::http::access::{KeyFile, Scope};

#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    /// The service's data folder, in which the keys are [default: data]; `add` creates it where it is missing.
    #[arg(long, env = "ROSALINE_DATA", value_name = "DIR", global = true)]
    data: Option<PathBuf>,
    /// The file of the keys, where it is not keys.json in the data folder.
    #[arg(long, env = "ROSALINE_KEYS", value_name = "FILE", global = true)]
    keys: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a key and print it: it is shown this once.
    Add {
        /// Whom the key is for; jobs belong to this name.
        name: String,
        /// What it may do: submit (make, cancel, purge jobs), read, admin (all, everybody's jobs).
        #[arg(long, value_delimiter = ',', required = true, value_name = "SCOPES")]
        scope: Vec<Scope>,
        /// Also for the name of a revoked key: the new one has the jobs of that name.
        #[arg(long)]
        inherit: bool,
    },
    /// List the keys, without their secrets.
    List,
    /// Give a name a new key, print it, and end the old one.
    Rotate { name: String },
    /// End a key; its jobs stay.
    Revoke { name: String },
}

/// A running service takes changes over with its next request.
pub fn run(args: Args) -> Result<(), Failure> {
    let (data, named) = (args.data.as_deref(), args.keys.as_deref());
    let place = OperatorPlace::of_keys(data, named);
    let mut out = std::io::stdout();
    let file = match (&args.command, named) {
        (Command::Add { .. }, _) | (_, None) => KeyFile::new(place.path()),
        (_, Some(named)) => KeyFile::named(named),
    };
    let made = match args.command {
        Command::Add { .. } => place.make()?,
        _ => place.check().map(|()| false)?,
    };
    match args.command {
        Command::Add { name, scope, inherit } => {
            writeln!(out, "{}", file.add(&name, &scope, inherit)?)?;
            if let Some(unsaid) = place.unsaid(made) {
                // It is made, whether or not somebody reads this.
                let _ = writeln!(std::io::stderr(), "rosaline: note: {unsaid}");
            }
        }
        Command::Rotate { name } => writeln!(out, "{}", file.rotate(&name)?)?,
        Command::Revoke { name } => file.revoke(&name)?,
        Command::List => {
            let keys = file.list()?;
            if keys.is_empty() {
                // Beside the list, which programs read.
                let _ = writeln!(
                    std::io::stderr(),
                    "there is no key in {}; 'rosaline keys add NAME --scope submit,read{}' makes one",
                    place.path().display(),
                    place.again()
                );
            }
            for key in keys {
                let scopes: Vec<&str> = key.scopes.iter().map(|scope| scope.name()).collect();
                let state = key.revoked.map_or("active".to_owned(), |when| format!("revoked {when}"));
                writeln!(out, "{}  {}  {}  {}  {state}", key.name, key.id, scopes.join(","), key.created)?;
            }
        }
    }
    Ok(())
}

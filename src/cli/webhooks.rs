//! `rosaline webhooks`: who is told of the ends of jobs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Subcommand;
use clap::builder::NonEmptyStringValueParser;

use super::Failure;
use super::operator_place::OperatorPlace;
use super::serve::Span;
use crate::http::access::KeyFile;
use crate::outbound::Url;
use crate::outbound::webhooks::{Event, TargetFile};

#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    /// The service's data folder, in which the targets are [default: data]; `add` creates it where it is missing.
    #[arg(long, env = "ROSALINE_DATA", value_name = "DIR", global = true)]
    data: Option<PathBuf>,
    /// The file of the targets, where it is not webhooks.json in the data folder.
    #[arg(long, env = "ROSALINE_WEBHOOKS", value_name = "FILE", global = true)]
    webhooks: Option<PathBuf>,
    /// The file of the API keys, where it is not keys.json in the data folder: --owner is looked for in it.
    #[arg(long, env = "ROSALINE_KEYS", value_name = "FILE", global = true)]
    keys: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Add a target and print the secret that its messages are signed with.
    Add {
        name: String,
        /// Where the messages go.
        #[arg(long)]
        url: Url,
        /// The ends of jobs that are told: successful, failed, dismissed [default: all].
        #[arg(long, value_delimiter = ',', value_name = "EVENTS")]
        events: Vec<Event>,
        /// Tell only of jobs of this principal: a key's name, or a token's ISSUER#SUBJECT.
        #[arg(long, value_name = "PRINCIPAL", value_parser = NonEmptyStringValueParser::new())]
        owner: Option<String>,
    },
    /// List the targets, without their secrets.
    List,
    /// Give a target a new secret and print it; messages are signed with the old one as well for a while.
    Rotate {
        name: String,
        /// How long the old one is used beside the new one; 0 ends it at once.
        #[arg(long, default_value = "24h", value_name = "TIME")]
        overlap: Span,
    },
    /// Tell a target nothing more; what it was not told yet is given up.
    Remove { name: String },
}

/// A running service takes changes over within a second.
pub fn run(args: Args) -> Result<(), Failure> {
    let (data, named) = (args.data.as_deref(), args.webhooks.as_deref());
    let place = OperatorPlace::of_webhooks(data, named);
    let file = match (&args.command, named) {
        (Command::Add { .. }, _) | (_, None) => TargetFile::new(place.path()),
        (_, Some(named)) => TargetFile::named(named),
    };
    let made = match args.command {
        Command::Add { .. } => place.make()?,
        _ => place.check().map(|()| false)?,
    };
    let mut out = std::io::stdout();
    match args.command {
        Command::Add { name, url, events, owner } => {
            let events = if events.is_empty() { Event::ALL.to_vec() } else { events };
            let keys = OperatorPlace::of_keys(data, args.keys.as_deref());
            let doubt = owner.as_deref().and_then(|owner| doubted(owner, &keys.path()));
            writeln!(out, "{}", file.add(&name, url, &events, owner)?)?;
            let unsaid = place.unsaid(made).map(|unsaid| format!("note: {unsaid}"));
            for line in doubt.map(|doubt| format!("warning: {doubt}")).into_iter().chain(unsaid) {
                // It is added, whether or not somebody reads this.
                let _ = writeln!(std::io::stderr(), "rosaline: {line}");
            }
        }
        Command::Rotate { name, overlap } => writeln!(out, "{}", file.rotate(&name, overlap.0)?)?,
        Command::Remove { name } => file.remove(&name)?,
        Command::List => {
            let targets = file.list()?;
            if targets.is_empty() {
                // Beside the list, which programs read.
                let _ = writeln!(
                    std::io::stderr(),
                    "there is no target in {}; 'rosaline webhooks add NAME --url URL{}' adds one",
                    place.path().display(),
                    place.again()
                );
            }
            for target in targets {
                let events: Vec<&str> = target.events.iter().map(|event| event.status().name()).collect();
                let owner = target.owner.as_deref().unwrap_or("everybody");
                writeln!(out, "{}  {}  {}  {owner}", target.name, target.url, events.join(","))?;
            }
        }
    }
    Ok(())
}

/// What makes it doubtful that a principal has jobs, by the keys in this file. It is no error: its key may be made later, and
/// of a token's subject nothing is known here.
fn doubted(owner: &str, keys: &Path) -> Option<String> {
    let path = keys.display();
    match KeyFile::new(keys).list() {
        // As tokens' names have it, and no key's.
        _ if owner.contains('#') => None,
        // A revoked key's jobs may be under way.
        Ok(known) if known.iter().any(|key| key.name == owner) => None,
        Ok(_) => Some(format!(
            "no key in {path} has the name '{owner}', so there is nothing to tell until one has; a token's owner is \
             ISSUER#SUBJECT"
        )),
        Err(error) => Some(format!("whether a key has the name '{owner}' is not known: {error}")),
    }
}

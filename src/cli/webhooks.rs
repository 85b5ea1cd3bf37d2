//! `rosaline webhooks`: who is told of the ends of jobs.

use std::io::Write;
use std::path::PathBuf;

use clap::Subcommand;

use super::Failure;
use super::files::create_private;
use super::serve::Span;
use crate::outbound::Url;
use crate::outbound::webhooks::{Event, TargetFile};

#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    /// The service's data folder, in which the targets are; created where it is missing.
    #[arg(long, env = "ROSALINE_DATA", default_value = "data", value_name = "DIR", global = true)]
    data: PathBuf,
    /// The file of the targets, where it is not webhooks.json in the data folder.
    #[arg(long, env = "ROSALINE_WEBHOOKS", value_name = "FILE", global = true)]
    webhooks: Option<PathBuf>,
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
        #[arg(long, value_name = "PRINCIPAL")]
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
    let path = match args.webhooks {
        Some(path) => path,
        None => {
            create_private(&args.data)?;
            args.data.join("webhooks.json")
        }
    };
    let file = TargetFile::new(path);
    let mut out = std::io::stdout();
    match args.command {
        Command::Add { name, url, events, owner } => {
            let events = if events.is_empty() { Event::ALL.to_vec() } else { events };
            writeln!(out, "{}", file.add(&name, url, &events, owner)?)?;
        }
        Command::Rotate { name, overlap } => writeln!(out, "{}", file.rotate(&name, overlap.0)?)?,
        Command::Remove { name } => file.remove(&name)?,
        Command::List => {
            let targets = file.list()?;
            if targets.is_empty() {
                // Beside the list, which programs read.
                writeln!(
                    std::io::stderr(),
                    "there is no target; 'rosaline webhooks add NAME --url URL' adds one"
                )?;
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

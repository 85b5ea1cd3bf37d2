//! What is wrong with the arguments, in one line: without clap's usage, and without its hints where they lead astray.

use std::ffi::OsString;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Command};

use super::Failure;
use super::config::Config;

/// The line; `None` for help and version, which are no failures to clap's callers and are printed.
pub(super) fn told(
    error: &clap::Error,
    config: &Config,
    command: &Command,
    arguments: &[OsString],
) -> Option<Failure> {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // A closed stdout leaves nobody to tell.
            let _ = error.print();
            return None;
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            return Some(Failure::new("a subcommand is missing; rosaline --help lists them"));
        }
        ErrorKind::TooManyValues => {
            let flag = invalid(error).unwrap_or("this flag");
            return Some(Failure::new(format!("{flag} takes no value; give it alone, or leave it out")));
        }
        ErrorKind::UnknownArgument => {
            if let Some(what) = behind_no_equals(error, command, arguments) {
                return Some(Failure::new(what));
            }
        }
        ErrorKind::MissingRequiredArgument => {
            if let Some(half) = config.half_of(error, command, arguments) {
                let [given, missing] = half;
                let message = format!("--{given} needs --{missing} beside it; give both, or neither");
                return Some(Failure { message, settings: &half[..1] });
            }
        }
        _ => {}
    }
    let place =
        config.place_of(error, command, arguments).map_or(String::new(), |place| format!("{place}: "));
    Some(Failure::new(format!("{place}{}; --help lists what can be given", in_words(error))))
}

/// The argument that is wrong.
fn invalid(error: &clap::Error) -> Option<&str> {
    match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(argument)) => Some(argument),
        _ => None,
    }
}

/// Clap's words, with what looks like what was meant; not that values may stand behind `--`, where none does.
fn in_words(error: &clap::Error) -> String {
    let text = error.to_string();
    let end = ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|mark| text.find(mark)).min();
    let text = text[..end.unwrap_or(text.len())].trim_start_matches("error: ").trim();
    let (mut what, mut tips) = (Vec::new(), String::new());
    for line in text.lines() {
        match line.trim_start().strip_prefix("tip: ") {
            Some(tip) if tip.starts_with("to pass ") => {}
            Some(tip) => tips += &format!("; {tip}"),
            None if line.is_empty() => {}
            None => what.push(line),
        }
    }
    what.join(" ") + &tips
}

/// For the value of a flag that it must be tied to: `--noise 0.4` are two arguments.
fn behind_no_equals(error: &clap::Error, command: &Command, arguments: &[OsString]) -> Option<String> {
    // Of "-0.5" clap names "-0".
    let begin = invalid(error)?;
    let place = arguments.iter().rposition(|argument| argument.to_string_lossy().starts_with(begin))?;
    let value = arguments.get(place)?.to_string_lossy();
    let flag = arguments.get(place.checked_sub(1)?)?.to_str()?.strip_prefix("--")?;
    let mut known = command.find_subcommand(arguments.get(1)?)?.get_arguments();
    let arg = known.find(|arg: &&Arg| arg.get_long() == Some(flag) && arg.is_require_equals_set())?;
    let name = arg.get_value_names().and_then(|names| names.first()).map_or("VALUE", |name| name.as_str());
    Some(format!(
        "'{value}' is no argument; a value of --{flag} is tied to it, as --{flag}={name}, and --help says which there are"
    ))
}

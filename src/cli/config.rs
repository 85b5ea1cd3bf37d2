//! The configuration file of `serve`, `doctor` and `health`: TOML, whose keys are the names of flags.
//!
//! What it says goes before clap as further flags, where neither a flag nor a variable says it already. So a value is read
//! by the flag's own rules, and what belongs together is wanted together wherever each part stands.

use std::ffi::{OsStr, OsString};
use std::io;
use std::ops::Range;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue};
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use toml::de::{DeTable, DeValue};

use crate::jobs::operator_file;

/// The subcommands that take a file, the flag that names it, and its variable.
const SUBCOMMANDS: [&str; 3] = [SERVE, "doctor", "health"];
/// The one whose flags a file may set; the others pass over those that they do not have.
const SERVE: &str = "serve";
const FLAG: &str = "config";
const VARIABLE: &str = "ROSALINE_CONFIG";
/// Flags that are asked of one run, not set: no keys of a file.
const NO_KEYS: [&str; 5] = [FLAG, "print-config", "alive", "help", "version"];
/// After it no flag comes.
const END: &str = "--";
/// Flags with another that they need, as `requires` of [`super::serve::Args`] has it, which clap keeps to itself.
const HALVES: &[[&str; 2]] = &[
    ["tls-cert", "tls-key"],
    ["tls-key", "tls-cert"],
    ["jwt-issuer", "jwt-audience"],
    ["jwt-audience", "jwt-issuer"],
    ["jwks", "jwt-issuer"],
];

/// What is wrong with the file.
#[derive(Debug, thiserror::Error)]
pub(super) enum ConfigError {
    #[error("the configuration file {path} cannot be read: {source}; give another with --config")]
    Io { path: String, source: std::io::Error },
    #[error("{path}, line {line}: this is no TOML: {what}")]
    Syntax { path: String, line: usize, what: String },
    #[error(
        "{path}, line {line}: there is no setting '{key}'{meant}; 'rosaline serve --print-config' lists them, with their values"
    )]
    Unknown { path: String, line: usize, key: String, meant: String },
    #[error("{path}, line {line}: '{key}' is {expected}")]
    Kind { path: String, line: usize, key: String, expected: &'static str },
}

/// What a file says.
#[derive(Debug, Default)]
pub(super) struct Config {
    path: PathBuf,
    settings: Vec<Setting>,
}

#[derive(Debug)]
struct Setting {
    key: String,
    line: usize,
    /// `None`: a flag without a value, which is not to be given.
    flag: Option<OsString>,
}

impl Config {
    /// The file that these arguments, or the environment, name for one of `command`'s subcommands; an empty one where they
    /// name none.
    ///
    /// # Errors
    /// [`ConfigError`], with the line.
    pub(super) fn of(command: &Command, arguments: &[OsString]) -> Result<Self, ConfigError> {
        let Some(subcommand) = subcommand(command, arguments) else { return Ok(Self::default()) };
        let asks = |flag: &str| flags(arguments).iter().any(|argument| argument == flag);
        let named = value_of(flags(arguments)).or_else(|| std::env::var_os(VARIABLE));
        match named {
            Some(path) if !asks("--help") && !asks("-h") => Self::read(Path::new(&path), command, subcommand),
            _ => Ok(Self::default()),
        }
    }

    fn read(path: &Path, command: &Command, subcommand: &Command) -> Result<Self, ConfigError> {
        let shown = path.display().to_string();
        let read = operator_file::read(path).and_then(|bytes| {
            String::from_utf8(bytes)
                .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error()))
        });
        let text = read.map_err(|source| ConfigError::Io { path: shown.clone(), source })?;
        let line =
            |place: Range<usize>| 1 + text.bytes().take(place.start).filter(|&byte| byte == b'\n').count();
        let table = DeTable::parse(&text).map_err(|error| ConfigError::Syntax {
            path: shown.clone(),
            line: line(error.span().unwrap_or_default()),
            what: error.message().to_owned(),
        })?;
        let mut settings = Vec::new();
        for (name, value) in table.into_inner() {
            let (line, key) = (line(name.span()), name.into_inner().into_owned());
            let of = |subcommand| keys(subcommand).find(|arg: &&Arg| arg.get_long() == Some(&key));
            let arg = match of(subcommand) {
                Some(arg) => arg,
                None if command.find_subcommand(SERVE).and_then(of).is_some() => continue,
                None => {
                    return Err(ConfigError::Unknown { path: shown, line, meant: meant(command, &key), key });
                }
            };
            let flag = flag(arg, &key, value.get_ref());
            let flag = flag.map_err(|expected| ConfigError::Kind {
                path: shown.clone(),
                line,
                key: key.clone(),
                expected,
            })?;
            settings.push(Setting { key, line, flag });
        }
        Ok(Self { path: path.to_owned(), settings })
    }

    /// The arguments, and those of the file that nobody has given otherwise.
    pub(super) fn added_to(&self, command: &Command, mut arguments: Vec<OsString>) -> Vec<OsString> {
        let Some(subcommand) = subcommand(command, &arguments) else { return arguments };
        let is_set = |setting: &&Setting| {
            let arg = keys(subcommand).find(|arg| arg.get_long() == Some(&setting.key));
            let variable = arg.and_then(Arg::get_env);
            variable.is_some_and(|name| std::env::var_os(name).is_some())
                || flags(&arguments).iter().any(|argument| is_of(argument, &setting.key))
        };
        let further: Vec<OsString> = self
            .settings
            .iter()
            .filter(|setting| !is_set(setting))
            .filter_map(|setting| setting.flag.clone())
            .collect();
        let end = flags(&arguments).len();
        arguments.splice(end..end, further);
        arguments
    }

    /// Where that comes from which clap refuses, where it is no flag among the arguments: a variable, or a line of the file.
    pub(super) fn place_of(
        &self,
        error: &clap::Error,
        command: &Command,
        arguments: &[OsString],
    ) -> Option<String> {
        let Some(ContextValue::String(named)) = error.get(ContextKind::InvalidArg) else { return None };
        self.place(long_of(named)?, command, arguments)
    }

    /// The same of settings that something is wrong with together.
    pub(super) fn places_of(
        &self,
        settings: &[&str],
        command: &Command,
        arguments: &[OsString],
    ) -> Option<String> {
        let places = settings.iter().filter_map(|setting| self.place(setting, command, arguments));
        let places: Vec<String> = places.collect();
        (!places.is_empty()).then(|| places.join(" and "))
    }

    fn place(&self, key: &str, command: &Command, arguments: &[OsString]) -> Option<String> {
        if flags(arguments).iter().any(|argument| is_of(argument, key)) {
            return None;
        }
        let subcommand = command.find_subcommand(arguments.get(1)?);
        let arg = subcommand.and_then(|each| each.get_arguments().find(|arg| arg.get_long() == Some(key)));
        let variable = arg.and_then(Arg::get_env).filter(|name| std::env::var_os(name).is_some());
        if let Some(variable) = variable {
            return Some(format!("the variable {}", variable.display()));
        }
        let setting = self.settings.iter().find(|setting| setting.key == key)?;
        Some(format!("{}, line {}", self.path.display(), setting.line))
    }

    /// The flag that was given and the one that clap misses beside it.
    pub(super) fn half_of(
        &self,
        error: &clap::Error,
        command: &Command,
        arguments: &[OsString],
    ) -> Option<&'static [&'static str; 2]> {
        let Some(ContextValue::Strings(missing)) = error.get(ContextKind::InvalidArg) else { return None };
        HALVES.iter().find(|[given, wanted]| {
            let is_given = flags(arguments).iter().any(|argument| is_of(argument, given))
                || self.place(given, command, arguments).is_some();
            is_given && missing.iter().any(|named| long_of(named) == Some(wanted))
        })
    }

    fn sets(&self, key: &str) -> bool {
        self.settings.iter().any(|setting| setting.key == key)
    }

    /// Every setting in force as a line of such a file, with where it comes from; those that nothing sets as remarks.
    pub(super) fn in_force(&self, command: &Command, arguments: &[OsString], matches: &ArgMatches) -> String {
        let mut text = String::new();
        for arg in subcommand(command, arguments).into_iter().flat_map(keys) {
            let (id, key) = (arg.get_id().as_str(), arg.get_long().unwrap_or_default());
            let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
            let given = flags(arguments).iter().any(|argument| is_of(argument, key));
            let source = match matches.value_source(id) {
                Some(ValueSource::CommandLine) if given || !self.sets(key) => "flag",
                Some(ValueSource::CommandLine) => "file",
                Some(ValueSource::EnvVariable) => "variable",
                _ => "default",
            };
            let values = matches.get_raw(id).into_iter().flatten();
            let value = values.map(|value| quoted(arg, &value.to_string_lossy())).next();
            text += &match value {
                Some(value) => format!("# {help} ({source})\n{key} = {value}\n"),
                None => format!("# {help}\n# {key} =\n"),
            };
        }
        text
    }
}

/// The subcommand that is asked for, where it takes a file.
fn subcommand<'c>(command: &'c Command, arguments: &[OsString]) -> Option<&'c Command> {
    let name = arguments.get(1)?.to_str()?;
    SUBCOMMANDS.contains(&name).then(|| command.find_subcommand(name))?
}

/// The name of a flag as clap shows it: `--name <VALUE>`.
fn long_of(shown: &str) -> Option<&str> {
    shown.split([' ', '=']).next()?.strip_prefix("--")
}

/// For one who spells a key as the variable, what it is called here.
fn meant(command: &Command, key: &str) -> String {
    let hyphened = key.to_ascii_lowercase().replace('_', "-");
    let mut known = command.find_subcommand(SERVE).into_iter().flat_map(keys).filter_map(Arg::get_long);
    let found = known.find(|long| *long == hyphened || hyphened.strip_prefix("rosaline-") == Some(long));
    found.map_or_else(String::new, |long| format!("; '{long}' is one"))
}

/// The flags that are keys of a file.
fn keys(subcommand: &Command) -> impl Iterator<Item = &Arg> {
    subcommand.get_arguments().filter(|arg| arg.get_long().is_some_and(|long| !NO_KEYS.contains(&long)))
}

/// The arguments before [`END`].
fn flags(arguments: &[OsString]) -> &[OsString] {
    let end = arguments.iter().position(|argument| argument == END).unwrap_or(arguments.len());
    &arguments[..end]
}

/// Whether an argument is this flag, with its value behind it or in it.
fn is_of(argument: &OsStr, key: &str) -> bool {
    let text = argument.to_string_lossy();
    text.strip_prefix("--").is_some_and(|rest| rest.split('=').next() == Some(key))
}

/// The value of [`FLAG`] among the arguments.
fn value_of(arguments: &[OsString]) -> Option<OsString> {
    let place = arguments.iter().position(|argument| is_of(argument, FLAG))?;
    // A path need be no text.
    let given = arguments[place].as_bytes();
    match given.iter().position(|&byte| byte == b'=') {
        Some(equals) => Some(OsStr::from_bytes(&given[equals + 1..]).to_owned()),
        None => arguments.get(place + 1).cloned(),
    }
}

/// A setting as the flag that says the same; the error is what its value should be.
fn flag(arg: &Arg, key: &str, value: &DeValue<'_>) -> Result<Option<OsString>, &'static str> {
    let is_switch = matches!(arg.get_action(), ArgAction::SetTrue);
    match (is_switch, value) {
        (true, DeValue::Boolean(given)) => Ok(given.then(|| format!("--{key}").into())),
        (true, _) => Err("true or false"),
        (false, DeValue::String(text)) => Ok(Some(format!("--{key}={text}").into())),
        (false, DeValue::Integer(number)) if number.radix() == 10 => {
            Ok(Some(format!("--{key}={number}").into()))
        }
        (false, _) => Err("a text in quotes, or a whole number"),
    }
}

/// A value as TOML has it.
fn quoted(arg: &Arg, value: &str) -> String {
    // TOML's whole numbers have 64 bits with a sign, and no zeros before them.
    let is_number = value.parse::<i64>().is_ok_and(|number| number.to_string() == value);
    if matches!(arg.get_action(), ArgAction::SetTrue) || is_number {
        return value.to_owned();
    }
    // TOML's basic strings have JSON's escapes.
    serde_json::Value::from(value).to_string()
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;

    #[test]
    fn every_flag_that_needs_another_is_known() {
        let command = super::super::command();
        let serve = command.find_subcommand(SERVE).unwrap();
        let needing = |arg: &&Arg| {
            let long = arg.get_long().unwrap();
            // One of them can be read.
            ["1", "1GiB", "text"].iter().any(|value| {
                let words = ["rosaline".to_owned(), SERVE.to_owned(), format!("--{long}={value}")];
                let parsed = command.clone().try_get_matches_from(words);
                parsed.is_err_and(|error| error.kind() == ErrorKind::MissingRequiredArgument)
            })
        };
        let found: Vec<&str> = keys(serve).filter(needing).filter_map(Arg::get_long).collect();
        let mut known: Vec<&str> = HALVES.iter().map(|[given, _]| *given).collect();
        known.sort_by_key(|given| found.iter().position(|long| long == given));
        assert_eq!(found, known);
    }
}

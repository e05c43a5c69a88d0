//! The configuration file of `run`, and which of several wishes counts.
//!
//! An option may be given as a flag, in the environment, or in the file; the first of them that is
//! given counts. The file's values become the defaults of the command line, so that they are read
//! and checked by the same rules as flags.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::parser::ValueSource;
use clap::{ArgAction, ArgMatches, Command};
use thiserror::Error;
use toml::de::{DeTable, DeValue};

use crate::scene_file::{FilePlace, nearest};

/// The verb that is configured.
const VERB: &str = "run";

/// Options that are about the file itself.
const OWN: [&str; 2] = ["config", "print_config"];

/// Read if nothing else is asked for and it is there: see [`default_path`].
const FILE: &str = "slitpose/config.toml";

/// Why a configuration cannot be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file.
    #[error("cannot read the configuration {}; give a file with --config, or `--config none`", path.display())]
    Read {
        /// Its path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Its text.
    #[error("{place}: not valid TOML here: {message}; correct this line")]
    Syntax {
        /// Where.
        place: FilePlace,
        /// What the parser said.
        message: String,
    },
    /// A key that is no option.
    #[error("{place}: `{key}` is no option of `slitpose {VERB}`{}; see `slitpose {VERB} --help`", hint(nearest.as_deref()))]
    UnknownKey {
        /// Where.
        place: FilePlace,
        /// The key.
        key: String,
        /// An option that it may be meant for.
        nearest: Option<String>,
    },
    /// A value of another kind.
    #[error("{place}: `{key}` is given as {found}; give a text, a number, true or false, or a list of texts")]
    Kind {
        /// Where.
        place: FilePlace,
        /// The key.
        key: String,
        /// What was found.
        found: &'static str,
    },
}

fn hint(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| format!(", `{nearest}` is"))
}

/// `command`, with the defaults of the configuration file that `matches` and the environment ask for.
pub(super) fn configured(command: Command, matches: &ArgMatches) -> Result<Command, ConfigError> {
    let Some((VERB, asked)) = matches.subcommand() else {
        return Ok(command);
    };
    let Some(path) = path_asked_for(asked) else {
        return Ok(command);
    };
    let text = fs::read_to_string(&path).map_err(|source| ConfigError::Read { path: path.clone(), source })?;
    let verb = command.find_subcommand(VERB).map(Command::get_arguments).into_iter().flatten();
    let known: Vec<String> = verb.map(|arg| arg.get_id().to_string()).filter(|id| is_option(id)).collect();
    let mut values = read(&path, &text, &known)?;
    Ok(command.mut_subcommand(VERB, |verb| {
        verb.mut_args(|arg| match values.iter().position(|(key, _)| key == arg.get_id().as_str()) {
            Some(at) => {
                let (_, texts) = values.swap_remove(at);
                arg.default_values(texts)
            }
            None => arg,
        })
    }))
}

/// Each option of `verb`, from the environment, too: SLITPOSE_ and its name.
pub(super) fn with_environment(verb: Command) -> Command {
    verb.mut_args(|arg| {
        let id = arg.get_id().as_str();
        let is_configured = is_option(id) || id == "config";
        let name = format!("SLITPOSE_{}", id.to_uppercase());
        if is_configured { arg.env(name).hide_env_values(true) } else { arg }
    })
}

fn is_option(id: &str) -> bool {
    !OWN.contains(&id) && !["help", "version"].contains(&id)
}

/// The file asked for, or else the first of the usual ones that is there.
fn path_asked_for(matches: &ArgMatches) -> Option<PathBuf> {
    match matches.get_one::<PathBuf>("config") {
        Some(path) if path == Path::new("none") => None,
        Some(path) => Some(path.clone()),
        None => default_paths().into_iter().find(|path| path.is_file()),
    }
}

/// Where a configuration is looked for: that of the user, then that of the machine.
fn default_paths() -> Vec<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")));
    user.into_iter().chain([PathBuf::from("/etc")]).map(|folder| folder.join(FILE)).collect()
}

/// The values in a file by option.
fn read(path: &Path, text: &str, known: &[String]) -> Result<Vec<(String, Vec<OsString>)>, ConfigError> {
    let origin = path.display().to_string();
    let place = |offset| FilePlace::of(&origin, text, offset);
    let table = DeTable::parse(text).map_err(|error| ConfigError::Syntax {
        place: place(error.span().map_or(0, |span| span.start)),
        message: error.message().replace('\n', ", "),
    })?;
    let mut values = Vec::new();
    for (key, value) in table.get_ref() {
        let name = key.get_ref().to_string();
        if !known.contains(&name) {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            let nearest = nearest(&name, &known).map(str::to_owned);
            return Err(ConfigError::UnknownKey { place: place(key.span().start), key: name, nearest });
        }
        let texts = texts_of(value.get_ref()).map_err(|found| ConfigError::Kind {
            place: place(value.span().start),
            key: name.clone(),
            found,
        })?;
        values.push((name, texts));
    }
    Ok(values)
}

fn texts_of(value: &DeValue<'_>) -> Result<Vec<OsString>, &'static str> {
    match value {
        DeValue::Array(values) => {
            let mut texts = Vec::new();
            for value in values.iter() {
                texts.push(text_of(value.get_ref())?);
            }
            Ok(texts)
        }
        value => Ok(vec![text_of(value)?]),
    }
}

fn text_of(value: &DeValue<'_>) -> Result<OsString, &'static str> {
    match value {
        DeValue::String(text) => Ok(text.to_string().into()),
        DeValue::Integer(number) => Ok(number.to_string().into()),
        DeValue::Float(number) => Ok(number.to_string().into()),
        DeValue::Boolean(flag) => Ok(flag.to_string().into()),
        DeValue::Datetime(_) => Err("a date"),
        DeValue::Array(_) => Err("a list of lists"),
        DeValue::Table(_) => Err("a table"),
    }
}

/// The options in force as a configuration file, each with where it comes from.
pub(super) fn print(command: &Command, matches: &ArgMatches) -> String {
    let (Some(verb), Some((VERB, given))) = (command.find_subcommand(VERB), matches.subcommand()) else {
        return String::new();
    };
    let path = path_asked_for(given);
    let mut text = match &path {
        Some(path) => format!("# with {}\n", path.display()),
        None => "# without a configuration file\n".to_owned(),
    };
    for arg in verb.get_arguments().filter(|arg| is_option(arg.get_id().as_str())) {
        let id = arg.get_id().as_str();
        let raw: Vec<String> = given
            .try_get_raw(id)
            .ok()
            .flatten()
            .map(|values| values.map(|value| value.to_string_lossy().into_owned()).collect())
            .unwrap_or_default();
        let source = match given.value_source(id) {
            Some(ValueSource::CommandLine) => "flag",
            Some(ValueSource::EnvVariable) => "environment",
            _ if raw.is_empty() => "default",
            _ => "file or default",
        };
        let value = match arg.get_action() {
            ArgAction::SetTrue => raw.first().cloned().unwrap_or_else(|| "false".to_owned()),
            ArgAction::Append => format!("{raw:?}"),
            _ => raw.first().map_or_else(|| "\"\"".to_owned(), |value| format!("{value:?}")),
        };
        let comment = if raw.is_empty() { "# " } else { "" };
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{comment}{id} = {value}  # {source}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Vec<(String, Vec<OsString>)>, String> {
        let known = ["device", "duration", "without_clipped", "seed"].map(str::to_owned);
        read(Path::new("config.toml"), text, &known).map_err(|error| error.to_string())
    }

    #[test]
    fn values_of_every_kind_become_texts() {
        let values = read_text("device = ['a', 'b']\nduration = '10s'\nwithout_clipped = true\nseed = 7").unwrap();
        let expected: [(&str, &[&str]); 4] =
            [("device", &["a", "b"]), ("duration", &["10s"]), ("seed", &["7"]), ("without_clipped", &["true"])];
        for (key, texts) in expected {
            let (_, found) = values.iter().find(|(name, _)| name == key).unwrap();
            assert_eq!(found, texts, "{key}");
        }
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (text, parts) in [
            ("seed = 1\ndevise = 'x'", ["config.toml:2:1", "`device`"]),
            ("seed = ", ["config.toml:1", "not valid TOML"]),
            ("seed = { a = 1 }", ["config.toml:1:8", "a table"]),
            ("device = [['a']]", ["config.toml:1:10", "a list of lists"]),
        ] {
            let message = read_text(text).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}

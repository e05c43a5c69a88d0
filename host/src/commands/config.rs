//! The configuration file of `run`, and the precedence of options.
//!
//! Flags override environment variables, which override the file. The file's values become the defaults of the command line, so that they are read
//! and checked by the same rules as flags.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use schemars::{Schema, json_schema};
use serde_json::{Map, json};
use toml::Value;
use toml::de::{DeTable, DeValue};

use super::{CommandError, UsageError, completions, usage};
use slitpose_head::foreign::printable;
use slitpose_head::platform::{machine_folder, user_folder};
use slitpose_head::scene_file::{FilePlace, nearest};
use slitpose_head::text_file::{self, TextFileError};

const VERB: &str = "run";

/// Options that are about the file itself.
const OWN: [&str; 2] = ["config", "print_config"];

/// Read if nothing else is asked for and it is there, in the user's folder, else in the machine's.
const FILE: &str = "slitpose/config.toml";

/// Answers of the command line list the values an option takes.
const MAX_ANSWER: usize = 400;

/// The command line with a configuration behind it.
pub(super) struct Configured {
    pub(super) command: Command,
    path: Option<PathBuf>,
    keys: Vec<String>,
}

/// `command`, with the defaults of the configuration file that `matches` and the environment ask for.
pub(super) fn configured(command: Command, matches: &ArgMatches) -> Result<Configured, CommandError> {
    let path = match matches.subcommand() {
        Some((VERB, asked)) => path_asked_for(asked),
        _ => None,
    };
    let (Some(path), Some(verb)) = (path, command.find_subcommand(VERB)) else {
        return Ok(Configured { command, path: None, keys: Vec::new() });
    };
    let bytes = text_file::read(&path);
    let text = bytes.and_then(|bytes| String::from_utf8(bytes).map_err(|_| TextFileError::NotText));
    let text = text.with_context(|| {
        usage!("cannot read the configuration {}; give a file with --config, or `--config none`", path.display())
    })?;
    let values = read(&path, &text, verb)?;
    let keys = values.iter().map(|(key, _)| key.clone()).collect();
    let mut values: HashMap<_, _> = values.into_iter().collect();
    let command = command.mut_subcommand(VERB, |verb| {
        verb.mut_args(|arg| match values.remove(arg.get_id().as_str()) {
            Some(texts) => arg.default_values(texts),
            None => arg,
        })
    });
    Ok(Configured { command, path: Some(path), keys })
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
        None => {
            let mut paths = [user_folder(), machine_folder()].into_iter().flatten().map(|folder| folder.join(FILE));
            paths.find(|path| path.is_file())
        }
    }
}

/// The options that a file of this text sets, or why it cannot be used.
pub fn configured_options(path: &Path, text: &str) -> Result<Vec<String>, String> {
    let command = super::command();
    let Some(verb) = command.find_subcommand(VERB) else { return Ok(Vec::new()) };
    let values = read(path, text, verb).map_err(|error| error.to_string())?;
    Ok(values.into_iter().map(|(key, _)| key).collect())
}

/// The values in a file by option of `verb`.
fn read(path: &Path, text: &str, verb: &Command) -> Result<Vec<(String, Vec<OsString>)>, UsageError> {
    let origin = path.display().to_string();
    let place = |offset| FilePlace::of(&origin, text, offset);
    let table = DeTable::parse(text).map_err(|error| {
        let (place, message) = (place(error.span().map_or(0, |span| span.start)), error.message().replace('\n', ", "));
        usage!("{place}: not valid TOML here: {}; correct this line", printable(&message))
    })?;
    let options = || verb.get_arguments().filter(|arg| is_option(arg.get_id().as_str()));
    let mut values = Vec::new();
    for (key, value) in table.get_ref() {
        let name = key.get_ref().to_string();
        let Some(option) = options().find(|arg| arg.get_id() == name.as_str()) else {
            let known: Vec<&str> = options().map(|arg| arg.get_id().as_str()).collect();
            let hint = nearest(&name, &known).map_or_else(String::new, |nearest| format!(", `{nearest}` is"));
            let (place, name) = (place(key.span().start), printable(&name));
            return Err(usage!(
                "{place}: `{name}` is no option of `slitpose {VERB}`{hint}; see `slitpose {VERB} --help`"
            ));
        };
        let place = place(value.span().start);
        let texts = texts_of(value.get_ref()).map_err(|found| {
            let next_step = "give a text, a number, true or false, or a list of texts";
            usage!("{place}: `{name}` is given as {found}; {next_step}")
        })?;
        check(verb, option, &texts).map_err(|message| {
            usage!("{place}: {}; see `slitpose {VERB} --help`", printable(&message).at_most(MAX_ANSWER))
        })?;
        values.push((name, texts));
    }
    Ok(values)
}

/// The error of the command line for these values of an option, if they are wrong.
fn check(verb: &Command, option: &Arg, texts: &[OsString]) -> Result<(), String> {
    let name = option.get_id();
    match (option.get_action(), texts) {
        (ArgAction::SetTrue, [text]) if text == "true" || text == "false" => return Ok(()),
        (ArgAction::SetTrue, _) => return Err(format!("`{name}` is true or false")),
        (ArgAction::Append, []) if !option.get_default_values().is_empty() => {
            return Err(format!("`{name}` needs at least one value"));
        }
        (ArgAction::Append, _) | (_, [_]) => {}
        _ => return Err(format!("`{name}` has one value")),
    }
    for text in texts {
        let mut typed = OsString::from(format!("--{}=", option.get_long().unwrap_or_default()));
        typed.push(text);
        if let Err(error) = verb.clone().try_get_matches_from([OsString::from(VERB), typed]) {
            let text = error.to_string();
            let lines = text.lines().map(str::trim).take_while(|line| !line.is_empty());
            let message = lines.collect::<Vec<_>>().join(" ");
            return Err(message.strip_prefix("error: ").unwrap_or(&message).to_owned());
        }
    }
    Ok(())
}

fn texts_of(value: &DeValue<'_>) -> Result<Vec<OsString>, &'static str> {
    match value {
        DeValue::Array(values) => values.iter().map(|value| text_of(value.get_ref())).collect(),
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

pub(super) fn schema() -> Schema {
    let command = super::command();
    let options = command.find_subcommand(VERB).into_iter().flat_map(Command::get_arguments);
    let of_option = |arg: &Arg| {
        let id = arg.get_id().as_str();
        let words: Vec<_> = arg.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect();
        let one = match arg.get_action() {
            ArgAction::SetTrue => json!({ "type": "boolean" }),
            _ if words.is_empty() => json!({ "type": ["string", "number"] }),
            _ => json!({ "enum": words }),
        };
        let mut value = match arg.get_action() {
            ArgAction::Append => json!({ "anyOf": [one, { "type": "array", "items": one }] }),
            _ => one,
        };
        value["description"] = arg.get_help().map(ToString::to_string).unwrap_or_default().into();
        (id.to_owned(), value)
    };
    json_schema!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Configuration of `slitpose run`",
        "type": "object",
        "properties": options.filter(|arg| is_option(arg.get_id().as_str())).map(of_option).collect::<Map<_, _>>(),
        "additionalProperties": false,
    })
}

/// The options in force as a configuration file, each with where it comes from.
pub(super) fn print(configured: &Configured, matches: &ArgMatches) -> String {
    let Configured { command, path, keys } = configured;
    let (Some(verb), Some((VERB, given))) = (command.find_subcommand(VERB), matches.subcommand()) else {
        return String::new();
    };
    let mut text = match path {
        Some(path) => format!("# with {}\n", path.display()),
        None => "# without a configuration file\n".to_owned(),
    };
    for arg in verb.get_arguments().filter(|arg| is_option(arg.get_id().as_str())) {
        let id = arg.get_id().as_str();
        let raw = given.try_get_raw(id).ok().flatten().unwrap_or_default();
        let texts: Vec<String> = raw.map(|value| value.to_string_lossy().into_owned()).collect();
        let source = match given.value_source(id) {
            Some(ValueSource::CommandLine) => "flag",
            Some(ValueSource::EnvVariable) => "environment",
            _ if keys.iter().any(|key| key == id) => "file",
            _ => "default",
        };
        let line = match (arg.get_action(), texts.first()) {
            (ArgAction::SetTrue, Some(flag)) => format!("{id} = {flag}  # {source}"),
            (ArgAction::Append, Some(_)) => format!("{id} = {}  # {source}", Value::from(texts)),
            (_, Some(text)) => format!("{id} = {}  # {source}", Value::from(text.as_str())),
            // Not given: the default, as a comment, for some make sense with a simulated board only.
            (_, None) => match completions::default_of(VERB, id) {
                Some(value) if !value.contains(' ') => format!("# {id} = {}  # default", Value::from(value)),
                Some(rule) => format!("# {id}: {rule}  # default"),
                None => format!("# {id}: none  # default"),
            },
        };
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{line}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Vec<(String, Vec<OsString>)>, String> {
        let command = crate::commands::command();
        let verb = command.find_subcommand(VERB).unwrap();
        read(Path::new("config.toml"), text, verb).map_err(|error| error.to_string())
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (text, parts) in [
            ("seed = 1\ndevise = 'x'", ["config.toml:2:1", "`device`"]),
            ("seed = ", ["config.toml:1", "not valid TOML"]),
            ("seed = { a = 1 }", ["config.toml:1:8", "a table"]),
            ("device = [['a']]", ["config.toml:1:10", "a list of lists"]),
            ("device = []", ["config.toml:1:10", "at least one"]),
            ("seed = ['1', '2']", ["config.toml:1:8", "one value"]),
            ("overwrite = 1", ["config.toml:1:13", "true or false"]),
            ("\nduration = 'soon'", ["config.toml:2:12", "'--duration <TIME>'"]),
            ("format = 'xml'", ["config.toml:1:10", "ndjson"]),
        ] {
            let message = read_text(text).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}

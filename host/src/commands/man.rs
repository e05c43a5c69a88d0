//! `slitpose man`: manual pages.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Arg, ArgAction, Command};
use clap_mangen::Man;

use super::{CommandError, Outcome};
use slitpose_head::table::{Output, OutputError};

/// Writes the manual pages: one for the program, and one for each verb.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose man --output ~/.local/share/man/man1 && man slitpose-run")]
pub(super) struct Args {
    /// Write to this folder
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
}

/// What the foot of a page says it is about.
const SOURCE: &str = concat!("slitpose ", env!("CARGO_PKG_VERSION"));

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let folder = &args.output;
    fs::create_dir_all(folder).map_err(|source| OutputError::Create { path: folder.clone(), source })?;
    let mut command = super::command().disable_help_subcommand(true);
    // Gives verbs their full names.
    command.build();
    write(&command, folder)?;
    Ok(Outcome::Done)
}

/// The page of `command`, and those of its verbs.
fn write(command: &Command, folder: &Path) -> Result<(), OutputError> {
    let man = Man::new(command.clone()).source(SOURCE).manual("slitpose");
    let mut text = Vec::new();
    // Writing to memory cannot fail; the generator writes text only.
    let _ = man.render(&mut text);
    let text = with_values(&String::from_utf8_lossy(&text), command);
    Output::file(&folder.join(man.get_filename()))?.write_text(&text)?;
    command.get_subcommands().try_for_each(|verb| write(verb, folder))
}

/// `page` with a synopsis that names the values of options.
fn with_values(page: &str, command: &Command) -> String {
    const HEADING: &str = ".SH SYNOPSIS\n";
    let Some((before, rest)) = page.split_once(HEADING) else { return page.to_owned() };
    let after = rest.find("\n.SH ").map_or("", |at| &rest[at..]);
    format!("{before}{HEADING}{}{after}", synopsis(command))
}

/// In roff: literal words bold, values in italics.
fn synopsis(command: &Command) -> String {
    let hyphens = |text: &str| text.replace('-', "\\-");
    let name = command.get_bin_name().unwrap_or_else(|| command.get_name());
    let mut words = vec![format!("\\fB{}\\fR", hyphens(name))];
    let is_own = |arg: &&Arg| !arg.is_hide_set() && !matches!(arg.get_id().as_str(), "help" | "version");
    for arg in command.get_arguments().filter(is_own) {
        let value = arg.get_value_names().and_then(|names| names.first());
        let value = format!("\\fI{}\\fR", hyphens(value.map_or(arg.get_id().as_str(), |name| name.as_str())));
        let word = match (arg.get_long(), arg.get_action().takes_values()) {
            (Some(long), true) => format!("\\fB\\-\\-{}\\fR {value}", hyphens(long)),
            (Some(long), false) => format!("\\fB\\-\\-{}\\fR", hyphens(long)),
            (None, _) => value,
        };
        let many = if matches!(arg.get_action(), ArgAction::Append) { " ..." } else { "" };
        words.push(if arg.is_required_set() { format!("{word}{many}") } else { format!("[{word}]{many}") });
    }
    if command.get_subcommands().next().is_some() {
        words.push("\\fIVERB\\fR".to_owned());
    }
    words.join(" ")
}

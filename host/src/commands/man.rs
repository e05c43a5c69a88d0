//! `slitpose man`: manual pages.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Command, CommandFactory};
use clap_mangen::Man;

use super::{Cli, CommandError, Outcome};
use crate::table::{Output, OutputError};

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
    let mut command = Cli::command().disable_help_subcommand(true);
    // Gives verbs their full names.
    command.build();
    write(&command, folder)?;
    Ok(Outcome::Done)
}

/// The page of `command`, and those of its verbs.
fn write(command: &Command, folder: &Path) -> Result<(), OutputError> {
    let man = Man::new(command.clone()).source(SOURCE).manual("slitpose");
    let mut page = Output::file(&folder.join(man.get_filename()))?;
    man.render(&mut page).map_err(|source| page.error(source))?;
    page.finish()?;
    command.get_subcommands().try_for_each(|verb| write(verb, folder))
}

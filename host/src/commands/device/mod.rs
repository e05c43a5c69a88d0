//! `slitpose device`: which boards there are, and what one is told beside measuring.

mod connection;
mod identify;
mod info;
mod list;
mod reboot;
mod set;

use clap::Subcommand;

pub(super) use connection::{BoardOptions, Connection};

use super::{CommandError, Outcome};

/// Lists boards; tells one what head it has, to show itself, or to start anew.
///
/// A board that another program follows is left alone.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    List(list::Args),
    Info(info::Args),
    Set(set::Args),
    Identify(identify::Args),
    Reboot(reboot::Args),
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    match &args.verb {
        Verb::List(args) => list::run(args),
        Verb::Info(args) => info::run(args),
        Verb::Set(args) => set::run(args),
        Verb::Identify(args) => identify::run(args),
        Verb::Reboot(args) => reboot::run(args),
    }
}

//! `slitpose scene`: everything about scenes that needs no device.

mod check;
mod list;
mod map;
mod optimise;
mod plot;
mod show;
mod view;

use clap::Subcommand;

use super::{CommandError, Outcome};

/// Checks, maps, draws, lists and shows scenes.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Check(check::Args),
    /// Lists the scenes that come with the program
    #[command(after_help = "Example:\n  slitpose scene list")]
    List,
    Map(map::Args),
    Optimise(optimise::Args),
    Plot(plot::Args),
    Show(show::Args),
    View(view::Args),
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    match &args.verb {
        Verb::Check(args) => check::run(args),
        Verb::List => list::run(),
        Verb::Map(args) => map::run(args),
        Verb::Optimise(args) => optimise::run(args),
        Verb::Plot(args) => plot::run(args),
        Verb::Show(args) => show::run(args),
        Verb::View(args) => view::run(args),
    }
}

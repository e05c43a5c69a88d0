//! `slitpose scene show`: the text of a scene that comes with the program.

use clap::builder::PossibleValuesParser;

use super::{CommandError, Outcome};
use slitpose_head::scene_file::{SHIPPED, Shipped};
use slitpose_head::table::Output;

/// Prints the scene file of a shipped scene: the place to start one's own from.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose scene show wide > mine.toml")]
pub(super) struct Args {
    /// Its name
    #[arg(value_parser = PossibleValuesParser::new(SHIPPED.map(|shipped| shipped.name)))]
    name: String,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    // The argument parser lets no other names through.
    let text = Shipped::named(&args.name).map_or("", |shipped| shipped.text);
    Output::open(None)?.write_text(text)?;
    Ok(Outcome::Done)
}

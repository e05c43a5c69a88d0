//! `slitpose device identify`: which board is it?

use super::BoardOptions;
use crate::commands::talk;
use crate::commands::{CommandError, Outcome};
use slitpose_head::scene_file::WIDE;

/// Blinks a board's indicator light, to find it among several.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose device identify --device 0036002900544850025a0320 --seconds 30")]
pub(super) struct Args {
    #[command(flatten)]
    board: BoardOptions,
    /// For how long; 0 ends it
    #[arg(long, value_name = "N", default_value_t = 10)]
    seconds: u8,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?.understood()?;
    connection.board.identify(args.seconds)?;
    match args.seconds {
        0 => talk(format_args!("{} shows itself no more", connection.name())),
        seconds => talk(format_args!("{} shows itself by its indicator light for {seconds} s", connection.name())),
    }
    Ok(Outcome::Done)
}

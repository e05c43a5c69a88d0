//! `slitpose replay`: captures through the live path.

use std::io::{self, IsTerminal};
use std::path::PathBuf;

use super::playback::{PlayOptions, Playback, Printing};
use super::poses::PoseOptions;
use super::{CommandError, Outcome};
use crate::terminal;
use slitpose_head::pace::Speed;

/// Solves captures again, through the same pipeline as live boards.
///
/// The same bytes give the same poses, bit for bit. Scene, equations and filter are those of the
/// recording unless given; files of a series are given together, in order. Files other than MCAP are
/// taken for the bytes of a port. Ends with exit code 3 if a capture is damaged or incomplete.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose replay contact.mcap --format csv > poses.csv\n  \
                        slitpose replay contact.mcap --speed 0.1 --from 2s --to 3s\n  \
                        slitpose replay night-0001.mcap night-0002.mcap --compare truth.csv --format none")]
pub(super) struct Args {
    /// Captures
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    play: PlayOptions,
    #[command(flatten)]
    poses: PoseOptions,
    /// Seconds of the recording per second, or max
    #[arg(long, value_name = "N", default_value_t = Speed::Max, allow_negative_numbers = true)]
    speed: Speed,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let is_terminal = io::stdout().is_terminal();
    let format = args.poses.format(is_terminal);
    let output = io::BufWriter::with_capacity(1 << 16, io::stdout());
    let sink = args.poses.open_sink(format, output, terminal::is_live());
    let printing = Printing { sink, target: "standard output", format, is_terminal };
    Playback::new(&args.files, &args.play, &args.poses, args.speed, printing)?.run()
}

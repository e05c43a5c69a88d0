//! `slitpose export`: every pose of a capture as a table.

use std::path::PathBuf;

use clap::ValueEnum;

use super::playback::{PlayOptions, Playback, Printing};
use super::poses::PoseOptions;
use super::{CommandError, Outcome};
use crate::pace::Speed;
use crate::sink::{self, Format};
use crate::table::Output;

/// Writes a pose for every scan of captures to a file.
///
/// A capture holds some poses only; the others follow from its bytes, as when it was recorded. The
/// format is that of the ending of the file's name, .csv or .ndjson, unless given.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose export contact.mcap --output poses.csv\n  \
                        slitpose export night-0001.mcap night-0002.mcap --output night.ndjson --filter 5ms")]
pub(super) struct Args {
    /// Captures
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// File to write; - is standard output
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    play: PlayOptions,
    #[command(flatten)]
    poses: PoseOptions,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let extension = args.output.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let by_name = Format::from_str(extension, true).unwrap_or(Format::Csv);
    let mut output = Output::open(Some(&args.output))?;
    let target = output.target().to_owned();
    let (format, is_terminal) = (args.poses.format_or(by_name), output.is_terminal());
    let sink = sink::open(format, &mut output, false);
    let printing = Printing { sink, target: &target, format, is_terminal };
    let played = Playback::new(&args.files, &args.play, &args.poses, Speed::Max, printing)?.run();
    let outcome = played?;
    output.finish()?;
    Ok(outcome)
}

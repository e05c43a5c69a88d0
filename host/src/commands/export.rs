//! `slitpose export`: every pose of a capture as a table.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use super::options::PoseOptions;
use super::playback::{PlayOptions, Playback, Printing};
use super::{CommandError, Outcome, interrupt};
use crate::sink::{Account, Format};
use slitpose_head::faults::Fault;
use slitpose_head::pace::Speed;
use slitpose_head::special_file;
use slitpose_head::table::{Output, OutputError, refuse_twice};

/// Writes a pose for every scan of captures to a file.
///
/// A capture holds some poses only; the others follow from its bytes, as when it was recorded. The
/// ending of the file's name says how they are written: .csv, .ndjson, or .parquet if this build
/// has it. Another needs --format.
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
    let format = match args.poses.asked_format() {
        Some(format) => format,
        None => format_of(&args.output)?,
    };
    refuse_twice(&args.output, args.files.iter().map(PathBuf::as_path).chain(args.play.sources()))?;
    Ok(write(&args.output, format, &args.files, (&args.play, &args.poses), Vec::new(), None)?.0)
}

/// Writes the poses of captures to `output`; returns how they did, too. `name`: that of a capture of several.
pub(super) fn write(
    output: &Path,
    format: Format,
    files: &[PathBuf],
    (play, poses): (&PlayOptions, &PoseOptions),
    faults: Vec<Fault>,
    name: Option<&str>,
) -> Result<(Outcome, Account), CommandError> {
    let stop = interrupt()?;
    let mut output = Output::open(Some(output))?;
    let target = output.target().to_owned();
    let is_terminal = output.is_terminal();
    let sink = poses.open_sink(format, &mut output, is_terminal)?;
    let printing = Printing { sink, target: &target, format, is_terminal, name };
    let done = Playback::new(files, play, poses, faults, Speed::Max, printing)?.play()?;
    if stop.load(Ordering::Relaxed) {
        return Err(OutputError::Interrupted { target }.into());
    }
    output.finish()?;
    Ok(done)
}

/// How poses are written to a file of this name.
fn format_of(output: &Path) -> Result<Format, CommandError> {
    match output.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => Ok(Format::Csv),
        Some("ndjson") => Ok(Format::Ndjson),
        #[cfg(feature = "parquet")]
        Some("parquet") => Ok(Format::Parquet),
        #[cfg(not(feature = "parquet"))]
        Some("parquet") => Err(CommandError::NoParquet { path: output.to_owned() }),
        // Standard output, devices and pipes have no name that could say it.
        _ if output == Path::new("-") || special_file::is_special(output) => Ok(Format::Csv),
        _ => Err(CommandError::Extension { path: output.to_owned() }),
    }
}

//! `slitpose replay` and `slitpose export`: captures through the live path.

use std::io;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use super::faults::FaultOptions;
use super::live::LiveOptions;
use super::options::PoseOptions;
use super::playback::{PlayOptions, Playback, Printing};
use super::player::{Orders, Player};
use super::{CommandError, Outcome, interrupt, usage};
use crate::live::LivePlan;
use crate::sink::{self, Format};
use crate::terminal;
use slitpose_head::pace::Speed;
use slitpose_head::special_file;
use slitpose_head::table::{Output, OutputError, refuse_twice};
use slitpose_tracking::columns::{COLUMNS, Column};

/// Solves captures again, through the same pipeline as live boards.
///
/// The same bytes give the same poses, bit for bit. Scene, equations and filter are those of the
/// recording unless given; files of a series are given together, in order. Files other than MCAP are
/// taken for the bytes of a port. Ends with exit code 3 if a capture is damaged or incomplete. With --live the
/// capture is played on a page, to pause, seek and go on, until the program is interrupted.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose replay contact.mcap --format csv > poses.csv\n  \
                        slitpose replay contact.mcap --speed 0.1 --from 2s --to 3s\n  \
                        slitpose replay contact.mcap --live --open\n  \
                        slitpose replay night-0001.mcap night-0002.mcap --compare truth.csv --format none")]
pub(super) struct ReplayArgs {
    /// Captures
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    play: PlayOptions,
    #[command(flatten)]
    poses: PoseOptions,
    #[command(flatten)]
    faults: FaultOptions,
    #[command(flatten)]
    live: LiveOptions,
    /// Seconds of the recording per second, or max
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    speed: Option<Speed>,
}

pub(super) fn replay(args: &ReplayArgs) -> Result<Outcome, CommandError> {
    let is_terminal = io::stdout().is_terminal();
    let format = args.poses.format(is_terminal);
    let output = io::BufWriter::with_capacity(1 << 16, io::stdout());
    let sink = sink::open(format, output, is_terminal && terminal::is_live());
    let printing = Printing { sink, target: "standard output", format, is_terminal, is_silent: false };
    let access = args.live.access()?;
    let usual = if access.is_some() { Speed::Times(1.0) } else { Speed::Max };
    let (faults, speed) = (args.faults.fault.clone(), args.speed.unwrap_or(usual));
    let playback = Playback::new(&args.files, &args.play, &args.poses, faults, speed, printing)?;
    args.faults.tell();
    let Some(access) = access else { return playback.run() };
    let orders = Orders::default();
    let server = args.live.access.start(LivePlan {
        access,
        source: "replay",
        boards: Vec::new(),
        scene: None,
        control: orders.control(),
        report: None,
        recordings: None,
    })?;
    let names: Vec<_> = args.files.iter().map(|file| file.display().to_string()).collect();
    match Player::new(orders, server.input, names.join(", "), &args.files, args.play.to)? {
        Some(player) => playback.played_by(player)?.run(),
        None => Ok(Outcome::Done),
    }
}

/// Writes a pose for every scan of captures to a file.
///
/// A capture holds some poses only; the others follow from its bytes, as when it was recorded. The
/// ending of the file's name says how they are written: .csv or .ndjson. Another needs --format. `slitpose export --help` lists the quantities of a pose.
#[derive(Debug, clap::Args)]
#[command(after_help = EXPORT_EXAMPLES, after_long_help = quantities())]
pub(super) struct ExportArgs {
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

const EXPORT_EXAMPLES: &str = "Examples:\n  slitpose export contact.mcap --output poses.csv\n  \
                               slitpose export night-0001.mcap night-0002.mcap --output night.ndjson --filter 5ms";

/// The quantities of a pose in all outputs.
fn quantities() -> String {
    let line = |column: &Column| {
        let names = match &column.names()[..] {
            [name] => name.clone(),
            names => format!("{} … {}", names[0], names[names.len() - 1]),
        };
        let unit = if column.unit.is_empty() { String::new() } else { format!(", {}", column.unit) };
        let key = if column.key.is_empty() { "-" } else { column.key };
        format!("  {key}{unit} | {names}\n      {}\n", column.meaning)
    };
    let lines: String = COLUMNS.iter().map(line).collect();
    format!("{EXPORT_EXAMPLES}\n\nQuantities, as key and unit of NDJSON | columns of CSV:\n{lines}")
}

pub(super) fn export(args: &ExportArgs) -> Result<Outcome, CommandError> {
    let format = match args.poses.format {
        Some(format) => format,
        None => format_of(&args.output)?,
    };
    refuse_twice(&args.output, args.files.iter().map(PathBuf::as_path).chain(args.play.sources()))?;
    let stop = interrupt()?;
    let mut output = Output::open(Some(&args.output))?;
    let target = output.target().to_owned();
    let is_terminal = output.is_terminal();
    let sink = sink::open(format, &mut output, is_terminal && terminal::is_live());
    let printing = Printing { sink, target: &target, format, is_terminal, is_silent: false };
    let outcome = Playback::new(&args.files, &args.play, &args.poses, Vec::new(), Speed::Max, printing)?.run()?;
    if stop.load(Ordering::Relaxed) {
        return Err(OutputError::Interrupted { target }.into());
    }
    output.finish()?;
    Ok(outcome)
}

/// How poses are written to a file of this name.
fn format_of(output: &Path) -> Result<Format, CommandError> {
    match output.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => Ok(Format::Csv),
        Some("ndjson") => Ok(Format::Ndjson),
        // Standard output, devices and pipes have no name that could say it.
        _ if output == Path::new("-") || special_file::is_special(output) => Ok(Format::Csv),
        _ => Err(usage!(
            "the name {} does not say how poses are to be written; give one that ends in .csv or .ndjson, or --format",
            output.display()
        )
        .into()),
    }
}

//! `slitpose replay` and `slitpose export`: captures through the live path; and a capture played as the page asks.

use std::io;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::compare::SideBySide;
use super::live::LiveOptions;
use super::options::PoseOptions;
use super::playback::{PlayOptions, Playback, Printing};
use super::simulate::FaultOptions;
use super::{CommandError, Outcome, UsageError, interrupt};
use crate::live::{Control, LiveBoard, LiveInput, LivePlan, Order, PlayerOrder, PlayerState, Refusal, Sampler};
use crate::sink::{Account, Format};
use crate::telemetry::DaemonReport;
use slitpose_head::faults::Fault;
use slitpose_head::pace::Speed;
use slitpose_head::special_file;
use slitpose_head::table::{Output, OutputError, refuse_twice};
use slitpose_head::threads::lock;
use slitpose_tracking::playback;
use slitpose_tracking::playback::Board;

/// Solves captures again, through the same pipeline as live boards.
///
/// The same bytes give the same poses, bit for bit. Scene, equations and filter are those of the
/// recording unless given; files of a series are given together, in order. Files other than MCAP are
/// taken for the bytes of a port. Ends with exit code 3 if a capture is damaged or incomplete. With --live the
/// capture is played on a page, to pause, seek and go on, until the program is interrupted.
///
/// With --jobs each file is a capture of its own, and several are replayed at once: each has the poses of its own
/// replay. They go to files in the folder of --output, and a table of how each capture did to standard output. A capture
/// that cannot be replayed does not keep the others from it; the exit code is then 1.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose replay contact.mcap --format csv > poses.csv\n  \
                        slitpose replay contact.mcap --speed 0.1 --from 2s --to 3s\n  \
                        slitpose replay contact.mcap --live --open\n  \
                        slitpose replay a.mcap b.mcap c.mcap --jobs 2 --output poses --format csv\n  \
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
    #[command(flatten)]
    side_by_side: SideBySide,
}

pub(super) fn replay(args: &ReplayArgs) -> Result<Outcome, CommandError> {
    if let Some(jobs) = args.side_by_side.jobs {
        return args.side_by_side.replay(jobs, &args.files, (&args.play, &args.poses), &args.faults);
    }
    let is_terminal = io::stdout().is_terminal();
    let format = args.poses.format(is_terminal);
    let output = io::BufWriter::with_capacity(1 << 16, io::stdout());
    let sink = args.poses.open_sink(format, output, is_terminal)?;
    let printing = Printing { sink, target: "standard output", format, is_terminal, name: None };
    let access = args.live.access()?;
    let usual = if access.is_some() { Speed::Times(1.0) } else { Speed::Max };
    let (faults, speed) = (args.faults.fault.clone(), args.speed.unwrap_or(usual));
    let playback = Playback::new(&args.files, &args.play, &args.poses, faults, speed, printing)?;
    args.faults.tell();
    let Some(access) = access else { return playback.run() };
    let length_s = args.play.to().unwrap_or(f64::INFINITY).min(playback::Playback::length_s(&args.files)?);
    let orders = Orders::default();
    let server = args.live.start(LivePlan {
        access,
        source: "replay",
        has_zero: false,
        boards: Vec::new(),
        scene: None,
        control: Box::new(orders.clone()),
        report: None,
    })?;
    let names: Vec<_> = args.files.iter().map(|file| file.display().to_string()).collect();
    let player = Player::new(orders, server.input(), names.join(", "), length_s);
    playback.played_by(player)?.run()
}

/// Writes a pose for every scan of captures to a file.
///
/// A capture holds some poses only; the others follow from its bytes, as when it was recorded. The
/// ending of the file's name says how they are written: .csv, .ndjson, or .parquet if this build
/// has it. Another needs --format.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose export contact.mcap --output poses.csv\n  \
                        slitpose export night-0001.mcap night-0002.mcap --output night.ndjson --filter 5ms")]
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

pub(super) fn export(args: &ExportArgs) -> Result<Outcome, CommandError> {
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
        Some("parquet") => Err(UsageError::NoParquet { path: output.to_owned() }.into()),
        // Standard output, devices and pipes have no name that could say it.
        _ if output == Path::new("-") || special_file::is_special(output) => Ok(Format::Csv),
        _ => Err(UsageError::Extension { path: output.to_owned() }.into()),
    }
}

// Played by the page.

/// Time between messages on the state of the player.
const TELL_EVERY: Duration = Duration::from_millis(250);

/// Orders that are not carried out yet; a later one overrides an earlier one.
#[derive(Clone, Debug, Default)]
pub(super) struct Orders(Arc<Mutex<PlayerOrder>>);

/// What is left to play at least, seconds.
const MIN_S: f64 = 0.05;

const SPEEDS: [f64; 2] = [1e-3, 1e3];

impl Control for Orders {
    fn order(&self, order: Order) -> Result<(), Refusal> {
        let order = match order {
            Order::Player(order) => order,
            Order::Record(_) => return Err(Refusal::NO_RECORDER),
            Order::Zero => return Err(Refusal::NO_MOUSE),
        };
        if let Some(Some(value)) = order.speed
            && !(SPEEDS[0]..=SPEEDS[1]).contains(&value)
        {
            return Err(Refusal::Value { key: "speed", value, hint: "0.001 to 1000, or null" });
        }
        if let Some(value) = order.seek_s
            && !(0.0..1e9).contains(&value)
        {
            return Err(Refusal::Value { key: "seek_s", value, hint: "seconds after the beginning" });
        }
        let mut waiting = lock(&self.0);
        *waiting = PlayerOrder {
            playing: order.playing.or(waiting.playing),
            speed: order.speed.or(waiting.speed),
            seek_s: order.seek_s.or(waiting.seek_s),
        };
        Ok(())
    }
}

pub(super) struct Player {
    orders: Orders,
    live: LiveInput,
    state: PlayerState,
    told: Option<Instant>,
}

impl Player {
    /// Plays a capture of `duration_s`.
    pub(super) fn new(orders: Orders, live: LiveInput, file: String, duration_s: f64) -> Self {
        let state = PlayerState { playing: true, duration_s, file, ..PlayerState::default() };
        Self { orders, live, state, told: None }
    }

    /// Shows these boards from now on, by the samplers that are returned.
    pub(super) fn show(&self, boards: &[Board]) -> Vec<Sampler> {
        let shown = |board: &Board| LiveBoard { name: board.name(), head: Some(board.head.clone()) };
        self.live.boards(boards.iter().map(shown).collect());
        (0..boards.len()).map(|number| Sampler::new(number, Arc::new(self.live.clone()))).collect()
    }

    pub(super) fn is_playing(&self) -> bool {
        self.state.playing && !self.state.ended
    }

    /// Carries out waiting orders: changes `speed`, and returns the place of a leap, seconds after the beginning.
    pub(super) fn obey(&mut self, speed: &mut Speed) -> Option<f64> {
        let PlayerOrder { playing, speed: new_speed, seek_s } = std::mem::take(&mut *lock(&self.orders.0));
        if let Some(new) = new_speed {
            *speed = new.map_or(Speed::Max, Speed::Times);
        }
        // Played again from the beginning.
        let again = (self.state.ended && playing == Some(true)).then_some(0.0);
        self.state.playing = playing.unwrap_or(self.state.playing);
        // Not so near the end that nothing is left to play.
        let seek_s = seek_s.map(|seek_s| seek_s.min(self.state.duration_s - MIN_S).max(0.0)).or(again);
        if let Some(seek_s) = seek_s {
            (self.state.position_s, self.state.ended) = (seek_s, false);
        }
        if playing.is_some() || new_speed.is_some() || seek_s.is_some() {
            self.told = None;
        }
        seek_s
    }

    /// Sends the state of the player and a report on the boards to the page, four times a second and after each change.
    pub(super) fn tell(&mut self, position_s: f64, speed: Speed, ended: bool, report: impl FnOnce() -> DaemonReport) {
        if ended != self.state.ended {
            self.told = None;
        }
        (self.state.position_s, self.state.ended) = (position_s, ended);
        self.state.speed = match speed {
            Speed::Max => None,
            Speed::Times(times) => Some(times),
        };
        if self.told.is_none_or(|told| told.elapsed() >= TELL_EVERY) {
            self.told = Some(Instant::now());
            self.live.player(PlayerState { playing: self.is_playing(), ..self.state.clone() });
            self.live.report(report());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_wait_are_joined_and_bad_ones_refused() {
        let orders = Orders::default();
        let give = |order| orders.order(Order::Player(order));
        let none = PlayerOrder::default();
        give(PlayerOrder { playing: Some(false), seek_s: Some(3.0), ..none }).unwrap();
        give(PlayerOrder { playing: Some(true), speed: Some(None), ..none }).unwrap();
        let joined = PlayerOrder { playing: Some(true), speed: Some(None), seek_s: Some(3.0) };
        assert_eq!(*lock(&orders.0), joined);
        for seek_s in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(give(PlayerOrder { seek_s: Some(seek_s), ..none }).is_err(), "{seek_s}");
        }
        for speed in [0.0, -1.0, 1e9, f64::NAN] {
            assert!(give(PlayerOrder { speed: Some(Some(speed)), ..none }).is_err(), "{speed}");
        }
        assert!(orders.order(Order::Record(true)).is_err());
        assert_eq!(*lock(&orders.0), joined, "refused orders change nothing");
    }
}

//! `slitpose simulate`, and the tool in front of a simulated board.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use slitpose_bench::{DrawnHead, Within};
use slitpose_calibration::Head;
use slitpose_model::Tier;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Schedule};

use super::faults::FaultOptions;
use super::options::{CalibrationOption, DEFAULT_TOLERANCE, TierOptions, open_scene, parse_duration};
use super::{CommandError, Outcome, interrupt, options, talk};
use crate::comparison::NothingMatches;
use crate::device::{Conversation, DeviceError, HELLO_WITHIN, SimulatedDevice};
use slitpose_head::faults::{Faults, Injector};
use slitpose_head::foreign::printable;
use slitpose_head::front_end;
use slitpose_head::pace::Speed;
use slitpose_head::scene_file::{SceneFile, nearest};
use slitpose_head::simulator::{PathError, SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_head::table::{Output, OutputError, POSE_COLUMNS, Replace, TableError, TableWriter, refuse_twice};
use slitpose_tracking::capture::{CaptureError, CaptureSeries, Settings, Setup};
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::pipeline::PipelineOptions;

/// Writes what a simulated board would send: a capture for `replay`.
///
/// The truth of each scan is in the capture; --truth writes it as a table, too.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  slitpose simulate --trajectory fast --duration 2s --output fast.mcap --truth fast.csv"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(long, value_name = "SCENE", default_value = "wide", value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Device time to simulate, such as 10s
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "10s")]
    duration: f64,
    /// Capture to write; - is standard output
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// Replace a file that is there already
    #[arg(long)]
    overwrite: bool,
    /// Write the bytes alone, as they would come from a port
    #[arg(long)]
    raw: bool,
    /// Table of true poses to write: seq, device_time_s and the columns of a pose
    #[arg(long, value_name = "CSV")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    tool: ToolOptions,
    #[command(flatten)]
    tier: TierOptions,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    Faults::check_simulate(&args.tool.faults.fault)?;
    let head = args.calibration.head(open_scene(&args.scene)?)?;
    let schedule = front_end::configuration(&head.file)?.schedule;
    let frames = (args.duration * schedule.frame_rate_hz() - 1e-6).ceil() as u64;
    let tier = args.tier.tier(DEFAULT_TOLERANCE);
    let device = args.tool.device(0, &head.simulated, tier, args.duration, Speed::Max)?;
    args.tool.faults.tell();
    let sources = [args.scene.as_str(), args.tool.table().unwrap_or_default()].map(Path::new);
    let sources = sources.into_iter().chain(args.calibration.file());
    refuse_twice(&args.output, sources.clone())?;
    if let Some(truth) = &args.truth {
        refuse_twice(truth, sources.chain([&*args.output]))?;
    }
    let stop = interrupt()?;
    let truth = args.truth.as_deref().map(Output::file).transpose()?;
    let target = Target {
        path: &args.output,
        replace: if args.overwrite { Replace::Anything } else { Replace::Nothing },
        raw: args.raw,
    };
    record(device, &head, tier, &target, |_| stop.load(Ordering::Relaxed))?;
    if let Some(truth) = truth {
        let instants = (0..frames).map(|frame| {
            (frame as f64 * f64::from(schedule.frame_ticks) + schedule.reference_ticks()) / f64::from(schedule.tick_hz)
        });
        write_truth(truth, &args.tool.trajectory(&head.file, 0, args.duration)?, instants, &stop)?;
    }
    Ok(Outcome::Done)
}

pub(super) struct Target<'a> {
    pub(super) path: &'a Path,
    pub(super) replace: Replace,
    /// Bytes alone, no capture.
    pub(super) raw: bool,
}

/// Records all that `device` sends, as a board on `head` would be recorded, unless `is_interrupted`, which is told the
/// device time so far in nanoseconds.
pub(super) fn record(
    device: SimulatedDevice,
    head: &Head,
    tier: Tier,
    target: &Target<'_>,
    mut is_interrupted: impl FnMut(u64) -> bool,
) -> Result<(), CommandError> {
    let configuration = front_end::configuration(&head.file)?;
    let mut board = Conversation::open(Box::new(device))?;
    let mut device = DeviceId::default();
    board.greet(HELLO_WITHIN, |hello| {
        device = DeviceId(hello.device_id);
        Ok::<_, DeviceError>(())
    })?;
    let mut record = Recording::begin(target, device, head, tier, &configuration.schedule)?;
    board.configure(configuration)?;
    board.start()?;
    record.write(&mut board)?;
    while board.listen()? {
        record.write(&mut board)?;
        if is_interrupted(record.device_ns) {
            return Err(OutputError::Interrupted { target: record.output.target().to_owned() }.into());
        }
    }
    board.stop()?;
    record.write(&mut board)?;
    record.finish()
}

struct Recording {
    output: Output,
    /// `None`: bytes alone.
    capture: Option<(Box<CaptureSeries>, DeviceId)>,
    segment: Segment,
    /// Finds out when the bytes come, by the board's clock.
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    tick_hz: f64,
    device_ns: u64,
}

impl Recording {
    fn begin(
        target: &Target<'_>,
        device: DeviceId,
        head: &Head,
        tier: Tier,
        schedule: &Schedule,
    ) -> Result<Self, CommandError> {
        let output = Output::replacing(target.path, target.replace)?;
        let capture = if target.raw {
            None
        } else {
            let file_of_capture = output.as_file().map_err(|source| output.error(source))?;
            let mut series = CaptureSeries::on_medium(Box::new(file_of_capture), target.path)?;
            let settings = Settings { tier, following: PipelineOptions::default() };
            series.add_device(Setup::new(device, head, settings), None, 0).map_err(|error| writing(&output, error))?;
            Some((Box::new(series), device))
        };
        let tick_hz = f64::from(schedule.tick_hz);
        Ok(Self { output, capture, segment: Segment::default(), decoder: Decoder::new(), tick_hz, device_ns: 0 })
    }

    fn write(&mut self, board: &mut Conversation) -> Result<(), CommandError> {
        self.segment.clear();
        board.fill(&mut self.segment);
        let mut bytes = &self.segment.bytes[..];
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            if let Ok(Message::Batch(batch)) = message {
                self.device_ns = (batch.tick as f64 / self.tick_hz * 1e9) as u64;
            }
        }
        let Self { output, capture, segment, device_ns, .. } = self;
        match capture {
            Some((series, device)) => {
                series.segment(*device, segment, *device_ns).map_err(|error| writing(output, error))
            }
            None => output.write_all(&segment.bytes).map_err(|source| output.error(source).into()),
        }
    }

    fn finish(self) -> Result<(), CommandError> {
        if let Some((series, _)) = self.capture {
            series.finish().map_err(|error| writing(&self.output, error))?;
        }
        Ok(self.output.finish()?)
    }
}

/// A capture that cannot be written is not kept in part, other than one that a daemon records.
fn writing(output: &Output, error: CaptureError) -> CommandError {
    match error {
        CaptureError::Write { source, .. } => output.error(source).into(),
        error => error.into(),
    }
}

fn write_truth(
    output: Output,
    trajectory: &Trajectory,
    instants: impl Iterator<Item = f64>,
    stop: &AtomicBool,
) -> Result<(), CommandError> {
    let target = output.target().to_owned();
    let header = ["seq", "device_time_s"].into_iter().chain(POSE_COLUMNS);
    let mut table = TableWriter::new(output, header)?;
    for (sequence, time_s) in instants.enumerate() {
        table.text(&sequence.to_string());
        table.number(time_s);
        table.pose(&trajectory.pose(time_s));
        table.end_row()?;
        if stop.load(Ordering::Relaxed) {
            return Err(OutputError::Interrupted { target }.into());
        }
    }
    Ok(table.finish()?)
}

/// How many times as far out as the workspace a path may lead without a word.
const FAR: f64 = 2.0;

/// A path begins within a day, if the simulation has no end, seconds.
const MAX_START_S: f64 = 86_400.0;

/// A path that is so many times as long as its simulation, which meets fewer rows of it than these, is hardly one in seconds.
const MAX_LENGTHS: f64 = 100.0;
const MIN_ROWS: usize = 3;

/// The tool in front of a simulated board.
#[derive(clap::Args, Debug)]
pub(super) struct ToolOptions {
    /// still, hand, smooth, fast, contact, or a CSV table with time_s and the columns of a pose
    #[arg(long, value_name = "MOTION", value_parser = options::motions(), hide_possible_values = true)]
    trajectory: Option<String>,
    /// Its motion unless one is given.
    #[arg(skip = "smooth")]
    pub(super) default_motion: &'static str,
    /// Seed of motion and noise
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Simulate a head whose parts deviate from the scene within its [tolerance], drawn by this seed as by `bench`: a head
    /// to calibrate
    #[arg(long, value_name = "N")]
    drawn: Option<u64>,
    /// A square wave at the trigger input of the simulated board, such as 10Hz
    #[arg(long, value_name = "FREQUENCY", value_parser = parse_trigger)]
    trigger: Option<f64>,
    #[command(flatten)]
    pub(super) faults: FaultOptions,
}

/// Highest frequency at a trigger input: 10 000 edges a second.
const MAX_TRIGGER_HZ: f64 = 5e3;

fn parse_trigger(text: &str) -> Result<f64, String> {
    let frequency_hz = options::parse_frequency(text).filter(|hz| *hz > 0.0 && *hz <= MAX_TRIGGER_HZ);
    frequency_hz
        .ok_or_else(|| format!("give a frequency above 0Hz, {}kHz at most, such as 10Hz", MAX_TRIGGER_HZ * 1e-3))
}

impl ToolOptions {
    /// The first option that was given, if any.
    pub(super) fn given(&self) -> Option<&'static str> {
        self.trajectory
            .as_ref()
            .map(|_| "--trajectory")
            .or(self.seed.map(|_| "--seed"))
            .or(self.drawn.map(|_| "--drawn"))
            .or(self.trigger.map(|_| "--trigger"))
            .or(self.faults.given())
    }

    /// The table of a motion, if it is one.
    pub(super) fn table(&self) -> Option<&str> {
        self.trajectory.as_deref().filter(|name| TrajectoryKind::named(name).is_none())
    }

    /// The simulated board with this number and the head of `file`, for `duration_s`, which may be
    /// infinite. Each number has a seed of its own.
    pub(super) fn device(
        &self,
        number: u8,
        file: &SceneFile,
        tier: Tier,
        duration_s: f64,
        speed: Speed,
    ) -> Result<SimulatedDevice, CommandError> {
        let frame_s = front_end::configuration(file)?.schedule.frame_rate_hz().recip();
        let seed = self.seed(number);
        let trajectory = self.trajectory(file, number, duration_s)?;
        if let (0, Some(table), Some((knots, sizes)), Some([first_s, last_s])) =
            (number, self.table(), trajectory.path(), trajectory.span_s())
        {
            let end_s = duration_s.min(MAX_START_S);
            if first_s > end_s || last_s < 0.0 {
                let (theirs, ours) = ([first_s, last_s], [0.0, end_s]);
                let file = table.to_owned();
                return Err(NothingMatches { file, theirs, column: "time_s", of: "the simulation", ours }.into());
            }
            let used = knots.iter().filter(|(time_s, _)| (0.0..=end_s).contains(time_s)).count();
            if used < MIN_ROWS && last_s - first_s > MAX_LENGTHS * duration_s {
                talk(format_args!(
                    "{table}: its time_s takes {} s, and the simulation {duration_s} s; are these milliseconds, or \
                     numbers of rows? time_s is seconds",
                    last_s - first_s
                ));
            }
            sizes.finding(table, &file.workspace, FAR).iter().for_each(|finding| talk(format_args!("{finding}")));
        }
        let board = match self.drawn {
            None => SimulatedBoard::numbered(number, file, trajectory, tier, seed)?,
            Some(drawn) => {
                let head = DrawnHead::draw(file, Within::Family, drawn.wrapping_add(number.into()))?;
                SimulatedBoard::with_light(number, &head.simulated(), head.light(), trajectory, seed)?
            }
        };
        let board = self.trigger.into_iter().fold(board, SimulatedBoard::with_trigger);
        let faults = Faults::new(self.faults.fault.clone(), file.scene.cells.len())?;
        let board = board.with_faults(&faults, file, tier)?;
        let device = SimulatedDevice::new(board, frame_s, duration_s, speed);
        Ok(device.with_faults(Injector::of_link(&faults)))
    }

    fn seed(&self, number: u8) -> u64 {
        self.seed.unwrap_or(1).wrapping_add(number.into())
    }

    /// The motion of the tool of that board, of the head of `file`, over `duration_s`, which may be infinite.
    pub(super) fn trajectory(&self, file: &SceneFile, number: u8, duration_s: f64) -> Result<Trajectory, CommandError> {
        let name = self.trajectory.as_deref().unwrap_or(self.default_motion);
        match TrajectoryKind::named(name) {
            Some(kind) => Ok(Trajectory::of_kind(kind, self.seed(number), duration_s).within(&file.workspace)),
            None => Trajectory::from_table(name).map_err(|error| match error {
                PathError::Table(source @ TableError::Open { .. }) => {
                    let motions = options::motions();
                    let known: Vec<&str> = motions.0.iter().map(String::as_str).collect();
                    let nearest = nearest(name, &known).map(|name| format!(" (did you mean `{name}`?)"));
                    anyhow::Error::new(source).context(format!(
                        "no motion is called {}{}; the motions are {}, or give a table of one",
                        printable(name),
                        nearest.unwrap_or_default(),
                        known.join(", ")
                    ))
                }
                error => error.into(),
            }),
        }
    }
}

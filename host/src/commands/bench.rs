//! `slitpose bench`: measurements on a virtual bench.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use slitpose_bench::{DrawnHead, Session, Settings as BenchSettings, Within, write};
use slitpose_calibration::Head;
use slitpose_model::Tier;

use super::options::{DEFAULT_TOLERANCE, number, open_scene, parse_duration};
use super::simulate::{Target, record};
use super::{CommandError, Outcome, interrupt, options, talk};
use crate::device::SimulatedDevice;
use crate::terminal::{Amount, Progress};
use slitpose_head::front_end;
use slitpose_head::pace::Speed;
use slitpose_head::simulator::{SimulatedBoard, Trajectory};
use slitpose_head::table::Replace;

/// Longest free motion, seconds.
const MAX_S: f64 = 3600.0;

fn within() -> impl TypedValueParser<Value = Within> {
    PossibleValuesParser::new(["family", "richer"])
        .map(|name| if name == "richer" { Within::Richer } else { Within::Family })
}

/// Draws one head from the tolerances of a scene, and simulates what is measured on it.
///
/// The folder gets scene.toml, the scene with a [tolerance], and, for `calibrate`: known.csv, poses by an instrument; known_own.csv, other poses in
/// frames of its own; pivot.csv, the tip of the tool in a cone; stage.csv, steps along a line; rest.csv, returns to one
/// stop; free.csv, free motion without poses; if the scene has a [front_end], free.mcap, a capture of it, and
/// session.csv, the motion of a session without an instrument, for `run --device sim --drawn` with the same seed. For judging the result: test.csv, exact poses and single frames, and test_quiet.csv, means of 100 frames at the same.
/// The folder truth/ has the true pose of every row, and truth.toml all parameters as they are. Nothing else does, but
/// for the capture: as any of a simulated board it holds its true poses.
///
/// Tables have the noise of [noise], or else of the [front_end]. All rows but those of free.mcap have every spot on
/// its detector. Nothing of this is measured.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  slitpose bench wide --output head-7\n  slitpose calibrate head-7/scene.toml --known head-7/known.csv --output head-7.toml\n  slitpose solve head-7/scene.toml --currents head-7/test.csv --calibration head-7.toml"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Make this folder with the tables
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Seed of the head and of all errors
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// What the head deviates in: only in parameters that a calibration has, or also in what no calibration describes
    #[arg(long, default_value = "family", value_parser = within())]
    within: Within,
    /// Poses that the instrument measures
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    poses: u32,
    /// Duration of the free motion, at most an hour
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = parse_free)]
    duration: f64,
    /// Standard deviation of the instrument's positions, each axis
    #[arg(long, value_name = "UM", default_value_t = 2.0, value_parser = number(|sigma| (0.0..1e6).contains(&sigma), "give a number of zero or more, such as 2"))]
    instrument_um: f64,
    /// Standard deviation of the instrument's rotations, each axis
    #[arg(long, value_name = "URAD", default_value_t = 20.0, value_parser = number(|sigma| (0.0..1e6).contains(&sigma), "give a number of zero or more, such as 2"))]
    instrument_urad: f64,
}

fn parse_free(text: &str) -> Result<f64, String> {
    match parse_duration(text)? {
        duration_s if duration_s <= MAX_S => Ok(duration_s),
        _ => Err("give an hour at most, such as 20s".to_owned()),
    }
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let settings = BenchSettings {
        seed: args.seed,
        poses: args.poses as usize,
        free_s: args.duration,
        instrument: [args.instrument_um * 1e-6, args.instrument_urad * 1e-6],
    };
    let head = DrawnHead::draw(&file, args.within, args.seed)?;
    let session = Session::of(&head, &settings)?;
    write(&args.output, &head, &session)?;
    for table in &session.tables {
        talk(format_args!("{:>15} {:>6} rows: {}", format!("{}.csv", table.name), table.row_count(), table.about));
    }
    if file.front_end.is_some() {
        capture(args, &head, &session)?;
        talk(format_args!("{:>15} a capture of the free motion", "free.mcap"));
        talk(format_args!("{:>15} the motion of a session without an instrument", "session.csv"));
    }
    let folder = args.output.display();
    talk(format_args!("wrote {folder}: a head of {} parameters, truth in {folder}/truth", head.parameters.len()));
    Ok(Outcome::Done)
}

/// Records the free motion as a board would, whose host knows the head by its scene alone.
fn capture(args: &Args, head: &DrawnHead, session: &Session) -> Result<(), CommandError> {
    let simulated = head.simulated();
    let frame_s = front_end::configuration(&simulated)?.schedule.frame_rate_hz().recip();
    let trajectory = Trajectory::through(session.path.clone());
    let board = SimulatedBoard::with_light(0, &simulated, head.light(), trajectory, args.seed)?;
    let device = SimulatedDevice::new(board, frame_s, args.duration, Speed::Max);
    let stop = interrupt()?;
    let mut progress = Progress::new("free.mcap", (args.duration * 1e3) as u64, Amount::Of("ms"));
    let path = args.output.join("free.mcap");
    let target = Target { path: &path, replace: Replace::Nothing, raw: false };
    let tier = Tier::Exact { tolerance: DEFAULT_TOLERANCE };
    record(device, &Head::uncalibrated(head.nominal.clone())?, tier, &target, |device_ns| {
        progress.at(device_ns / 1_000_000);
        stop.load(Ordering::Relaxed)
    })
}

//! `slitpose report`, `slitpose paper` and `slitpose bench`: studies of the method and measurements on a virtual bench, in
//! folders.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use slitpose_bench::{DrawnHead, Session, Settings as BenchSettings, Within, write};
use slitpose_calibration::Head;
use slitpose_design::paper::{Experiment, Point, Study, account, figures};
use slitpose_design::report::{Folder, POSES, QUICK_POSES, SECTIONS, Settings, study};
use slitpose_model::Tier;

use super::options::{DEFAULT_TOLERANCE, Jobs, number, open_scene, parse_duration, store};
use super::simulate::{Target, record};
use super::{CommandError, Outcome, interrupt, options, talk};
use crate::device::SimulatedDevice;
use crate::terminal::{Amount, Progress};
use slitpose_head::front_end;
use slitpose_head::pace::Speed;
use slitpose_head::scene_file::{BENCH, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory};
use slitpose_head::table::{Output, OutputError, Replace, TableWriter};

/// Measures how exact and how fast everything is, for one scene, and makes a page of it.
///
/// The folder gets one page (index.html, needs nothing else), the same tables as Markdown
/// (report.md) and as CSV, and the pictures as SVG. Sections: the forward model, the solver against
/// the Cramér–Rao bound, what each optional effect costs, and stiff and extreme cases. Errors follow
/// from the seed; times are those of this machine, one thread, least and median of interleaved
/// rounds. Nothing is measured on hardware.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose report --output report\n  slitpose report head.toml --output report --quick"
)]
pub(super) struct ReportArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(default_value = WIDE.name, value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Make this folder with the page, its tables and pictures
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Poses of the workspace
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    poses: Option<u32>,
    /// Seed of the noise
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Fewer poses and rounds: a quarter of the time
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn report(args: &ReportArgs) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let default = if args.quick { QUICK_POSES } else { POSES };
    let settings =
        Settings { poses: args.poses.map_or(default, |poses| poses as usize), seed: args.seed, quick: args.quick };
    let folder = Folder::create(&args.output)?;
    args.jobs.apply();
    let mut progress = Progress::new("report", SECTIONS, Amount::Of("sections"));
    let mut done = 0;
    let report = study(&file, &settings, |title| {
        progress.step(done, title);
        done += 1;
    })?;
    drop(progress);
    store(&report, &folder)?;
    Ok(Outcome::Done)
}

/// Calculates the experiments of De La Cruz et al. 2018 with the shipped scene `bench`.
///
/// Experiment 1 moves the emitter along the detector, experiment 2 turns it. Both are given as
/// equations (1) to (6) are printed (paper tier) and integrated over the spot (exact tier). The
/// paper's measured points were published without numbers and do not appear.
///
/// With --output the folder also gets a page (index.html, report.md) on the four errors that the paper does publish as
/// numbers: simulated benches with imperfect parts that have the same errors.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose paper > experiments.csv\n  slitpose paper --output paper-figures")]
pub(super) struct PaperArgs {
    /// Make this folder with the table and its figures, instead of the table on standard output
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub(super) fn paper(args: &PaperArgs) -> Result<Outcome, CommandError> {
    let bench = BENCH.read()?;
    let study = Study::of(&bench)?;
    let Some(folder) = &args.output else {
        write_table(&study, Output::open(None)?)?;
        return Ok(Outcome::Done);
    };
    let page = Folder::create(folder)?;
    let table = folder.join("experiments.csv");
    write_table(&study, Output::file(&table)?)?;
    talk(format_args!("wrote {}", table.display()));
    for (name, svg) in figures(&study, &bench.scene.cells[0]) {
        let path = folder.join(name);
        Output::file(&path)?.write_text(&svg)?;
        talk(format_args!("wrote {}", path.display()));
    }
    store(&account(&bench)?, &page)?;
    Ok(Outcome::Done)
}

fn write_table(study: &Study, output: Output) -> Result<(), OutputError> {
    let header = [
        "experiment",
        "position_mm",
        "angle_deg",
        "status",
        "gamma_deg",
        "paper_x_a_mm",
        "exact_x_a_mm",
        "paper_solid_angle_sr",
        "exact_solid_angle_sr",
        "paper_i_o_a",
        "exact_i_o_a",
        "identified_relative_intensity",
        "identified_i_o_a",
    ];
    let mut table = TableWriter::new(output, header)?;
    for (index, point) in study.translation.iter().enumerate() {
        let with_identified = study.with_identified.get(index).map(|response| response.i_o_a);
        write_point(&mut table, Experiment::Translation, point, [None, with_identified])?;
    }
    for (index, point) in study.rotation.iter().enumerate() {
        let identified = study.identified.get(index).map(|identified| identified.relative_intensity);
        write_point(&mut table, Experiment::Rotation, point, [identified, None])?;
    }
    table.finish()
}

fn write_point(
    table: &mut TableWriter,
    experiment: Experiment,
    point: &Point,
    identified: [Option<f64>; 2],
) -> Result<(), OutputError> {
    let (position_mm, angle_deg) = match experiment {
        Experiment::Translation => (point.amount, 0.0),
        Experiment::Rotation => (0.0, point.amount),
    };
    table.text(&experiment.number().to_string());
    table.number(position_mm);
    table.number(angle_deg);
    table.text(point.paper.status.as_str());
    table.optional(point.paper.gamma_rad.map(f64::to_degrees));
    table.optional(point.paper.x_a_m.map(|x_a_m| x_a_m * 1e3));
    table.optional(point.exact.x_a_m.map(|x_a_m| x_a_m * 1e3));
    table.number(point.paper.solid_angle_sr);
    table.number(point.exact.solid_angle_sr);
    table.number(point.paper.i_o_a);
    table.number(point.exact.i_o_a);
    table.optional(identified[0]);
    table.optional(identified[1]);
    table.end_row()
}

// The virtual bench.

/// Longest free motion, seconds.
const MAX_S: f64 = 3600.0;

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum WithinName {
    /// Only in parameters that a calibration has
    Family,
    /// In these, and in what no calibration describes
    Richer,
}

impl From<WithinName> for Within {
    fn from(name: WithinName) -> Self {
        match name {
            WithinName::Family => Self::Family,
            WithinName::Richer => Self::Richer,
        }
    }
}

/// Draws one head from the tolerances of a scene, and simulates what is measured on it.
///
/// The folder gets scene.toml, the scene with a [tolerance], and, for `calibrate`: known.csv, poses by an instrument; known_own.csv, other poses in
/// frames of its own; pivot.csv, the tip of the tool in a cone; stage.csv, steps along a line; rest.csv, returns to one
/// stop; free.csv, free motion without poses; if the scene has a [front_end], free.mcap, a capture of it, and
/// tracked.csv, its poses by an instrument with frames and a clock of its own. For judging the result: test.csv, exact poses and single frames, and test_quiet.csv, means of 100 frames at the same.
/// The folder truth/ has the true pose of every row, and truth.toml all parameters as they are. Nothing else does, but
/// for the capture: as any of a simulated board it holds its true poses.
///
/// Tables have the noise of [noise], or else of the [front_end]. All rows but those of free.mcap have every spot on
/// its detector. Nothing of this is measured.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  slitpose bench wide --output head-7\n  slitpose calibrate head-7/scene.toml --known head-7/known.csv --output head-7.toml\n  slitpose solve head-7/scene.toml --currents head-7/test.csv --calibration head-7.toml"
)]
pub(super) struct BenchArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Make this folder with the tables
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Seed of the head and of all errors
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// What the head deviates in
    #[arg(long, value_enum, default_value = "family")]
    within: WithinName,
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

pub(super) fn bench(args: &BenchArgs) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let settings = BenchSettings {
        seed: args.seed,
        poses: args.poses as usize,
        free_s: args.duration,
        instrument: [args.instrument_um * 1e-6, args.instrument_urad * 1e-6],
    };
    let head = DrawnHead::draw(&file, args.within.into(), args.seed)?;
    let session = Session::of(&head, &settings)?;
    write(&args.output, &head, &session)?;
    for table in &session.tables {
        talk(format_args!("{:>15} {:>6} rows: {}", format!("{}.csv", table.name), table.len(), table.about));
    }
    if file.front_end.is_some() {
        capture(args, &head, &session)?;
        talk(format_args!("{:>15} a capture of the free motion", "free.mcap"));
        talk(format_args!("{:>15} the same motion by the instrument's own clock, in its own frames", "tracked.csv"));
    }
    let folder = args.output.display();
    talk(format_args!("wrote {folder}: a head of {} parameters, truth in {folder}/truth", head.parameters.len()));
    Ok(Outcome::Done)
}

/// Records the free motion as a board would, whose host knows the head by its scene alone.
fn capture(args: &BenchArgs, head: &DrawnHead, session: &Session) -> Result<(), CommandError> {
    let simulated = head.simulated();
    let frame_s = front_end::configuration(&simulated)?.schedule.frame_rate_hz().recip();
    let trajectory = Trajectory::through(session.path.clone());
    let board = SimulatedBoard::with_light(0, &simulated, head.light()?.into(), trajectory, args.seed)?;
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

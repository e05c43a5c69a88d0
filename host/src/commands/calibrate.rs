//! `slitpose calibrate`: from measurements on a head to its parameters.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use clap::ValueEnum;
use slitpose_calibration::{Calibration, CellValidity, Head, Progress as Step, Request, Validity, calibrate, validity};
use slitpose_design::report::{Folder, calibration_report};

use super::options::{Jobs, number, open_scene};
use super::{CommandError, Outcome, interrupt, options, talk};
use crate::live::Calibrate;
use crate::platform::go_behind;
use crate::terminal::{Amount, Progress};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{Output, Replace};
use slitpose_model::Tier;
use slitpose_tracking::frame::View;
use slitpose_tracking::measurements::Measurements;
use slitpose_tracking::solving::{RowSolver, STREAM_TOLERANCE};
use slitpose_tracking::tip;

/// Finds the parameters of a real head from measurements on it.
///
/// The scene says what the designer wanted, its [tolerance] how far the parts may be from that. Give poses that
/// another instrument measured with --known, readings of free motion with --free, or motions that need no
/// instrument: --pivot, the tip of the tool in a cone; --stage, known steps along a line; --rest, returns to one
/// stop. Any mix of them is adjusted together. Columns in: those of `solve`, for --known also those of a pose, for
/// --stage step_mm; frames, the number of frames averaged in a row, and time_s, its instant, by which a drift of the light
/// is followed, may be among them.
///
/// The result is a file for --calibration of other commands. What the data leave open is named on standard error.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose calibrate head.toml --known poses.csv --output head-7.toml\n  slitpose solve head.toml --currents readings.csv --calibration head-7.toml"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene; with --check or --tip, a calibration
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Find out from these readings whether the calibration still holds: a capture, or a table as for --free
    #[arg(long, value_name = "FILE", conflicts_with_all = ["tip", "known", "free", "pivot", "stage", "rest", "start", "output", "report"])]
    check: Option<String>,
    /// Find the tip of the tool by the calibration, from readings as for --pivot; the result is a file for --tip of
    /// other commands
    #[arg(long, value_name = "FILE", conflicts_with_all = ["known", "free", "pivot", "stage", "rest", "start", "report"])]
    tip: Option<String>,
    /// Readings at poses that another instrument measured
    #[arg(long, value_name = "CSV")]
    known: Vec<String>,
    /// Readings of free motion
    #[arg(long, value_name = "FILE")]
    free: Vec<String>,
    /// Readings while one point of the tool rests in a cone and the tool turns about it
    #[arg(long, value_name = "FILE")]
    pivot: Vec<String>,
    /// Readings at known steps along a line, the tool not turning
    #[arg(long, value_name = "CSV")]
    stage: Vec<String>,
    /// Readings of several returns to one pose
    #[arg(long, value_name = "FILE")]
    rest: Vec<String>,
    /// Frames of the instrument's poses: those of the scene, or its own at unknown fixed places
    #[arg(long, value_enum, default_value_t = FramesOf::Scene)]
    frames: FramesOf,
    /// Standard deviation of the instrument's positions, each axis
    #[arg(long, value_name = "UM", default_value_t = 2.0, value_parser = number(|sigma| sigma > 0.0 && sigma < 1e6, "give a number above zero, such as 2"))]
    known_sigma_um: f64,
    /// Standard deviation of the instrument's rotations, each axis
    #[arg(long, value_name = "URAD", default_value_t = 20.0, value_parser = number(|sigma| sigma > 0.0 && sigma < 1e6, "give a number above zero, such as 2"))]
    known_sigma_urad: f64,
    /// Write the calibration to this file
    #[arg(long, value_name = "FILE", required_unless_present = "check")]
    output: Option<PathBuf>,
    /// Make this folder with a page on the calibration
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Day of the measurements, to be kept in the result
    #[arg(long, value_name = "DATE")]
    date: Option<String>,
    /// Go on from an earlier result of the same scene
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FramesOf {
    Scene,
    Own,
}

impl Args {
    fn measurements(&self) -> Measurements {
        Measurements {
            known: self.known.clone(),
            free: self.free.clone(),
            pivot: self.pivot.clone(),
            stage: self.stage.clone(),
            rest: self.rest.clone(),
            has_own_frames: self.frames == FramesOf::Own,
            known_sigmas: Some([self.known_sigma_um / 1e6, self.known_sigma_urad / 1e6]),
        }
    }
}

fn say(remark: &str) {
    talk(format_args!("{remark}"));
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    args.jobs.apply();
    match (&args.check, &args.output) {
        (None, Some(output)) if let Some(readings) = &args.tip => find_tip(readings, Path::new(&args.scene), output),
        (Some(check), _) => still_holds(check, Path::new(&args.scene)),
        (None, Some(output)) => adjust(args, output),
        // The command line asks for one of them.
        (None, None) => Ok(Outcome::Failed),
    }
}

/// Change of all light, relative, that is worth a word.
const WORTH_LEVEL: f64 = 1e-3;

/// Whether the calibration at `path` still describes the head that gave `readings`.
fn still_holds(readings: &str, path: &Path) -> Result<Outcome, CommandError> {
    let calibration = Calibration::open(path)?;
    let file = calibration.scene_file()?;
    let scene = calibration.apply(&file)?;
    let data = Measurements { free: vec![readings.to_owned()], ..Measurements::default() }.read(&file, &mut say)?;
    let found = validity(&scene, data.noise.or(scene.noise), &data.rows)?;
    let mut text = format!("{:>4} {:>10} {:>12} {:>12} {:>14}\n", "cell", "light", "position", "rms", "chi2 without");
    for (number, cell) in found.cells.iter().enumerate() {
        let (light, position, rms) = (cell.relative * 100.0, cell.position_m * 1e6, cell.rms_position_m * 1e6);
        text += &format!("{number:>4} {light:>+8.3} % {position:>+9.2} µm {rms:>9.2} µm {:>14.2}\n", cell.without);
    }
    text += &format!("{:>4} {:>+8.3} %\n", "all", found.light_level * 100.0);
    let level = format!("{:+.1} %", found.light_level * 100.0);
    let (verdict, outcome) = match (found.is_valid, found.changed) {
        (None, _) => ("too few rows have a pose to tell; give 20 or more".to_owned(), Outcome::Failed),
        (Some(true), _) if found.light_level.abs() < WORTH_LEVEL => ("it still holds".to_owned(), Outcome::Done),
        (Some(true), _) => (format!("it still holds: all light {level}, for which poses allow"), Outcome::Done),
        (Some(false), _) if !found.allows_level => {
            let next = "look after the emitters and their supply, then calibrate again";
            (format!("stale: all light {level}, more than light_level_relative of the scene; {next}"), Outcome::Failed)
        }
        (Some(false), Some(cell)) => {
            let CellValidity { relative, position_m, .. } = found.cells[cell];
            let (light, position) = (relative * 100.0, position_m * 1e6);
            let what =
                format!("cell {cell} has changed by {position:+.1} µm on its detector and {light:+.2} % in light");
            (format!("stale: {what}; look after that cell, then calibrate again"), Outcome::Failed)
        }
        (Some(false), None) => ("stale: more than one cell has changed; calibrate again".to_owned(), Outcome::Failed),
    };
    let Validity { rows, chi2, .. } = found;
    text +=
        &format!("calibration {}: chi2 of {rows} rows is {chi2:.2} of its expectation; {verdict}\n", calibration.id);
    options::print(&text)?;
    Ok(outcome)
}

fn adjust(args: &Args, path: &Path) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let start = args.start.as_deref().map(Calibration::open).transpose()?;
    let data = args.measurements().read(&file, &mut say)?;
    let output = Output::open(Some(path))?;
    let folder = args.report.as_deref().map(Folder::create).transpose()?;
    let stop = interrupt()?;
    let mut progress = Progress::new("calibrate", 100, Amount::Of("%"));
    let mut tell = |step: Step| {
        let (done, text) = in_words(step);
        progress.step(done, &text);
        if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let request = Request { file: &file, data: &data, start: start.as_ref(), date: args.date.as_deref() };
    let found = calibrate(&request, &mut tell);
    drop(progress);
    let found = found?;
    output.write_text(found.calibration.source())?;
    for line in summary(&found.calibration, &file) {
        talk(format_args!("{line}"));
    }
    talk(format_args!("wrote {}", path.display()));
    if let (Some(folder), Some(directory)) = (&folder, &args.report) {
        folder.write(&calibration_report(&file, &found))?;
        talk(format_args!("wrote {}", directory.join("index.html").display()));
    }
    for remark in &found.remarks {
        talk(format_args!("{remark}"));
    }
    if found.is_interrupted {
        talk(format_args!("interrupted: this is the best so far; go on from it with --start {}", path.display()));
    }
    Ok(Outcome::Done)
}

/// How far the work is, in per cent and in words.
fn in_words(step: Step) -> (u64, String) {
    match step {
        Step::Starting => (0, "first poses".to_owned()),
        Step::Adjusting(round, of, fit) => {
            (5 + 65 * (round as u64 - 1) / of as u64, format!("adjusting, chi2 {fit:.2} of its expectation"))
        }
        Step::LeavingOut(block, of) => (70 + 30 * (block as u64 - 1) / of as u64, "rows left out in turn".to_owned()),
    }
}

/// What a user wants to know at once.
fn summary(calibration: &Calibration, file: &SceneFile) -> Vec<String> {
    let statistics = &calibration.statistics;
    let mut lines = vec![format!(
        "calibration {} of {} parameters from {} rows; chi2 {:.2} of its expectation, {} readings and {} poses left out \
         as outliers",
        calibration.id,
        calibration.parameters().len(),
        statistics.rows,
        statistics.chi2 / statistics.redundancy,
        statistics.readings_rejected,
        statistics.poses_rejected,
    )];
    if let (Some(metres), Some(radians)) = (statistics.held_out_m, statistics.held_out_rad) {
        lines.push(format!(
            "poses left out in turn miss the instrument's by {:.1} µm and {:.3} mrad rms, errors of the instrument included",
            metres * 1e6,
            radians * 1e3
        ));
    }
    let head = Head::calibrated(file.clone(), calibration.clone()).ok();
    let solver = head.and_then(|head| RowSolver::new(head, Tier::Exact { tolerance: STREAM_TOLERANCE }, false).ok());
    if let Some([metres, radians]) = solver.and_then(|solver| solver.known_to()) {
        lines.push(format!(
            "poses are known to {:.1} µm and {:.3} mrad rms over the workspace, apart from where its frames lie, and from noise",
            metres * 1e6,
            radians * 1e3
        ));
    }
    lines.extend(calibration.weak.iter().map(|weak| format!("open: {weak}")));
    lines
}

/// Finds the tip in `readings`, by the calibration at `path`, and writes a file for --tip to `output`.
fn find_tip(readings: &str, path: &Path, output: &Path) -> Result<Outcome, CommandError> {
    let calibration = Calibration::open(path)?;
    let file = calibration.scene_file()?;
    let measured = Measurements { pivot: vec![readings.to_owned()], ..Measurements::default() };
    let data = measured.read(&file, &mut say)?;
    let output = Output::file(output)?;
    let found = tip::find(&Head::calibrated(file, calibration)?, &data)?;
    let [x, y, z] = (found.tip_m * 1e3).to_array();
    let [sx, sy, sz] = std::array::from_fn(|k| found.covariance.col(k)[k].sqrt() * 1e6);
    let text = format!(
        "tip at {x:.4} {y:.4} {z:.4} mm in the tool frame; sigma {sx:.1} {sy:.1} {sz:.1} um; from {} rows, {} left out; {:.1} um \
         rms from the cone",
        found.rows,
        found.left_out,
        found.rms_m * 1e6
    );
    let target = output.target().to_owned();
    output.write_text(&View::with_tip(found.tip_m, found.covariance).to_text(&text))?;
    talk(format_args!("{text}"));
    talk(format_args!("wrote {target}"));
    Ok(Outcome::Done)
}

/// Calibrates the head of `file` from recordings, for a page. The result becomes a new file.
pub(super) fn from_recordings(file: Arc<SceneFile>) -> Calibrate {
    Arc::new(move |measurements, path, tell| {
        // The board that is followed goes first: this is the niceness of the thread, and of those that it begins.
        go_behind();
        // As the designer wrote it: the daemon's has the most probable parts.
        let file = SceneFile::parse(&file.origin, &file.source)?;
        let mut said = Vec::new();
        let data = measurements.read(&file, &mut |remark| said.push(remark.to_owned()))?;
        let output = Output::replacing(path, Replace::Nothing)?;
        let request = Request { file: &file, data: &data, start: None, date: None };
        let found = calibrate(&request, &mut |step| {
            let (done, text) = in_words(step);
            tell(done, text);
            ControlFlow::Continue(())
        })?;
        output.write_text(found.calibration.source())?;
        said.extend(summary(&found.calibration, &file));
        said.extend(found.remarks);
        Ok(said)
    })
}

//! What verbs share: options, arguments that take names, tables of rows, and words to the user.

use std::ffi::OsStr;
use std::fmt;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Context;
use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Arg, Args, Command, ValueEnum};
use glam::DVec3;
use slitpose_calibration::Head;
use slitpose_design::report::{Folder, Report};
use slitpose_head::scene_file::{SHIPPED, SceneFile};
use slitpose_head::simulator::TrajectoryKind;
use slitpose_head::table::{Output, Rows, TableError, TableReader, TableRows, TableWriter};
use slitpose_head::threads::{cores, in_order, limit};
use slitpose_model::{Pose, Tier};

pub(super) use slitpose_tracking::solving::STREAM_TOLERANCE as DEFAULT_TOLERANCE;

use super::{CommandError, Outcome};
use crate::sink::Format;
use crate::terminal::{self, Amount, Progress};
use slitpose_tracking::frame::View;
use slitpose_tracking::pipeline::{Counts, PipelineOptions};
use slitpose_tracking::solving::{Filter, NOT_CALIBRATED, Solving, TierChoice, head_by, is_tolerance};

/// A number of millimetres or degrees beyond this is a slip of units: 1000 km.
const MOST: f64 = 1e9;

/// Rows of a table that a core takes at a time.
const ROWS: usize = 512;

/// Unreadable rows of a table that are named one by one.
const MAX_NAMED: u64 = 20;

/// Status of a row of a table in which a field is no number, or none that its column can mean.
pub(super) const UNREADABLE: &str = "unreadable";

/// How much works at once.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct Jobs {
    /// Work on so many cores; on all if not given
    #[arg(long, value_name = "N")]
    jobs: Option<NonZero<usize>>,
}

impl Jobs {
    /// Limits all that works at once in this process; returns how many threads work.
    pub(super) fn apply(self) -> NonZero<usize> {
        self.jobs.into_iter().for_each(limit);
        cores()
    }

    /// Finishes `table` with what `work` makes of the rows of `reader`, in their order. `name` is that of the progress line,
    /// which is drawn unless the table goes to a terminal. `work` returns the faults of rows that are [`UNREADABLE`]; they
    /// are written to standard error, and the data count as damaged.
    pub(super) fn table(
        self,
        name: &'static str,
        reader: &mut TableReader,
        mut table: TableWriter,
        work: impl Fn(&Rows, &mut TableRows) -> Result<Vec<TableError>, CommandError> + Sync,
    ) -> Result<Outcome, CommandError> {
        let length = reader.length().filter(|_| !table.is_terminal());
        let mut progress = length.map(|length| Progress::new(name, length, Amount::Bytes));
        let start = table.starting();
        let next = || {
            progress.iter_mut().for_each(|progress| progress.at(reader.position()));
            Ok::<_, CommandError>(Some(reader.next_rows(ROWS)?).filter(|rows| !rows.is_empty()))
        };
        let work = |rows: Rows| {
            let mut done = start();
            let end = work(&rows, &mut done);
            (done, end)
        };
        let mut unreadable = 0;
        in_order(self.apply(), next, work, |(done, faults)| {
            table.append(&done)?;
            for fault in faults? {
                unreadable += 1;
                if unreadable <= MAX_NAMED {
                    talk(format_args!("{fault}"));
                }
            }
            Ok::<_, CommandError>(())
        })?;
        table.finish()?;
        if unreadable == 0 {
            return Ok(Outcome::Done);
        }
        talk(format_args!("rows without values, with the status `{UNREADABLE}`: {unreadable}"));
        Ok(Outcome::DataLost)
    }
}

/// What the head is known by.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct CalibrationOption {
    /// Calibration of the head, as `slitpose calibrate` wrote it; or none: the head is as its scene says
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

impl CalibrationOption {
    pub(super) fn file(&self) -> Option<&Path> {
        self.calibration.as_deref().filter(|path| *path != NOT_CALIBRATED)
    }

    /// What was given: a file, or `none`.
    pub(super) fn given(&self) -> Option<&Path> {
        self.calibration.as_deref()
    }

    /// The head of `file` by the calibration given, else by its scene, with the tolerances if that has any.
    pub(super) fn head(&self, file: SceneFile) -> Result<Head, CommandError> {
        head_by(self.given(), file, |file| Ok(Head::as_scene_says(file)?))
    }

    /// The head of `file` by the calibration given, else as its scene says, whatever its tolerances.
    pub(super) fn head_as_drawn(&self, file: SceneFile) -> Result<Head, CommandError> {
        head_by(self.given(), file, |file| Ok(file.into()))
    }
}

/// Reads the scene of the file `argument`, or the shipped one of that name, and says what is doubtful in it.
pub(super) fn open_scene(argument: &str) -> Result<SceneFile, CommandError> {
    let file = SceneFile::open(argument)?;
    file.findings().iter().for_each(|finding| talk(format_args!("{finding}")));
    Ok(file)
}

/// Reads a number that `is_possible`, else gives `hint`.
pub(super) fn number(
    is_possible: fn(f64) -> bool,
    hint: &'static str,
) -> impl Fn(&str) -> Result<f64, &'static str> + Clone + Send + Sync {
    move |text| text.parse().ok().filter(|&number| is_possible(number)).ok_or(hint)
}

/// A pose as the command line gives it: millimetres, then a rotation vector in degrees.
pub(super) fn parse_pose(text: &str) -> Result<Pose, &'static str> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[tx, ty, tz, rx, ry, rz]) if numbers.iter().flatten().all(|number| number.abs() <= MOST) => {
            let degrees = DVec3::new(rx, ry, rz);
            Ok(Pose::from_vectors(DVec3::new(tx, ty, tz) * 1e-3, degrees * (std::f64::consts::PI / 180.0)))
        }
        _ => Err("give six numbers, tx,ty,tz in mm and rx,ry,rz in degrees, such as 1.5,0,-2,0,10,0"),
    }
}

/// Takes any text, and has shells complete some names.
#[derive(Clone)]
pub(super) struct Names(pub(super) Vec<String>);

impl TypedValueParser for Names {
    type Value = String;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.0.iter().map(PossibleValue::new)))
    }
}

/// A scene file, or the name of a shipped scene.
pub(super) fn scenes() -> Names {
    Names(SHIPPED.iter().map(|shipped| shipped.name.to_owned()).collect())
}

/// The path of a port, the number of a board, or a name that stands for boards.
pub(super) fn devices() -> Names {
    Names(["auto", "sim"].map(str::to_owned).to_vec())
}

/// A table of poses, or the name of a motion.
pub(super) fn motions() -> Names {
    Names(TrajectoryKind::NAMED.map(|(name, _)| name.to_owned()).to_vec())
}

/// How exactly the optics are evaluated.
#[derive(Args, Clone, Copy, Debug, Default)]
pub(super) struct TierOptions {
    /// Equations as printed in the source paper, or integrated over the spot
    #[arg(long, value_enum)]
    tier: Option<TierName>,
    /// Relative error of the exact tier's integrals; given alone it means the exact tier
    #[arg(long, value_name = "T", value_parser = tolerance())]
    tolerance: Option<f64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TierName {
    /// Equations (1) to (6) of De La Cruz et al. 2018
    Paper,
    /// Integrated over the spot
    Exact,
}

impl TierOptions {
    fn choice(self) -> TierChoice {
        match (self.tier, self.tolerance) {
            (Some(TierName::Paper), _) => TierChoice::Paper,
            (None, None) => TierChoice::Usual,
            (_, tolerance) => TierChoice::Exact(tolerance),
        }
    }

    /// The tier asked for; exact to `default_tolerance` if none is.
    pub(super) fn tier(self, default_tolerance: f64) -> Tier {
        self.choice().tier(default_tolerance)
    }
}

fn tolerance() -> impl Fn(&str) -> Result<f64, &'static str> + Clone + Send + Sync {
    number(is_tolerance, "give a number between 0 and 1, such as 1e-10")
}

/// A frequency in Hz, with its unit, which may be left out; `None`: it is none.
pub(super) fn parse_frequency(text: &str) -> Option<f64> {
    let number = |text: &str, unit: f64| text.trim().parse::<f64>().ok().map(|number| number * unit);
    match (text.strip_suffix("kHz"), text.strip_suffix("Hz")) {
        (Some(text), _) => number(text, 1e3),
        (None, text_hz) => number(text_hz.unwrap_or(text), 1.0),
    }
}

/// A duration such as `10s`, `500ms` or `2m`.
pub(super) fn parse_duration(text: &str) -> Result<f64, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if duration > Duration::ZERO => Ok(duration.as_secs_f64()),
        Ok(_) => Err("give more than nothing, such as 10s".to_owned()),
        Err(error) => Err(format!("{error}; give a duration such as 10s, 500ms or 2m")),
    }
}

fn parse_filter(text: &str) -> Result<Filter, String> {
    Ok(Filter(if text == "off" { None } else { Some(parse_duration(text)?) }))
}

/// How scans are solved.
#[derive(Args, Clone, Copy, Debug, Default)]
struct SolvingOptions {
    /// Also estimate each pose from many scans, by a parabola through about this long, such as 5ms;
    /// or off
    #[arg(long, value_name = "TIME", value_parser = parse_filter)]
    filter: Option<Filter>,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    without_clipped: bool,
    /// Take emitters for as bright as scene or calibration says; else each scan finds how bright all are, and those of a
    /// calibrated head may drift apart
    #[arg(long)]
    known_light: bool,
    #[command(flatten)]
    tier: TierOptions,
}

/// When a stream of poses ends, how it is written and how it is solved.
#[derive(clap::Args, Debug, Default)]
pub(super) struct PoseOptions {
    /// End after this much time of the board's clock, such as 10s; else at the end of the data, or at an interrupt
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) duration: Option<f64>,
    /// How poses are written
    #[arg(long, value_enum)]
    pub(super) format: Option<Format>,
    #[command(flatten)]
    solving: SolvingOptions,
    #[command(flatten)]
    pub(super) frame: FrameOptions,
}

/// The frame and the point of the tool that poses are given in.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct FrameOptions {
    /// Give poses, velocities and truth in the frame of this file, or of this name in slitpose/frames of the user's
    /// configuration; base is the head's own. Captures stay in that
    #[arg(long, value_name = "FILE|NAME")]
    frame: Option<String>,
    /// Give them at this point of the tool: x,y,z in mm in the tool frame, or a file that `calibrate --tip` wrote, whose
    /// uncertainty is then part of sigma
    #[arg(long, value_name = "X,Y,Z|FILE", allow_hyphen_values = true)]
    tip: Option<String>,
}

impl FrameOptions {
    /// The frame asked for, if it is not the head's.
    pub(super) fn view(&self) -> Result<Option<&'static View>, CommandError> {
        Ok(View::open(self.frame.as_deref(), self.tip.as_deref())?)
    }
}

impl PoseOptions {
    /// The format to write in; `live` tells whether somebody looks.
    pub(super) fn format(&self, live: bool) -> Format {
        self.format.unwrap_or(if live { Format::Summary } else { Format::Ndjson })
    }

    pub(super) fn solving(&self) -> Solving {
        let SolvingOptions { filter, without_clipped, known_light, tier } = self.solving;
        Solving { filter, without_clipped, known_light, tier: tier.choice() }
    }

    pub(super) fn following(&self) -> PipelineOptions {
        self.solving().following_or(None)
    }

    pub(super) fn tier(&self) -> Tier {
        self.solving().tier_or(None)
    }

    /// An option that was given for poses found by this program.
    pub(super) fn for_this_program(&self) -> Option<&'static str> {
        let SolvingOptions { filter, without_clipped, known_light, .. } = self.solving;
        let is_filtered = matches!(filter, Some(Filter(Some(_))));
        [(is_filtered, "--filter"), (without_clipped, "--without-clipped"), (known_light, "--known-light")]
            .into_iter()
            .find_map(|(is_given, option)| is_given.then_some(option))
    }
}

pub(super) fn talk(text: fmt::Arguments<'_>) {
    terminal::say(text);
}

/// The flag that is set when the user interrupts: see [`flag`](slitpose_head::interrupt::flag).
pub(super) fn interrupt() -> Result<Arc<AtomicBool>, CommandError> {
    slitpose_head::interrupt::flag().context("cannot listen to signals")
}

/// Reports the losses of a stream on standard error, if there are any. A packet under way when the
/// end was `wanted` is not lost: it was not waited for.
pub(super) fn tell(name: &str, counts: &Counts, wanted: bool) -> Outcome {
    match counts.losses(wanted) {
        None => Outcome::Done,
        Some(losses) => {
            talk(format_args!("{name}: {losses}"));
            Outcome::DataLost
        }
    }
}

pub(super) fn print(text: &str) -> Result<Outcome, CommandError> {
    Output::open(None)?.write_text(text)?;
    Ok(Outcome::Done)
}

/// Writes `report` to `folder`; without one, prints it in short.
pub(super) fn publish(report: &Report, folder: Option<&Folder>) -> Result<(), CommandError> {
    match folder {
        Some(folder) => store(report, folder),
        None => {
            warn(report);
            Ok(Output::open(None)?.write_text(&report.in_short())?)
        }
    }
}

/// Writes `report` to `folder`, and says where.
pub(super) fn store(report: &Report, folder: &Folder) -> Result<(), CommandError> {
    warn(report);
    for path in folder.write(report)? {
        talk(format_args!("wrote {}", path.display()));
    }
    Ok(())
}

fn warn(report: &Report) {
    for warning in &report.warnings {
        talk(format_args!("{warning}"));
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum TextOrJson {
    Text,
    Json,
}

/// A rate of poses, per second; zero for every scan.
pub(super) fn poses_hz() -> impl Fn(&str) -> Result<f64, &'static str> + Clone + Send + Sync {
    let hint = "give a number of poses a second, such as 25, or 0 for every scan";
    number(|rate| rate >= 0.0 && rate.is_finite(), hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_six_finite_numbers() {
        let pose = parse_pose("1, 2,-3,0,0,90").unwrap();
        assert_eq!(pose.translation_m, DVec3::new(1e-3, 2e-3, -3e-3));
        assert!((pose.rotation_rad().z - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        for text in ["", "1,2,3", "1,2,3,4,5,6,7", "1,2,3,4,5,x", "nan,0,0,0,0,0", "inf,0,0,0,0,0", "1e12,0,0,0,0,0"] {
            assert!(parse_pose(text).is_err(), "`{text}` was taken for a pose");
        }
    }

    #[test]
    fn durations_have_a_unit_and_are_more_than_nothing() {
        assert_eq!((parse_duration("10s"), parse_duration("500ms")), (Ok(10.0), Ok(0.5)));
        assert!(["", "10", "0s", "-1s", "soon"].iter().all(|text| parse_duration(text).is_err()));
    }
}

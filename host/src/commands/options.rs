//! Options that several verbs share.

use std::num::NonZero;
use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec3;
use slitpose_calibration::Head;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{Rows, TableError, TableReader, TableRows, TableWriter};
use slitpose_head::threads::{cores, in_order, limit};
use slitpose_model::Pose;

use super::talk::talk;
use super::{CommandError, Outcome};
use crate::solving::{NOT_CALIBRATED, head_by};
pub(super) use crate::solving::{STREAM_TOLERANCE as DEFAULT_TOLERANCE, TierOptions};
use crate::terminal::{Amount, Progress};

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
        table: TableWriter,
        work: impl Fn(&Rows, &mut TableRows) -> Result<Vec<TableError>, CommandError> + Sync,
    ) -> Result<Outcome, CommandError> {
        let mut table = table.into_chunks();
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
#[derive(Args, Clone, Debug)]
pub(super) struct CalibrationOption {
    /// Calibration of the head, as `slitpose calibrate` wrote it; or none: the head is as its scene says
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

impl CalibrationOption {
    /// The file, if one was given.
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

/// A number that `is_possible`, else `hint`.
pub(super) fn parse_number(
    text: &str,
    is_possible: impl Fn(f64) -> bool,
    hint: &'static str,
) -> Result<f64, &'static str> {
    text.parse().ok().filter(|&number| is_possible(number)).ok_or(hint)
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
}

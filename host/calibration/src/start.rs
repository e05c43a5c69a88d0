//! Where the adjustment starts: poses by the uncalibrated head, and what follows from them for constraints.

use glam::DVec3;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{MIN_CELLS, MotionPrior, Pair, Photocurrents, Pose, Reading, Scene, SceneError, Solver, Start};

use crate::constraint;
use crate::data::{Constraint, Data, Group, Knowledge, Row, compose, inverse, values_of};
use crate::frames;
use crate::state::TIER;
use crate::{CalibrateError, Calibration, uncalibrated};

/// Share of a group's rows that must lead to a pose for the others to follow from home.
const MIN_WITH_POSE: f64 = 0.25;

/// Poses of all rows and unknowns of all groups. Rows without a pose stay at home.
pub(crate) struct Beginning {
    pub(crate) poses: Vec<Pose>,
    pub(crate) unknowns: Vec<Vec<f64>>,
}

/// The pose of each row by `scene` alone.
pub(crate) fn solved(scene: &Scene, rows: &[Row]) -> Result<Vec<Option<Pose>>, SceneError> {
    let solver = Solver::<f64>::new(scene, TIER)?;
    let solve = |row: &Row| {
        let reading = |pair: &Option<[f64; 2]>| match pair {
            Some([i_x1_a, i_x2_a]) => Reading::Light(Pair { i_x1_a: *i_x1_a, i_x2_a: *i_x2_a }),
            None => Reading::Missing,
        };
        let readings = Photocurrents { cells: row.readings.iter().map(reading).collect() };
        Some(solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST).estimate?.pose)
    };
    Ok(rows.iter().map(solve).collect())
}

/// The head by an earlier calibration, or by the tolerances of `file`.
pub(crate) fn known_so_far(file: &SceneFile, start: Option<&Calibration>) -> Result<Scene, CalibrateError> {
    Ok(match start {
        Some(start) => start.apply(file)?,
        None => uncalibrated(file)?,
    })
}

/// The poses of `rows`, which are of the file `name`, by the head as it is [`known_so_far`].
pub(crate) fn first_poses(
    scene: &Scene,
    start: Option<&Calibration>,
    name: &str,
    rows: &[Row],
) -> Result<Vec<Option<Pose>>, CalibrateError> {
    let poses = solved(scene, rows)?;
    let found = poses.iter().flatten().count();
    if (found as f64) >= MIN_WITH_POSE * rows.len() as f64 {
        return Ok(poses);
    }
    let (basis, next_step) = match start {
        Some(_) => {
            ("the calibration to start with", "check that it is of this head, and that the currents are in amperes")
        }
        None if scene.cells.len() < MIN_CELLS => (
            "the scene, which has fewer than three cells",
            "such a head can only be calibrated by poses in the frames of the scene (--known)",
        ),
        None => (
            "the scene and its tolerances",
            "calibrate by poses in the frames of the scene first (--known), or begin with an earlier calibration (--start); \
             if neither helps, check the scene, and that the currents are in amperes",
        ),
    };
    Err(CalibrateError::NoPoses(name.to_owned(), found, rows.len(), basis, next_step))
}

impl Beginning {
    /// From the data and the head as it is [`known_so_far`].
    pub(crate) fn of(scene: &Scene, start: Option<&Calibration>, data: &Data) -> Result<Self, CalibrateError> {
        let (mut poses, mut unknowns) = (vec![Pose::HOME; data.rows.len()], Vec::new());
        for group in &data.groups {
            let rows = &data.rows[group.rows.clone()];
            let places = &mut poses[group.rows.clone()];
            if group.constraint == Constraint::Known {
                for (place, row) in places.iter_mut().zip(rows) {
                    *place = row.reported().unwrap_or(Pose::HOME);
                }
                unknowns.push(vec![0.0; constraint::unknowns(group)]);
                continue;
            }
            let found = first_poses(scene, start, &group.file, rows)?;
            for (place, pose) in places.iter_mut().zip(&found) {
                *place = pose.unwrap_or(Pose::HOME);
            }
            let mut of_group = of_group(group, rows, &found, places)?;
            // The clock starts as it was found.
            of_group.resize(constraint::unknowns(group), 0.0);
            unknowns.push(of_group);
        }
        Ok(Self { poses, unknowns })
    }
}

fn of_group(
    group: &Group,
    rows: &[Row],
    found: &[Option<Pose>],
    places: &mut [Pose],
) -> Result<Vec<f64>, CalibrateError> {
    let weak = || CalibrateError::LittleMotion(group.file.clone());
    let solved: Vec<Pose> = found.iter().flatten().copied().collect();
    let first = *solved.first().ok_or_else(weak)?;
    Ok(match group.constraint {
        Constraint::Known | Constraint::Free => Vec::new(),
        Constraint::KnownInOwnFrames => {
            let pairs: Vec<_> =
                found.iter().zip(rows).filter_map(|(pose, row)| Some(((*pose)?, row.reported()?))).collect();
            let [x, y] = frames::align(&pairs).ok_or_else(weak)?;
            for (place, row) in places.iter_mut().zip(rows) {
                if let Some(report) = row.reported() {
                    *place = compose(&compose(&x, &report), &inverse(&y));
                }
            }
            [values_of(&x), values_of(&y)].concat()
        }
        Constraint::Pivot => {
            let [in_tool, in_base] = frames::pivot(&solved).ok_or_else(weak)?;
            [in_tool.to_array(), in_base.to_array()].concat()
        }
        Constraint::Rest => values_of(&first).to_vec(),
        Constraint::Stage => {
            let (mut mean, mut step, mut count) = (DVec3::ZERO, 0.0, 0.0);
            let moved = || {
                found.iter().zip(rows).filter_map(|(pose, row)| match row.knowledge {
                    Knowledge::Step(step_m) => Some(((*pose)?, step_m)),
                    _ => None,
                })
            };
            for (pose, step_m) in moved() {
                mean += pose.translation_m;
                step += step_m;
                count += 1.0;
            }
            (mean, step) = (mean / count, step / count);
            let direction: DVec3 = moved().map(|(pose, step_m)| (pose.translation_m - mean) * (step_m - step)).sum();
            let direction = direction.try_normalize().ok_or_else(weak)?;
            let start = Pose { translation_m: mean - direction * step, ..first };
            [values_of(&start).as_slice(), &direction.to_array()].concat()
        }
    })
}

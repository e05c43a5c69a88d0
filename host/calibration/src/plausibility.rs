//! Data that cannot be what they are said to be, found by the uncalibrated head before anything is adjusted.

use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Plan, Pose, SceneError};
use thiserror::Error;

use crate::data::{Constraint, Data, Group, inverse};
use crate::sensitivity::TIER;
use crate::start::solved;
use crate::uncalibrated;

/// Rows of a group that are looked at.
const SAMPLE: usize = 60;

/// Fewest rows that say anything.
const LEAST: usize = 8;

/// How much better a wrong reading of the data must fit than the right one.
const BETTER: f64 = 9.0;

/// Motion that is too little for a calibration: of translations, metres, and of rotations, radians, root mean square.
const LITTLE_M: f64 = 0.2e-3;
const LITTLE_RAD: f64 = 0.01;

/// Distance of poses by the uncalibrated head from the instrument's that tolerances do not explain, in units of
/// the tolerances' effect.
const CONTRADICTION: f64 = 25.0;

/// What is wrong with the data.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Implausible {
    /// A scene that cannot be computed.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A cell without light.
    #[error(
        "{file}: cell {cell} sees no light in {dark} of {rows} rows; check its emitter and its detector, or take it out of the scene"
    )]
    Dark {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
        /// Rows without light.
        dark: usize,
        /// All rows.
        rows: usize,
    },
    /// Both electrodes of a cell exchanged.
    #[error(
        "{file}: the electrodes of cell {cell} look exchanged: I_X1 behaves like I_X2; exchange the columns i_x1_{cell}_a and i_x2_{cell}_a, the wires, or turn the cell's x_axis"
    )]
    Electrodes {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
    },
    /// Columns of another cell.
    #[error("{file}: the currents of cell {cell} look like those of cell {like}; exchange the columns or the wires")]
    Cells {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
        /// The cell that it looks like.
        like: usize,
    },
    /// Lengths in another unit.
    #[error(
        "{file}: the tool moves {ratio:.3e} times as far as its currents say; tx_mm, ty_mm and tz_mm are millimetres, are these {unit}?"
    )]
    Lengths {
        /// The file.
        file: String,
        /// Reported over found.
        ratio: f64,
        /// What they look like.
        unit: &'static str,
    },
    /// Angles in another unit.
    #[error(
        "{file}: the tool turns {ratio:.3e} times as far as its currents say; rx_rad, ry_rad and rz_rad are radians, are these {unit}?"
    )]
    Angles {
        /// The file.
        file: String,
        /// Reported over found.
        ratio: f64,
        /// What they look like.
        unit: &'static str,
    },
    /// tool_from_base instead of base_from_tool.
    #[error(
        "{file}: the poses look inverted, the base seen from the tool; give the tool seen from the base (base_from_tool)"
    )]
    Inverted {
        /// The file.
        file: String,
    },
    /// Poses of other rows.
    #[error(
        "{file}: the poses look shifted against the currents by {rows} rows; pair each pose with the currents of its own instant"
    )]
    Shifted {
        /// The file.
        file: String,
        /// By so many rows.
        rows: i64,
    },
    /// Not this head.
    #[error(
        "{file}: the currents do not belong to this scene: poses by it miss the instrument's by {found_mm:.2} mm, tolerances explain {expected_mm:.2} mm; check the scene, the frames (--frames own if the instrument has its own) and the order of the cells"
    )]
    OtherScene {
        /// The file.
        file: String,
        /// Median distance, millimetres.
        found_mm: f64,
        /// What is usual, millimetres.
        expected_mm: f64,
    },
    /// More cells in the table than in the scene.
    #[error("{file} has currents of a cell {cells}, the scene has the cells 0 to {last}; give the scene of this head", last = cells - 1)]
    MoreCells {
        /// The file.
        file: String,
        /// Cells of the scene.
        cells: usize,
    },
    /// Currents that lead to no pose.
    #[error(
        "{file}: only {found} of {rows} rows lead to a pose by this scene and its tolerances; check the scene, and that the currents are in amperes"
    )]
    NoPoses {
        /// The file.
        file: String,
        /// Rows with a pose.
        found: usize,
        /// Rows that were tried.
        rows: usize,
    },
    /// A tool that hardly moves.
    #[error(
        "{file}: the tool moves by {found_mm:.3} mm and turns by {found_deg:.3} degrees (rms) only, too little to tell parts apart; use the whole workspace, a third of it at least"
    )]
    LittleMotion {
        /// The file.
        file: String,
        /// Root-mean-square translation, millimetres.
        found_mm: f64,
        /// Root-mean-square rotation, degrees.
        found_deg: f64,
    },
}

/// The middle of `values`; NaN of none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Refuses data that look like another thing than they are said to be.
///
/// # Errors
/// What they look like.
pub(crate) fn check(file: &SceneFile, data: &Data) -> Result<(), Implausible> {
    for group in &data.groups {
        dark(file, data, group)?;
        let rows: Vec<usize> = group.rows.clone().filter(|&row| data.rows[row].reported().is_some()).collect();
        if rows.len() < LEAST {
            continue;
        }
        let reports: Vec<Pose> = rows.iter().filter_map(|&row| data.rows[row].reported()).collect();
        if group.constraint == Constraint::Known {
            known(file, data, group, &rows, &reports)?;
        }
        little_motion(group, &reports)?;
    }
    Ok(())
}

fn dark(file: &SceneFile, data: &Data, group: &Group) -> Result<(), Implausible> {
    let rows = group.rows.len();
    for cell in 0..file.scene.cells.len() {
        let faint_a = file.scene.cells[cell].detector.faint_a;
        let is_lit = |row: usize| data.rows[row].readings[cell].is_some_and(|[a, b]| a + b > faint_a);
        let dark = group.rows.clone().filter(|&row| !is_lit(row)).count();
        if rows >= LEAST && 2 * dark > rows {
            return Err(Implausible::Dark { file: group.file.clone(), cell, dark, rows });
        }
    }
    Ok(())
}

/// Root-mean-square deviation of translations and rotation vectors from their means.
fn extent(poses: &[Pose]) -> [f64; 2] {
    let count = poses.len() as f64;
    let centre = poses.iter().map(|pose| pose.translation_m).sum::<glam::DVec3>() / count;
    let first = poses[poses.len() / 2].rotation;
    let turns: Vec<_> =
        poses.iter().map(|pose| slitpose_model::rotation_log(pose.rotation * first.conjugate())).collect();
    let mean = turns.iter().sum::<glam::DVec3>() / count;
    let t: f64 = poses.iter().map(|pose| (pose.translation_m - centre).length_squared()).sum();
    let r: f64 = turns.iter().map(|turn| (*turn - mean).length_squared()).sum();
    [(t / count).sqrt(), (r / count).sqrt()]
}

fn little_motion(group: &Group, reports: &[Pose]) -> Result<(), Implausible> {
    let [metres, radians] = extent(reports);
    if metres >= LITTLE_M && radians >= LITTLE_RAD {
        return Ok(());
    }
    let (found_mm, found_deg) = (metres * 1e3, radians.to_degrees());
    Err(Implausible::LittleMotion { file: group.file.clone(), found_mm, found_deg })
}

fn known(file: &SceneFile, data: &Data, group: &Group, rows: &[usize], reports: &[Pose]) -> Result<(), Implausible> {
    let scene = uncalibrated(file)?;
    let name = || group.file.clone();
    let every = rows.len().div_ceil(SAMPLE);
    let sample: Vec<usize> = (0..rows.len()).step_by(every).collect();
    let chosen: Vec<_> = sample.iter().map(|&k| data.rows[rows[k]].clone()).collect();
    let poses = solved(&scene, &chosen)?;
    let pairs: Vec<(usize, Pose)> = sample.iter().zip(&poses).filter_map(|(&k, pose)| Some((k, (*pose)?))).collect();
    // Distance of the found poses from some reading of the reports, a radian of rotation counted as 10 mm.
    let miss = |of: Reports<'_>| {
        let distance = |(k, pose): &(usize, Pose)| {
            let (t, r) = pose.displacement_from(&of(*k)?);
            Some(t.length().hypot(0.01 * r.length()))
        };
        median(pairs.iter().filter_map(distance).collect())
    };
    let as_given = miss(&|k| Some(reports[k]));
    let expected = 1e-3;
    let enough = 2 * pairs.len() > sample.len();
    if enough && as_given < 2.0 * expected {
        // Nothing is far off as a whole; a shift by a row or two of a slow motion may be, and single cells.
        shifted(group, rows.len(), &miss, reports, as_given)?;
        return Ok(());
    }
    if enough {
        let spread = |poses: Vec<Pose>| extent(&poses);
        let found = spread(pairs.iter().map(|(_, pose)| *pose).collect());
        let reported = spread(pairs.iter().map(|(k, _)| reports[*k]).collect());
        let [lengths, angles] = [reported[0] / found[0], reported[1] / found[1]];
        let near = |ratio: f64, wanted: f64| (ratio / wanted).ln().abs() < 0.4;
        for (wanted, unit) in [(1e-3, "metres"), (1e3, "micrometres"), (1.0 / 25.4, "inches")] {
            if near(lengths, wanted) {
                return Err(Implausible::Lengths { file: name(), ratio: lengths, unit });
            }
        }
        // Beyond half a turn rotation vectors come back in on the other side.
        if near(angles, 1.0_f64.to_radians()) {
            return Err(Implausible::Angles { file: name(), ratio: angles, unit: "revolutions of some kind" });
        }
        if angles > 4.0 && near(lengths, 1.0) {
            return Err(Implausible::Angles { file: name(), ratio: angles, unit: "degrees" });
        }
        if miss(&|k| Some(inverse(&reports[k]))) * BETTER.sqrt() < as_given {
            return Err(Implausible::Inverted { file: name() });
        }
        shifted(group, rows.len(), &miss, reports, as_given)?;
    }
    columns(file, &scene, data, group, rows, reports)?;
    // Fewer cells see no pose by themselves.
    if file.scene.cells.len() < 3 {
        return Ok(());
    }
    if !enough {
        return Err(Implausible::NoPoses { file: name(), found: pairs.len(), rows: sample.len() });
    }
    if as_given < CONTRADICTION * expected / 5.0 {
        return Ok(());
    }
    let (found_mm, expected_mm) = (as_given * 1e3, expected * 1e3);
    Err(Implausible::OtherScene { file: name(), found_mm, expected_mm })
}

/// Some reading of the reported poses, by row.
type Reports<'a> = &'a dyn Fn(usize) -> Option<Pose>;

/// Farthest shift that is looked for, rows.
const FARTHEST: i64 = 10;

fn shifted(
    group: &Group,
    rows: usize,
    miss: &dyn Fn(Reports<'_>) -> f64,
    reports: &[Pose],
    as_given: f64,
) -> Result<(), Implausible> {
    let at = |shift: i64| {
        let of_row = |k: usize| {
            let other = usize::try_from(k as i64 + shift).ok()?;
            (other < rows).then(|| reports[other])
        };
        miss(&of_row)
    };
    let best = (-FARTHEST..=FARTHEST).filter(|&shift| shift != 0).map(|shift| (at(shift), shift));
    match best.min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((found, shift)) if found * BETTER.sqrt() < as_given => {
            Err(Implausible::Shifted { file: group.file.clone(), rows: shift })
        }
        _ => Ok(()),
    }
}

/// Finds columns that belong to other electrodes or cells, by where the light is.
fn columns(
    file: &SceneFile,
    scene: &slitpose_model::Scene,
    data: &Data,
    group: &Group,
    rows: &[usize],
    reports: &[Pose],
) -> Result<(), Implausible> {
    let plan = Plan::<f64>::compile(scene, TIER)?;
    let cells = file.scene.cells.len();
    let share = |[first, second]: [f64; 2]| (second - first) / (first + second);
    // Mean square of the difference of shares between column `column` and what cell `cell` should see.
    let misfit = |column: usize, cell: usize, sign: f64| {
        let difference = |(&row, pose): (&usize, &Pose)| {
            let expected = plan.photocurrents(cell, pose);
            let expected = [expected.i_x1_a, expected.i_x2_a];
            let found = data.rows[row].readings[column]?;
            (expected[0] + expected[1] > 0.0).then(|| (sign * share(found) - share(expected)).powi(2))
        };
        median(rows.iter().zip(reports).filter_map(difference).collect())
    };
    for cell in 0..cells {
        let own = misfit(cell, cell, 1.0);
        if misfit(cell, cell, -1.0) * BETTER < own {
            return Err(Implausible::Electrodes { file: group.file.clone(), cell });
        }
        for like in (0..cells).filter(|&like| like != cell) {
            if misfit(cell, like, 1.0) * BETTER < own && misfit(like, cell, 1.0) * BETTER < misfit(like, like, 1.0) {
                return Err(Implausible::Cells { file: group.file.clone(), cell, like });
            }
        }
    }
    Ok(())
}

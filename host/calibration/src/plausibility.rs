//! Data that cannot be what they are said to be, found by the uncalibrated head before anything is adjusted.

use glam::DVec3;
use slitpose_model::{Cell, Plan, Pose, Scene, SceneError};
use thiserror::Error;

use crate::data::{Constraint, Data, Group, inverse};
use crate::sensitivity::TIER;

/// Rows of a group that are looked at.
const SAMPLE: usize = 60;

/// Fewest rows that say anything.
const LEAST: usize = 8;

/// How much nearer spots must be to where another reading of the data has them, for that to be what the data are.
const BETTER: f64 = 3.0;

/// Motion that is too little for a calibration: of translations, metres, and of rotations, radians, root mean square.
const LITTLE_M: f64 = 0.2e-3;
const LITTLE_RAD: f64 = 0.01;

/// Median distance of spots from where the uncalibrated head has them that tolerances do not explain, in units of the
/// tolerances' effect: of five heads whose parts are off by more than one kind of effect it was 0.3 to 1.3, by the scene of
/// another head 7.3 to 8.4.
const CONTRADICTION: f64 = 5.0;

/// Least standard deviation of a spot's place that is counted with, as a share of half the detector: what noise of weak
/// light leaves.
const LEAST_SIGMA: f64 = 1e-3;

/// Distance of a spot from the place of one that is not there, as a share of half the detector.
const NO_SPOT: f64 = 2.0;

/// Shifts of poses against currents that are looked for, rows.
const FARTHEST: i64 = 10;

/// What is wrong with the data.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Implausible {
    /// A scene that cannot be computed.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A cell without light, or with too much.
    #[error(
        "{file}: cell {cell} sees no light, or more than its saturation_a, in {dark} of {rows} rows; check that currents are in amperes, its emitter and its detector, or take it out of the scene"
    )]
    Dark {
        /// The file.
        file: String,
        /// The cell.
        cell: usize,
        /// Rows without a reading.
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
        "{file}: tx_mm, ty_mm and tz_mm are millimetres, but are these {unit}? Then the currents fit the poses {better:.0} times as well"
    )]
    Lengths {
        /// The file.
        file: String,
        /// What they look like.
        unit: &'static str,
        /// By how much smaller the spots' distances are then.
        better: f64,
    },
    /// Angles in degrees.
    #[error(
        "{file}: rx_rad, ry_rad and rz_rad are radians, but are these degrees? Then the currents fit the poses {better:.0} times as well"
    )]
    Degrees {
        /// The file.
        file: String,
        /// By how much smaller the spots' distances are then.
        better: f64,
    },
    /// Axes of another order, direction or handedness, or rotations of the other sense.
    #[error(
        "{file}: the axes of the poses look exchanged or reversed: the currents fit {better:.0} times as well if tx_mm, ty_mm, tz_mm become ({translation}), and rx_rad, ry_rad, rz_rad ({rotation})"
    )]
    Axes {
        /// The file.
        file: String,
        /// What the translations become.
        translation: String,
        /// What the rotation vectors become.
        rotation: String,
        /// By how much smaller the spots' distances are then.
        better: f64,
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
        "{file}: the currents do not belong to this scene: spots are {found_mm:.2} mm from where it has them at the instrument's poses, tolerances explain {expected_mm:.2} mm; check the scene and its [tolerance], the frames (--frames own if the instrument has its own) and the order of the cells"
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
    /// One measurement given twice.
    #[error(
        "{file}: row {row} repeats an earlier one, currents and pose, to the last digit; a measurement that stands twice counts twice: remove one"
    )]
    Repeated {
        /// The file.
        file: String,
        /// The row, from 1.
        row: usize,
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

/// Refuses data that look like another thing than they are said to be; `scene` is the head by its tolerances.
///
/// # Errors
/// What they look like.
pub(crate) fn check(scene: &Scene, data: &Data) -> Result<(), Implausible> {
    for group in &data.groups {
        dark(scene, data, group)?;
        let rows: Vec<usize> = group.rows.clone().filter(|&row| data.rows[row].reported().is_some()).collect();
        if rows.len() < LEAST {
            continue;
        }
        let reports: Vec<Pose> = rows.iter().filter_map(|&row| data.rows[row].reported()).collect();
        match group.constraint {
            Constraint::Known => known(scene, data, group, &rows, &reports)?,
            _ => little_motion(group, &reports)?,
        }
    }
    Ok(())
}

fn dark(scene: &Scene, data: &Data, group: &Group) -> Result<(), Implausible> {
    let rows = group.rows.len();
    for cell in 0..scene.cells.len() {
        let faint_a = scene.cells[cell].detector.faint_a;
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
    let centre = poses.iter().map(|pose| pose.translation_m).sum::<DVec3>() / count;
    let first = poses[poses.len() / 2].rotation;
    let turns: Vec<_> =
        poses.iter().map(|pose| slitpose_model::rotation_log(pose.rotation * first.conjugate())).collect();
    let mean = turns.iter().sum::<DVec3>() / count;
    let t: f64 = poses.iter().map(|pose| (pose.translation_m - centre).length_squared()).sum();
    let r: f64 = turns.iter().map(|turn| (*turn - mean).length_squared()).sum();
    [(t / count).sqrt(), (r / count).sqrt()]
}

fn little_motion(group: &Group, reports: &[Pose]) -> Result<(), Implausible> {
    let [metres, radians] = extent(reports);
    // What only a translation or only a rotation leaves open is named by the calibration.
    if metres >= LITTLE_M || radians >= LITTLE_RAD {
        return Ok(());
    }
    let (found_mm, found_deg) = (metres * 1e3, radians.to_degrees());
    Err(Implausible::LittleMotion { file: group.file.clone(), found_mm, found_deg })
}

/// Some reading of the reported poses, by row.
type Reports<'a> = &'a dyn Fn(usize) -> Option<Pose>;

/// Where the light is, of rows with reported poses.
struct Spots<'a> {
    /// The head by its tolerances.
    plan: Plan<f64>,
    /// How far tolerances move the spots of each cell, as a share of half the detector.
    sigmas: Vec<f64>,
    /// Currents of each row, by cell.
    readings: Vec<&'a [Option<[f64; 2]>]>,
}

impl Spots<'_> {
    /// Median distance of the spots of all cells from where `reports` have them, in standard deviations.
    fn miss(&self, reports: Reports<'_>) -> f64 {
        let every = self.readings.len().div_ceil(SAMPLE);
        let sample = (0..self.readings.len()).step_by(every);
        let poses = sample.filter_map(|row| Some((row, reports(row)?)));
        let cells = 0..self.sigmas.len();
        let distances = poses.flat_map(|(row, pose)| {
            let distance = move |cell: usize| Some(self.distance(row, cell, cell, &pose)?.abs() / self.sigmas[cell]);
            cells.clone().filter_map(distance)
        });
        median(distances.collect())
    }

    /// From where cell `cell` has its spot at `pose` to where the light in column `column` is, as a share of half the
    /// detector; `None` without a reading.
    fn distance(&self, row: usize, column: usize, cell: usize, pose: &Pose) -> Option<f64> {
        let found = share(self.readings[row][column]?);
        let expected = self.plan.photocurrents(cell, pose);
        let has_spot = expected.i_x1_a + expected.i_x2_a > 0.0;
        Some(if has_spot { found - share([expected.i_x1_a, expected.i_x2_a]) } else { NO_SPOT })
    }

    /// Median distance of the light in column `column` from the spot of cell `cell`, the electrodes exchanged if `sign`
    /// is −1.
    fn miss_of(&self, column: usize, cell: usize, sign: f64, reports: &[Pose]) -> f64 {
        let distance = |(row, pose): (usize, &Pose)| {
            let found = share(self.readings[row][column]?);
            let moved = (sign - 1.0) * found;
            Some((self.distance(row, column, cell, pose)? + moved).abs())
        };
        median(reports.iter().enumerate().filter_map(distance).collect())
    }
}

/// Place of the light, as a share of half the detector.
fn share([first, second]: [f64; 2]) -> f64 {
    (second - first) / (first + second)
}

/// Holds poses in frames of the scene against the places of the light, read as they are and in all ways that users got wrong.
fn known(scene: &Scene, data: &Data, group: &Group, rows: &[usize], reports: &[Pose]) -> Result<(), Implausible> {
    // What is off in both currents alike does not move a spot.
    let sigma = |cell: &Cell| (2.0 * cell.effects.model_error.position_m / cell.detector.length_m).max(LEAST_SIGMA);
    let spots = Spots {
        plan: Plan::compile(scene, TIER)?,
        sigmas: scene.cells.iter().map(sigma).collect(),
        readings: rows.iter().map(|&row| data.rows[row].readings.as_slice()).collect(),
    };
    let as_given = spots.miss(&|row| Some(reports[row]));
    let mut best = (as_given / BETTER, None);
    let mut try_reading = |reports: Reports<'_>, is: &dyn Fn(f64) -> Implausible| {
        let miss = spots.miss(reports);
        if miss < best.0 {
            best = (miss, Some(is(as_given / miss)));
        }
    };
    let name = || group.file.clone();
    for (scale, unit) in [(1e3, "metres"), (1e-3, "micrometres"), (25.4, "inches")] {
        let longer = |row: usize| Some(Pose { translation_m: reports[row].translation_m * scale, ..reports[row] });
        try_reading(&longer, &|better| Implausible::Lengths { file: name(), unit, better });
    }
    let in_degrees = |row: usize| {
        let pose = reports[row];
        Some(Pose::from_vectors(pose.translation_m, pose.rotation_rad().map(f64::to_radians)))
    };
    try_reading(&in_degrees, &|better| Implausible::Degrees { file: name(), better });
    try_reading(&|row| Some(inverse(&reports[row])), &|_| Implausible::Inverted { file: name() });
    for axes in Axes::others() {
        let read = |row: usize| {
            let Pose { translation_m, .. } = reports[row];
            Some(Pose::from_vectors(axes.turned(translation_m), axes.sense * axes.turned(reports[row].rotation_rad())))
        };
        try_reading(&read, &|better| Implausible::Axes {
            file: name(),
            translation: axes.named(["tx_mm", "ty_mm", "tz_mm"], 1.0),
            rotation: axes.named(["rx_rad", "ry_rad", "rz_rad"], axes.sense),
            better,
        });
    }
    let leaves_enough = |shift: &i64| *shift != 0 && reports.len() as u64 >= LEAST as u64 + shift.unsigned_abs();
    for shift in (-FARTHEST..=FARTHEST).filter(leaves_enough) {
        let of_row = |row: usize| reports.get(usize::try_from(row as i64 + shift).ok()?).copied();
        try_reading(&of_row, &|_| Implausible::Shifted { file: name(), rows: shift });
    }
    if let (_, Some(other)) = best {
        return Err(other);
    }
    columns(&spots, group, reports)?;
    little_motion(group, reports)?;
    if as_given < CONTRADICTION {
        return Ok(());
    }
    let half_m = scene.cells.iter().zip(&spots.sigmas).map(|(cell, sigma)| 0.5 * cell.detector.length_m * sigma);
    let expected_mm = median(half_m.collect()) * 1e3;
    Err(Implausible::OtherScene { file: name(), found_mm: as_given * expected_mm, expected_mm })
}

/// Axes of the scene in terms of those of the poses.
#[derive(Clone, Copy, PartialEq)]
struct Axes {
    from: [usize; 3],
    signs: [f64; 3],
    /// Of rotations: −1 if they are counted the other way round.
    sense: f64,
}

impl Axes {
    /// All but those that are right.
    fn others() -> impl Iterator<Item = Self> {
        const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [2, 1, 0]];
        const BOTH: [f64; 2] = [1.0, -1.0];
        let signs = BOTH.into_iter().flat_map(|x| BOTH.into_iter().flat_map(move |y| BOTH.map(|z| [x, y, z])));
        let senses = signs.flat_map(|signs| BOTH.map(|sense| (signs, sense)));
        let all = senses.flat_map(|(signs, sense)| ORDERS.map(|from| Self { from, signs, sense }));
        all.filter(|axes| *axes != Self { from: ORDERS[0], signs: [1.0; 3], sense: 1.0 })
    }

    fn turned(&self, vector: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| self.signs[axis] * vector[self.from[axis]]))
    }

    /// The components of the scene, by the names of the columns.
    fn named(&self, columns: [&str; 3], sense: f64) -> String {
        let component = |axis: usize| {
            let sign = if sense * self.signs[axis] < 0.0 { "−" } else { "" };
            format!("{sign}{}", columns[self.from[axis]])
        };
        [0, 1, 2].map(component).join(", ")
    }
}

/// Finds columns that belong to other electrodes or cells, by where the light is.
fn columns(spots: &Spots<'_>, group: &Group, reports: &[Pose]) -> Result<(), Implausible> {
    let cells = spots.sigmas.len();
    let miss = |column: usize, cell: usize| spots.miss_of(column, cell, 1.0, reports);
    for cell in 0..cells {
        let own = miss(cell, cell);
        if spots.miss_of(cell, cell, -1.0, reports) * BETTER < own {
            return Err(Implausible::Electrodes { file: group.file.clone(), cell });
        }
        for like in (0..cells).filter(|&like| like != cell) {
            if miss(cell, like) * BETTER < own && miss(like, cell) * BETTER < miss(like, like) {
                return Err(Implausible::Cells { file: group.file.clone(), cell, like });
            }
        }
    }
    Ok(())
}

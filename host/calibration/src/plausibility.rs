//! Data that cannot be what they are said to be, found by the uncalibrated head before anything is adjusted.

use glam::{DQuat, DVec3};
use slitpose_head::table::POSE_COLUMNS;
use slitpose_model::{Cell, CompiledScene, Pose, Scene, SceneError, rotation_exp};
use thiserror::Error;

use crate::data::{Constraint, Data, Group, Row, compose, inverse, median, middle, values_of};
use crate::reading::{TIER, share};
use crate::start::{align, solved};

/// What is wrong with the data of a file, which comes first.
#[derive(Clone, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum Implausible {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(
        "{0}: cell {1} sees no light, or more than its saturation_a, in {2} of {3} rows; check that currents are in amperes, its emitter and its detector, or take it out of the scene"
    )]
    Dark(String, usize, usize, usize),
    #[error(
        "{0}: the electrodes of cell {1} look exchanged: I_X1 behaves like I_X2; exchange the columns i_x1_{1}_a and i_x2_{1}_a, the wires, or turn the cell's x_axis"
    )]
    Electrodes(String, usize),
    #[error("{0}: the currents of cell {1} look like those of cell {2}; exchange the columns or the wires")]
    Cells(String, usize, usize),
    #[error("{0}: tx_mm, ty_mm and tz_mm are millimetres, but are these {1}? Then the data fit {2:.0} times as well")]
    Lengths(String, &'static str, f64),
    #[error(
        "{0}: rx_rad, ry_rad and rz_rad are rotation vectors in radians, but are these {1}? Then the data fit {2:.1} times as well; convert them"
    )]
    Rotations(String, String, f64),
    #[error(
        "{0}: {1} of {2} poses are not where the light has the tool: {3}; remove rows in which the instrument had lost its marker, check that each pose is of the same instant as its currents"
    )]
    Outliers(String, usize, usize, String),
    #[error(
        "{0}: the axes of the poses look exchanged or reversed: the data fit {3:.0} times as well if tx_mm, ty_mm, tz_mm become ({1}), and rx_rad, ry_rad, rz_rad ({2})"
    )]
    Axes(String, String, String, f64),
    #[error(
        "{0}: the poses look inverted, the base seen from the tool; give the tool seen from the base (base_from_tool)"
    )]
    Inverted(String),
    #[error(
        "{0}: the poses look shifted against the currents by {1} rows; pair each pose with the currents of its own instant"
    )]
    Shifted(String, i64),
    #[error(
        "{0}: the currents do not belong to this scene: spots are {1:.2} mm from where it has them at the instrument's poses, tolerances explain {2:.2} mm; check the scene and its [tolerance], the frames (--frames own if the instrument has its own) and the order of the cells"
    )]
    OtherScene(String, f64, f64),
    #[error("{0} has currents of a cell {1}, the scene has the cells 0 to {last}; give the scene of this head", last = .1 - 1)]
    MoreCells(String, usize),
    #[error(
        "{0}: row {1} repeats an earlier one, currents and pose, to the last digit; a measurement that stands twice counts twice: remove one"
    )]
    Repeated(String, usize),
    #[error(
        "{0}: the tool moves by {1:.3} mm and turns by {2:.3} degrees (rms) only, too little to tell parts apart; use the whole workspace, a third of it at least"
    )]
    LittleMotion(String, f64, f64),
}

/// Units that lengths may be in by mistake, and how many millimetres they have.
const UNITS: [(f64, &str); 4] = [(1e3, "metres"), (1e-3, "micrometres"), (25.4, "inches"), (10.0, "centimetres")];

/// Rows of a group that are looked at.
const SAMPLE: usize = 60;

const LEAST: usize = 8;

/// How much nearer spots must be to where another reading of the data has them, for that to be what the data are.
const BETTER: f64 = 3.0;

/// Factor of the distance by which a later way of reading has to be nearer than an earlier one.
const CLEARLY: f64 = 0.95;

/// The same by a head that has been adjusted to the poses as they are.
const BETTER_ADJUSTED: f64 = 1.5;

/// Distance from what was measured, in standard deviations, below which poses are right: where spots stay at the middle of a
/// detector, other readings may fit to the last digit.
const MIN_MISS: f64 = 0.1;

/// Motion that is too little for a calibration: of translations, metres, and of rotations, radians, root mean square.
const LITTLE_M: f64 = 0.2e-3;
const LITTLE_RAD: f64 = 0.01;

/// Median distance of spots from where the uncalibrated head has them that tolerances do not explain, in units of the
/// tolerances' effect: of five heads whose parts are off by more than one kind of effect it was 0.3 to 1.3, by the scene of
/// another head 7.3 to 8.4.
const CONTRADICTION: f64 = 5.0;

/// Least standard deviation of a spot's place that is counted with, as a share of half the detector: what noise of weak
/// light leaves.
const MIN_SIGMA: f64 = 1e-3;

/// Distance of a spot from the place of one that is not there, as a share of half the detector.
const NO_SPOT: f64 = 2.0;

/// Shifts of poses against currents that are looked for, rows.
const FARTHEST: i64 = 10;

/// The second greatest distance of the spots of one row, in the same units or those of the usual row, from which its pose is
/// a gross outlier. Of 200 sound rows of each of those five heads it was 2.8 at most; a pose that is 20 mm off has 15. What is
/// less the adjustment finds.
const GROSS: f64 = 5.0;

/// Share of a cell's usual light below which a pose has it dark: stray light leaves some hundredths.
const DARK: f64 = 0.1;

/// Share of a file's poses that may be gross outliers, and how many may be in a short one.
const MAX_GROSS: f64 = 0.1;
const MAX_GROSS_ROWS: usize = 3;

/// Distance from the middle of all translations, by the median distance, beyond which a pose does not enter an alignment.
const FAR_OFF: f64 = 4.0;

const NAMED: usize = 5;

/// Refuses data that look like another thing than they are said to be; `scene` is the head by its tolerances. Gives the rows
/// whose poses are gross outliers, and a remark on those of each file.
pub(crate) fn check(scene: &Scene, data: &Data) -> Result<(Vec<usize>, Vec<String>), Implausible> {
    let (mut outliers, mut remarks) = (Vec::new(), Vec::new());
    for group in &data.groups {
        dark(scene, data, group)?;
        let Some(spots) = Spots::of(scene, data, group, LEAST)? else { continue };
        let as_given = spots.check_reading(group)?;
        let gross = if as_given < CONTRADICTION { spots.gross(as_given) } else { Vec::new() };
        if !gross.is_empty() {
            let (count, rows, file) = (gross.len(), spots.reports.len(), group.file.clone());
            let named: Vec<String> = gross.iter().take(NAMED).map(|&row| spots.named(row)).collect();
            let named = named.join("; ") + if count > NAMED { "; and more" } else { "" };
            if count > MAX_GROSS_ROWS.max((MAX_GROSS * rows as f64) as usize) {
                return Err(Implausible::Outliers(file, count, rows, named));
            }
            remarks.push(format!(
                "{file}: {count} of {rows} poses left out, for the light has the tool elsewhere: {named}"
            ));
            outliers.extend(gross.iter().map(|&row| spots.rows[row]));
        }
        let kept = (0..spots.reports.len()).filter(|row| !gross.contains(row)).map(|row| spots.reports[row]);
        little_motion(group, &kept.collect::<Vec<_>>())?;
        if group.constraint == Constraint::Known {
            spots.check_scene(scene, &group.file, as_given)?;
        }
    }
    Ok((outliers, remarks))
}

/// Refuses poses in frames of the scene that look like another thing than they are said to be, of however few rows; `scene` is
/// the head by its tolerances.
pub fn check_poses(scene: &Scene, data: &Data) -> Result<(), Implausible> {
    for group in &data.groups {
        if group.rows.clone().all(|row| data.rows[row].readings.iter().all(Option::is_none)) {
            let rows = group.rows.len();
            return Err(Implausible::Dark(group.file.clone(), 0, rows, rows));
        }
        let Some(spots) = Spots::of(scene, data, group, LEAST.div_ceil(scene.cells.len()))? else { continue };
        let as_given = spots.check_reading(group)?;
        little_motion(group, &spots.reports)?;
        spots.check_scene(scene, &group.file, as_given)?;
    }
    Ok(())
}

/// What the poses of an adjusted head `scene` look like, which the currents contradict.
pub(crate) fn likely_reading(scene: &Scene, data: &Data) -> Result<Option<Implausible>, SceneError> {
    for group in &data.groups {
        let Some(spots) = Spots::of(scene, data, group, LEAST)? else { continue };
        if let (_, Some((better, other))) = best_reading(&group.file, &spots.reports, &|reports| spots.miss(reports))
            && better > BETTER_ADJUSTED
        {
            return Ok(Some(other));
        }
    }
    Ok(None)
}

fn dark(scene: &Scene, data: &Data, group: &Group) -> Result<(), Implausible> {
    let rows = group.rows.len();
    for cell in 0..scene.cells.len() {
        let faint_a = scene.cells[cell].detector.faint_a;
        let is_lit = |row: usize| data.rows[row].readings[cell].is_some_and(|[a, b]| a + b > faint_a);
        let dark = group.rows.clone().filter(|&row| !is_lit(row)).count();
        if rows >= LEAST && 2 * dark > rows {
            return Err(Implausible::Dark(group.file.clone(), cell, dark, rows));
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
    Err(Implausible::LittleMotion(group.file.clone(), metres * 1e3, radians.to_degrees()))
}

/// Some reading of the reported poses, by row.
pub type Reports<'a> = &'a dyn Fn(usize) -> Option<Pose>;

/// Where the light is, of rows with reported poses.
struct Spots<'a> {
    plan: CompiledScene<f64>,
    /// How far tolerances move the spots of each cell, as a share of half the detector.
    sigmas: Vec<f64>,
    /// The rows, and where they are in their file.
    rows: Vec<usize>,
    first: usize,
    /// Currents of each row, by cell.
    readings: Vec<&'a [Option<[f64; 2]>]>,
    reports: Vec<Pose>,
    /// Poses by the currents alone, of an instrument that has frames of its own.
    solved: Option<Vec<Option<Pose>>>,
}

impl<'a> Spots<'a> {
    /// Of the rows of `group` that have a reported pose; `None`: fewer than `least`.
    fn of(scene: &Scene, data: &'a Data, group: &Group, least: usize) -> Result<Option<Self>, SceneError> {
        let rows: Vec<usize> = group.rows.clone().filter(|&row| data.rows[row].reported().is_some()).collect();
        let has_own_frames = group.constraint == Constraint::KnownInOwnFrames;
        if rows.len() < least || !(has_own_frames || group.constraint == Constraint::Known) {
            return Ok(None);
        }
        // What is off in both currents alike does not move a spot.
        let sigma = |cell: &Cell| (2.0 * cell.effects.model_error.position_m / cell.detector.length_m).max(MIN_SIGMA);
        let of_rows: Vec<Row> =
            if has_own_frames { rows.iter().map(|&row| data.rows[row].clone()).collect() } else { Vec::new() };
        Ok(Some(Self {
            plan: CompiledScene::compile(scene, TIER)?,
            sigmas: scene.cells.iter().map(sigma).collect(),
            readings: rows.iter().map(|&row| data.rows[row].readings.as_slice()).collect(),
            reports: rows.iter().filter_map(|&row| data.rows[row].reported()).collect(),
            first: group.rows.start,
            solved: if has_own_frames { Some(solved(scene, &of_rows)?) } else { None },
            rows,
        }))
    }

    /// Where the frames of the instrument lie in those of the scene by `reports`.
    fn frames(&self, reports: Reports<'_>) -> Option<[Pose; 2]> {
        let Some(solved) = &self.solved else { return Some([Pose::HOME; 2]) };
        let every = solved.len().div_ceil(SAMPLE);
        let pairs = (0..solved.len()).step_by(every).filter_map(|row| Some((solved[row]?, reports(row)?)));
        let pairs: Vec<(Pose, Pose)> = pairs.collect();
        let reported: Vec<DVec3> = pairs.iter().map(|(_, report)| report.translation_m).collect();
        let centre = middle(&reported);
        let distances: Vec<f64> = pairs.iter().map(|(_, report)| report.translation_m.distance(centre)).collect();
        let most = FAR_OFF * median(distances.clone());
        let near = pairs.iter().zip(distances).filter(|(_, distance)| *distance <= most).map(|(pair, _)| *pair);
        align(&near.collect::<Vec<_>>())
    }

    /// Distances of the spots of all cells in `row` from where the tool at `pose` has them, in standard deviations.
    fn distances(&self, row: usize, pose: &Pose) -> impl Iterator<Item = f64> {
        (0..self.sigmas.len())
            .filter_map(move |cell| Some(self.distance(row, cell, cell, pose)?.abs() / self.sigmas[cell]))
    }

    /// Their median over a sample of rows by `reports`.
    fn miss(&self, reports: Reports<'_>) -> f64 {
        let Some([x, y]) = self.frames(reports) else { return f64::INFINITY };
        let every = self.readings.len().div_ceil(SAMPLE);
        let sample = (0..self.readings.len()).step_by(every);
        let poses = sample.filter_map(|row| Some((row, compose(&compose(&x, &reports(row)?), &inverse(&y)))));
        median(poses.flat_map(|(row, pose)| self.distances(row, &pose).collect::<Vec<_>>()).collect())
    }

    /// Rows whose pose is far from where the light has the tool, if the spots of all are `as_given` from their places.
    fn gross(&self, as_given: f64) -> Vec<usize> {
        let Some([x, y]) = self.frames(&|row| Some(self.reports[row])) else { return Vec::new() };
        let place = |report: &Pose| compose(&compose(&x, report), &inverse(&y));
        let poses: Vec<Pose> = self.reports.iter().map(place).collect();
        let cells = self.sigmas.len();
        // Expected light by what was measured; an emitter may be much brighter than the scene says.
        let light = |row: usize, cell: usize| {
            let [a, b] = self.readings[row][cell]?;
            Some(self.plan.photocurrents(cell, &poses[row]).total_a() / (a + b))
        };
        let usual: Vec<f64> =
            (0..cells).map(|cell| median((0..poses.len()).filter_map(|row| light(row, cell)).collect())).collect();
        let is_gross = |row: &usize| {
            // A translation along one axis moves the spots of a few cells; a single cell may err by itself.
            let mut distances: Vec<f64> = self.distances(*row, &poses[*row]).collect();
            distances.sort_by(f64::total_cmp);
            let second = distances.iter().rev().nth(1).copied().unwrap_or(0.0);
            let is_dark = |cell: &usize| light(*row, *cell).is_some_and(|light| light < DARK * usual[*cell]);
            second > GROSS * as_given.max(1.0) || 2 * (0..cells).filter(is_dark).count() >= cells
        };
        (0..poses.len()).filter(is_gross).collect()
    }

    /// The row with its number and the coordinate that is farthest from those of the other rows.
    fn named(&self, row: usize) -> String {
        let values: Vec<[f64; 6]> = self.reports.iter().map(values_of).collect();
        let off = |k: usize| {
            let centre = median(values.iter().map(|of| of[k]).collect());
            let usual = median(values.iter().map(|of| (of[k] - centre).abs()).collect());
            (values[row][k] - centre).abs() / usual.max(1e-9)
        };
        let k = (0..6).max_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0);
        let (value, usual) = (values[row][k], median(values.iter().map(|of| of[k]).collect()));
        let [value, usual] = if k < 3 { [value * 1e3, usual * 1e3] } else { [value, usual] };
        format!("row {}, {} {value:.4} (median {usual:.4})", self.rows[row] - self.first + 1, POSE_COLUMNS[k])
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
    fn miss_of(&self, column: usize, cell: usize, sign: f64) -> f64 {
        let distance = |(row, pose): (usize, &Pose)| {
            let found = share(self.readings[row][column]?);
            let moved = (sign - 1.0) * found;
            Some((self.distance(row, column, cell, pose)? + moved).abs())
        };
        median(self.reports.iter().enumerate().filter_map(distance).collect())
    }

    /// The median distance of the spots by the poses as they are; an error if other poses or columns agree far better.
    fn check_reading(&self, group: &Group) -> Result<f64, Implausible> {
        let (as_given, other) = best_reading(&group.file, &self.reports, &|reports| self.miss(reports));
        if let Some((_, other)) = other.filter(|(better, _)| *better > BETTER && as_given >= MIN_MISS) {
            return Err(other);
        }
        if group.constraint == Constraint::Known {
            columns(self, group)?;
        }
        Ok(as_given)
    }

    /// Refuses poses that are `as_given` standard deviations from where `scene` has the spots.
    fn check_scene(&self, scene: &Scene, file: &str, as_given: f64) -> Result<(), Implausible> {
        if as_given < CONTRADICTION {
            return Ok(());
        }
        let half_m = scene.cells.iter().zip(&self.sigmas).map(|(cell, sigma)| 0.5 * cell.detector.length_m * sigma);
        let expected_mm = median(half_m.collect()) * 1e3;
        Err(Implausible::OtherScene(file.to_owned(), as_given * expected_mm, expected_mm))
    }
}

/// What the poses `reports` of `file` look like, if some other way in which users write poses misses what was measured by a
/// third of theirs at most, and of `most`. `miss` is how far the poses that it is given are from what was measured.
pub fn other_reading(
    file: &str,
    reports: &[Pose],
    most: f64,
    miss: &dyn Fn(Reports<'_>) -> f64,
) -> Option<Implausible> {
    let (as_given, other) = best_reading(file, reports, miss);
    let (better, other) = other?;
    (as_given >= MIN_MISS && as_given / better < as_given.min(most) / BETTER).then_some(other)
}

/// `miss` of the poses `reports` as they are; and of all ways in which users write them otherwise the one that misses least, with
/// how many times less.
fn best_reading(file: &str, reports: &[Pose], miss: &dyn Fn(Reports<'_>) -> f64) -> (f64, Option<(f64, Implausible)>) {
    let as_given = miss(&|row| Some(reports[row]));
    let mut best = (as_given, None);
    let mut try_reading = |reports: Reports<'_>, is: &dyn Fn(f64) -> Implausible| {
        let found = miss(reports);
        // Axes that only turn an unknown frame are equally good: the first is the simplest.
        if found < CLEARLY * best.0 {
            best = (found, Some((as_given / found, is(as_given / found))));
        }
    };
    let name = || file.to_owned();
    for (scale, unit) in UNITS {
        let longer = |row: usize| Some(Pose { translation_m: reports[row].translation_m * scale, ..reports[row] });
        try_reading(&longer, &|better| Implausible::Lengths(name(), unit, better));
    }
    let mut try_rotations = |form: &str, rotation: &dyn Fn(DVec3) -> DQuat| {
        let turned = |row: usize| Some(Pose { rotation: rotation(reports[row].rotation_rad()), ..reports[row] });
        try_reading(&turned, &|better| Implausible::Rotations(name(), form.to_owned(), better));
    };
    try_rotations("degrees", &|r| rotation_exp(r.map(f64::to_radians)));
    let half = "vector parts of quaternions, sin(angle/2), or Gibbs vectors, tan(angle/2), times the axis";
    try_rotations(half, &|r| DQuat::from_xyzw(r.x, r.y, r.z, (1.0 - r.length_squared()).max(0.0).sqrt()).normalize());
    for order in ORDERS {
        let [a, b, c] = order.map(|axis| ["x", "y", "z"][axis]);
        let form =
            format!("Euler angles about {a}, {b}, {c} (each axis turned by those before; fixed axes: {c}, {b}, {a})");
        try_rotations(&form, &|r| {
            let about = |axis: usize| rotation_exp(DVec3::AXES[axis] * r[axis]);
            order.into_iter().map(about).product()
        });
    }
    try_reading(&|row| Some(inverse(&reports[row])), &|_| Implausible::Inverted(name()));
    for [t, r] in Axes::others() {
        let read = |row: usize| {
            let pose = reports[row];
            Some(Pose::from_vectors(t.turned(pose.translation_m), r.turned(pose.rotation_rad())))
        };
        try_reading(&read, &|better| Implausible::Axes(name(), t.named([0, 1, 2]), r.named([3, 4, 5]), better));
    }
    let leaves_enough = |shift: &i64| *shift != 0 && reports.len() as u64 >= LEAST as u64 + shift.unsigned_abs();
    for shift in (-FARTHEST..=FARTHEST).filter(leaves_enough) {
        let of_row = |row: usize| reports.get(usize::try_from(row as i64 + shift).ok()?).copied();
        try_reading(&of_row, &|_| Implausible::Shifted(name(), shift));
    }
    (as_given, best.1)
}

const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [2, 1, 0]];

/// Components of a vector in the scene in terms of those of the poses.
#[derive(Clone, Copy, PartialEq)]
struct Axes {
    from: [usize; 3],
    signs: [f64; 3],
}

impl Axes {
    const SAME: Self = Self { from: ORDERS[0], signs: [1.0; 3] };

    /// Of translations and rotation vectors, all but those that are right: both alike, rotations counted the other way
    /// round, too; and either alone.
    fn others() -> impl Iterator<Item = [Self; 2]> {
        const BOTH: [f64; 2] = [1.0, -1.0];
        let signs = BOTH.into_iter().flat_map(|x| BOTH.into_iter().flat_map(move |y| BOTH.map(|z| [x, y, z])));
        let all = signs.flat_map(|signs| ORDERS.map(|from| Self { from, signs }));
        let both =
            all.clone().flat_map(|axes| [[axes; 2], [axes, Self { signs: axes.signs.map(|sign| -sign), ..axes }]]);
        let either = all.flat_map(|axes| [[axes, Self::SAME], [Self::SAME, axes]]);
        both.chain(either).filter(|axes| *axes != [Self::SAME; 2])
    }

    fn turned(&self, vector: DVec3) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|axis| self.signs[axis] * vector[self.from[axis]]))
    }

    /// The components of the scene, by the names of the pose's `columns`.
    fn named(&self, columns: [usize; 3]) -> String {
        let component = |axis: usize| {
            format!("{}{}", if self.signs[axis] < 0.0 { "−" } else { "" }, POSE_COLUMNS[columns[self.from[axis]]])
        };
        [0, 1, 2].map(component).join(", ")
    }
}

/// Finds columns that belong to other electrodes or cells, by where the light is.
fn columns(spots: &Spots<'_>, group: &Group) -> Result<(), Implausible> {
    let cells = spots.sigmas.len();
    let miss = |column: usize, cell: usize| spots.miss_of(column, cell, 1.0);
    for cell in 0..cells {
        let own = miss(cell, cell);
        if spots.miss_of(cell, cell, -1.0) * BETTER < own {
            return Err(Implausible::Electrodes(group.file.clone(), cell));
        }
        for like in (0..cells).filter(|&like| like != cell) {
            if miss(cell, like) * BETTER < own && miss(like, cell) * BETTER < miss(like, like) {
                return Err(Implausible::Cells(group.file.clone(), cell, like));
            }
        }
    }
    Ok(())
}

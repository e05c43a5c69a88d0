//! Measurements on one head: rows of readings, what is known of the pose of each row, and what the poses of a file have in
//! common, as residuals.
//!
//! Each kind of file has unknowns of its own, shared by its rows:
//! * an instrument with frames of its own: base_from_reference and tool_from_marker, as translation and rotation vector;
//! * a pivot: the point in the tool and in the base;
//! * a stage: the pose at step zero, and the vector of travel per metre of step;
//! * a rest: the pose.

use glam::DVec3;
use slitpose_head::scene_file::Workspace;
use slitpose_model::{Noise, Pair, Photocurrents, Pose, Reading, rotation_exp};

/// Measurements from any number of files.
#[derive(Clone, Debug, Default)]
pub struct Data {
    /// All rows.
    pub rows: Vec<Row>,
    pub(crate) groups: Vec<Group>,
    /// Noise of one frame; `None`: that of the scene.
    pub noise: Option<Noise>,
}

/// The readings of all cells at one pose; by default of none, in a single frame.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name in its file.
    pub id: String,
    /// Currents of each cell above dark, amperes; `None`: not usable.
    pub readings: Vec<Option<[f64; 2]>>,
    /// Frames averaged in the row.
    pub frames: f64,
    /// First and last instant of those frames by the board's clock, seconds, if they are known.
    pub time_s: Option<[f64; 2]>,
    /// What is known of its pose.
    pub knowledge: Knowledge,
}

impl Default for Row {
    fn default() -> Self {
        Self { id: String::new(), readings: Vec::new(), frames: 1.0, time_s: None, knowledge: Knowledge::Nothing }
    }
}

impl Row {
    /// The readings, for a solver.
    pub fn photocurrents(&self) -> Photocurrents {
        let reading = |pair: &Option<[f64; 2]>| match *pair {
            Some([i_x1_a, i_x2_a]) => Reading::Light(Pair { i_x1_a, i_x2_a }),
            None => Reading::Missing,
        };
        Photocurrents { cells: self.readings.iter().map(reading).collect() }
    }

    /// The pose that the instrument reports.
    pub(crate) fn reported(&self) -> Option<Pose> {
        match self.knowledge {
            Knowledge::Reported(pose) => Some(pose),
            Knowledge::Step(_) | Knowledge::Nothing => None,
        }
    }
}

/// What is known of the pose of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Knowledge {
    /// The instrument's pose of its marker.
    Reported(Pose),
    /// The distance moved along the line of a stage, metres.
    Step(f64),
    /// No more than that it belongs to its group.
    Nothing,
}

/// What the poses of a file have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constraint {
    /// An instrument reports them in the frames of the scene.
    Known,
    /// An instrument reports them in a frame and of a marker of its own.
    KnownInOwnFrames,
    /// Nothing.
    Free,
    /// One point of the tool stays in place.
    Pivot,
    /// The tool moves along a line, and does not turn.
    Stage,
    /// They are the same.
    Rest,
}

/// One file.
#[derive(Clone, Debug)]
pub struct Group {
    /// Its name, for messages.
    pub file: String,
    /// What its poses have in common.
    pub constraint: Constraint,
    /// Standard deviation of a length: of the instrument, or of how well the constraint is kept; metres.
    pub sigma_m: f64,
    /// Standard deviation of an angle, radians.
    pub sigma_rad: f64,
    pub(crate) rows: std::ops::Range<usize>,
}

impl Data {
    /// Adds the rows of one file.
    pub fn add(&mut self, file: &str, constraint: Constraint, [sigma_m, sigma_rad]: [f64; 2], rows: Vec<Row>) {
        let start = self.rows.len();
        self.rows.extend(rows);
        let rows = start..self.rows.len();
        self.groups.push(Group { file: file.to_owned(), constraint, sigma_m, sigma_rad, rows });
    }

    /// All but the rows `left_out`, which ascend.
    pub(crate) fn without(&self, left_out: &[usize]) -> Self {
        let mut data = self.clone();
        let mut row = 0..;
        data.rows.retain(|_| row.next().is_some_and(|row| left_out.binary_search(&row).is_err()));
        let kept = |row: usize| row - left_out.partition_point(|&out| out < row);
        data.groups.iter_mut().for_each(|group| group.rows = kept(group.rows.start)..kept(group.rows.end));
        data
    }
}

/// a_from_c of a_from_b and b_from_c.
pub fn compose(a_from_b: &Pose, b_from_c: &Pose) -> Pose {
    Pose {
        rotation: (a_from_b.rotation * b_from_c.rotation).normalize(),
        translation_m: a_from_b.translation_m + a_from_b.rotation * b_from_c.translation_m,
    }
}

/// b_from_a of a_from_b.
pub fn inverse(a_from_b: &Pose) -> Pose {
    let rotation = a_from_b.rotation.conjugate();
    Pose { rotation, translation_m: -(rotation * a_from_b.translation_m) }
}

/// A pose from translation and rotation vector.
pub fn pose_of(values: &[f64]) -> Pose {
    let vector = |k: usize| DVec3::new(values[k], values[k + 1], values[k + 2]);
    Pose { rotation: rotation_exp(vector(3)), translation_m: vector(0) }
}

/// Translation and rotation vector of a pose.
pub fn values_of(pose: &Pose) -> [f64; 6] {
    let (t, r) = (pose.translation_m, pose.rotation_rad());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// Half extents of a workspace along the six coordinates of [`values_of`].
pub fn half_extents(workspace: &Workspace) -> [f64; 6] {
    let ([x, y, z], [a, b, c]) = (workspace.half_extent_m.to_array(), workspace.half_extent_rad.to_array());
    [x, y, z, a, b, c]
}

/// The median of `values`; NaN if there are none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

pub(crate) fn middle(points: &[DVec3]) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| median(points.iter().map(|point| point[axis]).collect())))
}

pub(crate) const RESIDUALS: usize = 7;

/// Number of unknowns of a group, in SI units.
pub(crate) fn unknowns(constraint: Constraint) -> usize {
    match constraint {
        Constraint::Known | Constraint::Free => 0,
        Constraint::KnownInOwnFrames => 12,
        Constraint::Pivot | Constraint::Rest => 6,
        Constraint::Stage => 9,
    }
}

/// Scale of an unknown of a group: what makes the normal equations well conditioned, metres or radians.
pub(crate) fn scale(constraint: Constraint, unknown: usize) -> f64 {
    match constraint {
        Constraint::Stage if unknown >= 6 => 1e-2,
        Constraint::Pivot => 1e-4,
        _ if unknown % 6 < 3 => 1e-4,
        _ => 1e-2,
    }
}

/// How little is known of an unknown beforehand, in its scale.
pub(crate) const VAGUE: f64 = 1e6;

/// Residuals of one row, normalised by the standard deviations of lengths and angles; those that are not used are zero.
pub(crate) fn residuals(
    constraint: Constraint,
    [length, angle]: [f64; 2],
    row: &Row,
    unknowns: &[f64],
    pose: &Pose,
) -> [f64; RESIDUALS] {
    let mut scale = 0.0;
    let (t, r) = match (constraint, row.knowledge) {
        (Constraint::Known, Knowledge::Reported(report)) => pose.displacement_from(&report),
        (Constraint::KnownInOwnFrames, Knowledge::Reported(report)) => {
            let [base_from_reference, tool_from_marker] = [pose_of(&unknowns[..6]), pose_of(&unknowns[6..12])];
            let expected = compose(&compose(&inverse(&base_from_reference), pose), &tool_from_marker);
            expected.displacement_from(&report)
        }
        (Constraint::Pivot, _) => {
            let [in_tool, in_base] = [0, 3].map(|k| DVec3::from_slice(&unknowns[k..k + 3]));
            (pose.rotation * in_tool + pose.translation_m - in_base, DVec3::ZERO)
        }
        (Constraint::Stage, Knowledge::Step(step_m)) => {
            let direction = DVec3::from_slice(&unknowns[6..9]);
            let (t, r) = pose.displacement_from(&pose_of(&unknowns[..6]));
            // The steps are true to scale; ten times better than anything else that is known of them.
            scale = (direction.length() - 1.0) / 1e-5;
            (t - direction * step_m, r)
        }
        (Constraint::Rest, _) => pose.displacement_from(&pose_of(&unknowns[..6])),
        _ => return [0.0; RESIDUALS],
    };
    let (t, r) = (t / length, r / angle);
    [t.x, t.y, t.z, r.x, r.y, r.z, scale]
}

/// Derivatives of [`residuals`] by the pose (δt, δθ), and by the unknowns.
pub(crate) fn derivatives(
    constraint: Constraint,
    sigmas: [f64; 2],
    row: &Row,
    unknowns: &[f64],
    pose: &Pose,
) -> ([[f64; 6]; RESIDUALS], Vec<[f64; RESIDUALS]>) {
    // Differences: residuals are smooth, and linear over a micrometre to ten digits.
    const STEP: f64 = 1e-6;
    let slope = |after: [f64; RESIDUALS], before: [f64; RESIDUALS]| {
        std::array::from_fn::<f64, RESIDUALS, _>(|k| (after[k] - before[k]) / (2.0 * STEP))
    };
    let mut by_pose = [[0.0; 6]; RESIDUALS];
    for axis in 0..6 {
        let moved = |step: f64| {
            let mut by = [DVec3::ZERO; 2];
            by[axis / 3][axis % 3] = step;
            residuals(constraint, sigmas, row, unknowns, &pose.perturbed(by[0], by[1]))
        };
        for (of_pose, value) in by_pose.iter_mut().zip(slope(moved(STEP), moved(-STEP))) {
            of_pose[axis] = value;
        }
    }
    let by_unknowns = (0..unknowns.len()).map(|k| {
        let moved = |step: f64| {
            let mut changed = unknowns.to_vec();
            changed[k] += step;
            residuals(constraint, sigmas, row, &changed, pose)
        };
        slope(moved(STEP), moved(-STEP))
    });
    (by_pose, by_unknowns.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMAS: [f64; 2] = [1e-6, 1e-5];

    fn left(constraint: Constraint, knowledge: Knowledge, unknowns: &[f64], pose: &Pose) -> f64 {
        let residuals = residuals(constraint, SIGMAS, &Row { knowledge, ..Row::default() }, unknowns, pose);
        residuals.iter().fold(0.0, |most, value| value.abs().max(most))
    }

    #[test]
    fn a_tool_that_turns_about_its_tip_keeps_a_pivot() {
        let (tip, cone) = (DVec3::new(2e-3, -1e-3, -80e-3), DVec3::new(0.5e-3, 0.2e-3, -79e-3));
        let unknowns = [tip.to_array(), cone.to_array()].concat();
        for turn in [DVec3::ZERO, DVec3::new(0.2, -0.1, 0.7)] {
            let rotation = rotation_exp(turn);
            let pose = Pose { rotation, translation_m: cone - rotation * tip };
            assert!(left(Constraint::Pivot, Knowledge::Nothing, &unknowns, &pose) < 1e-8);
            let slipped = Pose { translation_m: pose.translation_m + DVec3::Y * 3e-6, ..pose };
            assert!((left(Constraint::Pivot, Knowledge::Nothing, &unknowns, &slipped) - 3.0).abs() < 1e-8);
        }
    }

    #[test]
    fn a_tool_that_moves_along_a_line_keeps_a_stage() {
        let (start, line) = ([1e-3, 2e-3, -1e-3, 0.1, -0.2, 0.05], DVec3::new(0.6, 0.0, -0.8));
        let unknowns = [start.as_slice(), &line.to_array()].concat();
        let at = |way_m: f64| Pose { translation_m: pose_of(&start).translation_m + line * way_m, ..pose_of(&start) };
        for step_m in [0.0, 2e-3, -1e-3] {
            assert!(left(Constraint::Stage, Knowledge::Step(step_m), &unknowns, &at(step_m)) < 1e-8);
        }
        // One micrometre too far along the line: 0.8 σ along z. Steps are true: a line longer than one is none.
        assert!((left(Constraint::Stage, Knowledge::Step(1e-3), &unknowns, &at(1.001e-3)) - 0.8).abs() < 1e-6);
        let longer = [start.as_slice(), &(line * 1.0001).to_array()].concat();
        assert!(left(Constraint::Stage, Knowledge::Step(0.0), &longer, &at(0.0)) > 9.0);
    }
}

//! Measurements on one head: rows of readings, and what is known of the pose of each row.

use glam::DVec3;
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

/// The median of `values`; NaN if there are none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

pub(crate) fn middle(points: &[DVec3]) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|axis| median(points.iter().map(|point| point[axis]).collect())))
}

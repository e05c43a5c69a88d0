//! The health of a head, for programs and for people.

use std::fmt;

use schemars::JsonSchema;
use serde::{Serialize, Serializer};
use slitpose_head::finding::Finding;
use slitpose_model::{MAX_CELLS, Pose};

use super::Exchange;

/// The state of a cell, gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Less than a second of scans: not judged yet.
    Unknown,
    /// Not measured: its emitter is off.
    Off,
    /// Its electrodes are swapped, or it is swapped with another cell.
    Swapped,
    /// Its words have stopped changing.
    Stuck,
    /// A converter or the detector is at its limit.
    Saturated,
    /// No light although the pose predicts some.
    Dark,
    /// It contradicts the other cells.
    Excluded,
    /// Too little light, and no pose that predicts more.
    Faint,
    /// More light in the dark slot than at the start.
    StrayRising,
    /// More noise than the scene's front end specifies.
    Noisy,
    /// No fault.
    Ok,
}

impl fmt::Display for Verdict {
    /// The word used in tables and messages.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Shares of the scans of the last second, 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Shares {
    /// A converter or the detector was at its limit.
    pub saturated: f64,
    /// I_O − I_D was below `faint_a` of the scene.
    pub faint: f64,
    /// I_O − I_D was below `faint_a`, though the pose predicts at least twice that; share of the scans with a pose.
    pub dark: f64,
    /// An end of the detector cuts the spot according to the pose; share of the scans with a pose.
    pub clipped: f64,
    /// The solver left the cell out because it contradicts the others.
    pub excluded: f64,
    /// Not measured because the emitter was off.
    pub off: f64,
}

/// Scans since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct CellTotals {
    /// All scans.
    pub scans: u64,
    /// As in [`Shares`].
    pub saturated: u64,
    /// As in [`Shares`].
    pub faint: u64,
    /// As in [`Shares`]; only some scans, 128 per second, are checked.
    pub dark: u64,
    /// As in [`Shares`].
    pub excluded: u64,
    /// As in [`Shares`].
    pub off: u64,
}

/// The health of one cell over the last second and since the session began.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct CellHealth {
    /// Its number.
    pub cell: usize,
    /// Its gravest fault.
    pub verdict: Verdict,
    /// Shares of the scans of the last second.
    pub shares: Shares,
    /// Mean photocurrent I_O − I_D at nominal drive, amperes.
    pub light_a: Option<f64>,
    /// Measured photocurrent over that predicted by the pose, where that is at least twice `faint_a`.
    pub brightness: Option<f64>,
    /// What its emitter deviates from the common light level of the head, relative, as far as the tool's motion has told, and
    /// its standard deviation; `None`: taken for known.
    pub emitter_drift: Option<f64>,
    /// See [`Self::emitter_drift`].
    pub emitter_drift_sigma: Option<f64>,
    /// Current in the dark slot above the dark current of the scene, both electrodes, amperes. It includes
    /// the offset of the front end.
    pub stray_a: Option<f64>,
    /// Rise of `stray_a` since the first second of the session, amperes.
    pub stray_rise_a: Option<f64>,
    /// Standard deviation of a dark word, from differences of successive words, amperes.
    pub noise_a: Option<f64>,
    /// The same in steps of one conversion.
    pub noise_lsb: Option<f64>,
    /// The same by the scene's front end, amperes.
    pub promised_noise_a: Option<f64>,
    /// Scans since the session began.
    pub totals: CellTotals,
}

/// A fault of a head.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// The fault of one cell.
    Cell {
        /// The cell.
        cell: usize,
        /// Its state.
        verdict: Verdict,
    },
    /// Most cells see too little light for a pose.
    TooDark,
    /// Two electrodes or two cells are swapped.
    Exchange(Exchange),
    /// Most scans contradict the scene, and no single cell and no exchange explains them.
    Unexplained,
    /// The head has changed since it was calibrated.
    CalibrationStale {
        /// The cell that deviates most.
        cell: usize,
        /// Mean deviation of its light, metres.
        shift_m: f64,
        /// χ² by its expectation.
        chi2: f64,
    },
}

/// A fault, for programs, and its finding, for people.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Diagnosis {
    /// The fault.
    pub fault: Fault,
    /// The fault in a sentence, with the next step.
    #[serde(rename = "text", serialize_with = "serialize_line")]
    #[schemars(with = "String")]
    pub finding: Finding,
}

fn serialize_line<S: Serializer>(finding: &Finding, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(finding)
}

/// The health of a head over the last second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct HeadHealth {
    /// Share of scans that the scene does not explain: a misfit, no pose, or a cell left out as an outlier.
    pub unexplained: f64,
    /// The cells in the order of the scene.
    pub cells: Vec<CellHealth>,
    /// The faults found; empty if there are none.
    pub findings: Vec<Diagnosis>,
}

// A model's errors are the same at every visit of a place, so that a tool at rest shows one draw of them over and over. How
// large they are shows from place to place.

/// Distance and angle beyond which the tool is at another place: metres, radians. Model errors vary over such ways.
const APART: [f64; 2] = [1e-3, 0.05];

/// Places that are remembered, and for how long, seconds of device time.
const REMEMBERED: usize = 24;
const REMEMBERED_S: f64 = 60.0;

/// Places that a verdict needs, and the redundancy of each: that of a scan with five cells.
const MIN_PLACES: usize = 8;
const MIN_REDUNDANCY: f64 = 4.0;

#[derive(Clone, Debug)]
struct Place {
    anchor: Pose,
    seen_s: f64,
    chi2: f64,
    redundancy: f64,
    /// Of each cell: number, and sum of the deviations of the position of its light, metres.
    shifts: [(u32, f64); MAX_CELLS],
}

impl Place {
    fn new(anchor: Pose) -> Self {
        Self { anchor, seen_s: 0.0, chi2: 0.0, redundancy: 0.0, shifts: [(0, 0.0); MAX_CELLS] }
    }

    fn is_near(&self, pose: &Pose) -> bool {
        let (way, turn) = pose.displacement_from(&self.anchor);
        way.length() < APART[0] && turn.length() < APART[1]
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    /// The current one is last.
    places: Vec<Place>,
}

#[derive(Clone, Debug)]
pub(super) struct Residuals {
    /// χ² by its expectation, mean of the places.
    pub(super) chi2: f64,
    /// Mean deviation of the position of the light of each cell, metres.
    pub(super) shifts_m: [f64; MAX_CELLS],
}

impl Places {
    /// Adds χ² and redundancy of a scan at `time_s`, with the tool at `pose`.
    pub(super) fn add(&mut self, time_s: f64, pose: &Pose, chi2: f64, redundancy: f64) {
        if !self.places.last().is_some_and(|place| place.is_near(pose)) {
            // A place is seen anew at every visit.
            self.places.retain(|place| !place.is_near(pose) && (0.0..REMEMBERED_S).contains(&(time_s - place.seen_s)));
            if self.places.len() >= REMEMBERED {
                self.places.remove(0);
            }
            self.places.push(Place::new(*pose));
        }
        if let Some(place) = self.places.last_mut() {
            place.seen_s = time_s;
            place.chi2 += chi2;
            place.redundancy += redundancy;
        }
    }

    /// Adds how far the light of `cell` is from where it is expected at the current place.
    pub(super) fn add_shift(&mut self, cell: usize, shift_m: f64) {
        if let Some(place) = self.places.last_mut() {
            place.shifts[cell].0 += 1;
            place.shifts[cell].1 += shift_m;
        }
    }

    /// What all places say; `None`: the tool has been at too few.
    pub(super) fn residuals(&self, now_s: f64) -> Option<Residuals> {
        let is_told = |place: &&Place| place.redundancy >= MIN_REDUNDANCY && now_s - place.seen_s < REMEMBERED_S;
        let told: Vec<&Place> = self.places.iter().filter(is_told).collect();
        if told.len() < MIN_PLACES {
            return None;
        }
        let chi2 = told.iter().map(|place| place.chi2 / place.redundancy).sum::<f64>() / told.len() as f64;
        let shifts_m = std::array::from_fn(|cell| {
            let of_cell = told.iter().map(|place| place.shifts[cell]).filter(|(count, _)| *count > 0);
            let (count, sum) = of_cell.fold((0, 0.0), |(count, sum), (n, of)| (count + 1, sum + of / f64::from(n)));
            sum / f64::from(count.max(1))
        });
        Some(Residuals { chi2, shifts_m })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn at(x_mm: f64) -> Pose {
        Pose::from_vectors(DVec3::X * x_mm * 1e-3, DVec3::ZERO)
    }

    #[test]
    fn a_tool_at_rest_tells_nothing_however_long_and_going_to_and_fro_hardly_more() {
        let mut places = Places::default();
        for second in 0..50 {
            for _ in 0..100 {
                places.add(f64::from(second), &at(f64::from(second % 2) * 3.0), 60.0, 6.0);
            }
            assert!(places.residuals(f64::from(second)).is_none(), "{second}");
        }
    }

    #[test]
    fn each_place_counts_once_and_is_forgotten_after_a_minute() {
        let mut places = Places::default();
        // Nine places: one of them with ten times the residuals and a hundred times the scans.
        for k in 0..9 {
            let (scans, chi2) = if k == 4 { (1000, 60.0) } else { (10, 6.0) };
            for _ in 0..scans {
                places.add(f64::from(k), &at(2.0 * f64::from(k)), chi2, 6.0);
                places.add_shift(3, 9e-6);
            }
        }
        let found = places.residuals(9.0).unwrap();
        assert!((found.chi2 - 2.0).abs() < 1e-12 && (found.shifts_m[3] - 9e-6).abs() < 1e-12, "{found:?}");
        assert_eq!(found.shifts_m[2], 0.0);
        assert!(places.residuals(61.5).is_none(), "two of nine are too old");
    }
}

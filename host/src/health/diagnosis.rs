//! The health of a head, for programs and for people.

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use super::Exchange;
use slitpose_head::finding::Finding;

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

impl Verdict {
    /// The word used in tables and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Off => "off",
            Self::Swapped => "swapped",
            Self::Stuck => "stuck",
            Self::Saturated => "saturated",
            Self::Dark => "dark",
            Self::Excluded => "excluded",
            Self::Faint => "faint",
            Self::StrayRising => "stray_rising",
            Self::Noisy => "noisy",
            Self::Ok => "ok",
        }
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

//! The health of a head, for programs and for people.

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use super::Exchange;
use slitpose_head::finding::Finding;

/// The state of a cell, gravest cause first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Less than a second of scans: nothing can be said yet.
    Unknown,
    /// Not measured: its emitter is off.
    Off,
    /// Its electrodes, or it and another cell, are in each other's place.
    Swapped,
    /// Its words do not change any more.
    Stuck,
    /// A converter or the detector is at its limit.
    Saturated,
    /// No light where the pose says that there should be some.
    Dark,
    /// It contradicts the other cells.
    Excluded,
    /// Too little light, and no pose that says otherwise.
    Faint,
    /// More light in the dark slot than at the start.
    StrayRising,
    /// More noise than the front end promises.
    Noisy,
    /// None of these.
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
    /// I_O − I_D was under `faint_a` of the scene.
    pub faint: f64,
    /// Under `faint_a`, though the pose gives at least twice that; of the scans with a pose.
    pub dark: f64,
    /// An end of the detector cuts the spot, by the pose; of the scans with a pose.
    pub clipped: f64,
    /// The solver left the cell out because it contradicts the others.
    pub excluded: f64,
    /// Not measured, as the emitter was off.
    pub off: f64,
}

/// Scans since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct CellTotals {
    /// All.
    pub scans: u64,
    /// As in [`Shares`].
    pub saturated: u64,
    /// As in [`Shares`].
    pub faint: u64,
    /// As in [`Shares`]; only some scans, 128 a second, are looked at.
    pub dark: u64,
    /// As in [`Shares`].
    pub excluded: u64,
    /// As in [`Shares`].
    pub off: u64,
}

/// One cell: the last second, and what there was since the session began.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct CellHealth {
    /// Its number.
    pub cell: usize,
    /// The gravest of what is wrong with it.
    pub verdict: Verdict,
    /// Of the last second.
    pub shares: Shares,
    /// Mean photocurrent I_O − I_D at nominal drive, amperes.
    pub light_a: Option<f64>,
    /// Measured photocurrent over what the pose says, where it says at least twice `faint_a`.
    pub brightness: Option<f64>,
    /// Current in the dark slot above the dark current of the scene, both electrodes, amperes. The
    /// offset of the front end is in it.
    pub stray_a: Option<f64>,
    /// By how much that has risen since the first second of the session, amperes.
    pub stray_rise_a: Option<f64>,
    /// Standard deviation of a dark word by what it differs from the one before, amperes.
    pub noise_a: Option<f64>,
    /// The same in steps of one conversion.
    pub noise_lsb: Option<f64>,
    /// What it is by the scene's front end, amperes.
    pub promised_noise_a: Option<f64>,
    /// Since the session began.
    pub totals: CellTotals,
}

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// A cell, as its verdict says.
    Cell {
        /// Which cell.
        cell: usize,
        /// What.
        verdict: Verdict,
    },
    /// Most cells see too little light for a pose.
    TooDark,
    /// Something is in the place of something else.
    Exchange(Exchange),
    /// Most scans contradict the scene, and no single cell and no exchange explains them.
    Unexplained,
}

/// A fault, for programs, and the finding on it, for people.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Diagnosis {
    /// What.
    pub fault: Fault,
    /// In a sentence, with what to do next.
    #[serde(rename = "text", serialize_with = "serialize_line")]
    #[schemars(with = "String")]
    pub finding: Finding,
}

fn serialize_line<S: Serializer>(finding: &Finding, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(finding)
}

/// A head over the last second.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct HeadHealth {
    /// Share of scans that the scene does not explain: a misfit, no pose, or a cell left out as an outlier.
    pub unexplained: f64,
    /// In the order of the scene.
    pub cells: Vec<CellHealth>,
    /// Empty if all is well.
    pub findings: Vec<Diagnosis>,
}

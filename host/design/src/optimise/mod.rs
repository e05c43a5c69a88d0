//! The best head within bounds: `slitpose scene optimise`.
//!
//! A candidate is a scene text: [`Quantity`]s are set in the scene that the search began with, and what is evaluated is
//! what is printed. [`Search::run`] looks at candidates spread over the bounds, and goes on from the best of them by
//! Nelder and Mead's simplex (1965): limits make kinks, where derivatives lead nowhere.

use std::fmt;

mod quantity;
mod score;
mod search;

pub use quantity::{Free, Quantity};
pub use score::{Demand, Goal, Judge, Score};
pub use search::{Found, Search};

#[cfg(test)]
mod tests;

/// What a head has to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Share of the workspace in which all spots lie on their detectors.
    pub lit: f64,
    /// Between the tool's emitters and the slits, over the workspace, metres.
    pub clearance_m: f64,
    /// Between detectors, and between emitters, from centre line to centre line: metres.
    pub detector_pitch_m: f64,
    /// See [`Self::detector_pitch_m`].
    pub emitter_pitch_m: f64,
    /// Light of other emitters of a slot, as a share of a cell's own.
    pub crosstalk: f64,
    /// Share of the workspace in which all electrodes stay below full scale.
    pub in_scale: f64,
    /// Farthest point of a detector from the z axis, metres.
    pub radius_m: f64,
}

impl Default for Limits {
    /// Of the parts of the shipped scenes: an S3932 is 13 mm long and 5 mm wide in its housing, a CQY36N 3 mm.
    fn default() -> Self {
        Self {
            lit: 0.999,
            clearance_m: 1e-3,
            detector_pitch_m: 6e-3,
            emitter_pitch_m: 4e-3,
            crosstalk: 1e-3,
            in_scale: 0.995,
            radius_m: f64::INFINITY,
        }
    }
}

/// The limits by name. Those without a field of [`Limits`] hold for every head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "each other is a field of Limits")]
pub enum Limit {
    /// A frame gives a pose, everywhere in the workspace.
    Pose,
    Lit,
    Clearance,
    Radius,
    DetectorPitch,
    EmitterPitch,
    /// The board can do what the front end and the lighting ask for.
    Board,
    InScale,
    Crosstalk,
}

/// A limit that is not kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Which one.
    pub limit: Limit,
    /// By how much, where it is worst: the share of poses without a pose; millimetres; the factor by which a current or
    /// light is too large; 1 for [`Limit::Board`].
    pub worst: f64,
    /// What it adds to the violation that a search makes least: millimetres, or logarithms of ratios, summed over parts.
    violation: f64,
}

impl fmt::Display for Excess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worst = self.worst;
        match self.limit {
            Limit::Pose => write!(f, "{:.1} % of the workspace without a pose", 100.0 * worst),
            Limit::Lit => write!(f, "spots {worst:.2} mm beyond their detectors"),
            Limit::Clearance => write!(f, "tool and head {worst:.2} mm too near to each other"),
            Limit::Radius => write!(f, "detectors {worst:.2} mm too far out"),
            Limit::DetectorPitch => write!(f, "detectors {worst:.2} mm too near to each other"),
            Limit::EmitterPitch => write!(f, "emitters {worst:.2} mm too near to each other"),
            Limit::Board => write!(f, "more than the board can do in a frame"),
            Limit::InScale => write!(f, "currents {:.2} % above full scale", 100.0 * (worst - 1.0)),
            Limit::Crosstalk => write!(f, "light of a slot's other emitters {worst:.2} times what it may be"),
        }
    }
}

/// Notes that `limit` is passed by `worst`, which is worth `violation`; not if that is zero.
fn note(excesses: &mut Vec<Excess>, limit: Limit, violation: f64, worst: f64) {
    if violation <= 0.0 {
        return;
    }
    match excesses.iter_mut().find(|noted| noted.limit == limit) {
        Some(noted) => {
            noted.violation += violation;
            noted.worst = noted.worst.max(worst);
        }
        None => excesses.push(Excess { limit, worst, violation }),
    }
}

/// What a search makes least: zero if all limits are kept.
fn violation(excesses: &[Excess]) -> f64 {
    excesses.iter().map(|excess| excess.violation).sum()
}

//! From photocurrents to a pose.
//!
//! | step | file | method |
//! |---|---|---|
//! | readings that count | [`readings`] | limits of light and saturation |
//! | first pose | [`planes`] | Gauss–Newton on the planes that the positions of the light give |
//! | weights, whitened residuals | [`weights`] | covariance of a cell's two currents |
//! | linearised problem | [`normal_equations`], [`level`], [`twist`], [`step`] | least squares, Schur complement, Cholesky or QR |
//! | minimum | [`levenberg_marquardt`], [`kink`] | damped Gauss–Newton, minima where derivatives jump |
//! | one cell against all others | [`outlier`] | leave one out |
//! | is it the pose? | [`accept`] | χ² gate, singular values, external reliability |
//! | other poses with such currents | [`images`] | reflections, double points |
//! | on a microcontroller | [`compact`] | one short rule for all spots |
//! | nothing known | [`cold_start`] | all of the above, from many starts |
//! | pose expected | [`warm_start`] | the same from one start |
//! | frame after frame | [`tracker`], [`filter`] | prediction by a fading-memory polynomial |
//! | levels of single emitters | [`levels`] | Kalman filter of their deviations from the common level |
//! | velocity, smoothed pose | [`tracked`], [`motion`] | several Kalman filters, weighted by how well they predict |
//!
//! [`solver`] is the interface, [`compiled`] a scene made ready, [`outcome`] the answer, [`algebra`] the 6 × 6 linear
//! algebra.

mod accept;
mod algebra;
mod cold_start;
mod compact;
mod compiled;
mod filter;
#[cfg(test)]
pub(crate) mod fixture;
mod home;
mod images;
mod kink;
mod level;
mod levels;
mod levenberg_marquardt;
mod motion;
mod normal_equations;
mod outcome;
mod outlier;
mod planes;
mod readings;
mod solver;
mod step;
mod tracked;
mod tracker;
mod twist;
mod warm_start;
mod weights;

pub use compact::{BoardTracker, CompactError, CompactFrame, CompactPart};
pub use compiled::MIN_CELLS;
pub(crate) use levels::Observation;
pub use motion::{Filtered, NoTwist, TwistEstimate};
pub use outcome::{
    AXES, Cells, DegradedReason, Directions, Estimate, MAX_MEAN_MISFIT, MAX_MISFIT, Outcome, Solution, Verified,
};
pub use readings::{Photocurrents, Reading};
pub use solver::{Solver, Start};
pub use tracked::{Tracked, Tracker};
pub use tracker::PoseTracker;
pub use twist::MotionPrior;

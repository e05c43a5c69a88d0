//! Optics of emitter-slit-detector cells, and the pose of a tool that carries the emitters.
//!
//! Each cell is an infrared emitter on the tool, a slit in a mask on the base, and behind it a
//! one-dimensional position-sensitive detector whose two photocurrents tell where the light that
//! passes the slit falls, and how much. A [`Scene`] describes the cells; compiled to a [`Plan`] it
//! answers what each cell delivers at a [`Pose`] and how that changes with the pose.
//!
//! # Conventions
//! * SI units throughout: metres, radians, amperes, watts, seconds.
//! * Frame `base` holds slits and detectors, frame `tool` the emitters; both right-handed. A pose is
//!   `base_from_tool`: p_base = R·p_tool + t.
//! * A perturbation (δt, δθ) of a pose means t + δt, exp(δθ)·R, in the base frame.
//! * Cell frame: origin at the centre of the detector's active area, x along its length from
//!   electrode 1 to electrode 2, z the outward normal, y = z × x.
//!
//! # Number types
//! One text serves `f32` (on the board) and `f64` (on the host): see [`Scalar`]. Descriptions and
//! poses are always `f64`.
#![no_std]

mod aperture;
mod exact;
mod identify;
mod paper;
mod plan;
mod polygon;
mod pose;
mod power;
mod profile;
mod real;
mod rectangle;
mod response;
mod scalar;
mod scene;
mod solid_angle;
mod solve;

pub use exact::Integration;
pub use identify::identified_relative_intensity;
pub use plan::{CurrentsJacobian, Plan, Tier};
pub use pose::{Pose, Twist, rotation_exp, rotation_log};
pub use response::{Flags, Pair, Response, Status};
pub use scalar::{Linear3, Scalar, Vector3};
pub use scene::{
    BOLTZMANN_J_PER_K, Cell, DEFAULT_FAINT_A, Detector, ELEMENTARY_CHARGE_C, Emitter, Fault, MAX_CELLS,
    MAX_PROFILE_KNOTS, Noise, Place, Profile, Scene, SceneError, Slit, Uncertainty,
};
pub use solve::{
    AXES, Cells, Directions, Estimate, MotionPrior, Outcome, Photocurrents, Reading, Smoothed, Solution, Solver, Start,
    Tracked, Tracker, TwistEstimate, Verified, Weakness,
};

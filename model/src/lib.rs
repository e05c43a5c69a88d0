//! Optics of emitter-slit-detector cells, and the pose of a tool that carries the emitters.
//!
//! Each cell is an infrared emitter on the tool, a slit in a mask on the base, and behind it a
//! one-dimensional position-sensitive detector whose two photocurrents measure position and power of
//! the light that passes the slit. A [`Scene`] describes the cells; a [`CompiledScene`], compiled from the
//! scene, gives each cell's photocurrents at a [`Pose`] and their derivatives with respect to the pose.
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
//! The code is generic over `f32` (on the board) and `f64` (on the host): see [`Scalar`]. Scenes and
//! poses are always `f64`.
//!
//! # Example
//! Six cells in a ring, their photocurrents at a pose, and the pose solved from these photocurrents alone:
//! ```
//! use std::f64::consts::{FRAC_PI_3, FRAC_PI_4};
//! use glam::{DVec2, DVec3};
//! use slitpose_model::*;
//!
//! let cell = |k: i32| {
//!     let (sin, cos) = (FRAC_PI_3 * f64::from(k)).sin_cos();
//!     let (out, along) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
//!     let roll = if k % 2 == 0 { FRAC_PI_4 } else { -FRAC_PI_4 };
//!     let x_axis_base = along * roll.cos() + DVec3::Z * roll.sin();
//!     Cell {
//!         detector: Detector {
//!             centre_base_m: 25e-3 * out, x_axis_base, normal_base: -out, length_m: 12e-3, width_m: 1e-3,
//!             responsivity_a_per_w: 0.54, dark_current_a: 0.0, interelectrode_ohm: None, saturation_a: None,
//!             faint_a: DEFAULT_FAINT_A,
//!         },
//!         slit: Slit {
//!             distance_m: 5e-3, width_m: 0.6e-3, length_m: 10e-3, offset_m: DVec2::ZERO, tilt_rad: DVec3::ZERO,
//!             thickness_m: 0.0,
//!         },
//!         emitter: Emitter {
//!             position_tool_m: 10e-3 * out, axis_tool: out, radiant_intensity_w_per_sr: 3.16e-3,
//!             profile: Profile::from_half_angle(55_f64.to_radians()),
//!         },
//!         effects: Effects::default(),
//!     }
//! };
//! let scene = Scene { cells: (0..6).map(cell).collect(), ..Scene::default() };
//! let tier = Tier::Exact { tolerance: 1e-6 };
//! let plan = CompiledScene::<f64>::compile(&scene, tier)?;
//! let truth = Pose::from_vectors(DVec3::new(1e-3, -2e-3, 0.5e-3), DVec3::new(0.0, 0.1, 0.05));
//! let currents = Photocurrents::of_pairs((0..6).map(|k| plan.photocurrents(k, &truth)));
//!
//! let solver = Solver::<f64>::new(&scene, tier)?;
//! let solution = solver.solve(&currents, Start::Cold, &MotionPrior::AT_REST);
//! assert_eq!(solution.outcome, Outcome::Converged);
//! let found = solution.estimate.expect("a pose").pose;
//! assert!(found.translation_m.distance(truth.translation_m) < 1e-9);
//! # Ok::<(), SceneError>(())
//! ```

#![no_std]

mod aperture;
mod effects;
mod entries;
mod exact;
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
mod lanes;
mod paper;
mod plan;
mod polygon;
mod pose;
mod power;
mod profile;
mod rectangle;
mod response;
mod scalar;
mod scene;
mod solve;

pub use effects::{
    AZIMUTHAL_TERMS, Converters, Effects, MAX_CONVERTER, MAX_NONLINEARITY, ModelError, Opening, ProfileShape,
    RADIAL_TERMS, Stray, Window,
};
pub use entries::Scalar;
pub use paper::identified_relative_intensity;
pub use plan::{BOARD_CELLS, CompactPlan, CompiledScene, CurrentsJacobian, Tier};
pub use pose::{Pose, Twist, rotation_exp, rotation_log};
pub use response::{Flags, Integration, Pair, Response, Status};
pub use scalar::{Linear3, Number, Real, Vector3};
pub use scene::{
    BOLTZMANN_J_PER_K, Cell, DEFAULT_FAINT_A, Detector, ELEMENTARY_CHARGE_C, Emitter, Fault, MAX_CELLS,
    MAX_PROFILE_KNOTS, Noise, Place, Profile, Scene, SceneError, Slit, Uncertainty,
};
pub use solve::{
    AXES, BoardTracker, Cells, CompactError, CompactFrame, CompactPart, DegradedReason, Directions, Estimate, Filtered,
    MAX_MEAN_MISFIT, MAX_MISFIT, MIN_CELLS, MotionPrior, NoTwist, Outcome, Photocurrents, PoseTracker, Reading,
    Solution, Solver, Start, Tracked, Tracker, TwistEstimate, Verified,
};

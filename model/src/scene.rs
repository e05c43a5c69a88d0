//! The description of a sensor head: detectors, slits, emitters, noise and calibration uncertainty.
//!
//! All values are `f64` in SI units. Positions and directions of detectors are in the base frame,
//! those of emitters in the tool frame. To evaluate a [`Scene`], compile it to a
//! [`CompiledScene`](crate::CompiledScene).

use crate::effects::{Effects, Opening};
use glam::{DVec2, DVec3};
use heapless::Vec;
use thiserror::Error;

/// Elementary charge, coulombs (SI, exact).
pub const ELEMENTARY_CHARGE_C: f64 = 1.602_176_634e-19;

/// Boltzmann constant, J/K (SI, exact).
pub const BOLTZMANN_J_PER_K: f64 = 1.380_649e-23;

/// Most cells a scene can have.
pub const MAX_CELLS: usize = 16;

/// Most knots a tabulated emission profile can have.
pub const MAX_PROFILE_KNOTS: usize = 64;

/// Default of [`Detector::faint_a`], amperes: about 40 times the noise of a single lit-minus-dark
/// sample of the default front end.
pub const DEFAULT_FAINT_A: f64 = 50e-9;

/// The optics of a sensor head.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// assert_eq!(scene.cells.len(), 6);
/// let without_noise = Scene { noise: None, ..scene };
/// assert!(CompiledScene::<f64>::compile(&without_noise, Tier::Paper).is_ok());
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// The emitter-slit-detector cells, in the order of their numbers.
    pub cells: Vec<Cell, MAX_CELLS>,
    /// Noise of the measured currents; `None`: noise-free.
    pub noise: Option<Noise>,
    /// Uncertainty left by calibration.
    pub uncertainty: Uncertainty,
}

/// For a head whose emitters all sit at the tool's origin; any length scale serves there.
const DEFAULT_LENGTH_SCALE_M: f64 = 0.01;

impl Scene {
    /// Length that makes rotations and translations of the tool comparable, metres: root-mean-square
    /// distance of the emitters from the tool's origin, or 0.01 if that distance is zero.
    pub fn length_scale_m(&self) -> f64 {
        let squares: f64 = self.cells.iter().map(|cell| cell.emitter.position_tool_m.length_squared()).sum();
        let length_scale_m = libm::sqrt(squares / self.cells.len() as f64);
        if length_scale_m > 0.0 { length_scale_m } else { DEFAULT_LENGTH_SCALE_M }
    }
}

/// One emitter-slit-detector cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The position-sensitive detector (PSD).
    pub detector: Detector,
    /// The slit in the mask above it.
    pub slit: Slit,
    /// The infrared emitter (IRED) on the tool.
    pub emitter: Emitter,
    /// What the parts do beyond the ideal.
    pub effects: Effects,
}

/// A one-dimensional PSD.
///
/// Its cell frame has the origin at the centre of the active area, x along its length, z the
/// outward normal, y = z × x.
#[derive(Clone, Debug, PartialEq)]
pub struct Detector {
    /// Centre of the active area, base frame, metres.
    pub centre_base_m: DVec3,
    /// Direction from electrode 1 to electrode 2, base frame, unit length.
    pub x_axis_base: DVec3,
    /// Outward normal, towards slit and emitter, base frame, unit length.
    pub normal_base: DVec3,
    /// Length Lx of the active area between the electrodes, metres.
    pub length_m: f64,
    /// Width Ly of the active area, metres.
    pub width_m: f64,
    /// Responsivity S, amperes per watt.
    pub responsivity_a_per_w: f64,
    /// Dark current I_D of both electrodes together, amperes.
    pub dark_current_a: f64,
    /// Inter-electrode resistance, ohms; `None`: no Johnson noise.
    pub interelectrode_ohm: Option<f64>,
    /// Total current I_O above which the detector saturates, amperes; `None`: never.
    pub saturation_a: Option<f64>,
    /// Photocurrent I_O − I_D below which the cell is flagged faint, amperes.
    pub faint_a: f64,
}

/// A rectangular slit in an otherwise opaque mask.
#[derive(Clone, Debug, PartialEq)]
pub struct Slit {
    /// Height d_B of the mask's mid-plane above the detector surface, at the slit's centre, metres.
    pub distance_m: f64,
    /// Width w, along the cell's x if the slit is not tilted, metres.
    pub width_m: f64,
    /// Length l, along the cell's y if the slit is not tilted, metres.
    pub length_m: f64,
    /// Centre of the slit in the cell's x and y, metres.
    pub offset_m: DVec2,
    /// Rotation vector of the slit about its centre in the cell frame, radians.
    pub tilt_rad: DVec3,
    /// Thickness t of the mask, metres; zero: a thin mask.
    pub thickness_m: f64,
}

/// A point-like infrared emitter.
#[derive(Clone, Debug, PartialEq)]
pub struct Emitter {
    /// Position in the tool frame, metres.
    pub position_tool_m: DVec3,
    /// Direction of its axis in the tool frame, unit length.
    pub axis_tool: DVec3,
    /// Radiant intensity I_e on the axis, watts per steradian.
    pub radiant_intensity_w_per_sr: f64,
    /// Relative radiant intensity I_rel as a function of the angle γ to the axis.
    pub profile: Profile,
}

/// The relative radiant intensity I_rel(γ) of an emitter. Zero from γ = 90° on.
///
/// ```
/// use slitpose_model::Profile;
/// let Profile::Cosine { exponent } = Profile::from_half_angle(60_f64.to_radians()) else { unreachable!() };
/// assert!((exponent - 1.0).abs() < 1e-12); // Lambert's
/// ```
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board; a scene has at most 16 of them")]
pub enum Profile {
    /// I_rel = cosⁿ γ.
    Cosine {
        /// The exponent n.
        exponent: f64,
    },
    /// Points (γ in radians, I_rel), ascending from γ = 0. If a function cosⁿγ·P(1 − cos γ), P of eighth degree at most
    /// and half as many coefficients as points, gives the table when rounded to the table's decimals (to 0.5 % of
    /// the greatest value, if those are one or none), I_rel is that function. Else it passes through the points and is
    /// interpolated between them by blended parabolas in 1 − cos γ, without overshoot, which takes tens of times as
    /// long. A table that ends before 90° falls to zero at 90°.
    Table(Vec<(f64, f64), MAX_PROFILE_KNOTS>),
}

impl Profile {
    /// The cosine profile that falls to one half at φ = `half_angle_rad`: n = ln ½ / ln cos φ.
    pub fn from_half_angle(half_angle_rad: f64) -> Self {
        let exponent = -core::f64::consts::LN_2 / libm::log(libm::cos(half_angle_rad));
        Self::Cosine { exponent }
    }
}

/// White noise of the measured currents.
///
/// There are two bandwidths because subtracting a dark sample doubles the variance of Johnson noise, of
/// the dark current's shot noise and of the converter, but not that of the light's shot noise.
///
/// ```
/// use slitpose_model::Noise;
/// let noise = Noise { shot_bandwidth_hz: 100e3, johnson_bandwidth_hz: 200e3, temperature_k: 300.0, adc_a: 2e-9 };
/// // Four readings: half the standard deviation.
/// assert_eq!(noise.averaged(4.0).adc_a, 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// One-sided noise bandwidth of the shot noise of light, hertz.
    pub shot_bandwidth_hz: f64,
    /// One-sided noise bandwidth of the noise without light, hertz: Johnson noise of the inter-electrode
    /// resistance, and shot noise of the dark current.
    pub johnson_bandwidth_hz: f64,
    /// Temperature of the detectors, kelvin.
    pub temperature_k: f64,
    /// Standard deviation of converter and amplifier together, per electrode, amperes.
    pub adc_a: f64,
}

impl Noise {
    /// Of the mean of so many readings.
    #[must_use]
    pub fn averaged(&self, readings: f64) -> Self {
        Self {
            shot_bandwidth_hz: self.shot_bandwidth_hz / readings,
            johnson_bandwidth_hz: self.johnson_bandwidth_hz / readings,
            adc_a: self.adc_a / libm::sqrt(readings),
            ..*self
        }
    }

    /// 2q·B: variance of the shot noise per ampere of current (Schottky 1918), A.
    pub fn shot_a(&self) -> f64 {
        2.0 * ELEMENTARY_CHARGE_C * self.shot_bandwidth_hz
    }

    /// 2q·I_D·B: variance of the shot noise of the dark current of `detector`, both electrodes together, A².
    pub fn dark_shot_a2(&self, detector: &Detector) -> f64 {
        2.0 * ELEMENTARY_CHARGE_C * self.johnson_bandwidth_hz * detector.dark_current_a
    }

    /// 4kT·B/R_ie: variance of the Johnson noise current that the inter-electrode resistance of `detector`
    /// drives from one electrode to the other (Johnson 1928), A². Zero if the resistance is not given.
    pub fn johnson_a2(&self, detector: &Detector) -> f64 {
        detector
            .interelectrode_ohm
            .map_or(0.0, |ohm| 4.0 * BOLTZMANN_J_PER_K * self.temperature_k * self.johnson_bandwidth_hz / ohm)
    }
}

/// Standard deviations of the parameters after calibration. Zero: known exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Relative standard deviation of each emitter's intensity, common to both electrodes of its cell.
    pub emitter_gain_relative: f64,
    /// Relative standard deviation of each electrode's gain.
    pub electrode_gain_relative: f64,
    /// Standard deviation of the relative position of each cell's detector, slit and emitter, per axis of
    /// space, metres. A displacement moves the spot and changes its power.
    pub position_m: f64,
    /// Relative standard deviation of a factor common to all light of a frame, which each frame finds for itself: emitters
    /// that are fed together and warm together. Zero: known.
    pub light_level_relative: f64,
    /// Relative standard deviation of what each emitter may deviate from that factor, and the time after which it says nothing
    /// more of itself, seconds: a [`crate::Tracker`] finds it while the tool moves. Zero: known.
    pub emitter_drift_relative: f64,
    /// See [`Self::emitter_drift_relative`]; more than zero where that is.
    pub emitter_drift_s: f64,
}

/// Why a scene cannot be compiled.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("{place}: {fault}")]
pub struct SceneError {
    /// The place in the scene.
    pub place: Place,
    /// The fault there.
    pub fault: Fault,
}

/// A place in a scene, in the terms of the scene file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The cell's number; `None`: a property of the scene.
    pub cell: Option<usize>,
    /// The section in the scene file, e.g. `slit`; `cell` for keys in `[[cell]]` itself.
    pub section: &'static str,
    /// The key, e.g. `width_mm`.
    pub key: &'static str,
}

impl core::fmt::Display for Place {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match (self.cell, self.section) {
            (Some(cell), "cell") => write!(f, "cell {cell}, {}", self.key),
            (Some(cell), section) => write!(f, "cell {cell}, {section}.{}", self.key),
            (None, section) => write!(f, "{section}.{}", self.key),
        }
    }
}

/// A fault of a value in a scene, with that value.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum Fault {
    /// NaN or infinite.
    #[error("{0} is not a finite number")]
    NotFinite(f64),
    /// Larger than any head can have, probably a mistake of units.
    #[error("{0} is more than any sensor head can have; check its unit")]
    TooLarge(f64),
    /// A negative value of a quantity that cannot be negative.
    #[error("{0} is negative; give zero or more")]
    Negative(f64),
    /// Zero or negative where a positive number is needed.
    #[error("{0} is not positive; give more than zero")]
    NotPositive(f64),
    /// An axis that is not a unit vector; its length.
    #[error("axis has length {0}, not 1; divide it by its length")]
    NotUnit(f64),
    /// Two axes that must be perpendicular and are not; their scalar product.
    #[error("x_axis and normal are not perpendicular, their scalar product is {0}; correct one of them")]
    NotPerpendicular(f64),
    /// The mask reaches below the detector's surface, by so many metres.
    #[error("the mask reaches {0} m below the detector surface; raise slit.distance_mm or make the mask thinner")]
    MaskInDetector(f64),
    /// A refractive index below that of vacuum.
    #[error("refractive index {0} is below 1; a resin has 1.5")]
    BelowOne(f64),
    /// A turned slit in a cell with effects; its rotation in degrees.
    #[error(
        "a slit turned by {0} degrees cannot be computed in a cell with effects such as a window; turn it by 10 degrees at most"
    )]
    TurnedWithEffects(f64),
    /// A part with which an opening cannot be computed.
    #[error("{part} cannot be computed with {opening}; leave it out")]
    NotThrough {
        /// The part.
        part: &'static str,
        /// What the light passes through.
        opening: Opening,
    },
    /// No cell at all.
    #[error("the scene has no cell; add at least one [[cell]]")]
    NoCells,
    /// A profile table with fewer than two knots; their number.
    #[error("a profile needs at least two knots, this one has {0}")]
    TooFewKnots(usize),
    /// A profile table that does not start on the axis; its first angle, degrees.
    #[error("a profile starts at 0 degrees, this one at {0}")]
    FirstKnotNotZero(f64),
    /// Profile angles not ascending, or beyond 90°; the two angles, degrees.
    #[error("profile angles must ascend and not pass 90 degrees, but {1} follows {0}")]
    KnotOrder(f64, f64),
    /// A half angle not between 0° and 90°, degrees.
    #[error("half angle {0} degrees is not between 0 and 90")]
    HalfAngle(f64),
}

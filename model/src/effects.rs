//! What a cell may be and do beyond an ideal slit on the base. All of it is off by default, and then costs nothing.

use heapless::Vec;

use crate::scene::Cell;

/// Most coefficients of [`Effects::nonlinearity_m`].
pub const MAX_NONLINEARITY: usize = 12;

/// Most coefficients of each curve of [`Converters`].
pub const MAX_CONVERTER: usize = 10;

/// Terms of [`ProfileShape::radial`].
pub const RADIAL_TERMS: usize = 4;

/// Terms of [`ProfileShape::azimuthal`].
pub const AZIMUTHAL_TERMS: usize = 4;

/// What the light of a cell passes through on its way to the detector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Opening {
    /// A slit on the base.
    #[default]
    Slit,
    /// A slit on the tool, which rides with the emitter. [`Slit`](crate::Slit) says where it is with the tool at home.
    RidingSlit,
    /// A round hole on the base. Its diameter is the width of [`Slit`](crate::Slit).
    Pinhole,
    /// A thin lens that fills a round hole on the base: light through each point of it goes on to the image of the
    /// emitter.
    Lens {
        /// Focal length f, metres.
        focal_length_m: f64,
    },
}

impl Opening {
    /// Whether it is a round hole, with a lens or without, and not a slit.
    pub fn is_hole(&self) -> bool {
        matches!(self, Self::Pinhole | Self::Lens { .. })
    }
}

/// Whether the light of `emitter`, whose cell shares a detector with `other_axis`, counts on the detector of another cell
/// `cell`: two cells that read one detector have one emitter, and each counts it as its own.
pub fn counts_on(emitter: usize, other_axis: Option<usize>, cell: usize) -> bool {
    other_axis.is_none_or(|other| other != cell && other > emitter)
}

impl core::fmt::Display for Opening {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Slit => "a slit on the base",
            Self::RidingSlit => "a slit on the tool",
            Self::Pinhole => "a pinhole",
            Self::Lens { .. } => "a lens",
        })
    }
}

/// The effects of one cell, in the order in which they act on light and currents.
#[derive(Clone, Debug, PartialEq)]
pub struct Effects {
    /// What the light passes through.
    pub opening: Opening,
    /// The cell that reads the other axis of the same detector, of the same emitter through the same opening. The
    /// emitter is that of the cell with the smaller number.
    pub other_axis: Option<usize>,
    /// Diameter of the emitter's luminous disc, perpendicular to its axis, metres; zero: a point.
    pub source_diameter_m: f64,
    /// Deviation of the emitter from its [`crate::Profile`].
    pub profile: ProfileShape,
    /// Cover on the detector.
    pub window: Option<Window>,
    /// X_measured − X_A as a polynomial in ξ = 2·X_A/Lx: coefficients of ξ⁰, ξ¹, …, metres.
    pub nonlinearity_m: Vec<f64, MAX_NONLINEARITY>,
    /// Light of the cell's emitter that does not come through the slit directly.
    pub stray: Option<Stray>,
    /// Other emitters that are lit in the same slot: bit j for emitter j.
    pub lit_together: u16,
    /// Factors of I_X1 and I_X2.
    pub electrode_gain: [f64; 2],
    /// Deviation of the converters of both electrodes from a straight line.
    pub converters: Option<Converters>,
    /// What the cell does beyond all of this.
    pub model_error: ModelError,
}

impl Default for Effects {
    fn default() -> Self {
        Self {
            opening: Opening::Slit,
            other_axis: None,
            source_diameter_m: 0.0,
            profile: ProfileShape::default(),
            window: None,
            nonlinearity_m: Vec::new(),
            stray: None,
            lit_together: 0,
            electrode_gain: [1.0; 2],
            converters: None,
            model_error: ModelError::default(),
        }
    }
}

impl Effects {
    /// Whether they change what a cell sees.
    fn act(&self) -> bool {
        let ideal = Self { model_error: self.model_error, ..Self::default() };
        *self != ideal
    }
}

impl Cell {
    /// The effects, if there are any that change what the cell sees.
    pub(crate) fn acting_effects(&self) -> Option<&Effects> {
        Some(&self.effects).filter(|effects| effects.act())
    }

    /// What the light passes through.
    pub fn opening(&self) -> Opening {
        self.effects.opening
    }

    /// The cell that reads the other axis of the same detector.
    pub fn other_axis(&self) -> Option<usize> {
        self.effects.other_axis
    }

    /// The cell whose emitter this cell, number `number`, sees: itself, unless it reads the second axis of its detector.
    pub fn emitter(&self, number: usize) -> usize {
        self.other_axis().map_or(number, |other| other.min(number))
    }

    /// Whether this cell, number `number`, reads the second axis of its detector: the emitter is that of another cell.
    pub fn is_second_axis(&self, number: usize) -> bool {
        self.emitter(number) != number
    }

    /// Whether the light of this cell's emitter, number `number`, counts on the detector of `cell` besides that of its own.
    pub fn shines_on(&self, number: usize, cell: usize) -> bool {
        number != cell && counts_on(number, self.other_axis(), cell)
    }

    /// Magnitude of the current that is read when only stray light comes, the tool at home, amperes.
    pub(crate) fn stray_a(&self) -> f64 {
        let Effects { stray, electrode_gain: gain, .. } = &self.effects;
        let [first, second] = stray.unwrap_or_default().constant_a;
        (first * gain[0] + second * gain[1]).abs()
    }
}

/// A plane-parallel cover on the detector, which refracts the light by Snell's law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Thickness t_g, metres.
    pub thickness_m: f64,
    /// Refractive index n.
    pub refractive_index: f64,
}

/// A factor of the relative radiant intensity: 1 + Σ radial + Σ azimuthal.
///
/// With c = cos γ, z = 1 − c, and (v, w) the components of the ray's unit vector across the emitter's
/// axis: v along the projection of the tool's z axis (of its x axis, if the emitter's axis is within 45° of
/// z), w = u × v.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProfileShape {
    /// Coefficients of z, z², z³, z⁴.
    pub radial: [f64; RADIAL_TERMS],
    /// Coefficients of v² − w², 2·v·w, z·v, z·w. (Terms in v and w alone would tilt the emitter.)
    pub azimuthal: [f64; AZIMUTHAL_TERMS],
}

impl ProfileShape {
    /// Whether the factor is 1.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Light of the cell's own emitter that reaches the detector by reflection, as the currents it adds to I_X1 and
/// I_X2. It follows the tool's translation t as a polynomial of second order, and its rotation by an angle θ about the unit
/// vector n in proportion to n·sin θ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stray {
    /// With the tool at home, amperes.
    pub constant_a: [f64; 2],
    /// Per metre of t_x, t_y, t_z.
    pub linear_a_per_m: [[f64; 3]; 2],
    /// Per square metre: coefficients of t_x², t_y², t_z², t_x·t_y, t_y·t_z, t_z·t_x.
    pub quadratic_a_per_m2: [[f64; 6]; 2],
    /// Per unit of n_x·sin θ, n_y·sin θ, n_z·sin θ.
    pub turning_a: [[f64; 3]; 2],
}

impl Stray {
    /// A constant current at one place of the detector of length `length_m`.
    pub fn at(current_a: f64, centre_m: f64, length_m: f64) -> Self {
        let share = centre_m / length_m;
        Self { constant_a: [current_a * (0.5 - share), current_a * (0.5 + share)], ..Self::default() }
    }
}

/// The non-linearity of two converters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Converters {
    /// Current at the top code, amperes.
    pub full_scale_a: f64,
    /// Current read − current, amperes, as polynomials in i = 2·I/full scale − 1: coefficients of i⁰, i¹, … Where |i|
    /// exceeds 1 they have their values at the ends.
    pub curves_a: [Vec<f64, MAX_CONVERTER>; 2],
}

/// Standard deviation of what a cell does beyond the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ModelError {
    /// Of the photocurrent, relative.
    pub relative: f64,
    /// Of the position of the light on the detector, metres.
    pub position_m: f64,
    /// Of the current of each electrode, amperes: of light that takes other ways.
    pub current_a: f64,
    /// How far from the centre of a detector, in halves of its length, light was where the model was fitted to readings: nine
    /// tenths of them. The first two errors grow with the distance u, their variances by the factor 1 + (u/reach)⁸. `None`: they
    /// are the same everywhere.
    pub reach: Option<f64>,
}

//! Relative radiant intensity of an emitter, compiled: I_rel as a function of c = cos γ.
//!
//! Defined for c > 0 only: an emitter emits nothing at γ ≥ 90°.

mod cosine;
mod fit;
mod shaped;
mod table;
mod window;

use crate::effects::RADIAL_TERMS;
use crate::exact::SERIES_EXPONENT;
use crate::power::Power;
use crate::scalar::{Number, Real};
use crate::scene::Profile;

pub use cosine::Cosine;
use fit::Smooth;
use shaped::Shape;
pub use shaped::Shaped;
pub use table::Table;
pub use window::Curve;

/// I_rel and its derivative with respect to cos γ, for one cell or several.
pub trait Falloff<R> {
    /// I_rel at cos γ = `c` > 0.
    fn relative(&self, c: R) -> R;
    /// (I_rel, dI_rel/dc) at cos γ = `c` > 0.
    fn with_slope(&self, c: R) -> (R, R);
}

/// Further properties of a profile, for integrals over a spot.
pub trait Emission<S>: Falloff<S> {
    /// Limit of I_rel for γ → 90° from below: zero unless the profile jumps there.
    fn at_horizon(&self) -> S;
    /// A cheaper series for this profile where |c − `centre`| ≤ `spread`·`centre`, within the tolerance
    /// the profile was compiled with; `None` if there is none.
    fn near(&self, centre: S, spread: S) -> Option<Series<S>>;
    /// The greatest I_rel for cos γ in `lower..=upper`.
    fn greatest(&self, lower: S, upper: S) -> S;
    /// Whether ten nodes spread over cos γ in `lower..=upper` are enough to find the light there.
    fn is_resolved(&self, lower: S, upper: S) -> bool;
    /// Whether the profile is analytic for cos γ in `lower..=upper`.
    fn is_smooth(&self, lower: S, upper: S) -> bool;
    /// For light so faint that it may underflow, a divisor for c and a factor for the resulting power;
    /// else one and one. `brightest`: the greatest c of the spot; `corner`: the greatest c of a corner.
    fn rescaling(&self, brightest: impl FnOnce() -> S, corner: S) -> (S, S);
}

/// Most terms of a [`Series`] after its first.
pub const MAX_TERMS: usize = 10;

/// I_rel around a centre c₀ as a polynomial in δ, c = c₀(1 + δ). A spot is small, so a few terms
/// replace a power or a table at each of its nodes.
#[derive(Clone, Copy, Debug)]
pub struct Series<S> {
    pub inverse: S,
    pub coefficients: [S; MAX_TERMS + 1],
    pub terms: usize,
    /// Gauss–Legendre nodes that integrate the polynomial along a line to the tolerance.
    pub nodes: usize,
    /// Nodes in addition to those for the emitter's distance alone, for a steep profile.
    pub more: usize,
}

impl<S> Series<S> {
    /// The number of nodes for this series, where `for_distance` suffice for the emitter's distance.
    #[inline(always)]
    pub fn nodes_with(&self, for_distance: usize) -> usize {
        (for_distance + self.more).max(self.nodes)
    }
}

impl<R: Real> Falloff<R> for Series<R> {
    #[inline(always)]
    fn relative(&self, c: R) -> R {
        let delta = c * self.inverse - c.constant(1.0);
        let mut value = c.constant(0.0);
        for &coefficient in self.coefficients[..=self.terms].iter().rev() {
            value = value * delta + coefficient;
        }
        value
    }

    #[inline(always)]
    fn with_slope(&self, c: R) -> (R, R) {
        let delta = c * self.inverse - c.constant(1.0);
        let [mut value, mut slope] = [c.constant(0.0); 2];
        for &coefficient in self.coefficients[..=self.terms].iter().rev() {
            slope = slope * delta + value;
            value = value * delta + coefficient;
        }
        (value, slope * self.inverse)
    }
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board; a plan has at most 16 of them")]
pub enum CompiledProfile<S> {
    Cosine(Cosine<S>),
    Table(Table<S>),
    ShapedCosine(Shaped<S, Cosine<S>>),
    ShapedTable(Shaped<S, Table<S>>),
}

impl<S: Number> CompiledProfile<S> {
    /// Compiles `profile` with its `radial` deviation, and its exponent for [`crate::exact::Orders`]. `tolerance`:
    /// relative error allowed to [`Emission::near`].
    pub fn compile(profile: &Profile, radial: [f64; RADIAL_TERMS], tolerance: f64) -> (Self, f64) {
        let mut shape: Shape<f64> = [1.0].into_iter().chain(radial).collect();
        let exponent = match profile {
            Profile::Cosine { exponent } => *exponent,
            Profile::Table(knots) => match Smooth::of(knots) {
                Some(smooth) => {
                    shape = shaped::product(&shape, &smooth.coefficients);
                    smooth.exponent
                }
                None => {
                    let table = Table::compile(knots, tolerance);
                    let is_plain = shape[1..].iter().all(|&coefficient| coefficient == 0.0);
                    let compiled = if is_plain {
                        Self::Table(table)
                    } else {
                        Self::ShapedTable(Shaped::new(table, &shape, tolerance))
                    };
                    return (compiled, SERIES_EXPONENT);
                }
            },
        };
        let cosine = Cosine::compile(exponent, tolerance);
        let is_power = shape[0] == 1.0 && shape[1..].iter().all(|&coefficient| coefficient == 0.0);
        let compiled =
            if is_power { Self::Cosine(cosine) } else { Self::ShapedCosine(Shaped::new(cosine, &shape, tolerance)) };
        (compiled, exponent)
    }

    /// Whether a rule chosen beforehand must integrate the series of [`Self::near`], because no estimate
    /// covers the variation of the profile itself.
    pub fn needs_series(&self) -> bool {
        matches!(self, Self::Table(_) | Self::ShapedTable(_))
    }

    pub fn as_power(&self) -> Option<&Power<S>> {
        match self {
            Self::Cosine(cosine) => Some(cosine.power()),
            Self::Table(_) | Self::ShapedCosine(_) | Self::ShapedTable(_) => None,
        }
    }
}

/// Each function is that of the profile.
macro_rules! of_profile {
    ($($(#[$attribute:meta])* $visibility:vis fn $name:ident(&self $(, $argument:ident: $of:ty)*) -> $result:ty;)*) => {
        $($(#[$attribute])*
        $visibility fn $name(&self $(, $argument: $of)*) -> $result {
            match self {
                Self::Cosine(profile) => profile.$name($($argument),*),
                Self::Table(profile) => profile.$name($($argument),*),
                Self::ShapedCosine(profile) => profile.$name($($argument),*),
                Self::ShapedTable(profile) => profile.$name($($argument),*),
            }
        })*
    };
}

impl<S: Number> Falloff<S> for CompiledProfile<S> {
    of_profile! {
        #[inline(always)]
        fn relative(&self, c: S) -> S;
        #[inline(always)]
        fn with_slope(&self, c: S) -> (S, S);
    }
}

impl<S: Number> Emission<S> for CompiledProfile<S> {
    of_profile! {
        fn at_horizon(&self) -> S;
        #[inline(always)]
        fn near(&self, centre: S, spread: S) -> Option<Series<S>>;
        fn greatest(&self, lower: S, upper: S) -> S;
        fn is_resolved(&self, lower: S, upper: S) -> bool;
        fn is_smooth(&self, lower: S, upper: S) -> bool;
        fn rescaling(&self, brightest: impl FnOnce() -> S, corner: S) -> (S, S);
    }
}

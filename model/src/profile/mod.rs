//! Relative radiant intensity of an emitter, compiled: I_rel as a function of c = cos γ.
//!
//! Callers ask only for c > 0; an emitter sends nothing to γ ≥ 90°.

mod cosine;
mod table;
mod window;

use crate::power::Power;
use crate::scalar::Scalar;
use crate::scene::Profile;

pub(crate) use cosine::Cosine;
pub(crate) use table::Table;

/// I_rel and its derivative by cos γ, for one cell or several.
pub(crate) trait Falloff<R> {
    /// I_rel at cos γ = `c` > 0.
    fn relative(&self, c: R) -> R;
    /// (I_rel, dI_rel/dc) at cos γ = `c` > 0.
    fn with_slope(&self, c: R) -> (R, R);
}

/// What integrals over a spot need to know of a profile besides.
pub(crate) trait Emission<S>: Falloff<S> {
    /// Whether a rule chosen beforehand must take the form that [`Self::near`] gives, because the profile
    /// itself varies in ways that no rule foresees.
    const NEEDS_SERIES: bool;
    /// I_rel at γ = 90° from within: zero unless the profile jumps there.
    fn at_horizon(&self) -> S;
    /// What stands for this profile where c differs from `centre` by no more than `spread`·`centre`:
    /// cheaper, and right to the tolerance the profile was compiled with. `None`: nothing is.
    fn near(&self, centre: S, spread: S) -> Option<Series<S>>;
    /// The greatest I_rel for cos γ in `lower..=upper`.
    fn greatest(&self, lower: S, upper: S) -> S;
    /// Whether ten nodes spread over cos γ in `lower..=upper` cannot miss where the light is.
    fn is_resolved(&self, lower: S, upper: S) -> bool;
    /// Whether the profile is analytic for cos γ in `lower..=upper`.
    fn is_smooth(&self, lower: S, upper: S) -> bool;
    /// For light so faint at `brightest` that the number range ends nearby: what to divide c by, and
    /// what to multiply the light with afterwards. Else one and one.
    fn rescaling(&self, brightest: impl FnOnce() -> S, corner: S) -> (S, S);
}

/// Most terms of a [`Series`] after its first.
pub(crate) const MAX_TERMS: usize = 10;

/// I_rel around a centre c₀, with c = c₀(1 + δ): a polynomial in δ. A spot is small, so a few terms
/// replace a power or a table at each of its nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Series<S> {
    pub(crate) inverse: S,
    pub(crate) coefficients: [S; MAX_TERMS + 1],
    pub(crate) terms: usize,
    /// Gauss–Legendre nodes that integrate the polynomial along a line to the tolerance.
    pub(crate) nodes: usize,
    /// Nodes more than those for the emitter's distance alone, which a steep profile brings out.
    pub(crate) more: usize,
}

impl<S> Series<S> {
    /// The nodes for it, where `for_distance` suffice for the emitter's distance.
    #[inline(always)]
    pub(crate) fn nodes_with(&self, for_distance: usize) -> usize {
        (for_distance + self.more).max(self.nodes)
    }
}

impl<S: Scalar> Falloff<S> for Series<S> {
    #[inline(always)]
    fn relative(&self, c: S) -> S {
        let delta = c * self.inverse - S::one();
        self.coefficients[..=self.terms].iter().rev().fold(S::zero(), |sum, &coefficient| sum * delta + coefficient)
    }

    #[inline(always)]
    fn with_slope(&self, c: S) -> (S, S) {
        let delta = c * self.inverse - S::one();
        let (mut value, mut slope) = (S::zero(), S::zero());
        for &coefficient in self.coefficients[..=self.terms].iter().rev() {
            slope = slope * delta + value;
            value = value * delta + coefficient;
        }
        (value, slope * self.inverse)
    }
}

/// The compiled profile of one emitter.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board; a plan has at most 16 of them")]
pub(crate) enum CompiledProfile<S> {
    Cosine(Cosine<S>),
    Table(Table<S>),
}

impl<S: Scalar> CompiledProfile<S> {
    /// `tolerance`: relative error allowed where a cheaper form stands for the profile.
    pub(crate) fn compile(profile: &Profile, tolerance: f64) -> Self {
        match profile {
            Profile::Cosine { exponent } => Self::Cosine(Cosine::compile(*exponent, tolerance)),
            Profile::Table(knots) => Self::Table(Table::compile(knots, tolerance)),
        }
    }

    /// The power, if that is what the profile is.
    pub(crate) fn as_power(&self) -> Option<&Power<S>> {
        match self {
            Self::Cosine(cosine) => Some(cosine.power()),
            Self::Table(_) => None,
        }
    }
}

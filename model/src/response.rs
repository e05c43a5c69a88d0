//! The response of one cell at one pose: currents, geometry and flags.

use core::fmt;

use crate::scalar::Number;

/// Cost and accuracy of the integrals over a spot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integration<S> {
    /// Evaluations of the profile for one cell's currents.
    pub evaluations: usize,
    /// Greatest error of each electrode's photocurrent, relative to the sum of both: the plan's
    /// tolerance, or more if rounding or [`CompiledScene::MAX_EVALUATIONS`](crate::CompiledScene::MAX_EVALUATIONS) prevents that;
    /// infinite if the limit was reached before any light was found.
    pub relative_error: S,
}

/// Geometric status of a cell's spot; the power of the light does not matter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The whole spot lies between the ends of the active area.
    Lit,
    /// The spot is cut along x by an end of the active area.
    Clipped,
    /// No spot on the active area.
    Dark,
    /// The emitter is at or behind the slit.
    Behind,
}

impl Status {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Lit => "lit",
            Self::Clipped => "clipped",
            Self::Dark => "dark",
            Self::Behind => "behind",
        }
    }

    /// Whether there is a spot.
    pub fn has_spot(self) -> bool {
        matches!(self, Self::Lit | Self::Clipped)
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Flags of the light and the currents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// I_O is above the detector's saturation current.
    pub saturated: bool,
    /// I_O − I_D is below the scene's faint threshold.
    pub faint: bool,
    /// The axis of the beam leaves the emitter at γ ≥ 90°.
    pub facing_away: bool,
}

impl fmt::Display for Flags {
    /// The words of the flags that are set, joined by `;`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = [(self.saturated, "saturated"), (self.faint, "faint"), (self.facing_away, "facing_away")];
        let mut separator = "";
        for (_, word) in words.into_iter().filter(|(set, _)| *set) {
            write!(f, "{separator}{word}")?;
            separator = ";";
        }
        Ok(())
    }
}

/// The two electrode currents of a cell, amperes.
///
/// ```
/// use slitpose_model::Pair;
/// // Light of 3 µA, 1 mm from the middle of a detector of 12 mm towards electrode 2.
/// let pair = Pair::divide(3e-6, 1e-3, 12e-3);
/// let x_a_m = 6e-3 * (pair.i_x2_a - pair.i_x1_a) / pair.total_a();
/// assert!((x_a_m - 1e-3_f64).abs() < 1e-15);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pair<S> {
    /// I_X1, current of the electrode at x = −Lx/2.
    pub i_x1_a: S,
    /// I_X2, current of the electrode at x = +Lx/2.
    pub i_x2_a: S,
}

impl<S: Number> Pair<S> {
    /// A total current divided between the electrodes according to the light's position X_A:
    /// I_X1,2 = I/2·(1 ∓ 2X_A/Lx), equation (1) of De La Cruz et al. 2018.
    ///
    /// ```
    /// // A spot 3 mm from the middle of a detector of 12 mm: three quarters of the current at the nearer electrode.
    /// let pair = slitpose_model::Pair::divide(2e-6, 3e-3, 12e-3);
    /// assert_eq!((pair.i_x1_a, pair.i_x2_a), (0.5e-6, 1.5e-6));
    /// ```
    #[inline(always)]
    pub fn divide(total_a: S, x_a_m: S, detector_length_m: S) -> Self {
        let half = S::half() * total_a;
        let imbalance = total_a * x_a_m / detector_length_m;
        Self { i_x1_a: half - imbalance, i_x2_a: half + imbalance }
    }

    /// I_O = I_X1 + I_X2.
    #[inline(always)]
    pub fn total_a(&self) -> S {
        self.i_x1_a + self.i_x2_a
    }
}

/// The model's full response of one cell at one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response<S> {
    /// Geometric status.
    pub status: Status,
    /// Flags of the light and the currents.
    pub flags: Flags,
    /// Position X_A of the light on the detector, metres; `None` without light.
    pub x_a_m: Option<S>,
    /// Angle γ between the emitter's axis and the beam's central axis, radians; `None` without spot.
    pub gamma_rad: Option<S>,
    /// Solid angle Ω of the spot seen from the emitter, steradians; zero without spot.
    pub solid_angle_sr: S,
    /// I_O, dark current included, amperes.
    pub i_o_a: S,
    /// I_X1 and I_X2, dark current included.
    pub currents: Pair<S>,
    /// Cost and accuracy of the integrals; `None` in the paper tier and where there is nothing to integrate.
    pub integration: Option<Integration<S>>,
}

impl<S: Number> Response<S> {
    pub(crate) fn without_spot(status: Status, flags: Flags, currents: Pair<S>) -> Self {
        let (solid_angle_sr, i_o_a) = (S::zero(), currents.total_a());
        Self { status, flags, x_a_m: None, gamma_rad: None, solid_angle_sr, i_o_a, currents, integration: None }
    }
}

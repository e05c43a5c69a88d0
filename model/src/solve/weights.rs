//! How much a current is worth: the covariance of a cell's two currents, whitening by it, and sums of whitened residuals.

use serde::{Deserialize, Serialize};

use crate::scalar::Number;
use crate::scene::{Scene, Uncertainty};

use super::algebra::Vector6;

/// Multiplies the residuals of a cell's two currents into uncorrelated ones of unit variance.
#[derive(Clone, Copy, Debug)]
pub struct Whitener<S> {
    rows: [[S; 2]; 2],
}

impl<S: Number> Whitener<S> {
    /// For two uncorrelated variances, A².
    #[inline(always)]
    fn of_variances(variances: [S; 2]) -> Self {
        let [first, second] = [variances[0].inverse_root(), variances[1].inverse_root()];
        Self { rows: [[first, S::zero()], [S::zero(), second]] }
    }

    /// For a covariance larger by `variance`·p·pᵀ.
    ///
    /// With v = W·p·σ the new whitener is (I + v·vᵀ)^(−½)·W, and
    /// (I + v·vᵀ)^(−½) = I − v·vᵀ/(s(1 + s)), s² = 1 + v². Nothing cancels however large σ is: a
    /// direction that is known to nothing loses its weight, the other keeps its digits.
    #[inline(always)]
    fn loosened(&self, pair: [S; 2], variance: S) -> Self {
        let [a, b] = self.apply(pair);
        let one = S::one();
        let root = (one + variance * (a * a + b * b)).root();
        let factor = variance / (root * (one + root));
        let [w0, w1] = self.rows;
        let along = [0, 1].map(|k| factor * (a * w0[k] + b * w1[k]));
        Self { rows: [[w0[0] - a * along[0], w0[1] - a * along[1]], [w1[0] - b * along[0], w1[1] - b * along[1]]] }
    }

    /// [`Self::loosened`] where `variance` is positive.
    #[inline(always)]
    fn loosened_if_positive(self, pair: [S; 2], variance: S) -> Self {
        if variance > S::zero() { self.loosened(pair, variance) } else { self }
    }

    /// For the pair of a cell whose parts may be displaced along each axis by a standard deviation of which
    /// `variance` is the square, m²: that does to the currents what moving the tool the other way does,
    /// by `jacobian`, of which the first three columns are the tool's translation.
    #[cold]
    pub fn displaced(&self, jacobian: &[[S; 6]; 2], variance: S) -> Self {
        (0..3).fold(*self, |whitener, axis| whitener.loosened(jacobian.map(|row| row[axis]), variance))
    }

    /// For derivatives that are to be counted in units of `unit`.
    #[inline(always)]
    pub fn scaled(&self, unit: S) -> Self {
        let [first, second] = self.rows;
        Self { rows: [[first[0] * unit, first[1] * unit], [second[0] * unit, second[1] * unit]] }
    }

    #[inline(always)]
    pub fn apply(&self, pair: [S; 2]) -> [S; 2] {
        let [first, second] = self.rows;
        [first[0] * pair[0] + first[1] * pair[1], second[0] * pair[0] + second[1] * pair[1]]
    }
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct CellNoise<S> {
    /// 2qB: variance of the total current per ampere of light.
    shot: S,
    /// 4kT·B/R_ie, and what the places where the dark current starts do.
    johnson: S,
    /// Of converter and amplifier, and of the model's currents, per electrode.
    converter: S,
    /// Relative variance of the emitter's gain: [`super::levels`] adds to it while a tool is tracked.
    pub emitter_gain: S,
    /// Relative variance of the total current by model error, at the centre of the detector.
    relative: S,
    electrode_gain: S,
    /// Variance of X_A/Lx: model error, and more on the way from far off.
    position: S,
    /// Variance of the place of the cell's parts per axis, m²: see [`Whitener::displaced`].
    pub displacement: S,
    /// Of the variances of the model's errors: see [`ModelError::reach`](crate::ModelError::reach).
    growth: S,
    /// Square of the relative error of the arithmetic: of the exact tier's integrals, or rounding.
    arithmetic: S,
    dark: S,
}

impl<S: Number> CellNoise<S> {
    pub fn compile(scene: &Scene, cell: usize, relative_error: f64) -> Self {
        let detector = &scene.cells[cell].detector;
        let (shot, dark, johnson, converter) = scene.noise.map_or((0.0, 0.0, 0.0, 0.0), |noise| {
            // Starting anywhere between the electrodes, an electron of the dark current divides into
            // ½ ∓ x/Lx, of which the variance is 1/12.
            let dark = noise.dark_shot_a2(detector);
            (noise.shot_a(), dark, noise.johnson_a2(detector) + dark / 12.0, noise.adc_a * noise.adc_a)
        });
        let Uncertainty { emitter_gain_relative, electrode_gain_relative, position_m, .. } = scene.uncertainty;
        let error = scene.cells[cell].effects.model_error;
        let moved = error.position_m / detector.length_m;
        // Two cells that read one detector see the same photons of the same emitter: what is common to both counts
        // twice in each, for their mean knows it no better than one.
        let common = if scene.cells[cell].other_axis().is_some() { 2.0 } else { 1.0 };
        Self {
            shot: S::of(common * shot),
            johnson: S::of(johnson),
            converter: S::of(converter + error.current_a * error.current_a),
            emitter_gain: S::of(common * emitter_gain_relative * emitter_gain_relative),
            relative: S::of(common * error.relative * error.relative),
            electrode_gain: S::of(electrode_gain_relative * electrode_gain_relative),
            position: S::of(moved * moved),
            displacement: S::of(position_m * position_m),
            growth: S::of(error.reach.map_or(0.0, |reach| libm::pow(reach, -8.0))),
            arithmetic: S::of(relative_error * relative_error),
            dark: S::of(dark),
        }
    }

    /// The same cell taken less literally: gain known to 5 %, position to 0.1 mm. Far from the
    /// solution true weights turn χ² into narrow bent valleys; these keep it round.
    pub fn coarse(&self, detector_length_m: S) -> Self {
        let position = S::of(1e-4) / detector_length_m;
        Self {
            emitter_gain: self.emitter_gain.max(S::of(0.05 * 0.05)),
            position: self.position.max(position * position),
            growth: S::zero(),
            ..*self
        }
    }

    /// The weights at the measured `currents` (above dark).
    ///
    /// Shot noise of a point spot is common to both electrodes and divides like the current; that of the
    /// dark current divides evenly;
    /// Johnson noise of the inter-electrode resistance flows out of one electrode into the other;
    /// unknown gains are nuisance parameters marginalised here: each belongs to this cell alone, so its
    /// effect is a covariance of this pair. So is that of displaced parts, which depends on the pose:
    /// [`Whitener::displaced`]. An emitter gain known to nothing leaves the ratio of the currents.
    #[inline(always)]
    pub fn whitener(&self, currents: [S; 2]) -> Whitener<S> {
        let (half, one) = (S::half(), S::one());
        let total = (currents[0] + currents[1]).abs();
        let square = total * total;
        let own = self.converter + self.arithmetic * square;
        let mut whitener =
            Whitener::of_variances(currents.map(|current| own + self.electrode_gain * current * current));
        let (mut position, mut relative) = (self.position, self.relative);
        if self.growth > S::zero() {
            let difference = currents[1] - currents[0];
            let from_centre = (difference * difference / square).min(S::one());
            let fourth = from_centre * from_centre;
            let grown = S::one() + self.growth * fourth * fourth;
            (position, relative) = (position * grown, relative * grown);
        }
        let across = self.johnson + position * square;
        whitener = whitener.loosened_if_positive([-one, one], across);
        if self.dark > S::zero() {
            whitener = whitener.loosened([half, half], self.dark);
        }
        let along = self.shot * total / square + self.emitter_gain + relative;
        whitener.loosened_if_positive(currents, along)
    }
}

/// One whitened residual and its derivatives by the scaled pose and by the light level.
#[derive(Clone, Copy, Debug)]
pub struct Row<S> {
    pub by_pose: Vector6<S>,
    /// Zero where the level is known.
    pub by_level: S,
    pub residual: S,
}

/// Sums over residuals r: χ² = rᵀr, and Jᵀr by the pose, by the twist, by the bend and by the light level.
#[derive(Clone, Copy)]
pub struct ResidualSums<S> {
    pub chi2: S,
    pub by_pose: Vector6<S>,
    pub by_twist: Vector6<S>,
    pub by_bend: Vector6<S>,
    pub by_level: S,
}

impl<S: Number> ResidualSums<S> {
    #[inline(always)]
    pub fn none() -> Self {
        let zero = S::zero();
        Self { chi2: zero, by_pose: [zero; 6], by_twist: [zero; 6], by_bend: [zero; 6], by_level: zero }
    }

    /// Adds the `rows` of one reading, exposed at `share` of the motion's duration; to `by_bend` only if that is asked for.
    #[inline(always)]
    pub fn add(&mut self, rows: &[Row<S>], share: S, has_bend: bool) {
        let mut own = [S::zero(); 6];
        for row in rows {
            self.chi2 += row.residual * row.residual;
            self.by_level += row.by_level * row.residual;
            for i in 0..6 {
                own[i] += row.by_pose[i] * row.residual;
            }
        }
        for i in 0..6 {
            self.by_pose[i] += own[i];
            self.by_twist[i] += share * own[i];
        }
        if has_bend {
            for i in 0..6 {
                self.by_bend[i] += share * share * own[i];
            }
        }
    }
}

/// Probability of a larger χ² by chance at which a fit is doubted: 1e-9, six one-sided σ.
const GATE_SIGMAS: f64 = 6.0;

/// Two currents a cell, less the unknowns: six of the pose, and the light level if that is one.
pub fn redundancy(cells: usize, has_level: bool) -> usize {
    (2 * cells).saturating_sub(6 + usize::from(has_level))
}

/// The χ² that `freedom` degrees of freedom exceed with probability 1e-9 (Wilson and Hilferty
/// 1931). Without redundancy a fit is exact, but for noise that leads past a fold of the currents:
/// counted as one degree.
pub fn chi2_gate(freedom: usize) -> f64 {
    let k = freedom.max(1) as f64;
    let spread = 2.0 / (9.0 * k);
    let root = 1.0 - spread + GATE_SIGMAS * libm::sqrt(spread);
    k * root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise<S: Number>(emitter_gain: f64) -> CellNoise<S> {
        CellNoise {
            shot: S::of(3.2e-15),
            johnson: S::of(3.4e-21),
            converter: S::of(3.6e-19),
            emitter_gain: S::of(emitter_gain * emitter_gain),
            electrode_gain: S::of(1e-6),
            relative: S::of(1e-6),
            position: S::of(1e-8),
            growth: S::of(4e3),
            displacement: S::zero(),
            arithmetic: S::of(1e-20),
            dark: S::of(1e-21),
        }
    }

    #[test]
    fn whitened_pairs_have_unit_variance() {
        let (noise, pair) = (noise::<f64>(0.01), [2e-6, 4e-6]);
        let whitener = noise.whitener(pair);
        let total = pair[0] + pair[1];
        let mut covariance = [[0.0; 2]; 2];
        let mut add = |p: [f64; 2], variance: f64| {
            for i in 0..2 {
                for j in 0..2 {
                    covariance[i][j] += variance * p[i] * p[j];
                }
            }
        };
        for electrode in [[1.0, 0.0], [0.0, 1.0]] {
            let current = electrode[0] * pair[0] + electrode[1] * pair[1];
            add(electrode, 3.6e-19 + 1e-20 * total * total + 1e-6 * current * current);
        }
        let grown = 1.0 + 4e3 / 3.0_f64.powi(8);
        add([-1.0, 1.0], 3.4e-21 + 1e-8 * grown * total * total);
        add([0.5, 0.5], 1e-21);
        add(pair, 3.2e-15 / total + 1e-4 + 1e-6 * grown);
        for i in 0..2 {
            for j in 0..2 {
                let product: f64 = (0..2)
                    .flat_map(|k| (0..2).map(move |l| (k, l)))
                    .map(|(k, l)| whitener.rows[i][k] * covariance[k][l] * whitener.rows[j][l])
                    .sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j}: {product}");
            }
        }
    }

    /// What moves light along the detector changes the ratio at a given sum; its weight must not
    /// depend on how little the gain is known.
    fn ratio_weight<S: Number>(emitter_gain: f64) -> f64 {
        let pair = [S::of(2e-6), S::of(4e-6)];
        let whitener = noise::<S>(emitter_gain).whitener(pair);
        // Of all unit vectors the part across what the gain does.
        let [a, b] = whitener.apply([S::of(-1e-8), S::of(1e-8)]);
        let [c, d] = whitener.apply(pair);
        let length = (c * c + d * d).sqrt();
        ((a * d - b * c) / length).abs().as_f64()
    }

    /// The photons and the gain of one emitter, read twice: both readings together know them as well as one does.
    #[test]
    fn what_two_axes_share_is_known_no_better_than_by_one() {
        let mut scene = super::super::fixture::head();
        scene.noise = Some(crate::scene::Noise {
            shot_bandwidth_hz: 1e5,
            johnson_bandwidth_hz: 0.0,
            temperature_k: 300.0,
            adc_a: 1e-15,
        });
        let information = |scene: &Scene, gain: f64| -> f64 {
            let mut scene = scene.clone();
            scene.uncertainty.emitter_gain_relative = gain;
            let [a, b] = CellNoise::<f64>::compile(&scene, 0, 1e-15).whitener([2e-6, 4e-6]).apply([2e-6, 4e-6]);
            a * a + b * b
        };
        for gain in [0.0, 0.01] {
            let one = information(&scene, gain);
            scene.cells[0].effects.other_axis = Some(1);
            let both: f64 = 2.0 * information(&scene, gain);
            scene.cells[0].effects.other_axis = None;
            assert!((both / one - 1.0).abs() < 1e-6, "{gain}: {both} {one}");
        }
    }

    #[test]
    fn an_unknown_gain_leaves_the_ratio() {
        let reference = ratio_weight::<f64>(1.0);
        for gain in [1e1, 1e3, 1e6] {
            assert!((ratio_weight::<f64>(gain) / reference - 1.0).abs() < 1e-3, "{gain}");
        }
        for gain in [1e-1, 1.0, 1e1] {
            // The direction itself, not its weight, is what single precision rounds.
            let single = ratio_weight::<f32>(gain) / ratio_weight::<f64>(gain);
            assert!((single - 1.0).abs() < 1e-2, "{gain}: {single}");
        }
    }

    #[test]
    fn the_gate_of_chi2_is_passed_by_chance_once_in_a_billion() {
        // Quantiles of χ² for 9.9e-10, from its closed form for even degrees of freedom. The cube root is
        // a normal deviate to a few percent, least so for few degrees.
        for (freedom, quantile) in [(2, 41.47), (4, 47.91), (6, 53.37), (10, 62.98), (26, 94.63)] {
            let ratio = chi2_gate(freedom) / quantile;
            assert!((0.99..1.2).contains(&ratio), "{freedom}: {ratio}");
        }
    }
}

//! The currents of one cell by an independent integration.
//!
//! Nothing here is shared with the model: the spot's sides come from differences that are exact in
//! the near field, and the integrals are done by the double exponential rule (Takahashi and Mori
//! 1974), which does not mind that the light ends within the spot.

use glam::DVec3;
use slitpose_model::Pair;

/// Step and reach of the double exponential rule: some 1e-15 of smooth integrals.
const STEP: f64 = 1.0 / 16.0;
const REACH: f64 = 3.4;

/// A detector at the origin, x along its length, z up, under a thin parallel slit, and a cosine
/// emitter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reference {
    /// Half length and half width of the active area, metres.
    pub(super) half_m: [f64; 2],
    /// Half width and half length of the slit, metres.
    pub(super) slit_half_m: [f64; 2],
    /// Height of the slit, metres.
    pub(super) slit_height_m: f64,
    /// Position of the emitter, metres.
    pub(super) emitter_m: DVec3,
    pub(super) axis: DVec3,
    pub(super) exponent: f64,
    /// Responsivity times radiant intensity, A/sr.
    pub(super) gain_a_per_sr: f64,
}

impl Reference {
    /// The photocurrents of both electrodes above dark; none without spot.
    pub(super) fn currents(&self) -> Option<Pair<f64>> {
        let [x, y] = [0, 1].map(|axis| self.side(axis));
        if self.emitter_m.z <= self.slit_height_m || x[1] <= x[0] || y[1] <= y[0] {
            return None;
        }
        let (mut power, mut moment) = (Sum::default(), Sum::default());
        double_exponential(y, |y_m, weight| {
            let row = self.lit(x, y_m);
            double_exponential(row, |x_m, column_weight| {
                let light = weight * column_weight * self.density(x_m, y_m);
                power.add(light);
                moment.add(light * x_m);
            });
        });
        let total_a = self.gain_a_per_sr * power.total();
        let imbalance_a = self.gain_a_per_sr * moment.total() / (2.0 * self.half_m[0]);
        Some(Pair { i_x1_a: 0.5 * total_a - imbalance_a, i_x2_a: 0.5 * total_a + imbalance_a })
    }

    /// Ends of the spot along x or y: where the rays past the slit's edges land, within the active
    /// area. Near the slit the edge's distance from the emitter is exact; far from it the emitter's
    /// own share is small. Either way no two large numbers are subtracted.
    fn side(&self, axis: usize) -> [f64; 2] {
        let emitter = self.emitter_m.to_array()[axis];
        let above = self.emitter_m.z - self.slit_height_m;
        let is_near = above < self.slit_height_m;
        let landing = |edge: f64| match is_near {
            true => edge + (edge - emitter) * (self.slit_height_m / above),
            false => (edge * self.emitter_m.z - emitter * self.slit_height_m) / above,
        };
        let (slit, half) = (self.slit_half_m[axis], self.half_m[axis]);
        [landing(-slit).max(-half), landing(slit).min(half)]
    }

    /// The part of a row that is not behind the emitter's horizon.
    fn lit(&self, [from, to]: [f64; 2], y_m: f64) -> [f64; 2] {
        let towards = |x_m: f64| self.axis.dot(DVec3::new(x_m, y_m, 0.0) - self.emitter_m);
        let (at_from, at_to) = (towards(from), towards(to));
        let cut = (from + (to - from) * at_from / (at_from - at_to)).clamp(from, to);
        match (at_from > 0.0, at_to > 0.0) {
            (true, true) => [from, to],
            (true, false) => [from, cut],
            (false, true) => [cut, to],
            (false, false) => [from, from],
        }
    }

    /// I_rel·dΩ/dA at a point of the detector, 1/m².
    fn density(&self, x_m: f64, y_m: f64) -> f64 {
        let ray = DVec3::new(x_m, y_m, 0.0) - self.emitter_m;
        let distance = ray.length();
        let cosine = (self.axis.dot(ray) / distance).max(0.0);
        cosine.powf(self.exponent) * self.emitter_m.z / (distance * distance * distance)
    }
}

/// A sum with the rounding of each addition carried along (Neumaier 1974).
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    sum: f64,
    lost: f64,
}

impl Sum {
    fn add(&mut self, value: f64) {
        let sum = self.sum + value;
        self.lost += if self.sum.abs() >= value.abs() { self.sum - sum + value } else { value - sum + self.sum };
        self.sum = sum;
    }

    fn total(self) -> f64 {
        self.sum + self.lost
    }
}

/// Nodes and weights between two ends, handed to `add`.
fn double_exponential([from, to]: [f64; 2], mut add: impl FnMut(f64, f64)) {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let steps = (REACH / STEP) as i32;
    for step in -steps..=steps {
        let t = f64::from(step) * STEP;
        let inner = std::f64::consts::FRAC_PI_2 * t.sinh();
        let weight = std::f64::consts::FRAC_PI_2 * t.cosh() / inner.cosh().powi(2);
        add(middle + half * inner.tanh(), half * STEP * weight);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bench() -> Reference {
        Reference {
            half_m: [6e-3, 0.5e-3],
            slit_half_m: [0.2e-3, 5e-3],
            slit_height_m: 7.5e-3,
            emitter_m: DVec3::Z * 15e-3,
            axis: -DVec3::Z,
            exponent: 1.246_972_446_943_723_8,
            gain_a_per_sr: 0.54 * 3.16e-3,
        }
    }

    #[test]
    fn the_numbers_are_those_of_fifty_digits() {
        // tests/data/reference/single_cell.csv: nominal, near_8.0, far_1e6, grazing_92deg.
        // The last one's axis is at 91° from the detector's normal; its name counts otherwise.
        let angle = 91f64.to_radians();
        for (reference, expected) in [
            (bench(), [3.029_692_458_806_154e-6, 3.029_692_458_806_154e-6]),
            (
                Reference { emitter_m: DVec3::new(0.3e-3, 0.1e-3, 8e-3), ..bench() },
                [6.133_932_375_119_397e-5, 1.790_669_607_930_650_4e-5],
            ),
            (
                Reference { emitter_m: DVec3::Z * 1e3, ..bench() },
                [3.412_825_596_191_271_4e-16, 3.412_825_596_191_271_4e-16],
            ),
            (
                Reference { axis: DVec3::new(angle.sin(), 0.0, -angle.cos()), ..bench() },
                [6.333_633_794_185_823e-10, 7.136_066_487_273_359e-10],
            ),
        ] {
            let pair = reference.currents().unwrap();
            for (found, expected) in [pair.i_x1_a, pair.i_x2_a].into_iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 3e-15, "{found:e} {expected:e}");
            }
        }
    }

    #[test]
    fn there_is_no_light_where_there_is_none() {
        assert!(Reference { emitter_m: DVec3::Z * 7.5e-3, ..bench() }.currents().is_none());
        assert!(Reference { emitter_m: DVec3::new(6.5e-3, 0.0, 15e-3), ..bench() }.currents().is_none());
        let away = Reference { axis: DVec3::Z, ..bench() }.currents().unwrap();
        assert_eq!(away.total_a(), 0.0);
    }
}

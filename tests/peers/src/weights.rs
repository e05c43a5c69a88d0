//! What the peers are told of a cell's two currents: their values, and a whitening by their
//! covariance, the same that slitpose computes for itself.

use slitpose_model::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C, Noise, Pair, Scene};

/// Cells of a head: the peers' problems have fixed sizes.
pub const CELLS: usize = 6;

#[derive(Clone, Copy, Debug)]
pub struct CellNoise {
    /// Variance of the total current per ampere: 2qB.
    shot_a: f64,
    /// 4kT·B/R_ie, A²: flows out of one electrode into the other.
    johnson_a2: f64,
    /// Of converter and amplifier, per electrode, A².
    converter_a2: f64,
}

/// The measured currents of one cell and the inverse of the lower Cholesky factor of their
/// covariance. Laid out as in `cpp/head.h`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct Weighted {
    currents_a: [f64; 2],
    whiten_first: f64,
    whiten_mixed: f64,
    whiten_second: f64,
}

impl CellNoise {
    /// The noise of each cell of `scene`.
    ///
    /// # Panics
    /// If the scene tells no noise or does not have six cells.
    pub fn of(scene: &Scene) -> [Self; CELLS] {
        let noise: &Noise = scene.noise.as_ref().expect("a scene with noise");
        core::array::from_fn(|cell| {
            let johnson = 4.0 * BOLTZMANN_J_PER_K * noise.temperature_k * noise.johnson_bandwidth_hz;
            Self {
                shot_a: 2.0 * ELEMENTARY_CHARGE_C * noise.shot_bandwidth_hz,
                johnson_a2: scene.cells[cell].detector.interelectrode_ohm.map_or(0.0, |ohm| johnson / ohm),
                converter_a2: noise.adc_a * noise.adc_a,
            }
        })
    }

    /// Lower Cholesky factor of the covariance at `currents`: [first, mixed, second].
    pub fn factor(&self, currents: &Pair<f64>) -> [f64; 3] {
        // Shot noise of a point spot is common to both electrodes and divides like the current.
        let [first, second] = [currents.i_x1_a, currents.i_x2_a];
        let shot = self.shot_a / (first + second);
        let own = self.converter_a2 + self.johnson_a2;
        let a = (own + shot * first * first).sqrt();
        let b = (shot * first * second - self.johnson_a2) / a;
        [a, b, (own + shot * second * second - b * b).sqrt()]
    }

    #[inline]
    pub fn weigh(&self, currents: &Pair<f64>) -> Weighted {
        let [a, b, c] = self.factor(currents);
        Weighted {
            currents_a: [currents.i_x1_a, currents.i_x2_a],
            whiten_first: a.recip(),
            whiten_mixed: -b / (a * c),
            whiten_second: c.recip(),
        }
    }
}

impl Weighted {
    /// Whitened difference of `predicted` and measured currents.
    #[inline]
    pub fn residual(&self, predicted: &Pair<f64>) -> [f64; 2] {
        self.whiten([predicted.i_x1_a - self.currents_a[0], predicted.i_x2_a - self.currents_a[1]])
    }

    /// A pair of differences of the two currents, made uncorrelated and of unit variance.
    #[inline]
    pub fn whiten(&self, [first, second]: [f64; 2]) -> [f64; 2] {
        [self.whiten_first * first, self.whiten_mixed * first + self.whiten_second * second]
    }
}

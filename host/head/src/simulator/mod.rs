//! A simulated board with a moving tool.
//!
//! [`Trajectory`] moves the tool; the optics of the scene turn its pose at each instant into
//! photocurrents; the electronics settle, add noise, saturate and quantise; `SimulatedHardware`
//! delivers the words to the firmware's own core, as a board's converters do; [`SimulatedBoard`]
//! advances time and exchanges bytes. All results are determined by the seed. [`noisy_reading`] is the short way from
//! photocurrents to a reading, for tables.

mod board;
mod electronics;
mod hardware;
mod reversals;
mod trajectory;

pub use board::{SimulatedBoard, SimulatorError};
pub use electronics::{CellNoise, Electrode, Electronics};
pub use trajectory::{MAX_KNOTS, PathError, Trajectory, TrajectoryKind};

use std::fmt::Debug;

use slitpose_model::{CompiledScene, Detector, Noise, Pair, Pose};

/// Optics of a head. [`CompiledScene`] has those of the model; a virtual bench may have more.
pub trait Light: Debug + Send + Sync {
    /// Number of cells.
    fn cell_count(&self) -> usize;

    /// Photocurrents of `cell` above dark, amperes, while the emitters `lit` shine, each at its level relative to
    /// nominal, with the tool at `pose`.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64>;
}

impl Light for CompiledScene<f64> {
    fn cell_count(&self) -> usize {
        self.cell_count()
    }

    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64> {
        self.photocurrents_of(cell, lit.iter().copied(), pose)
    }
}

/// The photocurrents `clean` of `detector` with `noise`; `normal` gives standard normal numbers, four for each reading.
///
/// Shot noise of a point spot is common to both electrodes and divides like the current; Johnson noise flows from one
/// to the other; that of the converter is each electrode's own.
pub fn noisy_reading(
    clean: Pair<f64>,
    detector: &Detector,
    noise: &Noise,
    mut normal: impl FnMut() -> f64,
) -> Pair<f64> {
    let total_a = clean.total_a();
    let variance_a2 = noise.shot_a() * total_a.abs() + noise.dark_shot_a2(detector);
    let shot = normal() * if total_a == 0.0 { 0.0 } else { variance_a2.sqrt() / total_a };
    let johnson_a = noise.johnson_a2(detector).sqrt() * normal();
    Pair {
        i_x1_a: clean.i_x1_a * (1.0 + shot) + johnson_a + noise.adc_a * normal(),
        i_x2_a: clean.i_x2_a * (1.0 + shot) - johnson_a + noise.adc_a * normal(),
    }
}

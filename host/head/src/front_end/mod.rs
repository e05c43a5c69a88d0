//! Conversion between ADC codes and currents, the interface of board and optics.
//!
//! [`configuration`] derives a board's schedule from a scene's lighting and electronics; [`Settling`] is the response
//! of a first-order front end to switched light; [`Stage`] converts scans, and has the noise of lit-minus-dark
//! currents.

mod noise;
mod settling;
mod stage;
#[cfg(test)]
mod tests;
mod timing;

pub use noise::{ROOM_TEMPERATURE_K, dark_word_noise_a};
pub use settling::Settling;
pub use stage::Stage;
pub use timing::{TimingError, board_configuration, configuration};

/// Largest relative difference of the full scales of one front end, above the tolerance of resistors.
const FULL_SCALE_SLACK: f64 = 0.01;

/// Whether a board with the full scale `board_a` may have the front end of a scene with `scene_a`, amperes.
pub fn is_full_scale_of(board_a: f64, scene_a: f64) -> bool {
    (board_a / scene_a - 1.0).abs() <= FULL_SCALE_SLACK
}

//! Between counts and currents: the one place where board and optics meet.
//!
//! [`configuration`] turns a scene's lighting and electronics into the schedule a board runs;
//! [`Settling`] is the response of a first-order front end to switched light; [`Stage`] has its effect on the noise of a
//! lit-minus-dark current, and converts scans.

mod noise;
mod settling;
mod stage;
#[cfg(test)]
mod tests;
mod timing;

pub use noise::{ROOM_TEMPERATURE_K, dark_word_noise_a};
pub use settling::Settling;
pub use stage::Stage;
pub use timing::{TimingError, configuration};

/// Full scales that differ by more are not those of one front end: resistors are better than that.
const FULL_SCALE_SLACK: f64 = 0.01;

/// Whether a board that measures up to `board_a` may have the front end of a scene that says `scene_a`.
pub fn is_full_scale_of(board_a: f64, scene_a: f64) -> bool {
    (board_a / scene_a - 1.0).abs() <= FULL_SCALE_SLACK
}

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
mod knots;
mod light;
mod reading;
mod reversals;
mod trajectory;

pub use board::{SimulatedBoard, SimulatorError};
pub use electronics::{CellNoise, Electrode, Electronics};
pub use light::Light;
pub use reading::noisy_reading;
pub use trajectory::{MAX_KNOTS, PathError, Trajectory, TrajectoryKind};

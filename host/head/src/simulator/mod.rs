//! A simulated board with a moving tool.
//!
//! [`Trajectory`] moves the tool; the optics of the scene turn its pose at each instant into
//! photocurrents; the electronics settle, add noise, saturate and quantise; `SimulatedHardware`
//! delivers the words to the firmware's own core, as a board's converters do; [`SimulatedBoard`]
//! advances time and exchanges bytes. All results are determined by the seed.

mod board;
mod electronics;
mod hardware;
mod knots;
mod reversals;
mod trajectory;

pub use board::{SimulatedBoard, SimulatorError};
pub use electronics::{CellNoise, Electrode, Electronics};
pub use trajectory::{PathError, Trajectory, TrajectoryKind};

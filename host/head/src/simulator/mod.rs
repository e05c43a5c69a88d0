//! A board with a tool in front of it, made of arithmetic.
//!
//! [`Trajectory`] moves the tool; the optics of the scene turn its pose at each instant into
//! photocurrents; the electronics settle, add noise, saturate and quantise; `SimulatedHardware`
//! hands the words to the firmware's own core, as a board's converters would; [`SimulatedBoard`]
//! lets time pass and carries bytes. Everything follows from the seed.

mod board;
mod electronics;
mod hardware;
mod knots;
mod reversals;
mod trajectory;

pub use board::{SimulatedBoard, SimulatorError};
pub use electronics::{CellNoise, Electrode, Electronics};
pub use trajectory::{PathError, Trajectory, TrajectoryKind};

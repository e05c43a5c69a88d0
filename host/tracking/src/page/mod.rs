//! Messages between the live page and the program that serves it (LIVE.md).
//!
//! A [`Sampler`] condenses the poses of a board: the newest, and statistics of all in bins of time. [`Optics`] makes a frame
//! of it, [`head_message`] describes the head.

mod bins;
mod frame;
mod message;

pub use bins::{Bins, COARSE_HZ, FINE_HZ};
pub use frame::{FRAMES_HZ, MAP_POINTS, Optics, Sample, Sampler, SceneView, head_message};
pub use message::{
    COARSE_S, CalibrationState, HISTORY_S, Order, Plane, PlayerOrder, PlayerState, Refusal, Request, hello,
    report_message,
};

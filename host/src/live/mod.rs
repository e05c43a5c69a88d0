//! The live page: heads, poses and health in a browser.
//!
//! ```text
//!  solver ──▶ Sampler ──samples, 30/s──▶ Hub ──text──▶ Session ──WebSocket──▶ page
//!            (one a board)              (history)      (one a client)
//! ```
//!
//! A [`Sampler`] condenses the poses of a board: the newest, and statistics of all in bins of time. The [`LiveServer`] has
//! a thread of its own, which turns samples into JSON once for all clients and keeps the frames of the last minute and
//! the coarse bins of the last ten. No client can delay a pose: a sample that finds the thread busy goes into the next one, and a client that does
//! not acknowledge what it got is sent the newest frames only, and how many it has missed. `LIVE.md` describes the
//! messages.

mod control;
mod hub;
mod recordings;
mod server;
mod session;
#[cfg(test)]
mod tests;

pub(crate) use control::{Access, Control, DEFAULT_LIVE_ADDRESS, live_address};
pub(crate) use hub::{Input, LiveBoard, LiveInput};
pub(crate) use recordings::{Calibrate, Recordings, now_in_a_name};
pub(crate) use server::{LivePlan, LiveServer};

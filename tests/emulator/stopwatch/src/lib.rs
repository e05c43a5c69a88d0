//! What an image that times the pose solver and its host say to each other.
//!
//! The host writes a [`Request`] into the image's [`Mailbox`], sets its state to [`State::Asked`]
//! and reads the [`Answer`] when the state is [`State::Waiting`] again: an emulator through its
//! memory, a debug probe through the core's. All that is said is numbers, `f64`, in the order in
//! which [`Request::write`] and [`Answer::write`] put them.
//!
//! | request | answer |
//! |---|---|
//! | [`Request::Scene`]: a new scene, without cells | [`Answer::Done`] |
//! | [`Request::Cell`]: one more cell of it | [`Answer::Done`] |
//! | [`Request::Compile`]: a solver for the scene | [`Answer::Done`] |
//! | [`Request::Solve`]: one timed solve | [`Answer::Solved`] |
//!
//! A request that cannot be carried out is answered with [`Answer::Refused`].
#![no_std]

mod mailbox;
mod message;
mod numbers;

pub use mailbox::{MAILBOX_SYMBOL, Mailbox, SLOTS, State};
pub use message::{Answer, Request, Solved};
pub use numbers::Numbers;

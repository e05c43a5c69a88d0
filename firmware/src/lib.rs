//! The core of a slitpose board: what it does with scans, commands and a link.
//!
//! The same core runs on the board, over converters and timers, and on a host, over a
//! simulator. Both sides are sans-IO: [`Hardware`] is the only way down, and bytes go in
//! by [`Board::receive`] and out by [`Board::transmit`].
//!
//! ```text
//! Hardware ─RawScan▶ collector ─Batch▶ outbox ─packets▶ Board::transmit ▶ link
//!     ▲                                  ▲ replies, events
//!     └──────── commands ◀──────── Board::receive ◀ link
//! ```
//!
//! # Latency
//! A batch is closed when it holds [`BATCH_SCANS`] scans, or as many as there are frames
//! in [`BATCH_SPAN_MS`] if that is fewer. Its first scan therefore waits for three more
//! frames at 4 kHz (0.75 ms), for one at 2 kHz (0.5 ms), and for none at 1 kHz and below.
//! It is closed early by a gap, a change of levels, a new configuration and a stop. To
//! this come the hardware's own rings, the interval between polls, and the link.
//!
//! # Loss
//! Every scan has a number. Whoever loses one counts it, and [`Status`] adds up:
//! the converters' loss is a gap in the numbers, the link's loss is counted packet by
//! packet as the outbox drops its oldest. Replies and events have a store of their own,
//! so scans cannot crowd them out; the two are sent in the order they arose.
//!
//! # Light
//! Emitters are lit only between an accepted Start and whatever ends it: a Stop, a
//! hardware fault, or a link closed for [`HOST_GONE_MS`]. If the hardware cannot confirm
//! that they are off, it is told again at every poll.
//!
//! [`Status`]: slitpose_protocol::Status

#![no_std]
#![forbid(unsafe_code)]

mod board;
mod collector;
mod commands;
mod defaults;
mod exposure;
mod hardware;
mod outbox;
mod queue;
pub mod settings;
pub mod timing;
mod validate;
pub mod wiring;

#[cfg(test)]
extern crate std;

pub use board::{Board, HOST_GONE_MS, Identity, Link, STATUS_MS, TRANSFER_BYTES, Transfer};
pub use collector::{BATCH_SCANS, BATCH_SPAN_MS};
pub use defaults::{DEFAULT_QUEUE_BYTES, TICK_HZ, default_configuration, default_scaling};
pub use hardware::{Hardware, Health, Indicator, ScanError, StorageError};
pub use validate::can_run;

//! The core of a slitpose board: what a board does with scans, commands and a link.
//!
//! The same core runs on the MCU, over converters and timers, and on a host, over a
//! simulator. Both sides are sans-IO: [`Hardware`] is the only way down, and bytes go in
//! by [`Board::receive`] and out by [`Board::transmit`].
//!
//! ```text
//! Hardware ─RawScan▶ collector ─Batch▶ outbox ─packets▶ Board::transmit ▶ link
//!     ▲                                  ▲ replies, events
//!     └──────── commands ◀──────── Board::receive ◀ link
//! ```
//!
//! [`pcb`] describes the one board that the image is made for: its wiring, its timers and
//! converters, its defaults. The core uses nothing of it.
//!
//! # Latency
//! A batch is closed when it holds [`BATCH_SCANS`] scans, or as many as there are frames
//! in [`BATCH_SPAN_MS`] if that is fewer. Its first scan therefore waits for three more
//! frames at 4 kHz (0.75 ms), for one at 2 kHz (0.5 ms), and for none at 1 kHz and below.
//! A gap, a change of levels, a new configuration and a stop close a batch early. The
//! hardware's own rings, the interval between polls, and the link add to the latency.
//!
//! # Loss
//! Every scan has a number, and every lost scan is counted in [`Status`]. Scans that the
//! hardware loses are gaps in the numbers; scans that the link is too slow for are counted
//! packet by packet as the outbox drops its oldest. Replies and events have a queue of
//! their own, so that scans cannot crowd them out; packets of both queues are sent in the
//! order in which they arose.
//!
//! # Light
//! Emitters are lit only between an accepted Start and a Stop, a hardware fault, or a link
//! closed for [`HOST_GONE_MS`]. Until the hardware confirms that the emitters are off, the
//! board switches them off again at every poll.
//!
//! [`Status`]: slitpose_protocol::Status

#![no_std]
#![forbid(unsafe_code)]

mod board;
mod collector;
mod exposure;
mod hardware;
mod outbox;
pub mod pcb;
mod queue;
pub mod settings;
mod validate;

#[cfg(test)]
mod fixture;

#[cfg(test)]
extern crate std;

pub use board::{Board, HOST_GONE_MS, Identity, Link, STATUS_MS, TRANSMIT_BYTES, TransmitBuffer};
pub use collector::{BATCH_SCANS, BATCH_SPAN_MS};
pub use hardware::{Acquisition, Hardware, Health, Indicator, ScanError, Storage, StorageError, System};

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
//! # Example
//! A board over hardware that has no light answers a ping:
//! ```
//! use slitpose_firmware::{pcb::*, settings::Settings, *};
//! use slitpose_protocol::*;
//!
//! struct Desk(u64);
//! impl Acquisition for Desk {
//!     fn check(&self, _: &Configuration) -> Result<(), HardwareFault> { Ok(()) }
//!     fn limit_levels(&self, _: &Schedule, _: &mut [Level]) {}
//!     fn acquire(&mut self, _: Option<&Configuration>) -> Result<(), HardwareFault> { Ok(()) }
//!     fn next_scan(&mut self, _: &mut RawScan) -> Result<bool, ScanError> { Ok(false) }
//!     fn set_pulse(&mut self, _: Pulse, _: &Schedule) -> Result<(), HardwareFault> { Ok(()) }
//! }
//! impl Storage for Desk {
//!     fn store(&mut self, _: Option<&Settings>, _: &[u8]) {}
//!     fn stored(&mut self) -> Option<Result<(), StorageError>> { Some(Ok(())) }
//! }
//! impl System for Desk {
//!     fn now_ticks(&mut self) -> u64 { self.0 += u64::from(TICK_HZ) / 1000; self.0 }
//!     fn next_edge(&mut self) -> Option<Edge> { None }
//!     fn housekeeping(&mut self, _: Indicator) -> Health {
//!         Health { supply_v: 3.3, temperature_k: 298.0, cpu_load_permille: 0 }
//!     }
//!     fn reboot(&mut self, _: BootTarget) {}
//! }
//!
//! let identity = Identity {
//!     device_id: *b"desk number1", kind: BoardKind::Simulated, board: "desk", reset_cause: ResetCause::PowerOn,
//!     hashes: Hashes { scene: None, calibration: None }, scaling: default_scaling(),
//!     full_scale_pa: None,
//!     clock: ClockSource::Internal, settings: SettingsSource::Defaults,
//! };
//! let mut board = Board::new(Desk(0), identity, default_configuration(), vec![0; QUEUE_BYTES]).unwrap();
//! let (mut request, mut sent) = ([0; MAX_REQUEST_BYTES], [0; TRANSMIT_BYTES]);
//! board.poll(Link::Open);
//! board.receive(encode(&Request { number: 1, command: Command::Ping { token: 7 } }, &mut request).unwrap());
//! board.poll(Link::Open);
//!
//! let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
//! let mut bytes = board.transmit(&mut sent);
//! let mut is_answered = false;
//! while let Some(message) = decoder.next::<Message>(&mut bytes) {
//!     is_answered |= matches!(message, Ok(Message::Pong(Pong { token: 7, .. })));
//! }
//! assert!(is_answered);
//! ```
//!
//! [`Status`]: slitpose_protocol::Status

#![no_std]
#![forbid(unsafe_code)]

mod board;
mod collector;
mod exposure;
mod hardware;
pub mod image;
mod outbox;
pub mod pcb;
#[cfg(feature = "pose")]
pub mod pose;
#[cfg(not(feature = "pose"))]
#[path = "pose/without.rs"]
mod pose;
mod queue;
pub mod settings;

#[cfg(test)]
extern crate std;

pub use board::{Board, HOST_GONE_MS, Identity, Link, STATUS_MS, TRANSMIT_BYTES, TransmitBuffer};
pub use collector::{BATCH_SCANS, BATCH_SPAN_MS};
pub use hardware::{Acquisition, Hardware, Health, Indicator, ScanError, SolvedPose, Storage, StorageError, System};
pub use pose::Poser;

/// Number of [`slitpose_protocol::Command::Head`] on the wire.
const HEAD_KIND: u32 = 9;

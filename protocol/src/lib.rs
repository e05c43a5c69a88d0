//! The wire protocol between a slitpose board and its host.
//!
//! The crate has no clock, does no I/O and allocates nothing; it encodes values as bytes
//! and decodes them. This page specifies the bytes for decoders in any language;
//! `tests/golden.rs` tests them.
//!
//! # Framing
//! The link is a byte stream in each direction (USB serial, UART, pipe or file).
//!
//! ```text
//! packet  = COBS( payload ‖ checksum ) ‖ 0x00
//! ```
//!
//! * *checksum*: CRC-32/ISO-HDLC of the payload (polynomial 0x04C11DB7 reflected, initial
//!   value and final exclusive-or 0xFFFFFFFF; that of zlib), 4 bytes, little endian.
//! * *COBS* (Cheshire and Baker 1999) replaces every zero, so that 0x00 only ever ends a
//!   packet. A code byte n < 255 means: n − 1 bytes follow as they are, then a zero that
//!   is not sent; n = 255 means: 254 bytes follow, and no zero. The zero after the last
//!   run is not part of the data.
//! * Packets from a board have at most [`MAX_MESSAGE_BYTES`], from a host at most
//!   [`MAX_REQUEST_BYTES`], 0x00 included.
//! * A single 0x00 has no meaning and may come at any time. The side that opens a link
//!   first sends one, which ends any incomplete packet left in it.
//!
//! A receiver collects bytes up to 0x00, undoes the stuffing, compares the checksum, and
//! drops packets that do not agree; no other synchronisation is needed.
//!
//! # Values
//! Payloads are [postcard](https://postcard.jamesmunns.com/wire-format) values:
//!
//! | type | bytes |
//! |---|---|
//! | `u8`, `bool` | one byte; `bool` is 0 or 1 |
//! | `u16`, `u32`, `u64` | varint: 7 bits a byte, least significant first, high bit set in all bytes but the last |
//! | `f32`, `f64` | IEEE 754, little endian, 4 or 8 bytes |
//! | `[T; n]` | n values, no count |
//! | `list T` | varint count, then the values |
//! | `bytes`, `str` | varint count of bytes, then the bytes (`str`: UTF-8) |
//! | `?T` | 0, or 1 and the value |
//! | enum | varint number of the variant, then its fields |
//! | struct | its fields in order, without padding |
//!
//! # Board to host
//! A payload is one enum; the first byte is its number.
//!
//! **0 Hello**: `u8` major, `u8` minor (version of the protocol) · `bytes` message keys,
//! `bytes` command keys (8 bytes little endian for each kind, see [`schema`]) ·
//! `[u8; 12]` device id · enum kind (0 physical, 1 simulated) · `str` board ·
//! `str` firmware · enum reset cause (0 unknown, 1 power on, 2 brown-out, 3 pin,
//! 4 software, 5 watchdog, 6 panic, 7 stack overflow) · `?u64` scene hash · `?u64` calibration hash ·
//! scaling (`f64` zero code, `f64` amperes per code, `u8` bits, `u16` saturation code:
//! [`AdcScaling`]) · `u16` configuration · schedule.
//! It is sent when the link is opened, on request, and whenever the schedule has changed,
//! before the batches of the new schedule.
//!
//! *schedule*: `u32` ticks per second · `u32` frame ticks · `list u16` slots (bit k:
//! emitter k is lit; 0: dark; at most 17) · `u32` slot ticks · `u32` settling ticks ·
//! `u32` conversion ticks · `u16` oversampling · `u8` cells. [`Schedule`] explains their
//! timing.
//!
//! **1 Batch**: `u16` configuration · `u64` sequence and `u64` tick of the first scan ·
//! `list u16` emitter levels (0x8000: nominal; one a cell) · `bytes` samples. Samples are
//! *not* varints: little-endian 16-bit words, for each scan I_X1 and I_X2 of cell 0, 1, …
//! lit, then the same dark if the schedule has a dark slot. The scans of a batch follow
//! each other in sequence and are one frame apart; the next batch may leave a gap in
//! sequence, and then those scans are lost. Read samples only by the schedule of the
//! Hello with the same configuration number.
//!
//! **2 Status**: `u64` tick · `bool` acquiring · `u64` scans taken · `u64` scans dropped ·
//! `u32` batches dropped · `u64` scans lost · `u32` ADC overruns · `u32` replies dropped ·
//! `u32` commands damaged · `u32` commands rejected · `f32` supply in volts ·
//! `f32` temperature in kelvin · `u16` processor load in thousandths · enum clock
//! (0 internal oscillator, 1 crystal, 2 internal oscillator as the crystal did not start:
//! [`ClockSource`]) · enum settings (0 defaults, 1 stored, 2 defaults as three starts in a
//! row with the stored ones failed: [`SettingsSource`]) ([`Status`]).
//!
//! **3 Event**: `u64` tick · enum severity (0 info, 1 warning, 2 error) · `str` text.
//!
//! **4 Reply**: `u16` number of the command · enum outcome (0 accepted; 1 rejected, then
//! an enum [`Rejection`], within it perhaps a [`ScheduleError`] or a [`HardwareFault`]; their
//! variants are listed [below](#schemas)).
//!
//! **5 Pong**: `u32` token · `u64` tick.
//!
//! **6 Truth**: `u64` sequence · `[f64; 3]` translation in metres · `[f64; 4]` rotation as
//! a quaternion x, y, z, w: the pose `base_from_tool` at the reference instant of that
//! scan ([`Schedule::reference_ticks`]). Only simulators send it.
//!
//! **7 Poses**: `u16` configuration · `u64` sequence and `u64` tick of the first scan · `u8` scans
//! from one pose to the next · `u32` scans missed · `u32` number of the head ([`Hashes::number`]) ·
//! `?[f32; 21]` covariance of the last pose · `bytes` records, of 40 bytes each ([`poses`]). Sent by
//! boards that hold a head, if they are asked for.
//!
//! **8 Edges**: `u32` number of the first · `u32` missed since reset · `list u64` edges (8 at most), each twice the
//! tick, plus one if the line has risen ([`Edges`]).
//!
//! # Host to board
//! A payload is `u16` number of the command, chosen by the host, then one enum:
//! **0 Hello** · **1 Start** · **2 Stop** · **3 Configure**: schedule, `list u16` levels,
//! enum exposure (0 fixed, 1 automatic) · **4 Ping**: `u32` token · **5 Identify**: `u8`
//! seconds · **6 Store**: `?u64` scene hash, `?u64` calibration hash · **7 Forget** ·
//! **8 Reboot**: enum target (0 firmware, 1 boot loader) · **9 Head**: `u16` offset, `u16` bytes of
//! the whole, `list u8` bytes (128 at most) · **10 Stream**: `u16` of how
//! many scans the first 32 are sent, `u8` of how many poses one is sent, none if zero · **11 FullScale**: `u32`
//! picoamperes at the end of the converters' range, not zero · **12 Packet**: `u8` scans or poses in a packet at most ·
//! **13 Pulse**: `u16` frames from one pulse to the next, none if zero, `u8` slot.
//!
//! Every command with a readable number gets one Reply, after all other messages it
//! causes; a command of unknown kind gets rejection 0 (unsupported).
//!
//! # Schemas
//! Every kind as `name:fields`, first the messages, then the commands, each from number 0 on. The keys of a
//! Hello are hashes of these texts ([`schema`]). Variants of an enum, `a|b`, are numbered from 0.
//!
//! ```text
#![doc = include_str!("schemas.txt")]
//! ```
//!
//! # Example
//! ```text
//! 0b 05 07 80 fd 87 51 56 d5 c4 6b 00
//! │  │  │  └────┬────┘ └────┬────┘ └ end of packet
//! │  │  │       │           └ checksum 0x6bc4d556
//! │  │  │       └ tick 170 000 000: 0x00 + (0x7d << 7) + (0x07 << 14) + (0x51 << 21)
//! │  │  └ token 7
//! │  └ message 5: Pong
//! └ COBS: ten bytes without a zero follow
//! ```
//!
//! From host to board, a Stop with the number 3:
//! ```text
//! 07 03 02 10 20 fa 84 00
//! │  │  │  └────┬────┘ └ end of packet
//! │  │  │       └ checksum 0x84fa2010
//! │  │  └ command 2: Stop
//! │  └ number 3
//! └ COBS: six bytes without a zero follow
//! ```
//!
//! The same in Rust; bytes may arrive cut anywhere:
//! ```
//! use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, Message, Pong, Request, encode};
//!
//! let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
//! let (mut early, mut late): (&[u8], &[u8]) =
//!     (&[0x0b, 0x05, 0x07, 0x80, 0xfd], &[0x87, 0x51, 0x56, 0xd5, 0xc4, 0x6b, 0x00]);
//! assert_eq!(decoder.next::<Message>(&mut early), None);
//! let pong = Message::Pong(Pong { token: 7, tick: 170_000_000 });
//! assert_eq!(decoder.next::<Message>(&mut late), Some(Ok(pong)));
//!
//! let mut buffer = [0; 16];
//! let stop = encode(&Request { number: 3, command: Command::Stop }, &mut buffer)?;
//! assert_eq!(stop, [0x07, 0x03, 0x02, 0x10, 0x20, 0xfa, 0x84, 0x00]);
//! # Ok::<(), slitpose_protocol::EncodeError>(())
//! ```
//!
//! # Versions, and what is not promised
//! Promised for ever: the framing, and that message 0 starts with the version. Within a
//! major version kinds are only added at the end, and the fields of a kind never change;
//! extra bytes after the fields make a payload malformed. A receiver skips kinds it does
//! not know. These promises begin with the first release, which will speak 2.0: until then
//! fields may change, and the keys of a Hello distinguish two builds.
//!
//! Not promised: that a varint or a stuffed run has its shortest form (receivers accept
//! any) · the number of scans in a batch, or that it is constant · the times of Status ·
//! the texts of Event, and the names of board and firmware · that sequence or tick start
//! at 0 when a host connects · that nothing is lost (gaps in the sequence show losses) ·
//! that tick rates of two boards agree better than the oscillators they are
//! [counted by](ClockSource).
#![no_std]
#![forbid(unsafe_code)]

pub mod batch;
mod command;
mod decoder;
mod frame;
mod message;
pub mod poses;
mod scan;
mod schedule;
pub mod schema;

use core::fmt;

use serde::{Deserialize, Serialize};

pub use batch::{Batch, BatchBuilder, BatchError, MAX_SCAN_BYTES};
pub use command::{
    BootTarget, Command, Configuration, Exposure, HEAD_PART_BYTES, Hashes, HeadPart, Pulse, Request, SAMPLE_SCANS,
    Stream,
};
pub use decoder::{Decoder, DecoderCounters};
pub use frame::{
    DELIMITER, EncodeError, FrameError, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Packet, PayloadError, encode,
};
pub use message::{
    BoardKind, ClockSource, Edge, Edges, Event, HardwareFault, Hello, MAX_EDGES, Message, Pong, Rejection, Reply,
    ResetCause, SettingsSource, Severity, Status, Truth,
};
pub use poses::{PoseRecord, PoseStatus, Poses, PosesBuilder};
pub use scan::{AdcScaling, Level, Levels, RawScan, ScalingError, WordPair};
pub use schedule::{EmitterSet, MAX_CELLS, MAX_OVERSAMPLING, MAX_SLOTS, Quantity, Schedule, ScheduleError};

/// Version of the protocol this crate speaks.
pub const PROTOCOL: ProtocolVersion = ProtocolVersion { major: 2, minor: 0 };

/// Version of the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProtocolVersion {
    /// Incremented when an existing part changes: two majors are incompatible.
    pub major: u8,
    /// Incremented when a message or command is added: two minors of one major share all
    /// kinds known to both.
    pub minor: u8,
}

impl fmt::Display for ProtocolVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

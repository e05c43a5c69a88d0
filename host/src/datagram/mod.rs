//! The newest pose, as a datagram, for control loops.
//!
//! A client sends a [`Request`] to one of the daemon's sockets, on a Unix socket or on UDP, for the newest
//! datagram of each board once, or for all datagrams of some seconds. All datagrams have one size:
//! [`PoseDatagram`] has their layout, and `include/slitpose_pose.h` defines it in C, with functions to
//! receive them.
//!
//! A datagram is sent by the thread that solved it, with no queue between solver and socket. The permissions
//! of a Unix socket decide which users may connect. On UDP every user of the host may, and can forge its
//! address: there a client is served once it has echoed a cookie. Places of followers are few; users share
//! them evenly, and a client without a place is notified.
//!
//! Each client has a queue of its own. On a Unix socket a datagram waits in the send buffer of the socket that sent it:
//! from one socket for all, a client that does not read would fill that buffer for the others (unix(7); in Linux,
//! `unix_dgram_sendmsg` charges the sender until the receiver has read). So a client makes a socket pair and passes one
//! end with each request, and the daemon sends from that end. On UDP a datagram waits in the receiver's buffer.
//!
//! The sending thread never waits: sockets do not block, requests come through a bounded queue, and the
//! newest datagram is stored for answers in a slot whose writer waits for no reader. The datagrams that a client misses
//! are counted and reported to it; one that misses some for over a second is a finding.
//!
//! # Layout
//!
//! The layout of datagrams, in both directions. `include/slitpose_pose.h` defines it in C.
//!
//! All numbers are little endian, without padding, each aligned to its size.
//!
//! A pose, 544 bytes:
//!
//! | at | type | what |
//! |---|---|---|
//! | 0 | u32 | magic, "SLPP" |
//! | 4 | u16 | version, 1: another version may change all later fields |
//! | 6 | u16 | total bytes; fields may be added at the end without a new version |
//! | 8 | u32 | flags: 1 pose, 2 twist, 4 host time, 8 arrival, 16 simulated, 32 behind: scans before this one were skipped because the daemon could not solve or print each in time |
//! | 12 | u16 | status: 0 converged, 1 degraded, 2 ambiguous, 3 unobservable, 4 too dark, 5 diverged |
//! | 14 | u16 | cells that were used |
//! | 16 | [u8; 12] | id of the board |
//! | 28 | u16 | cells that contradict all others and were left out, one bit each |
//! | 30 | u16 | redundancy: data minus unknowns |
//! | 32 | u64 | number of the datagram, from 1, of this board since the daemon started it |
//! | 40 | u64 | number of datagrams that the follower's full queue has refused; 0 in an answer |
//! | 48 | u64 | number of the scan, by the board |
//! | 56 | u64 | the pose's instant by the board's clock, ns |
//! | 64 | u64 | the same by CLOCK_MONOTONIC, ns; 0 without flag 4 |
//! | 72 | u64 | the same by UTC, ns since 1970; 0 without flag 4 |
//! | 80 | u64 | greatest error of both, ns; 0 without flag 4 |
//! | 88 | u64 | time at which the scan's bytes had been read, CLOCK_MONOTONIC, ns; 0 without flag 8 |
//! | 96 | u64 | time at which the datagram was made, CLOCK_MONOTONIC, ns |
//! | 104 | [f64; 3] | translation of `base_from_tool`, m |
//! | 128 | [f64; 4] | its rotation, quaternion x, y, z, w |
//! | 160 | [f64; 36] | covariance of (t, θ), row-major: m², m·rad, rad² |
//! | 448 | [f64; 3] | velocity in the base frame, m/s |
//! | 472 | [f64; 3] | angular velocity in the base frame, rad/s |
//! | 496 | [f64; 6] | standard deviations of those six |
//!
//! Absent values are NaN, and their flag is clear. On UDP a full queue is not reported: there only gaps in the numbers
//! of the datagrams show losses.
//!
//! A request, 32 bytes: u32 magic "SLPQ" · u16 version, 1 · u16 total bytes · u16 mode (1 newest,
//! 2 follow) · u16 zero · \[u8; 12\] id of a board, all zero for every board · u64 cookie, zero without one.
//! A request of 24 bytes, without the last field, has the cookie zero. On a Unix socket it carries one end of a socket pair
//! (`socketpair(AF_UNIX, SOCK_DGRAM, 0, …)`, `SCM_RIGHTS`), to which all answers go; the same with each request. Without
//! one it is refused.
//!
//! An answer that is not a pose, 24 bytes and so never longer than its request: u32 magic "SLPA" · u16 version, 1 ·
//! u16 total bytes · u16 kind · u16 zero · u32 zero · u64 cookie, or zero. By kind:
//!
//! 1. The request was not served: send it again with this cookie. UDP only, where a sender's address can be forged:
//!    echoing the cookie proves that the client receives there.
//! 2. The request was not served, or the client has lost its place: all places are taken. Ask again each second.
//! 3. The request was served; use this cookie from now on, as the last one expires soon.

use std::net::SocketAddr;
use std::sync::atomic;

pub use server::{DatagramCounts, DatagramServer, Publisher};
pub use socket::UnixClient;
pub use subscription::SlowClient;

pub use crate::address::Address;
use crate::address::ServeError;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Outcomes, Record};

mod server;
mod slot;
mod socket;
mod subscription;

/// Attempts to copy the newest datagram undisturbed. A copy takes a ten-thousandth of the time between two scans.
const ATTEMPTS: usize = 100;

/// The address at which clients request datagrams that `text` names.
pub(crate) fn address(text: &str) -> Result<Address, String> {
    match text.split_once(':') {
        Some(("unix", "")) => Err("`unix:` lacks the path of the socket; give unix:PATH".to_owned()),
        Some(("unix", path)) => Ok(Address::Unix(path.into())),
        Some(("udp", udp)) => {
            let error = |error| format!("`{udp}` is no address and port ({error}); give udp:127.0.0.1:PORT");
            let udp = udp.parse().map_err(error)?;
            require_loopback(udp).map(|()| Address::Udp(udp)).map_err(|error| error.to_string())
        }
        _ => Err(format!("`{text}` is no address for poses; give unix:PATH or udp:127.0.0.1:PORT")),
    }
}

/// Refuses addresses that other hosts can reach.
fn require_loopback(address: SocketAddr) -> Result<(), ServeError> {
    let reason = "poses carry no proof of their origin; give udp:127.0.0.1:PORT";
    let refused = || ServeError::NotLoopback { address: Address::Udp(address), reason };
    address.ip().is_loopback().then_some(()).ok_or_else(refused)
}

// The layout.

const POSE_MAGIC: [u8; 4] = *b"SLPP";
const REQUEST_MAGIC: [u8; 4] = *b"SLPQ";
const ANSWER_MAGIC: [u8; 4] = *b"SLPA";
const VERSION: u16 = 1;

const HAS_POSE: u32 = 1;
const HAS_TWIST: u32 = 2;
const HAS_HOST_TIME: u32 = 4;
const HAS_ARRIVAL: u32 = 8;
const IS_SIMULATED: u32 = 16;
const IS_BEHIND: u32 = 32;

const AT_FLAGS: usize = 8;
const AT_MISSED: usize = 40;

/// The bytes of a pose datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PoseDatagram([u8; Self::BYTES]);

impl PoseDatagram {
    /// Its length.
    pub const BYTES: usize = 544;

    /// The datagram of `record` with the number `number`, made at `now`.
    pub fn new(record: &Record, number: u64, now: HostInstant) -> Self {
        let solution = &record.solution;
        let flags = [
            (HAS_POSE, solution.estimate.is_some()),
            (HAS_TWIST, record.twist.is_some()),
            (HAS_HOST_TIME, record.host_time.is_some()),
            (HAS_ARRIVAL, record.arrival.is_some()),
            (IS_SIMULATED, record.simulated),
        ];
        let flags = flags.iter().filter(|(_, is_set)| *is_set).fold(0, |flags, (flag, _)| flags | flag);
        let excluded = solution.excluded.iter().fold(0, |cells, cell| cells | 1_u16 << cell);

        let mut writer = Writer { bytes: [0; Self::BYTES], at: 0 };
        writer.put(POSE_MAGIC);
        writer.put(VERSION.to_le_bytes());
        writer.put((Self::BYTES as u16).to_le_bytes());
        writer.put(flags.to_le_bytes());
        writer.put(Outcomes::number_of(&solution.outcome).to_le_bytes());
        writer.put((solution.cells_used.count() as u16).to_le_bytes());
        writer.put(record.device.0);
        writer.put(excluded.to_le_bytes());
        writer.put((solution.redundancy as u16).to_le_bytes());

        let (time, arrival) = (record.host_time, record.arrival);
        for number in [
            number,
            0,
            record.sequence,
            (record.device_time_s * 1e9).round() as u64,
            time.map_or(0, |time| time.monotonic_ns),
            time.map_or(0, |time| time.utc_ns),
            time.map_or(0, |time| time.uncertainty_ns),
            arrival.map_or(0, |arrival| arrival.monotonic_ns),
            now.monotonic_ns,
        ] {
            writer.put(number.to_le_bytes());
        }

        let estimate = solution.estimate;
        writer.numbers(estimate.map(|estimate| estimate.pose.translation_m.to_array()));
        writer.numbers(estimate.map(|estimate| estimate.pose.rotation.to_array()));
        for row in 0..6 {
            writer.numbers(estimate.map(|estimate| estimate.covariance[row]));
        }
        let twist = record.twist;
        writer.numbers(twist.map(|estimate| estimate.twist.linear_m_per_s.to_array()));
        writer.numbers(twist.map(|estimate| estimate.twist.angular_rad_per_s.to_array()));
        writer.numbers::<6>(twist.map(|estimate| std::array::from_fn(|i| estimate.covariance[i][i].sqrt())));
        Self(writer.bytes)
    }

    /// Marks that scans before this one were skipped, and the next may be, too.
    pub(crate) fn mark_behind(&mut self) {
        self.0[AT_FLAGS] |= IS_BEHIND as u8;
    }

    /// Sets the number of datagrams that the receiver has missed.
    pub(super) fn set_missed(&mut self, missed: u64) {
        self.0[AT_MISSED..AT_MISSED + 8].copy_from_slice(&missed.to_le_bytes());
    }

    /// As it is sent.
    pub fn as_bytes(&self) -> &[u8; Self::BYTES] {
        &self.0
    }

    pub(super) fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }
}

/// Fills the bytes of a datagram from front to back.
struct Writer {
    bytes: [u8; PoseDatagram::BYTES],
    at: usize,
}

impl Writer {
    fn put<const N: usize>(&mut self, value: [u8; N]) {
        self.bytes[self.at..self.at + N].copy_from_slice(&value);
        self.at += N;
    }

    fn numbers<const N: usize>(&mut self, values: Option<[f64; N]>) {
        for value in values.unwrap_or([f64::NAN; N]) {
            self.put(value.to_le_bytes());
        }
    }
}

/// A request of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// The number of datagrams.
    pub mode: Mode,
    /// The board; `None`: every board.
    pub device: Option<DeviceId>,
    /// The cookie last received, 0 before that. Unix sockets need none.
    pub cookie: u64,
}

/// The number of datagrams that a client requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The newest datagram of each board.
    Newest,
    /// All datagrams of the next seconds.
    Follow,
}

impl Request {
    /// Its length.
    pub const BYTES: usize = 32;

    const SHORT_BYTES: usize = 24;

    /// A request without a cookie.
    pub fn new(mode: Mode, device: Option<DeviceId>) -> Self {
        Self { mode, device, cookie: 0 }
    }

    /// As it is sent.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mode: u16 = match self.mode {
            Mode::Newest => 1,
            Mode::Follow => 2,
        };
        let mut bytes = [0; Self::BYTES];
        begin(&mut bytes, REQUEST_MAGIC, mode);
        bytes[12..Self::SHORT_BYTES].copy_from_slice(&self.device.unwrap_or_default().0);
        bytes[Self::SHORT_BYTES..].copy_from_slice(&self.cookie.to_le_bytes());
        bytes
    }

    /// The request in `bytes`; `None` if they are not a request of this version.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut whole = [0; Self::BYTES];
        whole.get_mut(..bytes.len())?.copy_from_slice(bytes);
        if bytes.len() == Self::SHORT_BYTES && whole[6..8] == (Self::SHORT_BYTES as u16).to_le_bytes() {
            whole[6..8].copy_from_slice(&(Self::BYTES as u16).to_le_bytes());
        } else if bytes.len() != Self::BYTES {
            return None;
        }
        let (head, cookie) = whole.split_last_chunk()?;
        let cookie = u64::from_le_bytes(*cookie);
        let device = DeviceId(head.get(12..)?.try_into().ok()?);
        let device = Some(device).filter(|device| *device != DeviceId::default());
        [Mode::Newest, Mode::Follow]
            .map(|mode| Self { mode, device, cookie })
            .into_iter()
            .find(|request| request.to_bytes() == whole)
    }
}

/// An answer to a client other than a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Ask again with this cookie.
    Prove(u64),
    /// All places are taken.
    Refused,
    /// Served; here is a newer cookie.
    Renew(u64),
}

impl Answer {
    /// Its length: no more than that of any request.
    pub const BYTES: usize = Request::SHORT_BYTES;

    /// As it is sent.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let (kind, cookie) = match self {
            Self::Prove(cookie) => (1, cookie),
            Self::Refused => (2, 0),
            Self::Renew(cookie) => (3, cookie),
        };
        let mut bytes = [0; Self::BYTES];
        begin(&mut bytes, ANSWER_MAGIC, kind);
        bytes[16..].copy_from_slice(&cookie.to_le_bytes());
        bytes
    }

    /// The answer in `bytes`; `None` if they are not an answer of this version.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let cookie = u64::from_le_bytes(*bytes.last_chunk()?);
        [Self::Prove(cookie), Self::Refused, Self::Renew(cookie)].into_iter().find(|answer| answer.to_bytes() == bytes)
    }
}

/// Writes the beginning of requests and answers.
fn begin<const N: usize>(bytes: &mut [u8; N], magic: [u8; 4], kind: u16) {
    bytes[..4].copy_from_slice(&magic);
    bytes[4..6].copy_from_slice(&VERSION.to_le_bytes());
    bytes[6..8].copy_from_slice(&(N as u16).to_le_bytes());
    bytes[8..10].copy_from_slice(&kind.to_le_bytes());
}

#[cfg(test)]
mod tests;

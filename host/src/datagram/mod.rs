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
//! Shared memory has the last poses of each board for any number of readers, who make no call to the system, and whose
//! deaths and delays nobody notices. Nobody is woken: waking costs the solver a call for each reader, and readers that
//! are to be woken have sockets.
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
//! A pose, 560 bytes:
//!
//! | at | type | what |
//! |---|---|---|
//! | 0 | u32 | magic, "SLPP" |
//! | 4 | u16 | version, 1: another version may change all later fields |
//! | 6 | u16 | total bytes; fields may be added at the end without a new version |
//! | 8 | u32 | flags: 1 pose, 2 twist, 4 host time, 8 arrival, 16 simulated, 32 behind: scans before this one were skipped because the daemon could not solve or print each in time; 64 the pose, its covariance and the velocity are in a frame of the user or of the tip, not of the head (`--frame`, `--tip`) |
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
//! | 544 | f64 | brightness of all light relative to scene or calibration |
//! | 552 | u64 | why a pose has no velocity: 1 too few poses yet, 2 the tool is not where its motion led; else 0 |
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
//!
//! Shared memory: 64 bytes with u32 magic "SLPM" · u16 version, 1 · u16 zero · u64 generation, the number of daemons that have
//! begun to write it, 0 before the first is ready. Then eight rings, one for each board. A ring: 64 bytes with u64 count of
//! its poses; 256 records of 576 bytes. The pose with number n, from 1, is in record (n - 1) mod 256: u64 version, 560
//! bytes. Version 2 n - 1 says that it is being written, 2 n that it is complete: a reader copies it between two reads of the
//! version. The count follows, and never falls: a ring whose board or daemon has gone is emptied by counting 256 poses that
//! no record has. While a daemon writes, it holds a lock for writing on the whole file (fcntl(2)).

use std::sync::atomic;

pub use layout::{Answer, Mode, PoseDatagram, Request};
pub use ring::MAX_BOARDS;
pub use server::{DatagramServer, Publisher};

pub use crate::address::Address;
use crate::address::require_loopback;
use socket::NO_PROOF;

mod layout;
mod ring;
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
            let address = Address::Udp(udp.parse().map_err(error)?);
            require_loopback(&address, NO_PROOF).map(|()| address).map_err(|error| error.to_string())
        }
        Some(("shm", "")) => Err("`shm:` lacks the name of the memory; give shm:NAME".to_owned()),
        Some(("shm", name)) => Ok(Address::of_memory(name)),
        _ => Err(format!("`{text}` is no address for poses; give unix:PATH, udp:127.0.0.1:PORT or shm:NAME")),
    }
}

#[cfg(test)]
mod tests;

//! Why a board cannot be used.

use std::io;

use slitpose_protocol::Rejection;
use slitpose_tracking::link::{DeviceId, Versions};
use thiserror::Error;

use super::listed::Listed;
use crate::platform::A_PORT;

/// Why a board cannot be used, or no longer.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum DeviceError {
    #[error("cannot list the serial ports of this system; give the path of the board's port, such as {A_PORT}")]
    Ports { source: serialport::Error },
    #[error("`{pattern}` is no pattern of paths; give one such as '/dev/ttyUSB*'")]
    Pattern { pattern: String, source: glob::PatternError },
    #[error(
        "no board found: nothing on USB is a `slitpose board` (1209:0001){}; plug one in, give its port with \
         --device PATH or where to look with --search, or --device sim for a simulated one",
        others(asked)
    )]
    NoBoard { asked: Vec<Listed> },
    #[error("there are {} boards: {}; say which with --device SERIAL", boards.len(), in_words(boards))]
    SeveralBoards { boards: Vec<Listed> },
    #[error(
        "the board {device} is not there{}; plug it in, or look with `slitpose device list` what is there",
        others(there)
    )]
    NoSuchBoard { device: DeviceId, there: Vec<Listed> },
    #[error(
        "`{name}` is neither the path of a serial port nor the serial number of a board (24 hexadecimal digits), as \
         `slitpose device list` shows them; give the path, such as {A_PORT}, or --device sim for a simulated board"
    )]
    NotAPath { name: String },
    #[error("there is no {name}; plug the board in and look for its port, or give --device sim for a simulated board")]
    Missing { name: String },
    #[error("{name} is a {what}, not a serial port; give the port of the board, such as {A_PORT}")]
    NotAPort { name: String, what: &'static str },
    #[error("{name} may not be opened by this user; on most systems the group dialout may: join it and log in again")]
    Forbidden { name: String },
    #[error("{name} is in use by another program, such as a running `slitpose run`; end that first")]
    Busy { name: String },
    #[error("{name} cannot be opened as a serial port; give the port of the board, such as {A_PORT}")]
    Open { name: String, source: serialport::Error },
    #[error(
        "nothing answers on {name}: not a byte came within {seconds} s; \
         check that this is the port of the board, and that the board has its firmware and power"
    )]
    Silent { name: String, seconds: f64 },
    #[error(
        "no board answers on {name}: {bytes} bytes came within {seconds} s, {packets} readable packets and no hello \
         among them; check that this is the port of the board, and reset the board"
    )]
    NoHello { name: String, seconds: f64, bytes: u64, packets: u64 },
    #[error("{name} cannot be used: {versions}")]
    Version { name: String, versions: Versions },
    #[error("the board on {name} sent no status within {seconds} s; reset the board")]
    NoStatus { name: String, seconds: f64 },
    #[error("the board on {name} has not come back within {seconds} s; reset it, or unplug it and plug it in again")]
    NotBack { name: String, seconds: f64 },
    #[error("the board on {name} says that another scene or schedule is stored than was sent; try again")]
    NotStored { name: String },
    #[error("the board on {name} did not reply to {command} within {seconds} s; reset the board")]
    NoReply { name: String, command: String, seconds: f64 },
    #[error("the board on {name} refused {command}; {next_step}")]
    Refused { name: String, command: String, next_step: &'static str, source: Rejection },
    #[error("the board on {name} has gone; if it was unplugged, plug it in again")]
    Gone { name: String, source: io::Error },
    #[error("no data for {seconds} s from the board on {name}; reset the board")]
    Quiet { name: String, seconds: f64 },
    #[error("no usable scan for {seconds:.0} s from the board on {name}: {cause}")]
    NoScans { name: String, seconds: f64, cause: Scanless },
    #[error("the board on {name} has stopped sampling: {reason}")]
    Stopped { name: String, reason: String },
}

/// The data that come instead of scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum Scanless {
    #[error("the board says that it is there, and nothing else; reset the board")]
    Nothing,
    /// Batches of another configuration than the one sent to the board.
    #[error(
        "{batches} batches came by a configuration that this program has not given; end any other program that speaks to the \
         board, then reset the board"
    )]
    Unexplained { batches: u64 },
    /// Whole packets that this program cannot read.
    #[error("{packets} packets came that cannot be read; build firmware and program from the same source")]
    Unreadable { packets: u64 },
    #[error("{packets} packets came damaged; check cable, hub and port of the board")]
    Damaged { packets: u64 },
}

fn in_words(listed: &[Listed]) -> String {
    let word = |listed: &Listed| match listed.device() {
        Some(device) => format!("{device} on {}", listed.port.name),
        None => format!("{} ({})", listed.port.name, listed.state.as_str()),
    };
    listed.iter().map(word).collect::<Vec<_>>().join(", ")
}

fn others(listed: &[Listed]) -> String {
    if listed.is_empty() { String::new() } else { format!("; there are {}", in_words(listed)) }
}

impl DeviceError {
    /// Whether the error may pass once the user plugs the board in and switches it on.
    pub(crate) fn is_passing(&self) -> bool {
        matches!(
            self,
            Self::NoBoard { .. }
                | Self::NoSuchBoard { .. }
                | Self::Missing { .. }
                | Self::Silent { .. }
                | Self::NoHello { .. }
                | Self::NoStatus { .. }
                | Self::NotBack { .. }
                | Self::NoReply { .. }
                | Self::Gone { .. }
                | Self::Quiet { .. }
                | Self::NoScans { .. }
                | Self::Stopped { .. }
        )
    }

    /// Time since the last usable scan when the error was noticed, seconds.
    pub(crate) fn missed_s(&self) -> f64 {
        match self {
            Self::Quiet { seconds, .. } | Self::NoScans { seconds, .. } => *seconds,
            _ => 0.0,
        }
    }

    /// Whether the board is not there, or its port is in use: another program may probe a port that has just appeared.
    /// Both may end at any moment.
    pub(crate) fn is_away(&self) -> bool {
        matches!(self, Self::Missing { .. } | Self::Gone { .. } | Self::Busy { .. })
    }

    /// Whether the user most likely has to act, so that trying again is not urgent.
    pub(crate) fn needs_user(&self) -> bool {
        matches!(self, Self::NoScans { .. }) || !self.is_passing() && !self.is_away()
    }
}

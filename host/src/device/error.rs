//! Why a board cannot be used, or no longer.

use std::io;

use slitpose_protocol::Rejection;
use thiserror::Error;

use super::probe::Listed;
use crate::link::{DeviceId, Versions};

/// Why a board cannot be used, or no longer.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// The system does not list its ports.
    #[error("cannot list the serial ports of this system; give the path of the board's port, such as /dev/ttyACM0")]
    Ports {
        /// The system's error.
        source: serialport::Error,
    },
    /// An invalid pattern of paths.
    #[error("`{pattern}` is no pattern of paths; give one such as '/dev/ttyUSB*'")]
    Pattern {
        /// What was given.
        pattern: String,
        /// The error in the pattern.
        source: glob::PatternError,
    },
    /// There is no board.
    #[error(
        "no board found: nothing on USB is a `slitpose board` (1209:0001){}; plug one in, give its port with \
         --device PATH or where to look with --search, or --device sim for a simulated one",
        others(asked)
    )]
    NoBoard {
        /// The ports that were asked.
        asked: Vec<Listed>,
    },
    /// Several boards match.
    #[error("there are {} boards: {}; say which with --device SERIAL", boards.len(), in_words(boards))]
    SeveralBoards {
        /// The boards.
        boards: Vec<Listed>,
    },
    /// The requested board is missing.
    #[error(
        "the board {device} is not there{}; plug it in, or look with `slitpose device list` what is there",
        others(there)
    )]
    NoSuchBoard {
        /// The requested board.
        device: DeviceId,
        /// The boards and ports found instead.
        there: Vec<Listed>,
    },
    /// A name that is neither a path nor a number.
    #[error(
        "`{name}` is neither the path of a serial port nor the serial number of a board (24 hexadecimal digits), as \
         `slitpose device list` shows them; give the path, such as /dev/ttyACM0, or --device sim for a simulated board"
    )]
    NotAPath {
        /// The name.
        name: String,
    },
    /// The path does not exist.
    #[error("there is no {name}; plug the board in and look for its port, or give --device sim for a simulated board")]
    Missing {
        /// The path.
        name: String,
    },
    /// The path is not a serial port.
    #[error("{name} is a {what}, not a serial port; give the port of the board, such as /dev/ttyACM0")]
    NotAPort {
        /// The path.
        name: String,
        /// The kind of file.
        what: &'static str,
    },
    /// The user may not open the port.
    #[error("{name} may not be opened by this user; on most systems the group dialout may: join it and log in again")]
    Forbidden {
        /// The path.
        name: String,
    },
    /// Another program has the port open.
    #[error("{name} is in use by another program, such as a running `slitpose run`; end that first")]
    Busy {
        /// The path.
        name: String,
    },
    /// The system does not open it as a serial port.
    #[error("{name} cannot be opened as a serial port; give the port of the board, such as /dev/ttyACM0")]
    Open {
        /// The path.
        name: String,
        /// The system's error.
        source: serialport::Error,
    },
    /// No byte came.
    #[error(
        "nothing answers on {name}: not a byte came within {seconds} s; \
         check that this is the port of the board, and that the board has its firmware and power"
    )]
    Silent {
        /// The device.
        name: String,
        /// How long was waited.
        seconds: f64,
    },
    /// Another host does not publish the board.
    #[error(
        "no {what} of {name} came within {seconds} s; check that `slitpose run --zenoh` follows the board there, and that \
         both reach the same router"
    )]
    NotPublished {
        /// The device.
        name: String,
        /// What was waited for.
        what: &'static str,
        /// How long was waited.
        seconds: f64,
    },
    /// Bytes came, but no hello.
    #[error(
        "no board answers on {name}: {bytes} bytes came within {seconds} s, {packets} readable packets and no hello \
         among them; check that this is the port of the board, and reset the board"
    )]
    NoHello {
        /// The device.
        name: String,
        /// How long was waited.
        seconds: f64,
        /// Bytes received.
        bytes: u64,
        /// Packets among them.
        packets: u64,
    },
    /// A board with another version of the protocol.
    #[error("{name} cannot be used: {versions}")]
    Version {
        /// The device.
        name: String,
        /// Both versions.
        versions: Versions,
    },
    /// The board sends no hello or status.
    #[error("the board on {name} sent no status within {seconds} s; reset the board")]
    NoStatus {
        /// The device.
        name: String,
        /// How long was waited.
        seconds: f64,
    },
    /// The board did not come back after a reboot.
    #[error("the board on {name} has not come back within {seconds} s; reset it, or unplug it and plug it in again")]
    NotBack {
        /// The device.
        name: String,
        /// How long was waited.
        seconds: f64,
    },
    /// The stored data differ from those sent.
    #[error("the board on {name} says that another scene or schedule is stored than was sent; try again")]
    NotStored {
        /// The device.
        name: String,
    },
    /// A command without a reply.
    #[error("the board on {name} did not reply to {command} within {seconds} s; reset the board")]
    NoReply {
        /// The device.
        name: String,
        /// The command.
        command: &'static str,
        /// How long was waited.
        seconds: f64,
    },
    /// The board refuses a command.
    #[error("the board on {name} refused {command}; {next_step}")]
    Refused {
        /// The device.
        name: String,
        /// The command.
        command: &'static str,
        /// The next step for the user.
        next_step: &'static str,
        /// The board's reason.
        source: Rejection,
    },
    /// The port has disappeared.
    #[error("the board on {name} has gone; if it was unplugged, plug it in again")]
    Gone {
        /// The device.
        name: String,
        /// The system's error.
        source: io::Error,
    },
    /// No more bytes come.
    #[error("no data for {seconds} s from the board on {name}; reset the board")]
    Quiet {
        /// The device.
        name: String,
        /// Time without bytes.
        seconds: f64,
    },
    /// Bytes come, but no scans.
    #[error("no usable scan for {seconds:.0} s from the board on {name}: {cause}")]
    NoScans {
        /// The device.
        name: String,
        /// Time without scans.
        seconds: f64,
        /// What came instead.
        cause: Scanless,
    },
    /// The board stopped by itself.
    #[error("the board on {name} has stopped sampling: {reason}")]
    Stopped {
        /// The device.
        name: String,
        /// The last thing it reported.
        reason: String,
    },
}

/// The data that come instead of scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Scanless {
    /// At most status messages.
    #[error("the board says that it is there, and nothing else; reset the board")]
    Nothing,
    /// Batches of another configuration than the one sent to the board.
    #[error(
        "{batches} batches came by a configuration that this program has not given; end any other program that speaks to the \
         board, then reset the board"
    )]
    Unexplained {
        /// Their number.
        batches: u64,
    },
    /// Whole packets that this program cannot read.
    #[error("{packets} packets came that cannot be read; build firmware and program from the same source")]
    Unreadable {
        /// How many.
        packets: u64,
    },
    /// Damaged packets.
    #[error("{packets} packets came damaged; check cable, hub and port of the board")]
    Damaged {
        /// How many.
        packets: u64,
    },
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
        match self {
            Self::NoBoard { .. }
            | Self::NoSuchBoard { .. }
            | Self::Missing { .. }
            | Self::Silent { .. }
            | Self::NotPublished { .. }
            | Self::NoHello { .. }
            | Self::NoStatus { .. }
            | Self::NotBack { .. }
            | Self::NoReply { .. }
            | Self::Gone { .. }
            | Self::Quiet { .. }
            | Self::NoScans { .. }
            | Self::Stopped { .. } => true,
            Self::Ports { .. }
            | Self::Pattern { .. }
            | Self::SeveralBoards { .. }
            | Self::NotStored { .. }
            | Self::NotAPath { .. }
            | Self::NotAPort { .. }
            | Self::Forbidden { .. }
            | Self::Busy { .. }
            | Self::Open { .. }
            | Self::Version { .. }
            | Self::Refused { .. } => false,
        }
    }
}

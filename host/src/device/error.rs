//! Why a board cannot be used, or no longer.

use std::io;

use slitpose_protocol::{PayloadError, Rejection};
use thiserror::Error;

/// What went wrong between host and board.
#[derive(Debug, Error)]
pub enum DeviceError {
    /// No path of a port.
    #[error(
        "`{name}` is not the path of a serial port, and this version does not search for boards; \
         give the path, such as /dev/ttyACM0, or --device sim for a simulated board"
    )]
    NotAPath {
        /// What was given.
        name: String,
    },
    /// Nothing has this path.
    #[error("there is no {name}; plug the board in and look for its port, or give --device sim for a simulated board")]
    Missing {
        /// The path.
        name: String,
    },
    /// Something else has this path.
    #[error("{name} is a {what}, not a serial port; give the port of the board, such as /dev/ttyACM0")]
    NotAPort {
        /// The path.
        name: String,
        /// What is there.
        what: &'static str,
    },
    /// The user may not open it.
    #[error("{name} may not be opened by this user; on most systems the group dialout may: join it and log in again")]
    Forbidden {
        /// The path.
        name: String,
    },
    /// Another program has it open.
    #[error("{name} is in use by another program; close that first")]
    Busy {
        /// The path.
        name: String,
    },
    /// The system refuses it as a serial port.
    #[error("{name} cannot be opened as a serial port; give the port of the board, such as /dev/ttyACM0")]
    Open {
        /// The path.
        name: String,
        /// What the system said.
        source: serialport::Error,
    },
    /// Not a byte.
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
    /// Bytes, but no hello among them.
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
    /// A board of another time.
    #[error("the board on {name} speaks another version of the protocol")]
    Version {
        /// The device.
        name: String,
        /// Which one.
        source: PayloadError,
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
    /// The board does not do what it is asked.
    #[error("the board on {name} refused {command}; {next_step}")]
    Refused {
        /// The device.
        name: String,
        /// The command.
        command: &'static str,
        /// What to do about it.
        next_step: &'static str,
        /// Why.
        source: Rejection,
    },
    /// The port is no longer there.
    #[error("the board on {name} has gone; if it was unplugged, plug it in and start again")]
    Gone {
        /// The device.
        name: String,
        /// What the system said.
        source: io::Error,
    },
    /// Bytes have ceased to come.
    #[error("no data for {seconds} s from the board on {name}; reset the board and start again")]
    Quiet {
        /// The device.
        name: String,
        /// How long nothing came.
        seconds: f64,
    },
    /// The board stopped of its own accord.
    #[error("the board on {name} has stopped sampling: {reason}")]
    Stopped {
        /// The device.
        name: String,
        /// The last thing it reported.
        reason: String,
    },
}

impl DeviceError {
    /// Whether waiting may mend it, without anybody doing anything but plug and switch on.
    pub fn is_passing(&self) -> bool {
        match self {
            Self::Missing { .. }
            | Self::Silent { .. }
            | Self::NoHello { .. }
            | Self::NoReply { .. }
            | Self::Gone { .. }
            | Self::Quiet { .. }
            | Self::Stopped { .. } => true,
            Self::NotAPath { .. }
            | Self::NotAPort { .. }
            | Self::Forbidden { .. }
            | Self::Busy { .. }
            | Self::Open { .. }
            | Self::Version { .. }
            | Self::Refused { .. } => false,
        }
    }
}

//! Boards at the other end of a byte stream, real or simulated.
//!
//! [`Device`] carries bytes without decoding them: [`SerialDevice`] is a serial port, `SimulatedDevice` a simulated
//! board. `Conversation` speaks the protocol over one of them: it greets, configures, starts and stops the board,
//! checks every reply, and passes on all other bytes.
//!
//! `find` searches for the board that a `Selector` names, `list` for all boards; a `Contact` opens one again and again,
//! wherever it is then.
//!
//! The host drops no bytes: those not fetched wait in the operating system, then in the board's queue, which drops its
//! oldest scans when full and so leaves gaps in their numbers.

use std::io;

pub(crate) use boot_loader::{BootLoader, BootLoaders};
pub(crate) use conversation::{Conversation, HELLO_WITHIN};
pub(crate) use discovery::{Contact, Selector, find, list};
pub use error::{DeviceError, Scanless};
pub(crate) use listed::{BoardInfo, Listed, Port, PortState, UsbId, in_words};
pub use orders::KeepAlive;
pub(crate) use ports::{ANSWER_WITHIN, Search, ports};
pub use serial::SerialDevice;
pub(crate) use serial::{SimulatedDevice, SimulatedPort};

mod boot_loader;
mod conversation;
mod discovery;
mod error;
mod listed;
mod orders;
mod ports;
mod serial;
#[doc(hidden)]
pub mod update;

/// A byte stream to and from a board.
pub trait Device: Send {
    /// What its user calls the device, in messages.
    fn name(&self) -> &str;

    /// Sends bytes to the board.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits for bytes from the board, a few hundredths of a second at most, and appends them to
    /// `bytes`. `false` if the stream has ended.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool>;

    /// Whether the board runs in real time.
    fn keeps_time(&self) -> bool {
        true
    }

    /// Starts pings that show the board that its host is alive; `None` if the board does not need them.
    fn keep_alive(&self) -> io::Result<Option<KeepAlive>> {
        Ok(None)
    }
}

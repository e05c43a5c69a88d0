//! Boards at the other end of a byte stream, real or simulated.
//!
//! [`Device`] carries bytes and knows nothing of what they mean: [`SerialDevice`] is a serial port,
//! [`SimulatedDevice`] a board made of arithmetic. [`Conversation`] speaks the protocol over one of
//! them: it greets, configures, starts and stops the board, checks every reply, and hands on what
//! the board says as it came.
//!
//! [`find`] looks for the board a [`Selector`] names, [`list`] for all of them, [`locate`] for one that was
//! there before.
//!
//! Nothing is dropped on this side: bytes that are not fetched wait in the operating system, then in
//! the board's queue, which gives up its oldest scans when it is full; their numbers show it.

mod board_info;
mod conversation;
mod discovery;
mod error;
mod holder;
mod keep_alive;
mod orders;
mod ports;
mod probe;
mod selector;
mod serial;
mod simulated;

use std::io;

pub(crate) use board_info::BoardInfo;
pub(crate) use conversation::{Conversation, Keep};
pub(crate) use discovery::{Found, find, list, locate};
pub use error::DeviceError;
pub(crate) use error::Scanless;
pub(crate) use holder::holders;
pub use keep_alive::KeepAlive;
pub(crate) use ports::{Port, Search, UsbId, ports};
pub(crate) use probe::{Listed, PortState};
pub(crate) use selector::Selector;
pub use serial::SerialDevice;
pub(crate) use simulated::SimulatedDevice;

/// A byte stream to a board and back.
pub trait Device: Send {
    /// What the user calls it.
    fn name(&self) -> &str;

    /// Hands bytes to the board.
    ///
    /// # Errors
    /// If they cannot be handed over: the board has gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits for bytes from the board, a few hundredths of a second at most, and appends them to
    /// `bytes`. `false` if none will ever come again.
    ///
    /// # Errors
    /// If the board has gone.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool>;

    /// Whether what comes from it comes when it happens.
    fn keeps_time(&self) -> bool {
        true
    }

    /// Shows the board from now on that its host is alive, if it needs that: `None` if not.
    ///
    /// # Errors
    /// Those of the operating system.
    fn keep_alive(&self) -> io::Result<Option<KeepAlive>> {
        Ok(None)
    }
}

//! Boards at the other end of a byte stream, real or simulated.
//!
//! [`Device`] carries bytes without decoding them: [`SerialDevice`] is a serial port, `SimulatedDevice` a simulated
//! board. `Conversation` speaks the protocol over one of them: it greets, configures, starts and stops the board,
//! checks every reply, and hands on all other bytes.
//!
//! `find` looks for the board a `Selector` names, `list` for all of them, `locate` for one that was there before.
//!
//! The host drops nothing: bytes that are not fetched wait in the operating system, then in the board's queue, which
//! drops its oldest scans when it is full; gaps in their numbers show it.

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
    /// `bytes`. `false` if the stream has ended.
    ///
    /// # Errors
    /// If the board has gone.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool>;

    /// Whether it runs in real time.
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

//! The bytes of a board.

use std::io;

use super::orders::KeepAlive;

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

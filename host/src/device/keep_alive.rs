//! Signs of life for a board that cannot see its host.

use std::io::Write;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

use slitpose_protocol::{Command, MAX_REQUEST_BYTES, Request, encode};

/// A board on a link without modem lines goes dark after 2 s without a command: four of these.
const INTERVAL: Duration = Duration::from_millis(500);

/// Number of the pings; a [`Conversation`](super::Conversation) counts its commands from 1.
pub(super) const PING: u16 = 0;

/// Sends pings, from a thread of its own so that a slow reader of the poses does not darken the
/// board, until dropped. Nobody else may write to the port meanwhile.
#[derive(Debug)]
pub struct KeepAlive {
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl KeepAlive {
    /// Pings through `port` every half second.
    pub fn new(mut port: impl Write + Send + 'static) -> Self {
        let (end, ended) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            for token in 0.. {
                if ended.recv_timeout(INTERVAL) != Err(RecvTimeoutError::Timeout) {
                    break;
                }
                let mut buffer = [0; MAX_REQUEST_BYTES];
                if let Ok(ping) = encode(&Request { number: PING, command: Command::Ping { token } }, &mut buffer) {
                    // A port that has gone is noticed by whoever reads from it.
                    let _ = port.write_all(ping);
                }
            }
        });
        Self { end: Some(end), thread: Some(thread) }
    }
}

impl Drop for KeepAlive {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // It does not panic.
            let _ = thread.join();
        }
    }
}

//! Pings, which show a board that its host is alive, and measure its clock.

use std::io::Write;
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use slitpose_protocol::{Command, MAX_REQUEST_BYTES, Request, encode};

use crate::clock::HostInstant;
use crate::link::Asked;

/// Interval of pings: a board on a link without modem lines goes dark after 2 s without a command, four intervals.
pub(super) const INTERVAL: Duration = Duration::from_millis(500);

/// Most sent pings kept until they are fetched.
const MAX_UNTOLD: usize = 16;

/// Number of the pings; a [`Conversation`](super::Conversation) counts its commands from 1.
pub(super) const PING: u16 = 0;

/// Sends pings until dropped, on its own thread so that a slow reader of the poses does not darken the
/// board. No other thread may write to the port meanwhile.
#[derive(Debug)]
pub struct KeepAlive {
    end: Option<Sender<()>>,
    asked: Receiver<Asked>,
    thread: Option<JoinHandle<()>>,
}

impl KeepAlive {
    /// Starts pings through `port`, at once and every half second.
    pub fn new(mut port: impl Write + Send + 'static) -> Self {
        let (end, ended) = bounded(0);
        let (tell, asked) = bounded(MAX_UNTOLD);
        let thread = std::thread::spawn(move || {
            for token in 0.. {
                let mut buffer = [0; MAX_REQUEST_BYTES];
                if let Some((ping, told)) = ping(token, &mut buffer) {
                    // Queued before it is sent, so that its answer cannot come first.
                    let _ = tell.try_send(told);
                    // The loss of the port is detected by its reader.
                    let _ = port.write_all(ping);
                }
                if ended.recv_timeout(INTERVAL) != Err(RecvTimeoutError::Timeout) {
                    break;
                }
            }
        });
        Self { end: Some(end), asked, thread: Some(thread) }
    }

    /// The next sent ping that was not fetched yet.
    pub fn asked(&self) -> Option<Asked> {
        self.asked.try_recv().ok()
    }
}

/// A ping, to be sent now.
pub(super) fn ping(token: u32, buffer: &mut [u8]) -> Option<(&[u8], Asked)> {
    let packet = encode(&Request { number: PING, command: Command::Ping { token } }, buffer).ok()?;
    Some((packet, Asked { token, at: HostInstant::now() }))
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

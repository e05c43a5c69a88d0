//! Commands other than measurement: introduce, store, identify, reboot.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use slitpose_protocol::{Command, HeadPart, MAX_REQUEST_BYTES, Message, Rejection, Request, Status, encode};

use super::conversation::{Conversation, REPLY_WITHIN};
use super::error::DeviceError;
use super::listed::BoardInfo;
use crate::background::Background;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::Asked;

/// Timeout of a status: a board sends one every 0.5 s, and the first after opening may be damaged.
const STATUS_WITHIN: Duration = Duration::from_millis(1500);

impl Conversation {
    /// [`greet`](Self::greet)s the board and returns its hello. The caller decides whether the board can be used.
    pub(crate) fn introduce(&mut self, within: Duration) -> Result<BoardInfo, DeviceError> {
        let mut last = None;
        self.greet(within, |hello| {
            last = Some(BoardInfo::from(hello));
            Ok::<_, DeviceError>(())
        })?;
        last.ok_or_else(|| DeviceError::Silent { name: self.name(), seconds: within.as_secs_f64() })
    }

    /// Waits for the board's next status. Other messages are dropped meanwhile.
    pub(crate) fn status(&mut self) -> Result<Status, DeviceError> {
        let until = Instant::now() + STATUS_WITHIN;
        self.decoder.reset();
        let mut more = true;
        while more && Instant::now() < until {
            self.inbox.clear();
            more = self.hear()?;
            let mut bytes = &self.inbox[..];
            let mut status = None;
            while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
                if let Ok(Message::Status(latest)) = message {
                    status = Some(latest);
                }
            }
            if let Some(status) = status {
                return Ok(status);
            }
        }
        Err(DeviceError::NoStatus { name: self.name(), seconds: STATUS_WITHIN.as_secs_f64() })
    }

    /// Takes the head from the board, which then solves no poses; `false` if it never does.
    pub(crate) fn forget_head(&mut self) -> Result<bool, DeviceError> {
        let none = HeadPart { offset: 0, total: 0, bytes: [].into_iter().collect() };
        match self.order(Command::Head(none)) {
            Err(DeviceError::Refused { source: Rejection::Unsupported { .. }, .. }) => Ok(false),
            outcome => outcome.map(|()| true),
        }
    }

    /// Gives the board a command beside measuring, and waits until it has obeyed.
    pub(crate) fn order(&mut self, command: Command) -> Result<(), DeviceError> {
        self.inbox.clear();
        self.decoder.reset();
        self.ask(command, REPLY_WITHIN)
    }
}

/// Interval of pings: a board on a link without modem lines goes dark after 2 s without a command, four intervals.
pub(super) const INTERVAL: Duration = Duration::from_millis(500);

/// Most sent pings kept until they are fetched.
const MAX_UNTOLD: usize = 16;

/// Number of the pings; a [`Conversation`] counts its commands from 1.
pub(super) const PING: u16 = 0;

/// Sends pings until dropped, on its own thread so that a slow reader of the poses does not darken the
/// board. No other thread may write to the port meanwhile.
#[derive(Debug)]
pub struct KeepAlive {
    asked: Receiver<Asked>,
    _thread: Background<Sender<()>>,
}

impl KeepAlive {
    /// Starts pings through `port`, at once and every half second.
    pub fn new(mut port: impl Write + Send + 'static) -> io::Result<Self> {
        let (end, ended) = bounded(0);
        let (tell, asked) = bounded(MAX_UNTOLD);
        let run = move || {
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
        };
        Ok(Self { asked, _thread: Background::spawn("pings", end, run)? })
    }

    /// The next sent ping that was not fetched yet.
    pub fn asked(&self) -> Option<Asked> {
        self.asked.try_recv().ok()
    }
}

pub(super) fn ping(token: u32, buffer: &mut [u8]) -> Option<(&[u8], Asked)> {
    let packet = encode(&Request { number: PING, command: Command::Ping { token } }, buffer).ok()?;
    Some((packet, Asked { token, at: HostInstant::now() }))
}

//! One control transfer: SETUP, data, status (USB 2.0 section 8.5.3).

use super::MS;
use super::attempt::{ATTEMPTS, Outcome, RETRY_TICKS};
use crate::peripherals::Ticks;

/// A device must finish any request within this time (section 9.2.6.1).
const PATIENCE_TICKS: Ticks = 5_000 * MS;

/// A request to the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Request {
    /// The eight bytes of the SETUP packet.
    pub(super) setup: [u8; 8],
    /// What goes with them to the device.
    pub(super) data: Vec<u8>,
}

/// Where a transfer stands after a transaction.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Progress {
    GoesOn,
    /// With what the device has sent.
    Done(Vec<u8>),
    Failed(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    DataIn,
    DataOut,
    StatusIn,
    StatusOut,
}

/// A transfer under way.
#[derive(Debug)]
pub(super) struct Transfer {
    request: Request,
    stage: Stage,
    packet_bytes: usize,
    /// Received, or sent so far.
    received: Vec<u8>,
    sent: usize,
    toggle: bool,
    silences: u8,
    begun_at: Ticks,
    /// When the next transaction may begin.
    pub(super) ready_at: Ticks,
}

impl Transfer {
    pub(super) fn new(request: Request, packet_bytes: usize, now: Ticks) -> Self {
        Self {
            request,
            stage: Stage::Setup,
            packet_bytes,
            received: Vec::new(),
            sent: 0,
            toggle: false,
            silences: 0,
            begun_at: now,
            ready_at: now,
        }
    }

    /// The packet to send next: whether it is a SETUP, its toggle and its bytes. `None`: an IN
    /// token is next.
    pub(super) fn packet(&self) -> Option<(bool, bool, Vec<u8>)> {
        match self.stage {
            Stage::Setup => Some((true, false, self.request.setup.to_vec())),
            Stage::DataOut => {
                let rest = &self.request.data[self.sent..];
                Some((false, self.toggle, rest[..rest.len().min(self.packet_bytes)].to_vec()))
            }
            Stage::StatusOut => Some((false, true, Vec::new())),
            Stage::DataIn | Stage::StatusIn => None,
        }
    }

    /// Goes on from the outcome of a transaction.
    pub(super) fn progress(&mut self, outcome: Outcome, now: Ticks) -> Progress {
        self.ready_at = now;
        if outcome != Outcome::Silence {
            self.silences = 0;
        }
        match outcome {
            Outcome::Nak if self.stage == Stage::Setup => Progress::Failed("NAK to a SETUP packet".to_owned()),
            Outcome::Nak if now - self.begun_at > PATIENCE_TICKS => {
                Progress::Failed(format!("still busy after 5 s in the {} stage", self.stage_name()))
            }
            Outcome::Nak => {
                self.ready_at = now + RETRY_TICKS;
                Progress::GoesOn
            }
            Outcome::Stall => Progress::Failed(format!("STALL in the {} stage", self.stage_name())),
            Outcome::Silence => {
                self.silences += 1;
                self.ready_at = now + RETRY_TICKS;
                if self.silences == ATTEMPTS {
                    return Progress::Failed(format!("no answer in the {} stage", self.stage_name()));
                }
                Progress::GoesOn
            }
            Outcome::Sent(len) => self.sent(len),
            Outcome::Received { toggle, bytes } => self.received(toggle, &bytes),
        }
    }

    fn length(&self) -> usize {
        usize::from(u16::from_le_bytes([self.request.setup[6], self.request.setup[7]]))
    }

    fn sent(&mut self, len: usize) -> Progress {
        match self.stage {
            Stage::StatusOut => return Progress::Done(std::mem::take(&mut self.received)),
            Stage::Setup => {
                let device_to_host = self.request.setup[0] & 0x80 != 0;
                self.stage = match (self.length(), device_to_host) {
                    (0, _) => Stage::StatusIn,
                    (_, true) => Stage::DataIn,
                    (_, false) => Stage::DataOut,
                };
                self.toggle = true;
            }
            Stage::DataOut | Stage::DataIn | Stage::StatusIn => {
                self.sent += len;
                self.toggle = !self.toggle;
                if self.sent == self.request.data.len() {
                    self.stage = Stage::StatusIn;
                }
            }
        }
        Progress::GoesOn
    }

    fn received(&mut self, toggle: bool, bytes: &[u8]) -> Progress {
        if self.stage == Stage::StatusIn {
            return match (toggle, bytes) {
                (true, []) => Progress::Done(Vec::new()),
                (false, _) => Progress::Failed("DATA0 in the status stage".to_owned()),
                (true, _) => Progress::Failed(format!("{} bytes in the status stage", bytes.len())),
            };
        }
        if toggle != self.toggle {
            return Progress::Failed("wrong data toggle in the data stage".to_owned());
        }
        self.toggle = !self.toggle;
        self.received.extend_from_slice(bytes);
        if bytes.len() > self.packet_bytes || self.received.len() > self.length() {
            return Progress::Failed(format!(
                "babble: a packet of {} bytes, {} of {} in all",
                bytes.len(),
                self.received.len(),
                self.length()
            ));
        }
        if bytes.len() < self.packet_bytes || self.received.len() == self.length() {
            self.stage = Stage::StatusOut;
        }
        Progress::GoesOn
    }

    fn stage_name(&self) -> &'static str {
        match self.stage {
            Stage::Setup => "setup",
            Stage::DataIn | Stage::DataOut => "data",
            Stage::StatusIn | Stage::StatusOut => "status",
        }
    }
}

//! What the host remembers between two transactions: of a control transfer (USB 2.0 section 8.5.3), and of a bulk or
//! interrupt endpoint.

use super::MS;
use super::enumeration::{Endpoint, Request};
use crate::peripherals::Ticks;
use crate::usb_wire::Answer;

/// From a NAK to the next attempt: 20 µs. Controllers differ: some ask again at once, some once a
/// frame.
const RETRY_TICKS: Ticks = MS / 50;

/// A device that does not answer is asked three times (USB 2.0 section 10.2.6).
const ATTEMPTS: u8 = 3;

/// A device must finish any request within this time (section 9.2.6.1).
const PATIENCE_TICKS: Ticks = 5_000 * MS;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    DataIn,
    DataOut,
    StatusIn,
    StatusOut,
}

#[derive(Debug)]
pub struct Transfer {
    request: Request,
    stage: Stage,
    packet_bytes: usize,
    received: Vec<u8>,
    sent: usize,
    toggle: bool,
    silences: u8,
    begun_at: Ticks,
    pub ready_at: Ticks,
}

impl Transfer {
    pub fn new(request: Request, packet_bytes: usize, now: Ticks) -> Self {
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
    pub fn packet(&self) -> Option<(bool, bool, Vec<u8>)> {
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

    /// Goes on from the answer to a transaction; gives what the device has sent when all is over.
    pub fn progress(&mut self, answer: Answer, sent: usize, now: Ticks) -> Result<Option<Vec<u8>>, String> {
        let stage = match self.stage {
            Stage::Setup => "setup",
            Stage::DataIn | Stage::DataOut => "data",
            Stage::StatusIn | Stage::StatusOut => "status",
        };
        self.ready_at = now;
        self.silences = if answer == Answer::Silence { self.silences + 1 } else { 0 };
        match answer {
            Answer::Nak if self.stage == Stage::Setup => Err("NAK to a SETUP packet".to_owned()),
            Answer::Nak if now - self.begun_at > PATIENCE_TICKS => {
                Err(format!("still busy after 5 s in the {stage} stage"))
            }
            Answer::Stall => Err(format!("STALL in the {stage} stage")),
            Answer::Silence if self.silences == ATTEMPTS => Err(format!("no answer in the {stage} stage")),
            Answer::Nak | Answer::Silence => {
                self.ready_at = now + RETRY_TICKS;
                Ok(None)
            }
            Answer::Ack => Ok(self.sent(sent)),
            Answer::Data { toggle, bytes } => self.received(toggle, &bytes),
        }
    }

    fn length(&self) -> usize {
        usize::from(u16::from_le_bytes([self.request.setup[6], self.request.setup[7]]))
    }

    fn sent(&mut self, len: usize) -> Option<Vec<u8>> {
        match self.stage {
            Stage::StatusOut => return Some(std::mem::take(&mut self.received)),
            Stage::Setup => {
                self.stage = match (self.length(), self.request.setup[0] & 0x80 != 0) {
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
        None
    }

    fn received(&mut self, toggle: bool, bytes: &[u8]) -> Result<Option<Vec<u8>>, String> {
        if self.stage == Stage::StatusIn {
            return match (toggle, bytes) {
                (true, []) => Ok(Some(Vec::new())),
                (false, _) => Err("DATA0 in the status stage".to_owned()),
                (true, _) => Err(format!("{} bytes in the status stage", bytes.len())),
            };
        }
        if toggle != self.toggle {
            return Err("wrong data toggle in the data stage".to_owned());
        }
        self.toggle = !self.toggle;
        self.received.extend_from_slice(bytes);
        let (len, all, most) = (bytes.len(), self.received.len(), self.length());
        if len > self.packet_bytes || all > most {
            return Err(format!("babble: a packet of {len} bytes, {all} of {most} in all"));
        }
        if len < self.packet_bytes || all == most {
            self.stage = Stage::StatusOut;
        }
        Ok(None)
    }
}

/// A bulk or interrupt endpoint, as the host keeps it.
#[derive(Debug)]
pub struct Pipe {
    pub endpoint: Endpoint,
    /// DATA1 is next.
    pub toggle: bool,
    pub ready_at: Ticks,
    silences: u8,
}

impl Pipe {
    pub fn new(endpoint: Endpoint, now: Ticks) -> Self {
        Self { endpoint, toggle: false, ready_at: now, silences: 0 }
    }

    /// Goes on from the answer to a transaction; gives what was received. A fault closes the pipe until the device is
    /// configured anew, or throws data away.
    pub fn progress(&mut self, answer: Answer, now: Ticks) -> Result<Vec<u8>, String> {
        self.ready_at = now + self.endpoint.interval;
        self.silences = if answer == Answer::Silence { self.silences + 1 } else { 0 };
        let fault = match answer {
            Answer::Nak => {
                self.ready_at = self.ready_at.max(now + RETRY_TICKS);
                return Ok(Vec::new());
            }
            Answer::Silence if self.silences < ATTEMPTS => {
                self.ready_at = now + RETRY_TICKS;
                return Ok(Vec::new());
            }
            Answer::Ack => {
                self.toggle = !self.toggle;
                return Ok(Vec::new());
            }
            Answer::Data { toggle, bytes } if toggle != self.toggle => {
                return Err(format!("wrong data toggle, {} bytes thrown away", bytes.len()));
            }
            Answer::Data { bytes, .. } if bytes.len() <= self.endpoint.packet_bytes => {
                self.toggle = !self.toggle;
                return Ok(bytes);
            }
            Answer::Data { bytes, .. } => {
                format!("babble: {} bytes where {} are the most", bytes.len(), self.endpoint.packet_bytes)
            }
            Answer::Stall => "STALL".to_owned(),
            Answer::Silence => "no answer".to_owned(),
        };
        self.ready_at = Ticks::MAX;
        Err(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data(toggle: bool, len: usize) -> Answer {
        Answer::Data { toggle, bytes: vec![1; len] }
    }

    #[test]
    fn a_pipe_tells_who_breaks_the_protocol_and_is_closed() {
        for (answers, fault, is_closed) in [
            (vec![data(true, 10)], "wrong data toggle, 10 bytes thrown away", false),
            (vec![data(false, 64), data(true, 65)], "babble: 65 bytes where 64 are the most", true),
            (vec![Answer::Nak, Answer::Stall], "STALL", true),
            (
                vec![Answer::Silence, Answer::Silence, Answer::Nak, Answer::Silence, Answer::Silence, Answer::Silence],
                "no answer",
                true,
            ),
        ] {
            let mut pipe = Pipe::new(Endpoint { number: 1, packet_bytes: 64, interval: 0 }, 0);
            let last = answers.len() - 1;
            for (n, answer) in answers.into_iter().enumerate() {
                let faulty = pipe.progress(answer, 0).err();
                assert_eq!(faulty.as_deref(), (n == last).then_some(fault));
            }
            assert_eq!(pipe.ready_at == Ticks::MAX, is_closed, "{fault}");
        }
    }

    #[test]
    fn a_control_transfer_tells_what_has_ended_it() {
        let ack = || Answer::Ack;
        for (answers, fault) in [
            (vec![Answer::Nak], "NAK to a SETUP packet"),
            (vec![Answer::Silence; 3], "no answer in the setup stage"),
            (vec![ack(), Answer::Nak, Answer::Stall], "STALL in the data stage"),
            (vec![ack(), data(false, 8)], "wrong data toggle in the data stage"),
            (vec![ack(), data(true, 8), data(false, 3)], "babble: a packet of 3 bytes, 11 of 10 in all"),
            (vec![ack(), data(true, 8), data(false, 2), Answer::Stall], "STALL in the status stage"),
        ] {
            let request = Request { setup: [0x80, 6, 0, 1, 0, 0, 10, 0], data: Vec::new() };
            let mut transfer = Transfer::new(request, 8, 0);
            let mut outcomes = answers.into_iter().map(|answer| transfer.progress(answer, 0, 0));
            let failed = outcomes.find_map(Result::err);
            assert_eq!(failed.as_deref(), Some(fault));
        }
    }
}

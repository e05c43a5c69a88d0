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
        let stage = self.stage;
        self.ready_at = now;
        self.silences = if answer == Answer::Silence { self.silences + 1 } else { 0 };
        let is_late = stage == Stage::Setup || now - self.begun_at > PATIENCE_TICKS;
        match answer {
            Answer::Nak if !is_late => self.ready_at = now + RETRY_TICKS,
            Answer::Silence if self.silences < ATTEMPTS => self.ready_at = now + RETRY_TICKS,
            Answer::Ack => return Ok(self.sent(sent)),
            Answer::Data { toggle, bytes } => {
                let (due, most) = match stage {
                    Stage::StatusIn => (true, 0),
                    _ => (self.toggle, self.packet_bytes.min(self.length() - self.received.len())),
                };
                check(toggle, bytes.len(), due, most).map_err(|fault| format!("{fault}, {stage:?}"))?;
                if stage == Stage::StatusIn {
                    return Ok(Some(Vec::new()));
                }
                self.toggle = !toggle;
                self.received.extend_from_slice(&bytes);
                if bytes.len() < self.packet_bytes || self.received.len() == self.length() {
                    self.stage = Stage::StatusOut;
                }
            }
            Answer::Nak | Answer::Silence | Answer::Stall => return Err(format!("{answer:?} at the last, {stage:?}")),
        }
        Ok(None)
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
}

fn check(toggle: bool, len: usize, due: bool, most: usize) -> Result<(), String> {
    if toggle == due && len <= most {
        return Ok(());
    }
    let [came, due] = [toggle, due].map(u8::from);
    Err(format!("{len} bytes of DATA{came} where DATA{due} of at most {most} is due"))
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
    /// configured anew.
    pub fn progress(&mut self, answer: Answer, now: Ticks) -> Result<Vec<u8>, String> {
        let ready_at = now + self.endpoint.interval;
        self.silences = if answer == Answer::Silence { self.silences + 1 } else { 0 };
        // Closed, unless all is well.
        self.ready_at = Ticks::MAX;
        match answer {
            Answer::Nak => self.ready_at = ready_at.max(now + RETRY_TICKS),
            Answer::Silence if self.silences < ATTEMPTS => self.ready_at = now + RETRY_TICKS,
            Answer::Ack => (self.toggle, self.ready_at) = (!self.toggle, ready_at),
            Answer::Data { toggle, bytes } => {
                check(toggle, bytes.len(), self.toggle, self.endpoint.packet_bytes)?;
                (self.toggle, self.ready_at) = (!toggle, ready_at);
                return Ok(bytes);
            }
            Answer::Stall | Answer::Silence => return Err(format!("{answer:?} at the last")),
        }
        Ok(Vec::new())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_breaks_the_protocol_is_told_and_is_asked_no_more() {
        let data = |toggle, len| Answer::Data { toggle, bytes: vec![1; len] };
        let silence = || Answer::Silence;
        for (answers, fault) in [
            (vec![data(true, 10)], "10 bytes of DATA1 where DATA0 of at most 64 is due"),
            (vec![data(false, 64), data(true, 65)], "65 bytes of DATA1 where DATA1 of at most 64 is due"),
            (vec![Answer::Nak, Answer::Stall], "Stall at the last"),
            (vec![silence(), silence(), Answer::Nak, silence(), silence(), silence()], "Silence at the last"),
        ] {
            let mut pipe = Pipe::new(Endpoint { number: 1, packet_bytes: 64, interval: 0 }, 0);
            let faults: Vec<_> = answers.into_iter().map(|answer| pipe.progress(answer, 0).err()).collect();
            let told = faults.iter().position(Option::is_some).expect("a fault");
            assert_eq!((told + 1, faults[told].as_deref()), (faults.len(), Some(fault)));
            assert_eq!(pipe.ready_at, Ticks::MAX);
        }
        let ack = || Answer::Ack;
        for (answers, fault) in [
            (vec![Answer::Nak], "Nak at the last, Setup"),
            (vec![silence(), silence(), silence()], "Silence at the last, Setup"),
            (vec![ack(), Answer::Nak, Answer::Stall], "Stall at the last, DataIn"),
            (vec![ack(), data(false, 8)], "8 bytes of DATA0 where DATA1 of at most 8 is due, DataIn"),
            (vec![ack(), data(true, 8), data(false, 3)], "3 bytes of DATA0 where DATA0 of at most 2 is due, DataIn"),
            (vec![ack(), data(true, 8), data(false, 2), Answer::Stall], "Stall at the last, StatusOut"),
        ] {
            let request = Request { setup: [0x80, 6, 0, 1, 0, 0, 10, 0], data: Vec::new() };
            let mut transfer = Transfer::new(request, 8, 0);
            let mut outcomes = answers.into_iter().map(|answer| transfer.progress(answer, 0, 0));
            assert_eq!(outcomes.find_map(Result::err).as_deref(), Some(fault));
        }
    }
}

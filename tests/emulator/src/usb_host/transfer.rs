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
    /// Endpoint 0.
    pub pipe: Pipe,
    received: Vec<u8>,
    sent: usize,
    begun_at: Ticks,
}

impl Transfer {
    pub fn new(request: Request, packet_bytes: usize, now: Ticks) -> Self {
        let pipe = Pipe::new(Endpoint { number: 0, packet_bytes, interval: 0 }, now);
        Self { request, stage: Stage::Setup, pipe, received: Vec::new(), sent: 0, begun_at: now }
    }

    /// The packet to send next: whether it is a SETUP, its toggle and its bytes. `None`: an IN
    /// token is next.
    pub fn packet(&self) -> Option<(bool, bool, Vec<u8>)> {
        match self.stage {
            Stage::Setup => Some((true, false, self.request.setup.to_vec())),
            Stage::DataOut => {
                let rest = &self.request.data[self.sent..];
                Some((false, self.pipe.toggle, rest[..rest.len().min(self.pipe.endpoint.packet_bytes)].to_vec()))
            }
            Stage::StatusOut => Some((false, true, Vec::new())),
            Stage::DataIn | Stage::StatusIn => None,
        }
    }

    /// Goes on from the answer to a transaction; gives what the device has sent when all is over.
    pub fn progress(&mut self, answer: Answer, sent: usize, now: Ticks) -> Result<Option<Vec<u8>>, String> {
        let stage = self.stage;
        let is_late = stage == Stage::Setup || now - self.begun_at > PATIENCE_TICKS;
        if is_late && answer == Answer::Nak {
            return Err(format!("{answer:?} at the last, {stage:?}"));
        }
        let is_taken = answer == Answer::Ack;
        match self.pipe.progress(answer, now).map_err(|fault| format!("{fault}, {stage:?}"))? {
            None if is_taken => return Ok(self.sent(sent)),
            None => {}
            Some(_) if stage == Stage::StatusIn => return Ok(Some(Vec::new())),
            Some(bytes) => {
                self.received.extend_from_slice(&bytes);
                if bytes.len() < self.pipe.endpoint.packet_bytes || self.received.len() >= self.length() {
                    self.stage = Stage::StatusOut;
                }
            }
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
            }
            Stage::DataOut | Stage::DataIn | Stage::StatusIn => {
                self.sent += len;
                if self.sent == self.request.data.len() {
                    (self.stage, self.pipe.toggle) = (Stage::StatusIn, true);
                }
            }
        }
        None
    }
}

/// An endpoint, as the host keeps it.
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
    pub fn progress(&mut self, answer: Answer, now: Ticks) -> Result<Option<Vec<u8>>, String> {
        let ready_at = now + self.endpoint.interval;
        self.silences = if answer == Answer::Silence { self.silences + 1 } else { 0 };
        // Closed, unless all is well.
        self.ready_at = Ticks::MAX;
        match answer {
            Answer::Nak => self.ready_at = ready_at.max(now + RETRY_TICKS),
            Answer::Silence if self.silences < ATTEMPTS => self.ready_at = now + RETRY_TICKS,
            Answer::Ack => (self.toggle, self.ready_at) = (!self.toggle, ready_at),
            Answer::Data { ref bytes, .. } if bytes.len() > self.endpoint.packet_bytes => {
                return Err(format!("{} bytes in a packet of at most {}", bytes.len(), self.endpoint.packet_bytes));
            }
            Answer::Data { toggle, bytes } => {
                self.ready_at = ready_at;
                // The other one is what the host has had already.
                if std::mem::replace(&mut self.toggle, !toggle) == toggle {
                    return Ok(Some(bytes));
                }
            }
            Answer::Stall | Answer::Silence => return Err(format!("{answer:?} at the last")),
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pipe() -> Pipe {
        Pipe::new(Endpoint { number: 1, packet_bytes: 64, interval: 0 }, 0)
    }

    #[test]
    fn who_refuses_or_keeps_silent_is_asked_no_more() {
        let silence = || Answer::Silence;
        for (answers, fault) in [
            (vec![Answer::Nak, Answer::Stall], "Stall at the last"),
            (vec![silence(), silence(), Answer::Nak, silence(), silence(), silence()], "Silence at the last"),
        ] {
            let mut pipe = pipe();
            let faults: Vec<_> = answers.into_iter().map(|answer| pipe.progress(answer, 0).err()).collect();
            let told = faults.iter().position(Option::is_some).expect("a fault");
            assert_eq!((told + 1, faults[told].as_deref()), (faults.len(), Some(fault)));
            assert_eq!(pipe.ready_at, Ticks::MAX);
        }
        let mut transfer = Transfer::new(Request { setup: [0x80, 6, 0, 1, 0, 0, 10, 0], data: Vec::new() }, 8, 0);
        assert_eq!(transfer.progress(Answer::Nak, 0, 0), Err("Nak at the last, Setup".to_owned()));
    }

    #[test]
    fn repeated_data_are_ignored_and_too_long_ones_refused() {
        let mut pipe = pipe();
        let long = Answer::Data { toggle: false, bytes: vec![0; 65] };
        assert_eq!(pipe.progress(long, 0), Err("65 bytes in a packet of at most 64".to_owned()));
        let mut is_new = |toggle| pipe.progress(Answer::Data { toggle, bytes: vec![1] }, 0).expect("data").is_some();
        assert_eq!([false, false, true, true, false].map(&mut is_new), [true, false, true, false, true]);
    }
}

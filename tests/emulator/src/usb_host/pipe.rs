//! One bulk or interrupt endpoint, as the host keeps it.

use super::MS;
use super::attempt::{ATTEMPTS, Outcome, RETRY_TICKS};
use super::descriptors::{AcmEndpoints, EndpointDescriptor};
use crate::peripherals::Ticks;

/// What became of a transaction.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Progress {
    Nothing,
    Sent(usize),
    Received(Vec<u8>),
    /// The pipe is closed, or data were thrown away.
    Fault(String),
}

/// The endpoints of a serial port.
#[derive(Debug)]
pub(super) struct Pipes {
    pub(super) notification: Pipe,
    pub(super) bulk_in: Pipe,
    pub(super) bulk_out: Pipe,
    pub(super) last_was_out: bool,
}

/// An endpoint and what is to be remembered about it.
#[derive(Debug)]
pub(super) struct Pipe {
    pub(super) endpoint: u8,
    pub(super) packet_bytes: usize,
    /// DATA1 is next.
    pub(super) toggle: bool,
    /// When it may be asked again.
    pub(super) ready_at: Ticks,
    /// Between two questions, whatever the answer was; 0 for bulk.
    interval: Ticks,
    silences: u8,
}

impl Pipes {
    pub(super) fn new(endpoints: &AcmEndpoints, now: Ticks) -> Self {
        Self {
            notification: Pipe::new(&endpoints.notification, Ticks::from(endpoints.notification.interval_ms) * MS, now),
            bulk_in: Pipe::new(&endpoints.bulk_in, 0, now),
            bulk_out: Pipe::new(&endpoints.bulk_out, 0, now),
            last_was_out: false,
        }
    }
}

impl Pipe {
    fn new(descriptor: &EndpointDescriptor, interval: Ticks, now: Ticks) -> Self {
        Self {
            endpoint: descriptor.number(),
            packet_bytes: usize::from(descriptor.max_packet_bytes),
            toggle: false,
            ready_at: now,
            interval,
            silences: 0,
        }
    }

    /// Goes on from the outcome of a transaction.
    pub(super) fn progress(&mut self, outcome: Outcome, now: Ticks) -> Progress {
        self.ready_at = now + self.interval;
        if outcome != Outcome::Silence {
            self.silences = 0;
        }
        match outcome {
            Outcome::Nak => {
                self.ready_at = self.ready_at.max(now + RETRY_TICKS);
                Progress::Nothing
            }
            Outcome::Sent(len) => {
                self.toggle = !self.toggle;
                Progress::Sent(len)
            }
            Outcome::Received { toggle, bytes } if toggle != self.toggle => {
                Progress::Fault(format!("wrong data toggle, {} bytes thrown away", bytes.len()))
            }
            Outcome::Received { bytes, .. } if bytes.len() > self.packet_bytes => {
                self.close();
                Progress::Fault(format!("babble: {} bytes where {} are the most", bytes.len(), self.packet_bytes))
            }
            Outcome::Received { bytes, .. } => {
                self.toggle = !self.toggle;
                Progress::Received(bytes)
            }
            Outcome::Stall => {
                self.close();
                Progress::Fault("STALL".to_owned())
            }
            Outcome::Silence => {
                self.silences += 1;
                self.ready_at = now + RETRY_TICKS;
                if self.silences < ATTEMPTS {
                    return Progress::Nothing;
                }
                self.close();
                Progress::Fault("no answer".to_owned())
            }
        }
    }

    /// Never asks again, until the device is configured anew.
    fn close(&mut self) {
        self.ready_at = Ticks::MAX;
    }
}

//! Attempts at a transaction, and how one ended.

use super::MS;
use crate::peripherals::Ticks;
use crate::usb_wire::{Handshake, InAnswer};

/// From a NAK to the next attempt: 20 µs. Controllers differ: some ask again at once, some once a
/// frame.
pub(super) const RETRY_TICKS: Ticks = MS / 50;

/// A device that does not answer is asked three times (USB 2.0 section 10.2.6).
pub(super) const ATTEMPTS: u8 = 3;

/// How a transaction ended, whichever its direction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Received { toggle: bool, bytes: Vec<u8> },
    Sent(usize),
    Nak,
    Stall,
    Silence,
}

impl Outcome {
    pub(super) fn of_in(answer: InAnswer) -> Self {
        match answer {
            InAnswer::Data { toggle, bytes } => Self::Received { toggle, bytes },
            InAnswer::Nak => Self::Nak,
            InAnswer::Stall => Self::Stall,
            InAnswer::Silence => Self::Silence,
        }
    }

    pub(super) fn of_out(handshake: Handshake, len: usize) -> Self {
        match handshake {
            Handshake::Ack => Self::Sent(len),
            Handshake::Nak => Self::Nak,
            Handshake::Stall => Self::Stall,
            Handshake::Silence => Self::Silence,
        }
    }
}

//! A board that counts what it sends.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use slitpose_protocol::{DELIMITER, Decoder, MAX_MESSAGE_BYTES, Message, Schedule};

use crate::terminal::{BACKLOG_BYTES, Board, Device};

/// What the study and a board tell each other.
#[derive(Debug, Default)]
pub struct Meter {
    /// Scans that it has sent.
    pub scans: AtomicU64,
    /// Whether it is to take no scans at the moment.
    pub holds_breath: AtomicBool,
    /// Whether its plug is to be pulled.
    pub is_unplugged: AtomicBool,
}

/// A board that counts its scans and sends no truths: no real one does.
pub struct Metered {
    board: Board,
    meter: Arc<Meter>,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<Schedule>,
    own: Vec<u8>,
    packet: Vec<u8>,
    sampled_s: f64,
}

impl Metered {
    /// `board`, which `meter` is told of.
    pub fn new(board: Board, meter: Arc<Meter>) -> Self {
        let (own, packet) = (Vec::new(), Vec::new());
        Self { board, meter, decoder: Decoder::new(), schedule: None, own, packet, sampled_s: 0.0 }
    }

    /// Whether the packet goes to the host.
    fn count(&mut self) -> bool {
        let mut packet = &self.packet[..];
        match self.decoder.next::<Message<'_>>(&mut packet) {
            Some(Ok(Message::Truth(_))) => return false,
            Some(Ok(Message::Hello(hello))) => self.schedule = Some(hello.schedule),
            Some(Ok(Message::Batch(batch))) => {
                let scans = batch.scans(self.schedule.as_ref().expect("hello first")).expect("readable").len();
                self.meter.scans.fetch_add(scans as u64, Ordering::Relaxed);
            }
            _ => {}
        }
        true
    }
}

impl Device for Metered {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        // Without time passing a board answers and takes no scans.
        if sent.len() <= BACKLOG_BYTES && !self.meter.holds_breath.load(Ordering::Relaxed) {
            self.sampled_s = now_s;
        }
        let mut own = std::mem::take(&mut self.own);
        let plugged = self.board.act(received, self.sampled_s, &mut own);
        for byte in own.drain(..) {
            self.packet.push(byte);
            if byte == DELIMITER {
                if self.count() {
                    sent.extend_from_slice(&self.packet);
                }
                self.packet.clear();
            }
        }
        self.own = own;
        plugged && !self.meter.is_unplugged.load(Ordering::Relaxed)
    }
}

//! What a page is shown of one board: its head, and its frames.

use std::collections::VecDeque;

use serde_json::{Value, json};
use slitpose_calibration::Head;
use slitpose_model::Photocurrents;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::{Optics, Sampler, head_message};
use slitpose_tracking::pipeline::Record;

/// Most messages that the page has not acknowledged: two seconds of frames. A page that is busy gets fewer frames.
const WINDOW: u64 = 64;

/// Messages on their way to the page.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    messages: VecDeque<String>,
    sent: u64,
    acknowledged: u64,
}

impl Outbox {
    /// A page has connected, which has got nothing.
    pub(crate) fn restart(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn acknowledge(&mut self, messages: u64) {
        self.acknowledged = messages.min(self.sent);
    }

    pub(crate) fn push(&mut self, message: impl Into<String>) {
        self.sent += 1;
        self.messages.push_back(message.into());
    }

    /// Something for the user to read.
    pub(crate) fn notice(&mut self, text: &str) {
        self.push(json!({"kind": "notice", "text": text}).to_string());
    }

    pub(crate) fn take(&mut self) -> Option<String> {
        self.messages.pop_front()
    }

    fn has_room(&self) -> bool {
        self.sent - self.acknowledged < WINDOW
    }
}

/// Makes the messages on one board.
pub(crate) struct Shown {
    board: usize,
    sampler: Sampler,
    optics: Option<Optics>,
    frames: u64,
    time_s: f64,
    /// The message on its head.
    pub(crate) head: String,
}

impl Shown {
    pub(crate) fn new(board: usize, head: &Head) -> Self {
        Self {
            board,
            sampler: Sampler::default(),
            // A scene that cannot be computed has been refused before.
            optics: Optics::of(head).ok(),
            frames: 0,
            time_s: f64::NEG_INFINITY,
            head: head_message(board, head),
        }
    }

    pub(crate) fn add(&mut self, record: &Record) {
        self.sampler.add(record);
    }

    /// Sends a frame if one is due and the page has time; `photocurrents` are those of the scan added last.
    pub(crate) fn send(&mut self, photocurrents: Option<&Photocurrents>, now: HostInstant, out: &mut Outbox) {
        let mut taken = None;
        self.sampler.send(photocurrents, now, |sample| {
            taken = out.has_room().then(|| sample.clone());
            taken.is_some()
        });
        let (Some(sample), Some(optics)) = (taken, &self.optics) else { return };
        // A board that has restarted begins anew, so that time only goes on.
        if sample.record.device_time_s < self.time_s {
            out.push(json!({"kind": "cleared", "board": self.board}).to_string());
        }
        self.time_s = sample.record.device_time_s;
        let frame: Value = optics.frame(self.board, self.frames, &sample);
        self.frames += 1;
        out.push(frame.to_string());
    }
}

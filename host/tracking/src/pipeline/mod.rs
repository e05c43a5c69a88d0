//! From bytes to poses: bytes → packets → scans → photocurrents → poses.
//!
//! One pipeline serves boards, simulated boards and captures. It does no I/O: bytes are pushed in, [`Item`]s come out
//! in order. After the first hello nothing is allocated per scan.
//!
//! [`push`](Pipeline::push) and [`feed`](Pipeline::feed) solve every scan. A caller that must keep up with a board uses
//! [`receive`](Pipeline::receive), which only decodes, and chooses the scan that is solved next.

mod board_clock;
mod board_poses;
mod counts;
mod doubt;
mod flow;
mod item;
mod session;
#[cfg(test)]
mod tests;
mod waiting;

use slitpose_calibration::Head;
use slitpose_head::scene_file::fnv1a_64;
use slitpose_model::{Photocurrents, Tier};
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Status};

pub use board_poses::{Agreement, PoseFault};
pub use counts::{Counts, Outcomes, reason};
pub use item::{EdgeRecord, Item, Oddity, PipelineError, PipelineOptions, PoseSource, Record, SceneMatch};
pub use session::{check, check_calibration, head_of};
pub use waiting::{Queue, Scan};

use crate::clock::ClockFit;
use crate::frame::{FrameReport, View, Viewer};
use crate::health::HeadHealth;
use crate::link::Segment;
use board_clock::Span;
use flow::{Flow, session_of};
use waiting::Content;

/// Turns bytes into poses.
#[derive(Debug)]
pub struct Pipeline {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    flow: Flow,
    /// Whether bytes after the [end](Self::until) have been left out.
    has_passed_end: bool,
    viewer: Viewer,
}

/// Whether scans are solved as they come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Solve {
    AtOnce,
    Later,
}

impl Pipeline {
    /// A pipeline for boards with `head`, solved in `tier`. That of a scene alone is taken to be as the scene says.
    pub fn new(head: impl Into<Head>, tier: Tier, scene_match: SceneMatch) -> Self {
        let flow = Flow::new(head.into(), tier, scene_match);
        Self { decoder: Decoder::new(), flow, has_passed_end: false, viewer: Viewer::default() }
    }

    /// Ends the stream `until_s` seconds of device time after the first scan, if given.
    #[must_use]
    pub fn until(mut self, until_s: Option<f64>) -> Self {
        self.flow.span = Span::until(until_s);
        self
    }

    /// Sets the options of the tracker.
    #[must_use]
    pub fn following(mut self, following: PipelineOptions) -> Self {
        self.flow.following = following;
        self
    }

    /// Gives poses in `view`; `None`: in the frame of the head.
    #[must_use]
    pub fn in_frame(mut self, view: Option<&'static View>) -> Self {
        self.viewer = Viewer::of(view);
        self
    }

    /// Also monitors the cells of the head: see [`health`](Self::health).
    #[must_use]
    pub fn watched(mut self) -> Self {
        self.flow.watched = true;
        self
    }

    /// Decodes and solves `bytes`, cut anywhere, and passes the items that they complete to `sink`. Returns the number
    /// of bytes used: all, or those before the first scan after the [end](Self::until). Poses get no host times; for
    /// these see [`feed`](Self::feed).
    ///
    /// # Errors
    /// If the board cannot be used with this scene, or `sink` fails. Damaged bytes are no error:
    /// they are counted and skipped.
    pub fn push<E: From<PipelineError>>(
        &mut self,
        bytes: &[u8],
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.flow.clock.at = None;
        self.decode(bytes, Solve::AtOnce, &mut sink)
    }

    /// Decodes and solves a segment as [`push`](Self::push) does. Where reads have instants, and after the first
    /// answered ping, it also finds the host's time of each scan.
    pub fn feed<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.process(segment, Solve::AtOnce, &mut sink)
    }

    /// Decodes a segment as [`feed`](Self::feed) does, but lets the scans wait for
    /// `solve_next`, `solve_newest` or `skip`.
    pub fn receive<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        mut sink: impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        self.process(segment, Solve::Later, &mut sink)
    }

    /// The state of the queue of waiting scans.
    pub fn queue(&self) -> Queue {
        Queue { sessions: self.flow.earlier.len(), ..self.flow.waiting.queue() }
    }

    /// Puts a record that was solved by [`Self::solve_next`] or [`Self::solve_newest`] into the frame of the user. Items
    /// are in it.
    pub fn see(&mut self, record: &mut Record) {
        self.viewer.see(record);
    }

    /// Makes the mean pose of the next `over_s` seconds of device time the zero of the frame; `None`: the frame is again
    /// that of the start.
    pub fn zero(&mut self, over_s: Option<f64>) {
        self.viewer.zero(over_s);
    }

    /// The frame of the poses.
    pub fn frame(&self) -> FrameReport {
        self.viewer.report()
    }

    /// Solves the oldest waiting scan, in the frame of the head. Poses solved in this order do not depend on the delay.
    pub fn solve_next(&mut self) -> Option<Record> {
        self.flow.solve_next()
    }

    /// Solves the newest waiting scan ahead of its turn; it keeps its place in the queue. `None` if it has already
    /// been solved ahead.
    pub fn solve_newest(&mut self) -> Option<Record> {
        self.flow.solve_newest()
    }

    /// Takes the oldest waiting scan that has photocurrents unsolved, with these, and counts it and those before as
    /// skipped.
    pub fn take_currents(&mut self) -> Option<(Scan, Photocurrents)> {
        loop {
            let (scan, _) = self.flow.pop()?;
            self.flow.counts.scans_skipped += 1;
            let session = session_of(&mut self.flow.earlier, &mut self.flow.session, scan.session)?;
            if let Content::Words(words) = &scan.content {
                let photocurrents = session.stage.photocurrents(words);
                return Some((scan, photocurrents));
            }
        }
    }

    /// When the light of each cell left its emitter in the session of `scan`, after the reference instant, in frames;
    /// `None` once a scan of a later session has been taken.
    pub fn exposures_of(&self, scan: &Scan) -> Option<Vec<f64>> {
        let mut sessions = self.flow.earlier.iter().chain(&self.flow.session);
        let session = sessions.find(|session| session.number == scan.session)?;
        let rate_hz = session.schedule.frame_rate_hz();
        Some(session.stage.exposures_s().iter().map(|exposure_s| exposure_s * rate_hz).collect())
    }

    /// How many sessions have begun: a board introduced itself for the first time, or with another configuration. Each
    /// begins with a new tracker.
    pub fn sessions(&self) -> u64 {
        self.flow.sessions
    }

    /// Digest of the state that later poses depend on besides later bytes and what scans say of themselves: that of the
    /// tracker, recent contradictions and sums of residuals. Of two pipelines that have decoded the same bytes and have the same digest, all later poses are the same,
    /// bit for bit, whichever scans each has solved before (but for a chance of 2⁻⁶⁴). `None` before the first hello.
    pub fn state(&self) -> Option<u64> {
        let session = self.flow.session.as_ref()?;
        // The text of a float says all its bits, and a field that is added to the tracker is in it.
        Some(fnv1a_64(format!("{} {:?}", session.number, session.state()).as_bytes()))
    }

    /// Drops the `count` oldest waiting scans unsolved, and counts them.
    pub fn skip(&mut self, count: usize) {
        let skipped = (0..count).map_while(|_| self.flow.pop()).count();
        self.flow.counts.scans_skipped += skipped as u64;
    }

    /// Drops all waiting scans unsolved, and counts them as given up.
    pub fn give_up(&mut self) -> usize {
        let count = self.queue().waiting;
        self.skip(count);
        self.flow.counts.scans_given_up += count as u64;
        count
    }

    fn process<E: From<PipelineError>>(
        &mut self,
        segment: &Segment,
        solve: Solve,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        if segment.opened {
            self.decoder.reset();
            self.flow.clock.reopen();
            self.flow.clock_watch.begin_anew();
            self.flow.is_opened = true;
        }
        for asked in &segment.asked {
            self.flow.clock.ask(*asked);
        }
        let mut taken = 0;
        for (bytes, at) in segment.chunks() {
            self.flow.clock.at = at;
            taken += self.decode(bytes, solve, sink)?;
        }
        Ok(taken)
    }

    /// Decodes all of `bytes`; returns how many of them are taken. After the end these are whole packets before the next scan,
    /// and then none: what is decoded counts as no damage, and what is taken ends with a packet.
    fn decode<E: From<PipelineError>>(
        &mut self,
        mut bytes: &[u8],
        solve: Solve,
        sink: &mut impl FnMut(Item<'_>) -> Result<(), E>,
    ) -> Result<usize, E> {
        let length = bytes.len();
        let mut taken = 0;
        while let Some(result) = self.decoder.next::<Message<'_>>(&mut bytes) {
            match result {
                Ok(Message::Batch(_) | Message::Poses(_) | Message::Truth(_)) if self.flow.span.is_complete => {
                    self.has_passed_end = true;
                }
                Ok(message) => self.flow.accept(&message, sink)?,
                // The decoder counts damage.
                Err(_) => {}
            }
            while solve == Solve::AtOnce
                && let Some(mut record) = self.flow.solve_next()
            {
                self.viewer.see(&mut record);
                sink(Item::Pose(&record))?;
            }
            if !self.has_passed_end {
                taken = length - bytes.len();
            }
        }
        if !self.is_complete() {
            return Ok(length);
        }
        self.has_passed_end |= taken < length;
        Ok(taken)
    }

    /// Counts scans as lost that the stream, which has ended by itself, did not bring before [`until`](Self::until).
    pub fn end(&mut self) {
        self.flow.end();
    }

    /// The photocurrents of the scan that was solved last; `None` before the first hello.
    pub fn last_photocurrents(&self) -> Option<&Photocurrents> {
        self.flow.session.as_ref().map(|session| &session.photocurrents)
    }

    /// The health of the head, if it is [monitored](Self::watched).
    pub fn health(&self) -> Option<HeadHealth> {
        self.flow.session.as_ref()?.health()
    }

    /// How the board's poses compare with those found here; `None` if it has sent none.
    pub fn agreement(&self) -> Option<Agreement> {
        let agreement = self.flow.session.as_ref()?.comparison.as_ref()?.agreement;
        let refused = self.flow.counts.poses_refused;
        Some(Agreement { refused, is_unchecked: self.flow.is_unchecked, ..agreement })
    }

    /// Rate error of the board's clock, ppm, positive if fast; `None` while unknown.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.flow.clock.fit.as_ref()?.drift_ppm()
    }

    /// Whether the board reports a crystal and its rate has broken the bounds of one.
    pub fn contradicts_crystal(&self) -> bool {
        self.flow.clock.fit.as_ref().is_some_and(ClockFit::contradicts_crystal)
    }

    /// Device time between the first scan and the last, seconds.
    pub fn elapsed_s(&self) -> f64 {
        self.flow.span.elapsed_s
    }

    /// Whether the [end](Self::until) is reached.
    pub fn is_complete(&self) -> bool {
        self.flow.span.is_complete
    }

    /// The board's last status.
    pub fn board_status(&self) -> Option<&Status> {
        self.flow.counts.board_status.as_ref()
    }

    /// The counts so far.
    pub fn counts(&self) -> Counts {
        let mut counts = self.flow.counts;
        counts.decoder = self.decoder.counters();
        counts.pending_bytes = self.decoder.pending_bytes();
        counts
    }
}

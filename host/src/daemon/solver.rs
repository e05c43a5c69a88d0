//! The thread that turns a board's bytes into poses and hands them to everybody who wants them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use slitpose_protocol::{Rejection, Reply, Severity};

use super::BoardSlot;
use super::circuit::{Drainer, Dry, Filler};
use super::error::BoardError;
use super::inlet::CaptureInlet;
use super::reader::Verdict;
use crate::clock::HostInstant;
use crate::datagram::{DatagramServer, Publisher};
use crate::device::DeviceId;
use crate::pipeline::{Counts, Item, Pipeline, Record, Segment};
use crate::sink::Note;
use crate::telemetry::{BoardStatistics, HostLosses};

/// Without anything to solve it looks about so often.
const IDLE: Duration = Duration::from_millis(100);

/// The account of a board is renewed so often.
const ACCOUNT_EVERY: Duration = Duration::from_millis(200);

/// Something for whoever prints.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a box would be allocated for each pose")]
pub(super) enum Outgoing {
    Pose(Record),
    Note(Note),
}

/// Poses in an ordinary outbox, and more: some milliseconds of a board at 4 kHz.
pub(super) const OUTBOX_POSES: usize = 16;

/// What goes to the printer in one piece.
pub(super) type Outbox = Vec<Outgoing>;

/// Solves one board.
pub(super) struct SolverThread {
    pub(super) pipeline: Pipeline,
    pub(super) segments: Drainer<Segment>,
    pub(super) verdicts: Sender<(u64, Verdict)>,
    pub(super) consumers: Consumers,
    pub(super) slot: Arc<BoardSlot>,
}

/// Who gets what the pipeline gives.
pub(super) struct Consumers {
    pub(super) datagrams: Option<Arc<DatagramServer>>,
    pub(super) publisher: Option<Publisher>,
    pub(super) statistics: BoardStatistics,
    pub(super) printer: Option<Filler<Outbox>>,
    pub(super) outbox: Option<Outbox>,
    pub(super) capture: Option<CaptureInlet>,
    pub(super) device: Option<DeviceId>,
    /// The last warning or error of the board.
    pub(super) complaint: Option<String>,
    /// What the board did not want to do.
    pub(super) refused: Option<Rejection>,
}

impl SolverThread {
    /// Solves until the reader has ended, and gives the last account.
    pub(super) fn run(mut self) -> Counts {
        let mut is_unusable = false;
        let mut is_complete = false;
        let mut connection = 0;
        let mut idle_tick = None;
        let mut accounted = Instant::now();
        loop {
            match self.segments.next(IDLE) {
                Ok(mut segment) => {
                    let opened = segment.opened;
                    connection += u64::from(opened);
                    is_unusable &= !opened;
                    // What is queued behind the end belongs to nobody; what cannot be solved is recorded.
                    if is_unusable && !is_complete {
                        self.consumers.begin(&segment);
                        self.consumers.keep(&segment);
                    } else if !is_complete {
                        if let Err(error) = self.solve(&mut segment) {
                            is_unusable = true;
                            self.tell(connection, Verdict::Unusable(error));
                        }
                        let status = self.pipeline.counts().board_status;
                        if opened {
                            // A status from before the start tells nothing.
                            idle_tick = status.map(|status| status.tick);
                        } else if status.is_some_and(|status| !status.acquiring && Some(status.tick) != idle_tick) {
                            idle_tick = status.map(|status| status.tick);
                            let complaint = self.consumers.complaint.take();
                            self.tell(connection, Verdict::Stopped(complaint));
                        }
                        if self.pipeline.is_complete() {
                            is_complete = true;
                            self.tell(connection, Verdict::Complete);
                        }
                    }
                    self.segments.give_back(segment);
                }
                Err(Dry::Yet) => self.consumers.hand_over_capture(),
                Err(Dry::Forever) => break,
            }
            if accounted.elapsed() >= ACCOUNT_EVERY {
                accounted = Instant::now();
                self.account();
            }
        }
        self.consumers.hand_over_capture();
        self.account();
        self.pipeline.counts()
    }

    fn solve(&mut self, segment: &mut Segment) -> Result<(), BoardError> {
        let Self { pipeline, consumers, .. } = self;
        consumers.begin(segment);
        let fed = pipeline.feed(segment, |item| consumers.take(&item));
        consumers.hand_over_outbox();
        segment.truncate(*fed.as_ref().unwrap_or(&segment.bytes.len()));
        consumers.keep(segment);
        match consumers.refused.take() {
            Some(rejection) => fed.and(Err(BoardError::Refused(rejection))),
            None => fed.map(drop),
        }
    }

    fn tell(&self, connection: u64, verdict: Verdict) {
        // A reader that has ended needs no verdict, and one that has had many will look at the first.
        let _ = self.verdicts.try_send((connection, verdict));
    }

    fn account(&mut self) {
        let Consumers { statistics, capture, publisher, .. } = &mut self.consumers;
        statistics.set_host_losses(HostLosses {
            bytes_unrecorded: capture.as_ref().map_or(0, CaptureInlet::bytes_dropped),
            poses_unsent: publisher.as_ref().map_or(0, Publisher::missed),
        });
        self.slot.account(&self.pipeline, statistics);
    }
}

impl Consumers {
    fn begin(&mut self, segment: &Segment) {
        if let Some(capture) = &mut self.capture {
            capture.begin(segment.opened);
        }
    }

    fn take(&mut self, item: &Item<'_>) -> Result<(), BoardError> {
        match item {
            Item::Pose(record) => return self.take_pose(item, record),
            Item::Hello(hello) => {
                let device = DeviceId(hello.device_id);
                if self.device.replace(device) != Some(device) {
                    self.publisher = self.datagrams.as_ref().map(|datagrams| datagrams.publisher(device));
                }
                if let Some(capture) = &mut self.capture {
                    capture.hello(hello);
                }
                self.note(|| Note::hello(hello));
            }
            Item::Event { severity, device_time_s, text } => {
                if *severity != Severity::Info {
                    self.complaint = Some((*text).to_owned());
                }
                let (device, severity, device_time_s) = (self.device, *severity, *device_time_s);
                self.note(|| Note::Event { device, severity, device_time_s, text: (*text).to_owned() });
            }
            // Told when all of the segment is solved: what came is not to be lost.
            Item::Reply(Reply { outcome: Err(rejection), .. }) => self.refused = Some(*rejection),
            Item::Reply(_) | Item::Status(_) => {}
        }
        self.statistics.take(item, None, None);
        Ok(())
    }

    /// The most urgent first.
    fn take_pose(&mut self, item: &Item<'_>, record: &Record) -> Result<(), BoardError> {
        if let Some(publisher) = &mut self.publisher {
            publisher.publish(record, HostInstant::now());
        }
        self.statistics.take(item, record.arrival, record.arrival.map(|_| HostInstant::now()));
        if let Some(capture) = &mut self.capture {
            capture.pose(record);
        }
        if let Some(outbox) = self.outbox() {
            outbox.push(Outgoing::Pose(*record));
        }
        Ok(())
    }

    fn note(&mut self, note: impl FnOnce() -> Note) {
        if let Some(outbox) = self.outbox() {
            outbox.push(Outgoing::Note(note()));
        }
    }

    /// The outbox under way. Waits for one: whoever prints gets everything.
    fn outbox(&mut self) -> Option<&mut Outbox> {
        if self.outbox.is_none() {
            self.outbox = self.printer.as_ref()?.spare();
        }
        self.outbox.as_mut()
    }

    fn hand_over_outbox(&mut self) {
        if let (Some(printer), Some(outbox)) = (&self.printer, self.outbox.take()) {
            printer.hand_over(outbox);
        }
    }

    fn keep(&mut self, segment: &Segment) {
        if let Some(capture) = &mut self.capture {
            capture.keep(segment);
        }
    }

    fn hand_over_capture(&mut self) {
        if let Some(capture) = &mut self.capture {
            capture.hand_over();
        }
    }
}

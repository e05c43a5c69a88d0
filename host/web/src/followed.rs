//! One board, real or simulated, from its link to the page.

use slitpose_calibration::Head;
use slitpose_head::causes::with_causes;
use slitpose_model::Tier;
use slitpose_protocol::{Configuration, MAX_MESSAGE_BYTES, Message, Severity, encode};
use slitpose_tracking::capture::{CaptureError, Settings};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::pipeline::{
    Item, Pipeline, PipelineError, PipelineOptions, Record, SceneMatch, check, check_calibration, head_of,
};
use slitpose_tracking::solving::STREAM_TOLERANCE;
use slitpose_tracking::telemetry::{
    BoardReport, BoardStatistics, DaemonReport, LinkReport, LinkState, RecorderReport, RecorderState,
};

use crate::conversation::{Conversation, ConversationError};
use crate::recording::{Recording, Written, failed};
use crate::shown::{Outbox, Shown};
use crate::simulated::SimulatedHead;

const TIER: Tier = Tier::Exact { tolerance: STREAM_TOLERANCE };

/// A board that was lost while its link is open is greeted again after this time.
const AGAIN_NS: u64 = 500_000_000;

/// What is at the other end.
pub(crate) enum Far {
    Simulated(Box<SimulatedHead>),
    /// A port that the page reads and writes; whether it is open.
    Port(bool),
}

/// A board that is followed, for as long as its source is chosen.
pub(crate) struct Followed {
    head: Head,
    configuration: Configuration,
    far: Far,
    pub(crate) conversation: Option<Conversation>,
    again_ns: u64,
    pub(crate) pipeline: Pipeline,
    pub(crate) statistics: BoardStatistics,
    pub(crate) shown: Shown,
    link: LinkReport,
    has_run: bool,
    idle_tick: Option<u64>,
    pub(crate) recording: Option<Recording>,
    recorder: RecorderReport,
    device: Option<DeviceId>,
    /// Its last hello packet.
    hello: Vec<u8>,
    segment: Segment,
    poses: Vec<Record>,
    bytes: Vec<u8>,
}

impl Followed {
    pub(crate) fn new(name: &str, head: Head, configuration: Configuration, far: Far, now: HostInstant) -> Self {
        let head = if matches!(far, Far::Simulated(_)) { head.in_simulation() } else { head };
        Self {
            configuration,
            far,
            conversation: None,
            again_ns: 0,
            pipeline: Pipeline::new(head.clone(), TIER, SceneMatch::Required).watched(),
            statistics: BoardStatistics::new(name, now),
            shown: Shown::new(0, &head),
            head,
            link: LinkReport { since_utc_ns: now.utc_ns, ..LinkReport::default() },
            has_run: false,
            idle_tick: None,
            recording: None,
            recorder: RecorderReport::default(),
            device: None,
            hello: Vec::new(),
            segment: Segment::default(),
            poses: Vec::new(),
            bytes: Vec::new(),
        }
    }

    pub(crate) fn opened(&mut self, now: HostInstant) {
        self.far = Far::Port(true);
        self.greet(now);
    }

    pub(crate) fn closed(&mut self, reason: &str, now: HostInstant) {
        self.far = Far::Port(false);
        self.lost(&ConversationError::Gone { reason: reason.to_owned() }, now);
    }

    /// What is to be sent over the port; a simulated board gets it without.
    pub(crate) fn take_outgoing(&mut self) -> Vec<u8> {
        match (&self.far, &mut self.conversation) {
            (Far::Port(_), Some(conversation)) => conversation.take_outgoing(),
            _ => Vec::new(),
        }
    }

    /// Does what is due.
    pub(crate) fn tick(&mut self, clock: &dyn Fn() -> HostInstant, out: &mut Outbox) {
        let now = clock();
        let is_link_open = match &mut self.far {
            Far::Simulated(head) => head.is_there(now),
            Far::Port(is_open) => *is_open,
        };
        if self.conversation.is_none() && is_link_open && now.monotonic_ns >= self.again_ns {
            self.greet(now);
        }
        if let Far::Simulated(head) = &mut self.far {
            self.conversation.iter_mut().for_each(|conversation| head.write(&conversation.take_outgoing()));
            let mut bytes = std::mem::take(&mut self.bytes);
            bytes.clear();
            let is_open = head.advance(now, &mut bytes);
            self.receive(&bytes, now, clock, out);
            self.bytes = bytes;
            if !is_open {
                self.lost(&ConversationError::Gone { reason: "by a fault, or this page was stopped".to_owned() }, now);
            }
        }
        if let Some(conversation) = &mut self.conversation {
            let due = conversation.tick(now, &mut self.segment);
            self.settle(due, now);
        }
    }

    /// Takes bytes that were read at `at`.
    pub(crate) fn receive(&mut self, bytes: &[u8], at: HostInstant, clock: &dyn Fn() -> HostInstant, out: &mut Outbox) {
        let Some(conversation) = &mut self.conversation else { return };
        let was_running = conversation.is_running();
        let head = &self.head;
        let admit = |hello: &slitpose_protocol::Hello<'_>| {
            let head = head_of(head, hello);
            check(&head.file, SceneMatch::Required, hello)?;
            check_calibration(&head, SceneMatch::Required, hello)
        };
        let taken = conversation.receive(bytes, at, &mut self.segment, admit);
        if taken.is_ok() && conversation.is_running() {
            self.segment.opened |= !was_running;
            let solved = self.solve(clock, out);
            self.settle(solved.map_err(ConversationError::from), at);
        }
        self.settle(taken, at);
    }

    /// Solves the bytes of the segment, shows and records what comes of them.
    fn solve(&mut self, clock: &dyn Fn() -> HostInstant, out: &mut Outbox) -> Result<(), PipelineError> {
        let Self { pipeline, statistics, shown, segment, poses, device, hello, .. } = self;
        let is_recorded = self.recording.is_some();
        let (mut complaint, mut has_scans) = (None, false);
        let fed = pipeline.feed(segment, |item| {
            match &item {
                Item::Pose(record) => {
                    shown.add(record);
                    if is_recorded {
                        poses.push(**record);
                    }
                }
                Item::Hello(said) => {
                    *device = Some(DeviceId(said.device_id));
                    // It came in a packet, so it fits one.
                    let mut buffer = [0; MAX_MESSAGE_BYTES];
                    if let Ok(packet) = encode(&Message::Hello((*said).clone()), &mut buffer) {
                        *hello = packet.to_vec();
                    }
                }
                Item::Event { severity, text, .. } if *severity != Severity::Info => {
                    complaint = Some((*text).to_owned());
                }
                Item::Scan(_) => has_scans = true,
                Item::Oddity { oddity, .. } => out.notice(&oddity.to_string()),
                _ => {}
            }
            let (read_at, published_at) = match &item {
                Item::Scan(scan) => (scan.arrival, None),
                Item::Pose(record) => (record.arrival, record.arrival.map(|_| clock())),
                _ => (None, None),
            };
            statistics.update(&item, read_at, published_at);
            Ok::<_, PipelineError>(())
        });
        let now = clock();
        shown.send(pipeline.last_photocurrents(), now, out);
        if let (Some(recording), Some(device)) = (&mut self.recording, *device) {
            let done = recording.add(device, hello, segment, poses, now);
            self.settle_recording(done);
        }
        let is_first = self.segment.opened;
        self.segment.clear();
        self.poses.clear();
        fed?;
        self.watch(is_first, has_scans, complaint, now);
        Ok(())
    }

    /// Notices that scans have come, or that the board has stopped.
    fn watch(&mut self, is_first: bool, has_scans: bool, complaint: Option<String>, now: HostInstant) {
        if has_scans && self.link.state != LinkState::Running {
            self.link.reconnects += u64::from(std::mem::replace(&mut self.has_run, true));
            self.link.attempts = 0;
            self.set(LinkState::Running, None, now);
        }
        let idle = self.pipeline.board_status().filter(|status| !status.acquiring).map(|status| status.tick);
        // A status from before the start does not count.
        if !is_first && idle.is_some() && idle != self.idle_tick {
            let reason = complaint.unwrap_or_else(|| "it gives no reason; reset the board".to_owned());
            self.lost(&ConversationError::Stopped { reason }, now);
        }
        self.idle_tick = idle;
    }

    fn greet(&mut self, now: HostInstant) {
        self.conversation = Some(Conversation::open(self.configuration.clone(), now));
        self.segment.clear();
        self.set(LinkState::Connecting, None, now);
    }

    fn settle(&mut self, outcome: Result<(), ConversationError>, now: HostInstant) {
        if let Err(error) = outcome {
            self.lost(&error, now);
        }
    }

    /// The board cannot be followed for now, or at all.
    fn lost(&mut self, error: &ConversationError, now: HostInstant) {
        let state = match error {
            ConversationError::Gone { .. } => LinkState::Gone,
            ConversationError::Version(_) | ConversationError::Refused(_) | ConversationError::Pipeline(_) => {
                LinkState::Refused
            }
            _ => LinkState::Quiet,
        };
        self.conversation = None;
        self.again_ns = now.monotonic_ns + AGAIN_NS;
        self.link.attempts += 1;
        self.set(state, Some(with_causes(error)), now);
    }

    fn set(&mut self, state: LinkState, reason: Option<String>, now: HostInstant) {
        if self.link.state != state {
            self.link.since_utc_ns = now.utc_ns;
        }
        // While it is tried again the reason stands.
        let reason = if state == LinkState::Connecting { self.link.reason.take() } else { reason };
        (self.link.state, self.link.reason) = (state, reason);
    }

    /// Begins the capture called `name` on `written`, from the next bytes on.
    pub(crate) fn record(&mut self, name: &str, written: Written) -> Result<(), CaptureError> {
        let settings = Settings { tier: TIER, following: PipelineOptions::default() };
        let recording = Recording::begin(name, self.head.clone(), settings, written)?;
        self.recorder = recording.report();
        self.recording = Some(recording);
        Ok(())
    }

    pub(crate) fn end_recording(&mut self, now: HostInstant) {
        if let Some(recording) = self.recording.take() {
            self.recorder = RecorderReport { state: RecorderState::Off, ..recording.report() };
            if let Err(error) = recording.finish(now) {
                self.recorder = failed(&error);
            }
        }
    }

    /// Ends the recording if it has failed.
    pub(crate) fn settle_recording(&mut self, done: Result<(), CaptureError>) {
        if let Err(error) = done {
            self.recording = None;
            self.recorder = failed(&error);
        }
    }

    /// The report of the program, which began at `began`; also goes into the capture being recorded.
    pub(crate) fn report(&mut self, began: HostInstant, now: HostInstant) -> DaemonReport {
        let Self { pipeline, statistics, link, .. } = self;
        statistics.report.clock.drift_ppm = pipeline.drift_ppm();
        statistics.report.clock.contradicts_crystal = pipeline.contradicts_crystal();
        let report = statistics.report(&pipeline.counts(), pipeline.health(), now);
        let board = BoardReport { frame: pipeline.frame(), link: link.clone(), ..report };
        if let Some(recording) = &self.recording {
            self.recorder = recording.report();
        }
        let report = DaemonReport::of(began, now, vec![board], self.recorder.clone());
        if let Some(recording) = &mut self.recording {
            let done = recording.tick(&report.boards[0], &report, now);
            self.settle_recording(done);
        }
        report
    }
}

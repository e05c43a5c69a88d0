//! The thread that records. No other thread waits for the disk.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded, unbounded};
use slitpose_calibration::Head;

use super::board::{BoardError, BoardPlan};
use super::handoff::{Consumer, Empty, buffer_pool};
use super::tap::{TapChunk, TapEnds};
use super::{Talk, spawn};
use crate::telemetry::{DaemonReport, RecorderReport, RecorderState};
use slitpose_head::causes::with_causes;
use slitpose_head::threads::{join, lock};
use slitpose_tracking::capture::{CaptureError, CaptureSeries, Settings, Setup};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;

const CHUNK: Duration = Duration::from_millis(20);

/// Most chunks on their way to the disk: 5 s of one board.
const CHUNKS_A_BOARD: usize = 256;

/// Most reports on their way to the disk.
const ACCOUNTS: usize = 4;

const IDLE: Duration = Duration::from_millis(100);

/// A board hands over its last chunk of an ended recording within this time.
const LAST_CHUNK: Duration = Duration::from_millis(200);

pub(crate) struct CapturePlan {
    /// The files; `None`: the recording begins later.
    pub series: Option<CaptureSeries>,
    /// Poses recorded per device second, in addition to the bytes from which all poses can be solved again.
    pub poses_hz: f64,
    pub talk: Arc<Talk>,
}

pub(super) struct RecorderThread {
    thread: Mutex<Option<JoinHandle<()>>>,
    accounts: Mutex<Option<Sender<DaemonReport>>>,
    /// The next captures; `None` ends the present one.
    captures: Sender<Option<CaptureSeries>>,
    pub(super) report: Arc<Mutex<RecorderReport>>,
}

struct Source {
    head: Head,
    settings: Settings,
    keeps_time: bool,
    device: Option<DeviceId>,
}

struct Recorder {
    series: Option<CaptureSeries>,
    captures: Receiver<Option<CaptureSeries>>,
    recording: Arc<AtomicBool>,
    /// When the last chunks of an ended recording have come.
    ends_at: Option<Instant>,
    sources: Vec<Source>,
    talk: Arc<Talk>,
    report: Arc<Mutex<RecorderReport>>,
    bytes_missing: u64,
    log_ns: u64,
}

impl RecorderThread {
    /// Starts the thread; returns what boards need of it.
    pub(super) fn start(plan: CapturePlan, boards: &[BoardPlan]) -> Result<(Self, TapEnds), BoardError> {
        let (producer, consumer) = buffer_pool(CHUNKS_A_BOARD * boards.len().max(1), TapChunk::with_capacity);
        let (tell, accounts) = bounded(ACCOUNTS);
        let source = |board: &BoardPlan| Source {
            head: board.head.clone(),
            settings: Settings { tier: board.tier, following: board.following },
            keeps_time: board.keeps_time,
            device: None,
        };
        let (order, captures) = unbounded();
        let recording = Arc::new(AtomicBool::new(plan.series.is_some()));
        let state = if plan.series.is_some() { RecorderState::Recording } else { RecorderState::Off };
        let report = Arc::new(Mutex::new(RecorderReport { state, ..RecorderReport::default() }));
        let recorder = Recorder {
            series: plan.series,
            captures,
            recording: Arc::clone(&recording),
            ends_at: None,
            sources: boards.iter().map(source).collect(),
            talk: plan.talk,
            report: Arc::clone(&report),
            bytes_missing: 0,
            log_ns: 0,
        };
        recorder.publish();
        let thread = spawn("record".to_owned(), move || recorder.run(&consumer, &accounts))?;
        let this = Self { thread: Mutex::new(Some(thread)), accounts: Mutex::new(Some(tell)), captures: order, report };
        let ends = TapEnds {
            chunks: producer,
            is_wanted: recording,
            pose_every_s: plan.poses_hz.recip(),
            span: CHUNK,
            tells_hello: false,
        };
        Ok((this, ends))
    }

    pub(super) fn report(&self) -> RecorderReport {
        lock(&self.report).clone()
    }

    /// Begins a recording, after the present one if there is one.
    pub(super) fn begin(&self, series: CaptureSeries) {
        lock(&self.report).state = RecorderState::Recording;
        let _ = self.captures.send(Some(series));
    }

    pub(super) fn end_capture(&self) {
        let _ = self.captures.send(None);
    }

    /// Records the daemon's report in the capture, unless the recorder is far behind.
    pub(super) fn account(&self, report: DaemonReport) {
        if let Some(accounts) = &*lock(&self.accounts) {
            let _ = accounts.try_send(report);
        }
    }

    /// Waits for the end; all boards must have ended.
    pub(super) fn end(&self) -> RecorderReport {
        drop(lock(&self.accounts).take());
        if let Some(thread) = lock(&self.thread).take() {
            join(thread);
        }
        self.report()
    }
}

impl Recorder {
    fn run(mut self, chunks: &Consumer<TapChunk>, accounts: &Receiver<DaemonReport>) {
        loop {
            let done = match chunks.next(IDLE) {
                Ok(chunk) => {
                    let done = self.record(&chunk);
                    chunks.give_back(chunk);
                    done
                }
                Err(Empty::ForNow) => self.series.as_mut().map_or(Ok(()), CaptureSeries::tick),
                Err(Empty::Closed) => break,
            };
            self.report_failure(done);
            while let Ok(report) = accounts.try_recv() {
                let done = self.record_account(&report);
                self.report_failure(done);
            }
            self.change_captures();
            self.publish();
        }
        // The last report comes when all boards have ended.
        for report in accounts {
            let done = self.record_account(&report);
            self.report_failure(done);
        }
        self.publish();
        self.finish();
    }

    /// Ends the present capture, and begins the next, as asked.
    fn change_captures(&mut self) {
        if self.ends_at.is_some_and(|at| Instant::now() < at) {
            return;
        }
        if self.ends_at.take().is_some() {
            self.finish();
        }
        match self.captures.try_recv() {
            Ok(Some(series)) => {
                self.finish();
                self.series = Some(series);
                // Each capture has the setup of its boards.
                self.sources.iter_mut().for_each(|source| source.device = None);
                let mut report = lock(&self.report);
                *report = RecorderReport { state: RecorderState::Recording, ..RecorderReport::default() };
                self.bytes_missing = 0;
                self.recording.store(true, Ordering::Relaxed);
            }
            Ok(None) => {
                self.recording.store(false, Ordering::Relaxed);
                self.ends_at = Some(Instant::now() + LAST_CHUNK);
            }
            Err(_) => {}
        }
    }

    /// Completes the present capture, if there is one.
    fn finish(&mut self) {
        let Some(series) = self.series.take() else { return };
        match series.finish() {
            Ok(recorded) => {
                let mut report = lock(&self.report);
                report.bytes_dropped = recorded.dropped_bytes + self.bytes_missing;
                if report.state == RecorderState::Recording {
                    report.state = RecorderState::Off;
                }
            }
            Err(error) => self.report_failure(Err(error)),
        }
    }

    fn record(&mut self, chunk: &TapChunk) -> Result<(), CaptureError> {
        let Some(series) = &mut self.series else { return Ok(()) };
        let source = &mut self.sources[chunk.board];
        let now_ns = HostInstant::now().utc_ns;
        let log_ns = match chunk.segment.reads.first() {
            Some(read) => read.at.map_or(chunk.device_ns, |at| at.utc_ns),
            None => now_ns,
        };
        self.log_ns = log_ns;
        let hello = Some(chunk.hello.as_slice()).filter(|hello| !hello.is_empty());
        if let Some(device) = chunk.device
            && (source.device != Some(device) || hello.is_some())
        {
            source.device = Some(device);
            let added = series.add_device(Setup::new(device, &source.head, source.settings), hello, log_ns);
            if added.is_err() {
                self.bytes_missing += chunk.segment.bytes.len() as u64;
                return added;
            }
        }
        let Some(device) = source.device else {
            // Without a hello a board's bytes cannot be decoded.
            self.bytes_missing += chunk.segment.bytes.len() as u64;
            return Ok(());
        };
        series.segment(device, &chunk.segment, log_ns)?;
        chunk.poses.iter().try_for_each(|record| series.pose(record, log_ns))
    }

    fn record_account(&mut self, report: &DaemonReport) -> Result<(), CaptureError> {
        let Some(series) = &mut self.series else { return Ok(()) };
        // On one timeline with the boards.
        let keep_time = self.sources.iter().all(|source| source.keeps_time);
        let now_ns = if keep_time { HostInstant::now().utc_ns } else { self.log_ns };
        for board in &report.boards {
            if let Some(device) = board.device.filter(|device| self.sources.iter().any(|it| it.device == Some(*device)))
            {
                series.report(Some(device), board, now_ns)?;
            }
        }
        series.report(None, report, now_ns)
    }

    /// Tells the user why the capture has ended.
    fn report_failure(&self, done: Result<(), CaptureError>) {
        if let Err(error) = done {
            let reason = with_causes(&error);
            (self.talk)(format_args!("{reason}"));
            let mut report = lock(&self.report);
            (report.state, report.reason) = (RecorderState::Failed, Some(reason));
        }
    }

    fn publish(&self) {
        let Some(series) = &self.series else { return };
        let recorded = series.recorded();
        let mut report = lock(&self.report);
        report.file = Some(series.path().display().to_string());
        report.bytes = series.bytes();
        report.files = recorded.files;
        report.flushes = series.flushes();
        report.bytes_dropped = recorded.dropped_bytes + self.bytes_missing;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, VecDeque};
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;
    use slitpose_tracking::capture::{CaptureReader, Entry, Existing, Limits};
    use slitpose_tracking::link::Segment;
    use slitpose_tracking::pipeline::PipelineOptions;

    const BOARDS: [DeviceId; 2] = [DeviceId(*b"first board."), DeviceId(*b"second board")];

    /// Bytes of each board in a capture.
    type Bytes = BTreeMap<DeviceId, Vec<u8>>;

    #[derive(Clone, Copy, Debug)]
    enum Step {
        /// The user begins a recording, or ends it.
        Order(bool),
        /// A board hands over bytes, and has introduced itself or not.
        Chunk { board: usize, introduced: bool },
        /// The thread looks for orders, before or after the last chunks of an ended recording have come.
        Look { later: bool },
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let chunk = (0..2_usize, any::<bool>()).prop_map(|(board, introduced)| Step::Chunk { board, introduced });
        let look = any::<bool>().prop_map(|later| Step::Look { later });
        proptest::collection::vec(prop_oneof![any::<bool>().prop_map(Step::Order), chunk, look], 0..40)
    }

    #[derive(Default)]
    struct Reference {
        orders: VecDeque<bool>,
        captures: Vec<Bytes>,
        is_open: bool,
        is_wanted: bool,
        is_ending: bool,
        is_introduced: [bool; 2],
        missing: u64,
    }

    impl Reference {
        fn chunk(&mut self, board: usize, introduced: bool, bytes: &[u8]) {
            let Some(capture) = self.captures.last_mut().filter(|_| self.is_open) else { return };
            self.is_introduced[board] |= introduced;
            if self.is_introduced[board] {
                capture.entry(BOARDS[board]).or_default().extend(bytes);
            } else {
                self.missing += bytes.len() as u64;
            }
        }

        fn look(&mut self, later: bool) {
            if self.is_ending && !later {
                return;
            }
            self.is_open &= !self.is_ending;
            self.is_ending = false;
            match self.orders.pop_front() {
                Some(true) => {
                    self.captures.push(Bytes::new());
                    (self.is_open, self.is_wanted, self.missing, self.is_introduced) = (true, true, 0, [false; 2]);
                }
                Some(false) => (self.is_wanted, self.is_ending) = (false, true),
                None => {}
            }
        }
    }

    fn bytes_in(path: &Path) -> Bytes {
        let (mut bytes, mut segment) = (Bytes::new(), Segment::default());
        let mut reader = CaptureReader::open(path).unwrap();
        while let Some(entry) = reader.next(&mut segment).unwrap() {
            if let Entry::Link { device: Some(device), .. } = entry {
                bytes.entry(device).or_default().extend(&segment.bytes);
            }
        }
        bytes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Recordings begin and end at random while boards send. Each capture holds the bytes that came while it was open, in
        /// their order; bytes of boards that have not introduced themselves are counted as missing.
        #[test]
        fn captures_hold_what_came_while_they_were_open(steps in steps()) {
            let folder = tempfile::tempdir().unwrap();
            let path = |number: usize| folder.path().join(format!("{number}.mcap"));
            let (order, captures) = unbounded();
            let source = || Source {
                head: WIDE.read().unwrap().into(),
                settings: Settings { tier: Tier::Paper, following: PipelineOptions::default() },
                keeps_time: true,
                device: None,
            };
            let mut recorder = Recorder {
                series: None,
                captures,
                recording: Arc::default(),
                ends_at: None,
                sources: vec![source(), source()],
                talk: Arc::new(|text| panic!("{text}")),
                report: Arc::default(),
                bytes_missing: 0,
                log_ns: 0,
            };
            let mut reference = Reference::default();
            let mut begun = 0;
            for (number, step) in (0_u8..).zip(steps) {
                match step {
                    Step::Order(begins) => {
                        let series = begins.then(|| {
                            begun += 1;
                            let (limits, schema) = (Limits::default(), String::new());
                            CaptureSeries::create(&path(begun), limits, Existing::Kept, schema).unwrap()
                        });
                        order.send(series).unwrap();
                        reference.orders.push_back(begins);
                    }
                    Step::Chunk { board, introduced } => {
                        let mut chunk = TapChunk { board, ..TapChunk::default() };
                        chunk.device = introduced.then_some(BOARDS[board]);
                        let bytes = [number; 3];
                        chunk.segment.push(&bytes, None);
                        prop_assert!(recorder.record(&chunk).is_ok());
                        reference.chunk(board, introduced, &bytes);
                    }
                    Step::Look { later } => {
                        let now = Instant::now();
                        // However long the test is stopped here.
                        let ends_at = if later { now } else { now + Duration::from_secs(3600) };
                        recorder.ends_at = recorder.ends_at.map(|_| ends_at);
                        recorder.change_captures();
                        reference.look(later);
                    }
                }
                recorder.publish();
                let report = lock(&recorder.report).clone();
                let state = if reference.is_open { RecorderState::Recording } else { RecorderState::Off };
                prop_assert_eq!(report.state, state);
                prop_assert_eq!(report.bytes_dropped, reference.missing);
                prop_assert_eq!(recorder.recording.load(Ordering::Relaxed), reference.is_wanted);
            }
            recorder.finish();
            drop(recorder);
            for (number, expected) in (1..).zip(&reference.captures) {
                prop_assert_eq!(&bytes_in(&path(number)), expected, "capture {}", number);
            }
        }
    }
}

//! The recorder: its thread takes all bytes of all boards, and alone waits for the disk.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender, TryRecvError, unbounded};
use slitpose_calibration::Head;

use super::board::BoardPlan;
use super::handoff::{Consumer, buffer_pool};
use super::tap::{TapChunk, TapEnds};
use crate::background::{NO_THREAD, spawn};
use crate::terminal::say;
use slitpose_head::causes::with_causes;
use slitpose_head::threads::lock;
use slitpose_tracking::capture::{CaptureError, CaptureSeries, Settings, Setup};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::telemetry::{DaemonReport, RecorderReport, RecorderState};

const IDLE: Duration = Duration::from_millis(100);

/// Most chunks on their way to the disk: 5 s of one board.
const CHUNKS_A_BOARD: usize = 256;

/// A report is left out if so many orders wait for the recorder.
const ACCOUNTS: usize = 4;

/// A board hands over its last chunk of an ended recording within this time.
const LAST_CHUNK: Duration = Duration::from_millis(200);

pub(crate) struct CapturePlan {
    /// The files; `None`: the recording begins later.
    pub series: Option<CaptureSeries>,
    /// Poses recorded per device second, in addition to the bytes from which all poses can be solved again.
    pub poses_hz: f64,
}

enum RecorderOrder {
    Begin(Box<CaptureSeries>),
    End,
    /// Note a text of an instant, so many nanoseconds before it was asked for.
    Note {
        text: String,
        ago_ns: u64,
        asked: Instant,
    },
    Account(Box<DaemonReport>),
}

/// The daemon's end of the recorder.
pub(crate) struct RecorderControl {
    /// `None` once the last report is sent.
    orders: Mutex<Option<Sender<RecorderOrder>>>,
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
    orders: Receiver<RecorderOrder>,
    recording: Arc<AtomicBool>,
    /// When the last chunks of an ended recording have come.
    ends_at: Option<Instant>,
    sources: Vec<Source>,
    report: Arc<Mutex<RecorderReport>>,
    bytes_missing: u64,
    log_ns: u64,
}

impl RecorderControl {
    /// Starts the recorder's thread; returns what boards need of it, too.
    pub(super) fn start(plan: CapturePlan, boards: &[BoardPlan]) -> anyhow::Result<(Self, JoinHandle<()>, TapEnds)> {
        let (order, orders) = unbounded();
        let source = |board: &BoardPlan| Source {
            head: board.head.clone(),
            settings: Settings { tier: board.tier, following: board.following },
            keeps_time: board.keeps_time,
            device: None,
        };
        let is_wanted = Arc::new(AtomicBool::new(plan.series.is_some()));
        let state = if plan.series.is_some() { RecorderState::Recording } else { RecorderState::Off };
        let report = Arc::new(Mutex::new(RecorderReport { state, ..RecorderReport::default() }));
        let recorder = Recorder {
            series: plan.series,
            orders,
            recording: Arc::clone(&is_wanted),
            ends_at: None,
            sources: boards.iter().map(source).collect(),
            report: Arc::clone(&report),
            bytes_missing: 0,
            log_ns: 0,
        };
        recorder.publish();
        let (chunks, consumer) = buffer_pool(CHUNKS_A_BOARD * boards.len().max(1), TapChunk::with_capacity);
        let thread = spawn("record".to_owned(), move || recorder.run(&consumer)).context(NO_THREAD)?;
        let pose_every_s = plan.poses_hz.recip();
        let ends = TapEnds { chunks, is_wanted, pose_every_s };
        Ok((Self { orders: Mutex::new(Some(order)), report }, thread, ends))
    }

    /// Begins a recording, after the present one if there is one.
    pub(crate) fn begin(&self, series: CaptureSeries) {
        // The file that it had was that of the recording before.
        *lock(&self.report) = RecorderReport { state: RecorderState::Recording, ..RecorderReport::default() };
        self.order(RecorderOrder::Begin(Box::new(series)));
    }

    /// Ends the present capture, when the last bytes have come.
    pub(crate) fn end_capture(&self) {
        lock(&self.report).state = RecorderState::Off;
        self.order(RecorderOrder::End);
    }

    /// Notes a text of an instant in the present capture.
    pub(crate) fn note(&self, text: String, ago_s: f64) {
        let ago_ns = (ago_s * 1e9) as u64;
        self.order(RecorderOrder::Note { text, ago_ns, asked: Instant::now() });
    }

    /// Records the daemon's report in the capture, unless the recorder is far behind.
    pub(super) fn account(&self, report: DaemonReport) {
        let is_behind = lock(&self.orders).as_ref().is_some_and(|orders| orders.len() >= ACCOUNTS);
        if !is_behind {
            self.order(RecorderOrder::Account(Box::new(report)));
        }
    }

    fn order(&self, order: RecorderOrder) {
        // The recorder ends after all who give orders.
        let _ = lock(&self.orders).as_ref().map(|orders| orders.send(order));
    }

    /// Records the daemon's last report, however far behind the recorder is, which ends behind it.
    pub(super) fn close(&self, last: DaemonReport) {
        self.order(RecorderOrder::Account(Box::new(last)));
        lock(&self.orders).take();
    }
}

impl Recorder {
    /// Records until all boards have ended. Nothing waits for it.
    fn run(mut self, chunks: &Consumer<TapChunk>) {
        loop {
            match chunks.next(IDLE) {
                Ok(chunk) => {
                    let done = self.record(&chunk);
                    self.report_failure(done);
                    chunks.give_back(chunk);
                }
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return self.end(),
            }
            self.tick();
        }
    }

    fn tick(&mut self) {
        if let Some(series) = &mut self.series
            && lock(&self.report).state == RecorderState::Recording
        {
            let done = series.tick();
            self.report_failure(done);
        }
        self.obey();
        self.publish();
    }

    fn end(&mut self) {
        // The last report comes when all boards have ended.
        while let Ok(order) = self.orders.recv() {
            if let RecorderOrder::Account(report) = order {
                self.record_account(&report);
            }
        }
        self.publish();
        self.finish();
    }

    /// Ends the present capture, begins the next, or notes or reports something, as asked.
    fn obey(&mut self) {
        if self.ends_at.is_some_and(|at| Instant::now() < at) {
            return;
        }
        if self.ends_at.take().is_some() {
            self.finish();
        }
        match self.orders.try_recv() {
            Ok(RecorderOrder::Begin(series)) => {
                self.finish();
                self.series = Some(*series);
                // Each capture has the setup of its boards.
                self.sources.iter_mut().for_each(|source| source.device = None);
                let mut report = lock(&self.report);
                *report = RecorderReport { state: RecorderState::Recording, ..RecorderReport::default() };
                self.bytes_missing = 0;
                self.recording.store(true, Ordering::Relaxed);
            }
            Ok(RecorderOrder::Note { text, ago_ns, asked }) => {
                let now_ns = self.now_ns();
                if let Some(series) = &mut self.series {
                    let waited_ns = asked.elapsed().as_nanos() as u64;
                    let done = series.note(now_ns.saturating_sub(ago_ns + waited_ns), &text, now_ns);
                    self.report_failure(done);
                }
            }
            Ok(RecorderOrder::End) => {
                self.recording.store(false, Ordering::Relaxed);
                self.ends_at = Some(Instant::now() + LAST_CHUNK);
            }
            Ok(RecorderOrder::Account(report)) => self.record_account(&report),
            Err(_) => {}
        }
    }

    /// Completes the present capture, if there is one.
    fn finish(&mut self) {
        let Some(series) = self.series.take() else { return };
        match series.finish() {
            Ok(recorded) => {
                let mut report = lock(&self.report);
                report.bytes_dropped = recorded.bytes_dropped + self.bytes_missing;
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

    fn record_account(&mut self, report: &DaemonReport) {
        let now_ns = self.now_ns();
        let Some(series) = &mut self.series else { return };
        let is_recorded = |device: &DeviceId| self.sources.iter().any(|source| source.device == Some(*device));
        let mut of_boards = report.boards.iter().filter_map(|board| Some((board.device.filter(is_recorded)?, board)));
        let done = of_boards
            .try_for_each(|(device, board)| series.report(Some(device), board, now_ns))
            .and_then(|()| series.report(None, report, now_ns));
        self.report_failure(done);
    }

    /// Now, on one time line with the boards.
    fn now_ns(&self) -> u64 {
        let keep_time = self.sources.iter().all(|source| source.keeps_time);
        if keep_time { HostInstant::now().utc_ns } else { self.log_ns }
    }

    /// Tells the user why the capture has ended.
    fn report_failure(&self, done: Result<(), CaptureError>) {
        if let Err(error) = done {
            let reason = with_causes(&error);
            say(format_args!("{reason}"));
            let mut report = lock(&self.report);
            (report.state, report.reason) = (RecorderState::Failed, Some(reason));
        }
    }

    fn publish(&self) {
        let Some(series) = &self.series else { return };
        let mut report = lock(&self.report);
        let (state, reason) = (report.state, report.reason.take());
        *report = RecorderReport { state, reason, ..series.progress() };
        report.bytes_dropped += self.bytes_missing;
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;
    use slitpose_tracking::capture::{CaptureReader, Entry, Existing, Limits};
    use slitpose_tracking::link::Segment;
    use slitpose_tracking::pipeline::PipelineOptions;

    const BOARDS: [DeviceId; 2] = [DeviceId(*b"first board."), DeviceId(*b"second board")];

    #[derive(Clone, Copy, Debug)]
    enum Step {
        /// The user begins a recording, or ends it.
        Order(bool),
        /// A board hands over its bytes, and has introduced itself or not.
        Chunk { board: usize, introduced: bool },
        /// The thread looks for orders, before or after the last chunks of an ended recording have come.
        Look { later: bool },
    }

    /// The number of each step whose chunk is in the capture at `path`, by board.
    fn steps_in(path: &Path) -> [Vec<u8>; 2] {
        let (mut steps, mut segment) = ([Vec::new(), Vec::new()], Segment::default());
        let mut reader = CaptureReader::open(path).unwrap();
        while let Some(entry) = reader.next(&mut segment).unwrap() {
            if let Entry::Link { device: Some(device), .. } = entry {
                steps[usize::from(device == BOARDS[1])].extend(&segment.bytes);
            }
        }
        steps
    }

    #[test]
    fn captures_hold_what_came_while_they_were_open_of_boards_that_have_introduced_themselves() {
        use RecorderState::{Off, Recording};
        use Step::{Chunk, Look, Order};
        let chunk = |board, introduced| Chunk { board, introduced };
        // Each step, and what then holds: the state, the bytes missing, whether boards hand over chunks.
        let steps = [
            (chunk(0, true), (Off, 0, false)),
            (Order(true), (Off, 0, false)),
            (Look { later: false }, (Recording, 0, true)),
            (chunk(0, false), (Recording, 1, true)),
            (chunk(0, true), (Recording, 1, true)),
            (chunk(0, false), (Recording, 1, true)),
            (chunk(1, false), (Recording, 2, true)),
            (Order(false), (Recording, 2, true)),
            (Look { later: false }, (Recording, 2, false)),
            (chunk(1, true), (Recording, 2, false)),
            (Order(true), (Recording, 2, false)),
            (Look { later: false }, (Recording, 2, false)),
            (Look { later: true }, (Recording, 0, true)),
            // It is another capture, to which boards introduce themselves anew.
            (chunk(0, false), (Recording, 1, true)),
            (chunk(1, true), (Recording, 1, true)),
            // The next one comes at once.
            (Order(true), (Recording, 1, true)),
            (Look { later: false }, (Recording, 0, true)),
            (chunk(0, true), (Recording, 0, true)),
            (Order(false), (Recording, 0, true)),
            (Look { later: false }, (Recording, 0, false)),
            (Look { later: true }, (Off, 0, false)),
            (chunk(0, true), (Off, 0, false)),
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = |number: usize| folder.path().join(format!("{number}.mcap"));
        let (order, orders) = unbounded();
        let source = || Source {
            head: WIDE.read().unwrap().into(),
            settings: Settings { tier: Tier::Paper, following: PipelineOptions::default() },
            keeps_time: true,
            device: None,
        };
        let mut recorder = Recorder {
            series: None,
            orders,
            recording: Arc::default(),
            ends_at: None,
            sources: vec![source(), source()],
            report: Arc::default(),
            bytes_missing: 0,
            log_ns: 0,
        };
        let mut begun = 0;
        for (number, (step, expected)) in (0..).zip(steps) {
            match step {
                Order(begins) => {
                    let given = if begins {
                        begun += 1;
                        let (limits, existing) = (Limits::default(), Existing::Kept);
                        let series = CaptureSeries::create(&path(begun), limits, existing).unwrap();
                        RecorderOrder::Begin(Box::new(series))
                    } else {
                        RecorderOrder::End
                    };
                    order.send(given).unwrap();
                }
                Chunk { board, introduced } => {
                    let device = introduced.then_some(BOARDS[board]);
                    let mut chunk = TapChunk { board, device, ..TapChunk::default() };
                    chunk.segment.push(&[number], None);
                    let done = recorder.record(&chunk);
                    recorder.report_failure(done);
                }
                Look { later } => {
                    // However long the test is stopped here.
                    let wait = if later { Duration::ZERO } else { Duration::from_secs(3600) };
                    recorder.ends_at = recorder.ends_at.map(|_| Instant::now() + wait);
                    recorder.tick();
                }
            }
            recorder.publish();
            let report = recorder.report.lock().unwrap().clone();
            let found = (report.state, report.bytes_dropped, recorder.recording.load(Ordering::Relaxed));
            assert_eq!(found, expected, "step {number}, {step:?}");
        }
        let captured = [1, 2, 3].map(|number| steps_in(&path(number)));
        assert_eq!(captured, [[vec![4, 5], vec![9]], [vec![], vec![14]], [vec![17], vec![]]]);
    }

    #[test]
    fn the_last_report_is_recorded_however_many_orders_wait() {
        let (order, orders) = unbounded();
        let control = RecorderControl { orders: Mutex::new(Some(order)), report: Arc::default() };
        (0..ACCOUNTS).for_each(|_| control.note(String::new(), 0.0));
        let report = || DaemonReport::of(HostInstant::now(), HostInstant::now(), Vec::new(), RecorderReport::default());
        control.account(report());
        control.close(report());
        // The recorder ends behind it, which is the only one.
        assert_eq!(orders.iter().filter(|order| matches!(order, RecorderOrder::Account(_))).count(), 1);
    }
}

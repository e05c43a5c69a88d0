//! The thread that records. No other thread waits for the disk.

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use slitpose_calibration::Head;

use super::board::BoardPlan;
use super::buffer_pool::{Consumer, Empty, Producer, buffer_pool};
use super::capture_queue::CaptureChunk;
use super::error::{BoardError, with_causes};
use super::{Talk, spawn};
use crate::capture::{CaptureError, CaptureSeries, Settings, Setup};
use crate::clock::HostInstant;
use crate::link::DeviceId;
use crate::telemetry::{DaemonReport, RecorderReport, RecorderState};
use slitpose_head::threads::{join, lock};

/// Most chunks on their way to the disk: 5 s of one board.
const CHUNKS_A_BOARD: usize = 256;

/// Most reports on their way to the disk.
const ACCOUNTS: usize = 4;

/// Longest wait without anything to record.
const IDLE: Duration = Duration::from_millis(100);

/// A capture to be recorded.
pub(crate) struct CapturePlan {
    /// The files.
    pub series: CaptureSeries,
    /// Poses recorded per device second, in addition to the bytes from which all poses can be solved again.
    pub poses_hz: f64,
    /// Prints a message for the user.
    pub talk: Arc<Talk>,
}

/// The recorder's thread.
pub(super) struct RecorderThread {
    thread: Mutex<Option<JoinHandle<()>>>,
    accounts: Mutex<Option<Sender<DaemonReport>>>,
    report: Arc<Mutex<RecorderReport>>,
}

/// The board of a number.
struct Source {
    head: Head,
    settings: Settings,
    keeps_time: bool,
    device: Option<DeviceId>,
}

/// State of the thread.
struct Recorder {
    series: CaptureSeries,
    sources: Vec<Source>,
    talk: Arc<Talk>,
    report: Arc<Mutex<RecorderReport>>,
    bytes_missing: u64,
    /// Log time of the last record.
    log_ns: u64,
}

impl RecorderThread {
    /// Starts the thread; returns the boards' end of the queue and the device time between recorded poses, seconds.
    pub(super) fn start(
        plan: CapturePlan,
        boards: &[BoardPlan],
    ) -> Result<(Self, (Producer<CaptureChunk>, f64)), BoardError> {
        let (producer, consumer) = buffer_pool(CHUNKS_A_BOARD * boards.len().max(1), CaptureChunk::with_capacity);
        let (tell, accounts) = bounded(ACCOUNTS);
        let source = |board: &BoardPlan| Source {
            head: board.head.clone(),
            settings: Settings { tier: board.tier, following: board.following },
            keeps_time: board.keeps_time,
            device: None,
        };
        let recording = RecorderReport { state: RecorderState::Recording, ..RecorderReport::default() };
        let report = Arc::new(Mutex::new(recording));
        let recorder = Recorder {
            series: plan.series,
            sources: boards.iter().map(source).collect(),
            talk: plan.talk,
            report: Arc::clone(&report),
            bytes_missing: 0,
            log_ns: 0,
        };
        recorder.publish();
        let thread = spawn("record".to_owned(), move || recorder.run(&consumer, &accounts))?;
        let this = Self { thread: Mutex::new(Some(thread)), accounts: Mutex::new(Some(tell)), report };
        Ok((this, (producer, plan.poses_hz.recip())))
    }
}

impl RecorderThread {
    /// The state of the recording.
    pub(super) fn report(&self) -> RecorderReport {
        lock(&self.report).clone()
    }

    /// A function that returns the state of the recording.
    pub(super) fn reports(&self) -> impl Fn() -> RecorderReport + Send + use<> {
        let report = Arc::clone(&self.report);
        move || lock(&report).clone()
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
    fn run(mut self, chunks: &Consumer<CaptureChunk>, accounts: &Receiver<DaemonReport>) {
        loop {
            let done = match chunks.next(IDLE) {
                Ok(chunk) => {
                    let done = self.record(&chunk);
                    chunks.give_back(chunk);
                    done
                }
                Err(Empty::ForNow) => self.series.tick(),
                Err(Empty::Closed) => break,
            };
            self.report_failure(done);
            while let Ok(report) = accounts.try_recv() {
                let done = self.record_account(&report);
                self.report_failure(done);
            }
            self.publish();
        }
        // The last report comes when all boards have ended.
        for report in accounts {
            let done = self.record_account(&report);
            self.report_failure(done);
        }
        self.publish();
        let Self { series, talk, report, bytes_missing, .. } = self;
        let finished = series.finish();
        let mut report = lock(&report);
        match finished {
            Ok(recorded) => {
                report.bytes_dropped = recorded.dropped_bytes + bytes_missing;
                if report.state == RecorderState::Recording {
                    report.state = RecorderState::Off;
                }
            }
            Err(error) => {
                let reason = with_causes(&error);
                talk(format_args!("{reason}"));
                report.state = RecorderState::Failed;
                report.reason = Some(reason);
            }
        }
    }

    fn record(&mut self, chunk: &CaptureChunk) -> Result<(), CaptureError> {
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
            let added = self.series.add_device(Setup::new(device, &source.head, source.settings), hello, log_ns);
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
        self.series.segment(device, &chunk.segment, log_ns)?;
        chunk.poses.iter().try_for_each(|record| self.series.pose(record, log_ns))
    }

    fn record_account(&mut self, report: &DaemonReport) -> Result<(), CaptureError> {
        // On one timeline with the boards.
        let keep_time = self.sources.iter().all(|source| source.keeps_time);
        let now_ns = if keep_time { HostInstant::now().utc_ns } else { self.log_ns };
        for board in &report.boards {
            if let Some(device) = board.device.filter(|device| self.sources.iter().any(|it| it.device == Some(*device)))
            {
                self.series.report(Some(device), board, now_ns)?;
            }
        }
        self.series.report(None, report, now_ns)
    }

    /// Tells the user why the capture has ended.
    fn report_failure(&mut self, done: Result<(), CaptureError>) {
        if let Err(error) = done {
            let reason = with_causes(&error);
            (self.talk)(format_args!("{reason}"));
            let mut report = lock(&self.report);
            (report.state, report.reason) = (RecorderState::Failed, Some(reason));
        }
    }

    fn publish(&self) {
        let recorded = self.series.recorded();
        let mut report = lock(&self.report);
        report.file = Some(self.series.path().display().to_string());
        report.bytes = self.series.bytes();
        report.files = recorded.files;
        report.flushes = self.series.flushes();
        report.bytes_dropped = recorded.dropped_bytes + self.bytes_missing;
    }
}

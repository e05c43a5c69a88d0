//! The thread that records: whatever the disk does, nobody waits for it.

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};

use super::board::BoardPlan;
use super::circuit::{Drainer, Dry, Filler, circuit};
use super::error::{BoardError, with_causes};
use super::inlet::Parcel;
use super::{Talk, spawn};
use crate::capture::{CaptureError, CaptureSeries, Settings, Setup};
use crate::clock::HostInstant;
use crate::link::DeviceId;
use crate::telemetry::{DaemonReport, RecorderReport, RecorderState};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::threads::{join, lock};

/// Pieces of captures on their way to the disk: 5 s of one board.
const PARCELS_A_BOARD: usize = 256;

/// Accounts on their way to the disk.
const ACCOUNTS: usize = 4;

/// Without anything to record it looks about so often.
const IDLE: Duration = Duration::from_millis(100);

/// A capture to be recorded.
pub(crate) struct CapturePlan {
    /// Where.
    pub series: CaptureSeries,
    /// Poses that are kept a device second, besides the bytes all poses can be found from again.
    pub poses_hz: f64,
    /// Says something to the user.
    pub talk: Arc<Talk>,
}

/// The recorder's thread.
pub(super) struct RecorderThread {
    thread: Mutex<Option<JoinHandle<()>>>,
    accounts: Mutex<Option<Sender<DaemonReport>>>,
    report: Arc<Mutex<RecorderReport>>,
}

/// The board behind a number.
struct Source {
    file: SceneFile,
    settings: Settings,
    keeps_time: bool,
    device: Option<DeviceId>,
}

/// What the thread works on.
struct Recorder {
    series: CaptureSeries,
    sources: Vec<Source>,
    talk: Arc<Talk>,
    report: Arc<Mutex<RecorderReport>>,
    bytes_missing: u64,
    /// When what was recorded last came.
    log_ns: u64,
}

impl RecorderThread {
    /// Starts it, and gives where boards put their pieces and how far apart in device time, seconds,
    /// poses shall be.
    pub(super) fn start(plan: CapturePlan, boards: &[BoardPlan]) -> Result<(Self, (Filler<Parcel>, f64)), BoardError> {
        let (filler, drainer) = circuit(PARCELS_A_BOARD * boards.len().max(1), Parcel::with_room);
        let (tell, accounts) = bounded(ACCOUNTS);
        let source = |board: &BoardPlan| Source {
            file: board.file.clone(),
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
        let thread = spawn("record".to_owned(), move || recorder.run(&drainer, &accounts))?;
        let this = Self { thread: Mutex::new(Some(thread)), accounts: Mutex::new(Some(tell)), report };
        Ok((this, (filler, plan.poses_hz.recip())))
    }
}

impl RecorderThread {
    /// How it goes.
    pub(super) fn report(&self) -> RecorderReport {
        lock(&self.report).clone()
    }

    /// Says how it goes whenever it is asked.
    pub(super) fn reports(&self) -> impl Fn() -> RecorderReport + Send + use<> {
        let report = Arc::clone(&self.report);
        move || lock(&report).clone()
    }

    /// Puts an account into the capture, if the recorder is not far behind.
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
    fn run(mut self, parcels: &Drainer<Parcel>, accounts: &Receiver<DaemonReport>) {
        loop {
            let done = match parcels.next(IDLE) {
                Ok(parcel) => {
                    let done = self.record(&parcel);
                    parcels.give_back(parcel);
                    done
                }
                Err(Dry::Yet) => self.series.tick(),
                Err(Dry::Forever) => break,
            };
            self.tell_of(done);
            while let Ok(report) = accounts.try_recv() {
                let done = self.record_account(&report);
                self.tell_of(done);
            }
            self.publish();
        }
        // The last one comes when all boards have ended.
        for report in accounts {
            let done = self.record_account(&report);
            self.tell_of(done);
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

    fn record(&mut self, parcel: &Parcel) -> Result<(), CaptureError> {
        let source = &mut self.sources[parcel.board];
        let now_ns = HostInstant::now().utc_ns;
        let log_ns = match parcel.segment.reads.first() {
            Some(read) => read.at.map_or(parcel.device_ns, |at| at.utc_ns),
            None => now_ns,
        };
        self.log_ns = log_ns;
        let hello = Some(parcel.hello.as_slice()).filter(|hello| !hello.is_empty());
        if let Some(device) = parcel.device
            && (source.device != Some(device) || hello.is_some())
        {
            source.device = Some(device);
            let added = self.series.add_device(Setup::new(device, &source.file, source.settings), hello, log_ns);
            if added.is_err() {
                self.bytes_missing += parcel.segment.bytes.len() as u64;
                return added;
            }
        }
        let Some(device) = source.device else {
            // A board that has never said who it is has said nothing that could be read.
            self.bytes_missing += parcel.segment.bytes.len() as u64;
            return Ok(());
        };
        self.series.segment(device, &parcel.segment, log_ns)?;
        parcel.poses.iter().try_for_each(|record| self.series.pose(record, log_ns))
    }

    fn record_account(&mut self, report: &DaemonReport) -> Result<(), CaptureError> {
        // On one timeline with what the boards say.
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

    /// Tells the user once that the capture has ended.
    fn tell_of(&mut self, done: Result<(), CaptureError>) {
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

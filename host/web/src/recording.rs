//! A capture that is recorded in memory, from which the browser takes its bytes as they come.

use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use slitpose_calibration::Head;
use slitpose_head::causes::with_causes;
use slitpose_head::threads::lock;
use slitpose_tracking::capture::{CaptureError, CaptureSeries, Medium, PoseRate, Settings, Setup};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::pipeline::Record;
use slitpose_tracking::telemetry::{BoardReport, DaemonReport, RecorderReport, RecorderState};

/// A message of a capture holds the bytes of this time.
const CHUNK_NS: u64 = 20_000_000;

/// Device time between recorded poses, seconds: all others follow from the bytes.
const POSE_EVERY_S: f64 = 0.04;

/// Interval of reports in the capture.
const REPORT_EVERY_NS: u64 = 1_000_000_000;

/// Bytes that have been written and not been taken.
#[derive(Clone, Debug, Default)]
pub(crate) struct Written(Arc<Mutex<Vec<u8>>>);

impl Written {
    pub(crate) fn append(&self, bytes: &[u8]) {
        lock(&self.0).extend_from_slice(bytes);
    }

    pub(crate) fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *lock(&self.0))
    }
}

impl Write for Written {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        lock(&self.0).write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Medium for Written {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    /// Bytes that have been taken cannot be dropped.
    fn truncate(&mut self, _: u64) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

/// A recording of one board, from its next bytes on.
pub(crate) struct Recording {
    series: CaptureSeries,
    head: Head,
    settings: Settings,
    chunk: Segment,
    poses: Vec<Record>,
    rate: PoseRate,
    device: Option<DeviceId>,
    begun_ns: u64,
    reported_ns: u64,
}

impl Recording {
    /// Begins the capture called `name`, of a board with `head`, on `written`.
    pub(crate) fn begin(name: &str, head: Head, settings: Settings, written: Written) -> Result<Self, CaptureError> {
        let series = CaptureSeries::on_medium(Box::new(written), Path::new(name))?;
        let rate = PoseRate::every(POSE_EVERY_S);
        // The first bytes do not continue those of a message before.
        let chunk = Segment { opened: true, ..Segment::default() };
        Ok(Self { series, head, settings, chunk, poses: Vec::new(), rate, device: None, begun_ns: 0, reported_ns: 0 })
    }

    /// Records bytes of `device`, whose last hello packet is `hello`, and what came of them.
    pub(crate) fn add(
        &mut self,
        device: DeviceId,
        hello: &[u8],
        segment: &Segment,
        poses: &[Record],
        now: HostInstant,
    ) -> Result<(), CaptureError> {
        if self.device != Some(device) {
            self.device = Some(device);
            self.series.add_device(Setup::new(device, &self.head, self.settings), Some(hello), now.utc_ns)?;
        }
        if segment.opened && !self.chunk.bytes.is_empty() {
            self.pass_on(device, now)?;
        }
        self.chunk.append(segment);
        let Self { rate, poses: kept, .. } = self;
        kept.extend(poses.iter().filter(|record| rate.is_due(record.device_time_s)));
        if now.monotonic_ns.saturating_sub(self.begun_ns) >= CHUNK_NS { self.pass_on(device, now) } else { Ok(()) }
    }

    fn pass_on(&mut self, device: DeviceId, now: HostInstant) -> Result<(), CaptureError> {
        self.begun_ns = now.monotonic_ns;
        let log_ns = self.chunk.reads.iter().find_map(|read| read.at).map_or(now.utc_ns, |at| at.utc_ns);
        self.series.segment(device, &self.chunk, log_ns)?;
        self.chunk.clear();
        self.poses.drain(..).try_for_each(|record| self.series.pose(&record, log_ns))
    }

    /// Records the reports on board and program once a second, and flushes in time.
    pub(crate) fn tick(
        &mut self,
        board: &BoardReport,
        report: &DaemonReport,
        now: HostInstant,
    ) -> Result<(), CaptureError> {
        if self.device.is_some() && now.monotonic_ns.saturating_sub(self.reported_ns) >= REPORT_EVERY_NS {
            self.reported_ns = now.monotonic_ns;
            self.series.report(self.device, board, now.utc_ns)?;
            self.series.report(None, report, now.utc_ns)?;
        }
        self.series.tick()
    }

    pub(crate) fn note(&mut self, text: &str, ago_s: f64, now: HostInstant) -> Result<(), CaptureError> {
        self.series.note(now.utc_ns.saturating_sub((ago_s * 1e9) as u64), text, now.utc_ns)
    }

    pub(crate) fn finish(mut self, now: HostInstant) -> Result<(), CaptureError> {
        if let Some(device) = self.device {
            self.pass_on(device, now)?;
        }
        self.series.finish().map(drop)
    }

    pub(crate) fn report(&self) -> RecorderReport {
        self.series.progress()
    }
}

/// The report after `error` has ended a recording.
pub(crate) fn failed(error: &CaptureError) -> RecorderReport {
    RecorderReport { state: RecorderState::Failed, reason: Some(with_causes(error)), ..RecorderReport::default() }
}

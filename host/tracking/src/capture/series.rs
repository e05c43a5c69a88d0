//! A capture as one file, or as a series of files.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::McapError;
use serde::Serialize;
use web_time::Instant;

use super::file::{AnyMedium, CaptureFile, Channels, Medium, io_error};
use super::link_bytes::{Packets, last_hello};
use super::place::{Existing, Place, next_number, numbered};
use super::{CaptureError, Setup};
use crate::link::{DeviceId, Segment};
use crate::pipeline::Record;
use crate::telemetry::{RecorderReport, RecorderState, report_schema};

/// Interval of flushes. CAPTURES.md promises one per second; the rest is for the next message and the disk.
const FLUSH_EVERY: Duration = Duration::from_millis(900);

/// When a file ends and the next begins. Without limits there is one file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Greatest length of a file, without the summary at its end.
    pub max_bytes: Option<u64>,
    /// Greatest time between the first and the last data of a file.
    pub max_age: Option<Duration>,
}

/// A capture that is being recorded.
///
/// If writing fails, that call returns the error, the file is cut back to its last flush, and the
/// recording [is over](Self::is_recording): all later calls only count.
///
/// It keeps 0.9 kB of memory per chunk of the current file, for the index at its end: 4 kB per second of a board at 4 kHz.
pub struct CaptureSeries {
    limits: Limits,
    output: Output,
    devices: BTreeMap<DeviceId, DeviceStream>,
    message: Segment,
}

struct DeviceStream {
    setup: Setup,
    channels: Channels,
    packets: Packets,
    log_ns: u64,
}

struct Output {
    file: Option<CaptureFile>,
    /// Its place; `None` for a medium opened by the caller.
    place: Option<Place>,
    path: PathBuf,
    /// Path and number of the next file; `None` for a single file.
    next: Option<(PathBuf, u64)>,
    opened: Instant,
    flushed: Instant,
    /// Of the recording so far, without what is asked of the file.
    report: RecorderReport,
}

impl CaptureSeries {
    /// Begins a capture. Without limits it is the file `path`. With limits it is a series of files numbered from 1 after the
    /// stem of `path`: `name-0001.mcap`, `name-0002.mcap`, …; the numbers continue after existing ones, so that no file is
    /// replaced.
    pub fn create(path: &Path, limits: Limits, existing: Existing) -> Result<Self, CaptureError> {
        let mut output = Output::new(path.to_owned());
        if limits != Limits::default() {
            let number = next_number(path).map_err(|source| CaptureError::Create { path: path.to_owned(), source })?;
            output.next = Some((path.to_owned(), number));
        }
        output.open(existing)?;
        Ok(Self { limits, output, devices: BTreeMap::new(), message: Segment::default() })
    }

    /// Begins a capture on `medium`, such as a file that is open; `path` names it in messages.
    pub fn on_medium(medium: Box<dyn Medium + Send>, path: &Path) -> Result<Self, CaptureError> {
        let mut output = Output::new(path.to_owned());
        output.begin(medium)?;
        Ok(Self { limits: Limits::default(), output, devices: BTreeMap::new(), message: Segment::default() })
    }

    /// Adds a board, before its data. A board added again continues with the new setup. `hello`: its
    /// last hello packet, delimiter included, if that will not come again.
    ///
    /// `log_ns`, in all methods: UTC, or the device time of a stream that does not run in real time,
    /// nanoseconds.
    pub fn add_device(&mut self, setup: Setup, hello: Option<&[u8]>, log_ns: u64) -> Result<(), CaptureError> {
        let device = setup.device;
        let mut added = None;
        self.output.attempt(0, |file| {
            let hello = hello.unwrap_or_else(|| file.hello(device)).to_owned();
            added = Some(file.add_device(&setup, &hello, log_ns)?);
            file.flush()
        })?;
        let Some(channels) = added else { return Ok(()) };
        let packets = self.devices.remove(&device).map(|stream| stream.packets).unwrap_or_default();
        self.devices.insert(device, DeviceStream { setup, channels, packets, log_ns });
        Ok(())
    }

    /// Records a segment of the link of `device`. Reads without a time get `log_ns`.
    pub fn segment(&mut self, device: DeviceId, segment: &Segment, log_ns: u64) -> Result<(), CaptureError> {
        let bytes = segment.bytes.len() as u64;
        if let Err(error) = self.rotate_if_due(log_ns) {
            self.output.report.bytes_dropped += bytes;
            return Err(error);
        }
        if !self.is_recording() {
            self.output.report.bytes_dropped += bytes;
            return Ok(());
        }
        let stream = self.devices.get_mut(&device).ok_or(CaptureError::UnknownDevice { device })?;
        let message = &mut self.message;
        self.output.attempt(bytes, |file| {
            stream.log_ns = log_ns;
            if stream.packets.must_end_before(segment) && stream.packets.take_rest(message) {
                stream.write(file, message)?;
            }
            stream.packets.push(segment);
            while stream.packets.next(message) {
                stream.write(file, message)?;
            }
            Ok(())
        })?;
        self.output.settle()?;
        self.tick()
    }

    /// Records the pose of a scan, and its velocity, if there are any.
    pub fn pose(&mut self, record: &Record, log_ns: u64) -> Result<(), CaptureError> {
        let Some(channels) = self.channels(record.device)? else { return Ok(()) };
        self.output.attempt(0, |file| file.pose(channels, record, log_ns))?;
        self.tick()
    }

    /// Records a report of a board, or of the program itself: health, statistics, events.
    pub fn report(
        &mut self,
        device: Option<DeviceId>,
        report: &impl Serialize,
        log_ns: u64,
    ) -> Result<(), CaptureError> {
        let channels = device.map(|device| self.channels(device)).transpose()?;
        let report = serde_json::to_string(report)?;
        self.output.attempt(0, |file| file.report(channels.flatten(), &report, log_ns))?;
        self.tick()
    }

    /// Records what a person noted of the instant `stamp_ns`, on the time line of `log_ns`.
    pub fn note(&mut self, stamp_ns: u64, text: &str, log_ns: u64) -> Result<(), CaptureError> {
        self.output.attempt(0, |file| file.note(stamp_ns, text, log_ns))?;
        self.tick()
    }

    /// The channels of a board; `None` if recording is over.
    fn channels(&self, device: DeviceId) -> Result<Option<Channels>, CaptureError> {
        if !self.is_recording() {
            return Ok(None);
        }
        let stream = self.devices.get(&device).ok_or(CaptureError::UnknownDevice { device })?;
        Ok(Some(stream.channels))
    }

    /// Flushes if a flush is due; to be called several times per second while no data come.
    pub fn tick(&mut self) -> Result<(), CaptureError> {
        if self.output.flushed.elapsed() < FLUSH_EVERY || self.output.file.as_ref().is_some_and(CaptureFile::is_flushed)
        {
            return Ok(());
        }
        self.flush()
    }

    /// Ends the chunk, and waits until it would survive a power cut.
    pub fn flush(&mut self) -> Result<(), CaptureError> {
        self.output.attempt(0, CaptureFile::flush)?;
        // From its end on: a disk that takes longer than the interval would be flushed after every message.
        self.output.flushed = Instant::now();
        self.output.check()?;
        self.output.report.flushes += 1;
        Ok(())
    }

    /// Writes what waits, and ends the last file.
    pub fn finish(mut self) -> Result<RecorderReport, CaptureError> {
        for stream in self.devices.values_mut() {
            let message = &mut self.message;
            if stream.packets.take_rest(message) {
                self.output.attempt(message.bytes.len() as u64, |file| stream.write(file, message))?;
            }
        }
        self.output.end()?;
        Ok(self.progress())
    }

    /// Whether data are still written: `false` once writing has failed.
    pub fn is_recording(&self) -> bool {
        self.output.file.is_some()
    }

    /// What has been recorded so far: the file that is written now, and an upper bound of its length.
    pub fn progress(&self) -> RecorderReport {
        let file = Some(self.output.path.display().to_string());
        RecorderReport { file, bytes: self.output.bytes(), ..self.output.report.clone() }
    }

    fn rotate_if_due(&mut self, log_ns: u64) -> Result<(), CaptureError> {
        if !self.is_recording() {
            return Ok(());
        }
        let is_long = self.limits.max_bytes.is_some_and(|limit| self.output.bytes() >= limit);
        let is_old = self.limits.max_age.is_some_and(|limit| self.output.opened.elapsed() >= limit);
        if !is_long && !is_old {
            return Ok(());
        }
        let hello = |device| self.output.file.as_ref().map_or(Vec::new(), |file| file.hello(device).to_owned());
        let hellos: Vec<Vec<u8>> = self.devices.keys().map(|device| hello(*device)).collect();
        self.output.end()?;
        self.output.open(Existing::Kept)?;
        self.output.attempt(0, |file| {
            for (stream, hello) in self.devices.values_mut().zip(&hellos) {
                stream.channels = file.add_device(&stream.setup, hello, log_ns)?;
            }
            file.flush()
        })
    }
}

impl DeviceStream {
    fn write(&mut self, file: &mut CaptureFile, message: &Segment) -> Result<(), McapError> {
        let first_read = message.reads.iter().find_map(|read| read.at);
        let first = first_read.or_else(|| message.asked.first().map(|asked| asked.at));
        file.link(self.channels, message, first.map_or(self.log_ns, |at| at.utc_ns))?;
        if let Some(hello) = last_hello(&message.bytes) {
            file.set_hello(self.setup.device, hello);
        }
        Ok(())
    }
}

impl Output {
    fn new(path: PathBuf) -> Self {
        let now = Instant::now();
        Self {
            file: None,
            place: None,
            path,
            next: None,
            opened: now,
            flushed: now,
            report: RecorderReport { state: RecorderState::Recording, ..RecorderReport::default() },
        }
    }

    fn open(&mut self, existing: Existing) -> Result<(), CaptureError> {
        let existing = match &mut self.next {
            Some((path, number)) => {
                self.path = numbered(path, *number);
                *number += 1;
                Existing::Kept
            }
            None => existing,
        };
        let path = self.path.clone();
        let (file, place) = Place::create(&path, existing).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => CaptureError::Exists { path: path.clone() },
            io::ErrorKind::WouldBlock => CaptureError::InUse { path: path.clone() },
            io::ErrorKind::Interrupted => CaptureError::Interrupted { path: path.clone() },
            _ => CaptureError::Create { path: path.clone(), source },
        })?;
        self.begin(Box::new(file))?;
        self.place = Some(place);
        Ok(())
    }

    fn begin(&mut self, medium: AnyMedium) -> Result<(), CaptureError> {
        let error = |error| CaptureError::Create { path: self.path.clone(), source: io_error(error) };
        let schema = report_schema().as_value().to_string();
        self.file = Some(CaptureFile::create(medium, &schema).map_err(error)?);
        self.opened = Instant::now();
        self.report.files += 1;
        Ok(())
    }

    fn bytes(&self) -> u64 {
        self.file.as_ref().map_or(0, CaptureFile::bytes)
    }

    /// Writes, if nothing has failed so far; `bytes` of a link are dropped if it fails.
    fn attempt(
        &mut self,
        bytes: u64,
        write: impl FnOnce(&mut CaptureFile) -> Result<(), McapError>,
    ) -> Result<(), CaptureError> {
        let Some(file) = &mut self.file else {
            return Ok(());
        };
        let before = file.unflushed_link_bytes;
        let Err(error) = write(file) else {
            return Ok(());
        };
        self.report.bytes_dropped += before + bytes;
        let kept_bytes = self.file.take().map_or(0, CaptureFile::cut_back);
        Err(CaptureError::Write { path: self.path.clone(), kept_bytes, source: io_error(error) })
    }

    /// Moves the file, which now has content, to its place.
    fn settle(&mut self) -> Result<(), CaptureError> {
        if let Some(Err(source)) = self.place.as_mut().map(Place::settle) {
            self.report.bytes_dropped += self.file.take().map_or(0, |file| file.unflushed_link_bytes);
            let path = self.path.clone();
            return Err(match source.kind() {
                io::ErrorKind::WouldBlock => CaptureError::InUse { path },
                _ => CaptureError::Create { path, source },
            });
        }
        Ok(())
    }

    /// Ends recording if the file has been deleted or replaced.
    fn check(&mut self) -> Result<(), CaptureError> {
        if self.file.is_some() && self.place.as_ref().is_some_and(Place::is_lost) {
            self.file = None;
            return Err(CaptureError::Lost { path: self.path.clone() });
        }
        Ok(())
    }

    fn end(&mut self) -> Result<(), CaptureError> {
        self.attempt(0, CaptureFile::finish)?;
        self.check()?;
        self.file = None;
        self.place = None;
        Ok(())
    }
}

/// Chooses the poses that a capture has, besides the bytes from which all of them follow, at a rate of device time.
#[derive(Clone, Copy, Debug)]
pub struct PoseRate {
    every_s: f64,
    /// The device time from which on the next pose is kept, seconds.
    due_s: f64,
}

impl PoseRate {
    /// One pose in so many seconds; zero for every pose.
    pub fn every(every_s: f64) -> Self {
        Self { every_s, due_s: f64::NEG_INFINITY }
    }

    /// Whether a pose of `time_s` is kept.
    pub fn is_due(&mut self, time_s: f64) -> bool {
        let every_s = self.every_s;
        // Device time may restart.
        let is_due = time_s >= self.due_s || time_s < self.due_s - 2.0 * every_s;
        if is_due {
            // One period after the last one was due, so that the rate does not drift; unless that is not the next period.
            let next_s = self.due_s + every_s;
            self.due_s = if next_s > time_s && next_s <= time_s + every_s { next_s } else { time_s + every_s };
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_kept_at_their_rate_also_when_device_time_restarts() {
        let mut rate = PoseRate::every(0.04);
        // 4 kHz for 10 s, a reset, 4 kHz for 5 s, and a jump ahead by a minute.
        let times = (0..40_000).chain(0..20_000).chain(260_000..264_000).map(|scan| f64::from(scan) / 4000.0);
        let kept: Vec<f64> = times.filter(|&time_s| rate.is_due(time_s)).collect();
        // 25 a second, and one for each new beginning at most.
        assert!((400..=402).contains(&kept.len()), "{}", kept.len());
    }
}

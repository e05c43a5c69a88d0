//! A capture as one file, or as a series of files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::McapError;
use serde::Serialize;
use web_time::Instant;

use super::file::{CaptureFile, Channels, io_error};
use super::medium::Medium;
use super::packets::{Packets, last_hello};
use super::place::{Existing, Place, next_number, numbered};
use super::{CaptureError, Setup};
use crate::link::{DeviceId, Segment};
use crate::pipeline::Record;

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

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recorded {
    pub files: u64,
    /// Bytes of links that were not recorded because writing failed.
    pub dropped_bytes: u64,
}

/// A capture that is being recorded.
///
/// If writing fails, that call returns the error, the file is cut back to its last flush, and the
/// recording [is over](Self::is_recording): all later calls only count.
///
/// It keeps 0.9 kB of memory per chunk of the current file, for the index at its end: 4 kB per second of a board at 4 kHz.
pub struct CaptureSeries {
    report_schema: String,
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
    file: Option<CaptureFile<Box<dyn Medium + Send>>>,
    /// Its place; `None` for a medium opened by the caller.
    place: Option<Place>,
    path: PathBuf,
    /// Path and number of the next file; `None` for a single file.
    next: Option<(PathBuf, u64)>,
    opened: Instant,
    flushed: Instant,
    flushes: u64,
    recorded: Recorded,
}

impl CaptureSeries {
    /// Begins a capture, in which `report_schema` is the JSON schema of its reports. Without limits it is the file `path`. With limits it is a series of files
    /// numbered from 1 after the stem of `path`: `name-0001.mcap`, `name-0002.mcap`, …; the numbers
    /// continue after existing ones, so that no file is replaced.
    pub fn create(
        path: &Path,
        limits: Limits,
        existing: Existing,
        report_schema: String,
    ) -> Result<Self, CaptureError> {
        let mut output = Output::new(path.to_owned());
        if limits != Limits::default() {
            let number = next_number(path).map_err(|source| CaptureError::Create { path: path.to_owned(), source })?;
            output.next = Some((path.to_owned(), number));
        }
        output.open(existing, &report_schema)?;
        Ok(Self::over(output, limits, report_schema))
    }

    /// Begins a capture in a file that is open; `path` names it in messages.
    pub fn in_file(file: File, path: &Path, report_schema: String) -> Result<Self, CaptureError> {
        Self::on_medium(Box::new(file), path, report_schema)
    }

    /// Begins a capture on `medium`; `path` names it in messages.
    pub fn on_medium(medium: Box<dyn Medium + Send>, path: &Path, report_schema: String) -> Result<Self, CaptureError> {
        let mut output = Output::new(path.to_owned());
        output.begin(medium, &report_schema)?;
        Ok(Self::over(output, Limits::default(), report_schema))
    }

    fn over(output: Output, limits: Limits, report_schema: String) -> Self {
        Self { report_schema, limits, output, devices: BTreeMap::new(), message: Segment::default() }
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
            self.output.recorded.dropped_bytes += bytes;
            return Err(error);
        }
        if !self.is_recording() {
            self.output.recorded.dropped_bytes += bytes;
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
        let channels = match device {
            Some(device) => match self.channels(device)? {
                Some(channels) => Some(channels),
                None => return Ok(()),
            },
            None => None,
        };
        let report = serde_json::to_string(report)?;
        self.output.attempt(0, |file| file.report(channels, &report, log_ns))?;
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
        self.output.flushes += 1;
        Ok(())
    }

    /// Number of flushes so far, in all files.
    pub fn flushes(&self) -> u64 {
        self.output.flushes
    }

    /// Writes what waits, and ends the last file.
    pub fn finish(mut self) -> Result<Recorded, CaptureError> {
        for stream in self.devices.values_mut() {
            let message = &mut self.message;
            if stream.packets.take_rest(message) {
                self.output.attempt(message.bytes.len() as u64, |file| stream.write(file, message))?;
            }
        }
        self.output.end()?;
        Ok(self.output.recorded)
    }

    /// Whether data are still written: `false` once writing has failed.
    pub fn is_recording(&self) -> bool {
        self.output.file.is_some()
    }

    /// The file that is written now.
    pub fn path(&self) -> &Path {
        &self.output.path
    }

    /// Upper bound of the length of that file.
    pub fn bytes(&self) -> u64 {
        self.output.file.as_ref().map_or(0, CaptureFile::bytes)
    }

    /// What has been recorded so far.
    pub fn recorded(&self) -> Recorded {
        self.output.recorded
    }

    fn rotate_if_due(&mut self, log_ns: u64) -> Result<(), CaptureError> {
        if !self.is_recording() {
            return Ok(());
        }
        let is_long = self.limits.max_bytes.is_some_and(|limit| self.bytes() >= limit);
        let is_old = self.limits.max_age.is_some_and(|limit| self.output.opened.elapsed() >= limit);
        if !is_long && !is_old {
            return Ok(());
        }
        let hello = |device| self.output.file.as_ref().map_or(Vec::new(), |file| file.hello(device).to_owned());
        let hellos: Vec<Vec<u8>> = self.devices.keys().map(|device| hello(*device)).collect();
        self.output.end()?;
        self.output.open(Existing::Kept, &self.report_schema)?;
        self.output.attempt(0, |file| {
            for (stream, hello) in self.devices.values_mut().zip(&hellos) {
                stream.channels = file.add_device(&stream.setup, hello, log_ns)?;
            }
            file.flush()
        })
    }
}

impl DeviceStream {
    fn write<M: Medium>(&mut self, file: &mut CaptureFile<M>, message: &Segment) -> Result<(), McapError> {
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
            flushes: 0,
            recorded: Recorded::default(),
        }
    }

    fn open(&mut self, existing: Existing, report_schema: &str) -> Result<(), CaptureError> {
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
        self.begin(Box::new(file), report_schema)?;
        self.place = Some(place);
        Ok(())
    }

    fn begin(&mut self, medium: Box<dyn Medium + Send>, report_schema: &str) -> Result<(), CaptureError> {
        let error = |error| CaptureError::Create { path: self.path.clone(), source: io_error(error) };
        self.file = Some(CaptureFile::create(medium, report_schema).map_err(error)?);
        self.opened = Instant::now();
        self.recorded.files += 1;
        Ok(())
    }

    /// Writes, if nothing has failed so far; `bytes` of a link are dropped if it fails.
    fn attempt(
        &mut self,
        bytes: u64,
        write: impl FnOnce(&mut CaptureFile<Box<dyn Medium + Send>>) -> Result<(), McapError>,
    ) -> Result<(), CaptureError> {
        let Some(file) = &mut self.file else {
            return Ok(());
        };
        let before = file.unflushed_link_bytes;
        let Err(error) = write(file) else {
            return Ok(());
        };
        self.recorded.dropped_bytes += before + bytes;
        let kept_bytes = self.file.take().map_or(0, |file| file.cut_back().0);
        Err(CaptureError::Write { path: self.path.clone(), kept_bytes, source: io_error(error) })
    }

    /// Moves the file, which now has content, to its place.
    fn settle(&mut self) -> Result<(), CaptureError> {
        if let Some(Err(source)) = self.place.as_mut().map(Place::settle) {
            self.recorded.dropped_bytes += self.file.take().map_or(0, |file| file.unflushed_link_bytes);
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

//! One file of a capture, on any medium: a file of the system, or what else takes its bytes.
//!
//! Scenes, metadata and hellos are repeated, so that damage affects only the chunk it is in: metadata before
//! each chunk, the last hello of each board at the beginning of each chunk, heads as shapes in the first and in
//! each [`SCENE_EVERY`]th, scenes before these, and scenes, calibrations and metadata at the end of the file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};

use super::records::PROGRAM;
use super::setup::{LinkChannels, METADATA, Setup};
use super::{LINK_BYTES, REPORT_SCHEMA, link_bytes};
use crate::frame::BASE;
use crate::link::{DeviceId, Segment};
use crate::pipeline::Record;
use crate::ros::cdr::Encoder;
use crate::ros::{self, MARKERS, NOTE, NOTES, POSE, POSE_STAMPED, REPORT, RosType, TRANSFORMS, TWIST};

/// Level 3 makes captures 4 % shorter and takes twice as long (six cells at 4 kHz).
const ZSTD_LEVEL: u32 = 1;

/// Most bytes of a chunk, and so the most lost by a damaged byte. Half of it would make captures 1.5 %
/// longer.
const CHUNK_BYTES: u64 = 1 << 17;

/// Scenes are repeated before each chunk with a number divisible by this: some 10 s apart.
const SCENE_EVERY: u64 = 32;

/// Type of the attachments with scenes and calibrations.
pub(super) const TOML: &str = "application/toml";

const REPORT_CONTENT: (&str, &str) = ("content", "JSON; its schema is the attachment report.schema.json");

/// The channels of a board in one file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Channels {
    link: u16,
    hello: u16,
    pose: u16,
    pose_stamped: u16,
    twist: u16,
    report: u16,
    head: u16,
    /// Whether the board was the first of its file: the frames of others are named with their number.
    is_first: bool,
}

/// Data of a board that each chunk repeats.
struct Board {
    channels: Channels,
    metadata: Metadata,
    /// Its last hello, delimiter included; empty if there was none.
    hello: Vec<u8>,
    /// Its head as shapes; empty if its scene cannot be read.
    head: Vec<u8>,
    /// The file does not have the head yet.
    is_new: bool,
}

pub(super) struct CaptureFile {
    writer: Writer<Sink>,
    report: u16,
    notes: u16,
    transforms: u16,
    /// Texts of scenes by name of attachment.
    scenes: BTreeMap<String, Arc<str>>,
    /// Texts of calibrations likewise. They are long: only the end of the file has copies.
    calibrations: BTreeMap<String, Arc<str>>,
    boards: BTreeMap<DeviceId, Board>,
    chunks: u64,
    log_ns: u64,
    message: Vec<u8>,
    links: u32,
    written_bytes: Arc<AtomicU64>,
    chunk_bytes: u64,
    /// Bytes of links written after the last flush.
    pub(super) unflushed_link_bytes: u64,
}

impl CaptureFile {
    pub(super) fn create(medium: AnyMedium, report_schema: &str) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(format!("{PROGRAM}{}", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(ZSTD_LEVEL)
            .compression_threads(0)
            // Chunks are ended explicitly, where copies are due.
            .chunk_size(None)
            // Chunks are collected in memory, so that each reaches the file whole.
            .disable_seeking(true);
        let sink = Sink::new(medium);
        let written_bytes = sink.position();
        let mut writer = options.create(sink)?;
        attach(&mut writer, REPORT_SCHEMA, "application/schema+json", report_schema, 0)?;
        let report = ros_channel(&mut writer, REPORT, "/slitpose/report", &[REPORT_CONTENT])?;
        let notes = ros_channel(&mut writer, NOTE, NOTES, &[("content", "notes of persons, each of its instant")])?;
        let transforms = ros_channel(&mut writer, TRANSFORMS, "/tf", &[])?;
        Ok(Self {
            writer,
            report,
            notes,
            transforms,
            scenes: BTreeMap::new(),
            calibrations: BTreeMap::new(),
            boards: BTreeMap::new(),
            chunks: 0,
            log_ns: 0,
            message: Vec::new(),
            links: 0,
            written_bytes,
            chunk_bytes: 0,
            unflushed_link_bytes: 0,
        })
    }

    /// Writes setup and channels of a board, before its data. `hello`: its last hello packet, empty if none.
    pub(super) fn add_device(&mut self, setup: &Setup, hello: &[u8], log_ns: u64) -> Result<Channels, McapError> {
        let source = &setup.scene.source;
        let attachment = setup.attachment(|name| self.scenes.get(name).is_some_and(|taken| taken != source));
        if self.scenes.insert(attachment.clone(), Arc::clone(source)).is_none() {
            attach(&mut self.writer, &attachment, TOML, source, log_ns)?;
        }
        if let Some((name, source)) = setup.calibration()
            && self.calibrations.insert(name.to_owned(), Arc::clone(source)).is_none()
        {
            attach(&mut self.writer, name, TOML, source, log_ns)?;
        }
        let writer = &mut self.writer;
        let mut channel = |of: RosType, name: &str, about: &[(&str, &str)]| {
            ros_channel(writer, of, &ros::topic(setup.device, name), about)
        };
        let base_from_tool = ("content", "base_from_tool; metres");
        let channels = Channels {
            link: channel(LINK_BYTES, "link", &[])?,
            hello: channel(LINK_BYTES, "hello", &[("content", "the last hello, as it came")])?,
            pose: channel(
                POSE,
                "pose",
                &[
                    base_from_tool,
                    (
                        "covariance",
                        "row-major, of t' = t + dt, R' = exp(dtheta) R, order (dt, dtheta); m2, m rad, rad2",
                    ),
                ],
            )?,
            pose_stamped: channel(POSE_STAMPED, "pose_stamped", &[base_from_tool])?,
            twist: channel(
                TWIST,
                "twist",
                &[
                    ("content", "velocity of the tool's origin and of its rotation, in the base frame; m/s, rad/s"),
                    ("covariance", "row-major, order (linear, angular); m2/s2, m rad/s2, rad2/s2"),
                ],
            )?,
            report: channel(REPORT, "report", &[REPORT_CONTENT])?,
            head: channel(MARKERS, "head", &[("content", "detectors, masks with their openings, emitters; metres")])?,
            is_first: self.boards.keys().all(|device| *device == setup.device),
        };
        let mut head = Vec::new();
        if let Some(cells) = setup.cells() {
            ros::encode_head(&cells, &ros::tool_frame(setup.device, channels.is_first), &mut head);
        }
        let link_channels = LinkChannels { link: channels.link, hello: channels.hello };
        let metadata = Metadata { name: METADATA.to_owned(), metadata: setup.to_metadata(&attachment, link_channels) };
        self.writer.write_metadata(&metadata)?;
        self.chunk_bytes = 0;
        self.boards.insert(setup.device, Board { channels, metadata, hello: hello.to_owned(), head, is_new: true });
        Ok(channels)
    }

    /// Sets the last hello of a board, for all later chunks.
    pub(super) fn set_hello(&mut self, device: DeviceId, packet: &[u8]) {
        if let Some(board) = self.boards.get_mut(&device) {
            board.hello.clear();
            board.hello.extend_from_slice(packet);
        }
    }

    /// The last hello of a board; empty if there was none.
    pub(super) fn hello(&self, device: DeviceId) -> &[u8] {
        self.boards.get(&device).map_or(&[], |board| &board.hello)
    }

    pub(super) fn link(&mut self, channels: Channels, segment: &Segment, log_ns: u64) -> Result<(), McapError> {
        link_bytes::encode(segment, &mut self.message);
        self.unflushed_link_bytes += segment.bytes.len() as u64;
        self.links = self.links.wrapping_add(1);
        self.write(channels.link, self.links, log_ns, log_ns)
    }

    /// Writes a pose and a velocity, if the record has them.
    pub(super) fn pose(&mut self, channels: Channels, record: &Record, log_ns: u64) -> Result<(), McapError> {
        let stamp_ns = ros::stamp_ns(record);
        let publish_ns = record.host_time.map_or(log_ns, |time| time.utc_ns);
        let sequence = record.sequence as u32;
        if let Some(estimate) = &record.solution.estimate {
            ros::encode_pose(stamp_ns, BASE, estimate, &mut self.message);
            self.write(channels.pose, sequence, log_ns, publish_ns)?;
            ros::encode_pose_stamped(stamp_ns, &estimate.pose, &mut self.message);
            self.write(channels.pose_stamped, sequence, log_ns, publish_ns)?;
            let child = ros::tool_frame(record.device, channels.is_first);
            ros::encode_transform(stamp_ns, &child, &estimate.pose, None, &mut self.message);
            self.write(self.transforms, sequence, log_ns, publish_ns)?;
        }
        if let Ok(twist) = &record.twist {
            ros::encode_twist(stamp_ns, BASE, twist, &mut self.message);
            self.write(channels.twist, sequence, log_ns, publish_ns)?;
        }
        Ok(())
    }

    /// Writes a report of a board, or of the program.
    pub(super) fn report(&mut self, of: Option<Channels>, report: &str, log_ns: u64) -> Result<(), McapError> {
        Encoder::new(&mut self.message).text(report);
        self.write(of.map_or(self.report, |channels| channels.report), 0, log_ns, log_ns)
    }

    /// Writes what a person noted of an instant.
    pub(super) fn note(&mut self, stamp_ns: u64, text: &str, log_ns: u64) -> Result<(), McapError> {
        ros::encode_note(stamp_ns, text, &mut self.message);
        self.write(self.notes, 0, log_ns, log_ns)
    }

    fn write(&mut self, channel_id: u16, sequence: u32, log_ns: u64, publish_ns: u64) -> Result<(), McapError> {
        if self.chunk_bytes == 0 || self.chunk_bytes >= CHUNK_BYTES {
            self.begin_chunk(log_ns)?;
        }
        let header = MessageHeader { channel_id, sequence, log_time: log_ns, publish_time: publish_ns };
        self.log_ns = log_ns;
        self.chunk_bytes += self.message.len() as u64;
        self.writer.write_to_known_channel(&header, &self.message)
    }

    /// Ends the chunk, writes the copies between two chunks, and begins the next with the hellos.
    fn begin_chunk(&mut self, log_ns: u64) -> Result<(), McapError> {
        self.chunks += 1;
        self.chunk_bytes = 0;
        // Copies for all boards, even for one just written: they stand together before each chunk.
        self.write_copies(self.chunks.is_multiple_of(SCENE_EVERY), log_ns)?;
        let (mut hello, mut message) = (Segment::default(), Vec::new());
        let is_due = self.chunks.is_multiple_of(SCENE_EVERY);
        for board in self.boards.values_mut() {
            let mut write = |channel_id, message: &[u8]| {
                self.chunk_bytes += message.len() as u64;
                let header = MessageHeader { channel_id, sequence: 0, log_time: log_ns, publish_time: log_ns };
                self.writer.write_to_known_channel(&header, message)
            };
            if !board.hello.is_empty() {
                hello.clear();
                hello.push(&board.hello, None);
                link_bytes::encode(&hello, &mut message);
                write(board.channels.hello, &message)?;
            }
            if !board.head.is_empty() && (std::mem::take(&mut board.is_new) || is_due) {
                write(board.channels.head, &board.head)?;
            }
        }
        Ok(())
    }

    /// Repeats the metadata of all boards, and their scenes if `with_scenes`.
    fn write_copies(&mut self, with_scenes: bool, log_ns: u64) -> Result<(), McapError> {
        let Self { writer, scenes, boards, .. } = self;
        if with_scenes {
            scenes.iter().try_for_each(|(name, source)| attach(writer, name, TOML, source, log_ns))?;
        }
        boards.values().try_for_each(|board| writer.write_metadata(&board.metadata))
    }

    /// Ends the chunk and waits until it would survive a power cut.
    pub(super) fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.chunk_bytes = 0;
        self.unflushed_link_bytes = 0;
        Ok(())
    }

    pub(super) fn is_flushed(&self) -> bool {
        self.chunk_bytes == 0
    }

    /// Length of the file if it were flushed now, at most.
    pub(super) fn bytes(&self) -> u64 {
        self.written_bytes.load(Ordering::Relaxed) + self.chunk_bytes
    }

    pub(super) fn finish(&mut self) -> Result<(), McapError> {
        // The records are safe before the summary is written.
        self.flush()?;
        let Self { writer, calibrations, log_ns, .. } = self;
        calibrations.iter().try_for_each(|(name, source)| attach(writer, name, TOML, source, *log_ns))?;
        self.write_copies(true, self.log_ns)?;
        self.writer.finish()?;
        Ok(())
    }

    /// After a failure: cuts the file back to the last flush; returns its length.
    pub(super) fn cut_back(self) -> u64 {
        self.writer.into_inner().cut_back()
    }
}

fn attach(writer: &mut Writer<Sink>, name: &str, media_type: &str, text: &str, log_ns: u64) -> Result<(), McapError> {
    writer.attach(&Attachment {
        log_time: log_ns,
        create_time: log_ns,
        name: name.to_owned(),
        media_type: media_type.to_owned(),
        data: Cow::Borrowed(text.as_bytes()),
    })
}

fn ros_channel(writer: &mut Writer<Sink>, of: RosType, topic: &str, about: &[(&str, &str)]) -> Result<u16, McapError> {
    let schema = writer.add_schema(of.name, "ros2msg", of.definition.as_bytes())?;
    // The ROS profile requires the quality of service, which only ROS publishers have.
    let about = about.iter().chain([&("offered_qos_profiles", "")]);
    let metadata = about.map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
    writer.add_channel(schema, topic, "cdr", &metadata)
}

pub(super) fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}

const BUFFER_BYTES: usize = 1 << 18;

/// A medium to which a capture can be written.
pub trait Medium: Write {
    /// Waits until all written bytes would survive a power cut.
    fn sync(&mut self) -> io::Result<()>;

    /// Drops all bytes after the first `length`; nothing is written afterwards.
    fn truncate(&mut self, length: u64) -> io::Result<()>;
}

impl Medium for File {
    fn sync(&mut self) -> io::Result<()> {
        match self.sync_data() {
            // A pipe or a device has nothing to sync.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            synced => synced,
        }
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.sync()
    }
}

/// Any of them.
pub(super) type AnyMedium = Box<dyn Medium + Send>;

/// A medium behind a buffer. A flush reaches the disk.
struct Sink {
    medium: BufWriter<AnyMedium>,
    position: Arc<AtomicU64>,
    safe: u64,
}

impl Sink {
    fn new(medium: AnyMedium) -> Self {
        Self { medium: BufWriter::with_capacity(BUFFER_BYTES, medium), position: Arc::default(), safe: 0 }
    }

    /// The number of bytes written, which the MCAP writer does not report.
    fn position(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.position)
    }

    /// After a failure: drops, if possible, the bytes after the last flush; returns the safe length.
    fn cut_back(self) -> u64 {
        // What is in the buffer still is not written.
        let (mut medium, _) = self.medium.into_parts();
        // Otherwise a record without an end remains, which readers skip.
        let _ = medium.truncate(self.safe);
        self.safe
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.medium.write(bytes)?;
        self.position.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.medium.flush()?;
        self.medium.get_mut().sync()?;
        self.safe = self.position.load(Ordering::Relaxed);
        Ok(())
    }
}

/// Only reports its position: the MCAP writer does not seek.
impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position.load(Ordering::Relaxed)),
            _ => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}

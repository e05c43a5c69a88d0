//! One file of a capture, on any medium.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use serde::Serialize;

use super::medium::{Medium, Sink};
use super::schemas::{LINK_BYTES, POSE, REPORT, RosType, TWIST};
use super::setup::{LinkChannels, METADATA, Setup};
use super::{About, geometry, link_bytes};
use crate::pipeline::{Record, Segment};

/// Level 3 makes captures 4 % shorter and takes twice as long (six cells at 4 kHz).
const ZSTD_LEVEL: u32 = 1;

/// A chunk that grows beyond this ends before it is flushed.
const CHUNK_BYTES: u64 = 1 << 20;

/// The channels of a board in one file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Channels {
    link: u16,
    hello: u16,
    pose: u16,
    twist: u16,
    report: u16,
}

/// A file that is being written.
pub(super) struct CaptureFile<M: Medium> {
    writer: Writer<Sink<M>>,
    /// The program's own reports.
    report: u16,
    report_schema: u16,
    /// Scenes by name of attachment.
    attachments: BTreeMap<String, u64>,
    message: Vec<u8>,
    links: u32,
    written_bytes: Arc<AtomicU64>,
    chunk_bytes: u64,
    unflushed_link_bytes: u64,
}

impl<M: Medium> CaptureFile<M> {
    /// Begins a file.
    pub(super) fn create(medium: M, about: &About) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(format!("slitpose {}", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(ZSTD_LEVEL)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            // Chunks gather in memory, so that each reaches the file whole.
            .disable_seeking(true);
        let sink = Sink::new(medium);
        let written_bytes = sink.position();
        let mut writer = options.create(sink)?;
        let report_schema = writer.add_schema(REPORT, "jsonschema", about.report_schema.as_bytes())?;
        let report = writer.add_channel(report_schema, "/slitpose/report", "json", &BTreeMap::new())?;
        Ok(Self {
            writer,
            report,
            report_schema,
            attachments: BTreeMap::new(),
            message: Vec::new(),
            links: 0,
            written_bytes,
            chunk_bytes: 0,
            unflushed_link_bytes: 0,
        })
    }

    /// Writes what belongs to a board, ahead of all it says.
    pub(super) fn add_device(&mut self, setup: &Setup, log_ns: u64) -> Result<Channels, McapError> {
        let hash = setup.scene.hash;
        let attachment = setup.attachment(|name| self.attachments.get(name).is_some_and(|taken| *taken != hash));
        if self.attachments.insert(attachment.clone(), hash).is_none() {
            self.writer.attach(&Attachment {
                log_time: log_ns,
                create_time: log_ns,
                name: attachment.clone(),
                media_type: "application/toml".to_owned(),
                data: Cow::Borrowed(setup.scene.source.as_bytes()),
            })?;
        }
        let topic = |name: &str| format!("/slitpose/{}/{name}", setup.device);
        let channels = Channels {
            link: self.ros_channel(LINK_BYTES, &topic("link"), &[])?,
            hello: self.ros_channel(LINK_BYTES, &topic("hello"), &[("content", "the last hello, as it came")])?,
            pose: self.ros_channel(
                POSE,
                &topic("pose"),
                &[
                    ("content", "base_from_tool; metres"),
                    (
                        "covariance",
                        "row-major, of t' = t + dt, R' = exp(dtheta) R, order (dt, dtheta); m2, m rad, rad2",
                    ),
                ],
            )?,
            twist: self.ros_channel(
                TWIST,
                &topic("twist"),
                &[
                    ("content", "velocity of the tool's origin and of its rotation, in the base frame; m/s, rad/s"),
                    ("covariance", "row-major, order (linear, angular); m2/s2, m rad/s2, rad2/s2"),
                ],
            )?,
            report: self.writer.add_channel(self.report_schema, &topic("report"), "json", &BTreeMap::new())?,
        };
        let link_channels = LinkChannels { link: channels.link, hello: channels.hello };
        self.writer.write_metadata(&Metadata {
            name: METADATA.to_owned(),
            metadata: setup.to_metadata(&attachment, link_channels),
        })?;
        Ok(channels)
    }

    fn ros_channel(&mut self, of: RosType, topic: &str, about: &[(&str, &str)]) -> Result<u16, McapError> {
        let schema = self.writer.add_schema(of.name, "ros2msg", of.definition.as_bytes())?;
        // The profile asks for the quality of service, which nothing but a ROS publisher has.
        let about = about.iter().chain([&("offered_qos_profiles", "")]);
        let metadata = about.map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        self.writer.add_channel(schema, topic, "cdr", &metadata)
    }

    /// Writes the last hello of a board.
    pub(super) fn hello(&mut self, channels: Channels, packet: &[u8], log_ns: u64) -> Result<(), McapError> {
        let mut hello = Segment::default();
        hello.push(packet, None);
        link_bytes::encode(&hello, &mut self.message);
        self.write(channels.hello, 0, log_ns, log_ns)
    }

    /// Writes what a link delivered.
    pub(super) fn link(&mut self, channels: Channels, segment: &Segment, log_ns: u64) -> Result<(), McapError> {
        link_bytes::encode(segment, &mut self.message);
        self.unflushed_link_bytes += segment.bytes.len() as u64;
        self.links = self.links.wrapping_add(1);
        self.write(channels.link, self.links, log_ns, log_ns)
    }

    /// Writes a pose and a velocity, if the record has them.
    pub(super) fn pose(&mut self, channels: Channels, record: &Record, log_ns: u64) -> Result<(), McapError> {
        // Saturates, and a negative time does not exist.
        let device_ns = (record.device_time_s * 1e9) as u64;
        let (stamp_ns, publish_ns) = match record.host_time {
            Some(time) => (time.utc_ns, time.utc_ns),
            None => (device_ns, log_ns),
        };
        let sequence = record.sequence as u32;
        if let Some(estimate) = &record.solution.estimate {
            geometry::encode_pose(stamp_ns, estimate, &mut self.message);
            self.write(channels.pose, sequence, log_ns, publish_ns)?;
        }
        if let Some(twist) = &record.twist {
            geometry::encode_twist(stamp_ns, twist, &mut self.message);
            self.write(channels.twist, sequence, log_ns, publish_ns)?;
        }
        Ok(())
    }

    /// Writes a report of a board, or of the program.
    pub(super) fn report(&mut self, of: Option<Channels>, report: &[u8], log_ns: u64) -> Result<(), McapError> {
        self.message.clear();
        self.message.extend_from_slice(report);
        self.write(of.map_or(self.report, |channels| channels.report), 0, log_ns, log_ns)
    }

    fn write(&mut self, channel_id: u16, sequence: u32, log_ns: u64, publish_ns: u64) -> Result<(), McapError> {
        let header = MessageHeader { channel_id, sequence, log_time: log_ns, publish_time: publish_ns };
        self.chunk_bytes += self.message.len() as u64;
        self.writer.write_to_known_channel(&header, &self.message)
    }

    /// Ends the chunk and waits until it would survive a power cut.
    pub(super) fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.chunk_bytes = 0;
        self.unflushed_link_bytes = 0;
        Ok(())
    }

    /// Whether nothing waits for a flush.
    pub(super) fn is_flushed(&self) -> bool {
        self.chunk_bytes == 0
    }

    /// Length of the file if it were flushed now, at most.
    pub(super) fn bytes(&self) -> u64 {
        self.written_bytes.load(Ordering::Relaxed) + self.chunk_bytes
    }

    /// Bytes of links that came behind the last flush.
    pub(super) fn unflushed_link_bytes(&self) -> u64 {
        self.unflushed_link_bytes
    }

    /// Ends the file.
    pub(super) fn finish(&mut self) -> Result<(), McapError> {
        // What was recorded is safe before the summary is tried.
        self.flush()?;
        self.writer.finish()?;
        Ok(())
    }

    /// After a failure: cuts the file back to the last flush, and gives its length and the medium.
    pub(super) fn cut_back(self) -> (u64, M) {
        self.writer.into_inner().cut_back()
    }
}

/// The bytes of a report.
pub(super) fn report_bytes(report: &impl Serialize) -> Result<Vec<u8>, serde_json::Error> {
    serde_json::to_vec(report)
}

/// What the system said.
pub(super) fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}

//! What records mean: which channel is whose, which scene belongs to which board.

use std::collections::BTreeMap;

use mcap::records::{Record, op};

use super::link_bytes;
use super::reader::Entry;
use super::records::attachment;
use super::setup::{METADATA, Setup};
use crate::device::DeviceId;
use crate::pipeline::Segment;

/// A scene is some kilobytes of text. Longer attachments are not ours.
const MAX_SCENE_BYTES: usize = 1 << 20;

/// More scenes than boards that one host can follow.
const MAX_SCENES: usize = 256;

/// What must be remembered to understand records.
#[derive(Default)]
pub(super) struct Index {
    channels: BTreeMap<u16, Channel>,
    /// Scenes by name of attachment.
    attachments: BTreeMap<String, String>,
    /// Records that are damaged, so far.
    pub(super) damaged_records: u64,
    /// Bytes in them.
    pub(super) damaged_bytes: u64,
}

#[derive(Clone, Copy)]
enum Channel {
    Link(DeviceId),
    Hello(DeviceId),
    Other,
}

impl Index {
    /// Counts a damaged record.
    pub(super) fn count_damage(&mut self, bytes: u64) {
        self.damaged_records += 1;
        self.damaged_bytes += bytes;
    }

    /// Takes a record; gives an entry if it is one.
    pub(super) fn take(&mut self, opcode: u8, record: &[u8], segment: &mut Segment) -> Option<Entry> {
        let taken = match opcode {
            op::CHANNEL => self.take_channel(record).map(|()| None),
            op::ATTACHMENT => self.take_attachment(record).map(|()| None),
            op::METADATA => self.take_metadata(record),
            op::MESSAGE => self.take_message(record, segment),
            _ => Some(None),
        };
        if taken.is_none() {
            self.count_damage(record.len() as u64);
        }
        taken.flatten()
    }

    fn take_channel(&mut self, record: &[u8]) -> Option<()> {
        let Ok(Record::Channel(channel)) = mcap::parse_record(op::CHANNEL, record) else {
            return None;
        };
        let of_board = || {
            let (device, topic) = channel.topic.strip_prefix("/slitpose/")?.split_once('/')?;
            Some((device.parse().ok()?, topic))
        };
        let channel_is = match of_board() {
            Some((device, "link")) => Channel::Link(device),
            Some((device, "hello")) => Channel::Hello(device),
            _ => Channel::Other,
        };
        self.channels.insert(channel.id, channel_is);
        Some(())
    }

    fn take_attachment(&mut self, record: &[u8]) -> Option<()> {
        let (name, media_type, data) = attachment(record)?;
        if media_type != "application/toml" || data.len() > MAX_SCENE_BYTES || self.attachments.len() >= MAX_SCENES {
            return Some(());
        }
        self.attachments.insert(name.to_owned(), std::str::from_utf8(data).ok()?.to_owned());
        Some(())
    }

    fn take_metadata(&mut self, record: &[u8]) -> Option<Option<Entry>> {
        let Ok(Record::Metadata(metadata)) = mcap::parse_record(op::METADATA, record) else {
            return None;
        };
        if metadata.name != METADATA {
            return Some(None);
        }
        let (setup, channels) = Setup::from_metadata(&metadata.metadata, &self.attachments)?;
        // Should the chunk with the channels be damaged; a file that was edited may number otherwise.
        self.channels.entry(channels.link).or_insert(Channel::Link(setup.device));
        self.channels.entry(channels.hello).or_insert(Channel::Hello(setup.device));
        Some(Some(Entry::Setup(Box::new(setup))))
    }

    fn take_message(&mut self, record: &[u8], segment: &mut Segment) -> Option<Option<Entry>> {
        let Ok(Record::Message { header, data }) = mcap::parse_record(op::MESSAGE, record) else {
            return None;
        };
        let log_ns = header.log_time;
        let entry = match self.channels.get(&header.channel_id) {
            Some(Channel::Link(device)) => Entry::Link { device: Some(*device), log_ns },
            Some(Channel::Hello(device)) => Entry::Hello { device: *device, log_ns },
            Some(Channel::Other) | None => return Some(None),
        };
        link_bytes::decode(&data, segment)?;
        Some(Some(entry))
    }
}

//! The interpretation of records: the board to which a channel, a scene or a calibration belongs.

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::{Record, op};

use super::entry::Entry;
use super::link_bytes;
use super::records::attachment;
use super::setup::{METADATA, Setup, SetupError, Texts};
use crate::link::{DeviceId, Segment};
use crate::ros;
use slitpose_head::scene_file::fnv1a_64;

/// Longest text accepted: scenes have some kilobytes, calibrations up to 10 MB, longer attachments are foreign.
const MAX_TEXT_BYTES: usize = 1 << 24;

/// Most bytes of texts that are kept.
const MAX_KEPT_BYTES: usize = 1 << 28;

/// Most boards accepted, more than one host can follow.
const MAX_BOARDS: usize = 256;

/// Most texts accepted: each board may have had several in turn.
const MAX_TEXTS: usize = 4 * MAX_BOARDS;

/// Channels, scenes and boards, which give records their meaning.
#[derive(Default)]
pub(super) struct Index {
    channels: BTreeMap<u16, Channel>,
    texts: Texts,
    /// Bytes in them.
    kept_bytes: usize,
    /// Boards with their last settings.
    setups: BTreeMap<DeviceId, Setup>,
    /// Boards whose last hello has been read: copies of it are skipped.
    greeted: BTreeSet<DeviceId>,
    /// Whether settings may be missing, so that later copies must be searched.
    pub(super) misses_settings: bool,
    /// Records that are damaged, so far.
    pub(super) damaged_records: u64,
    /// Bytes in them.
    pub(super) damaged_bytes: u64,
    /// The first settings that cannot be used, though nothing damaged them.
    pub(super) refused: Option<SetupError>,
}

#[derive(Clone, Copy)]
enum Channel {
    Link(DeviceId),
    Hello(DeviceId),
    Other,
}

impl Index {
    /// Counts a damaged record, or bytes that are not a record. As it may have held a hello, hellos count again.
    pub(super) fn count_damage(&mut self, bytes: u64) {
        self.damaged_records += 1;
        self.damaged_bytes += bytes;
        self.greeted.clear();
    }

    /// Interprets a record; returns its entry, if any.
    pub(super) fn interpret(&mut self, opcode: u8, record: &[u8], segment: &mut Segment) -> Option<Entry> {
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

    /// Reads a scene or the settings of a board from further on in the file. `Some` if the settings of a
    /// board are then known, with an entry if they are new.
    pub(super) fn take_ahead(&mut self, opcode: u8, record: &[u8]) -> Option<Option<Entry>> {
        match opcode {
            op::ATTACHMENT => self.take_attachment(record).and(None),
            op::METADATA => self.settle(&metadata(record)?).ok(),
            _ => None,
        }
    }

    fn take_channel(&mut self, record: &[u8]) -> Option<()> {
        let Ok(Record::Channel(channel)) = mcap::parse_record(op::CHANNEL, record) else {
            return None;
        };
        let channel_is = match ros::board_of(&channel.topic) {
            Some((device, "link")) => Channel::Link(device),
            Some((device, "hello")) => Channel::Hello(device),
            _ => Channel::Other,
        };
        self.channels.insert(channel.id, channel_is);
        Some(())
    }

    fn take_attachment(&mut self, record: &[u8]) -> Option<()> {
        let (_, media_type, data) = attachment(record)?;
        if media_type != "application/toml" || data.len() > MAX_TEXT_BYTES {
            return Some(());
        }
        let hash = fnv1a_64(data);
        let is_kept = self.texts.len() < MAX_TEXTS && self.kept_bytes + data.len() <= MAX_KEPT_BYTES;
        if is_kept && !self.texts.contains_key(&hash) {
            self.texts.insert(hash, std::str::from_utf8(data).ok()?.into());
            self.kept_bytes += data.len();
        }
        Some(())
    }

    fn take_metadata(&mut self, record: &[u8]) -> Option<Option<Entry>> {
        let Some(entries) = metadata(record) else { return Some(None) };
        match self.settle(&entries) {
            Ok(entry) => Some(entry),
            Err(SetupError::Damaged) => {
                self.misses_settings = true;
                None
            }
            // The text was damaged and has been counted; there may be another copy.
            Err(SetupError::Scene { .. } | SetupError::Calibration { .. }) => {
                self.misses_settings = true;
                Some(None)
            }
            Err(refused) => {
                self.refused.get_or_insert(refused);
                Some(None)
            }
        }
    }

    /// Reads the settings of a board; returns an entry if they are new.
    fn settle(&mut self, entries: &BTreeMap<String, String>) -> Result<Option<Entry>, SetupError> {
        let (setup, channels) = Setup::from_metadata(entries, &self.texts)?;
        let device = setup.device;
        if self.setups.len() >= MAX_BOARDS && !self.setups.contains_key(&device) {
            return Err(SetupError::TooMany { limit: MAX_BOARDS });
        }
        // In case the chunk with the channels is damaged. An edited file may have other numbers.
        self.channels.entry(channels.link).or_insert(Channel::Link(device));
        self.channels.entry(channels.hello).or_insert(Channel::Hello(device));
        if self.setups.get(&device) == Some(&setup) {
            return Ok(None);
        }
        self.setups.insert(device, setup.clone());
        Ok(Some(Entry::Setup(Box::new(setup))))
    }

    fn take_message(&mut self, record: &[u8], segment: &mut Segment) -> Option<Option<Entry>> {
        let Ok(Record::Message { header, data }) = mcap::parse_record(op::MESSAGE, record) else {
            return None;
        };
        let log_ns = header.log_time;
        let entry = match self.channels.get(&header.channel_id) {
            Some(Channel::Link(device)) => {
                self.greeted.insert(*device);
                Entry::Link { device: Some(*device), log_ns }
            }
            // Each chunk has a hello; it is news only at the beginning and after damage.
            Some(Channel::Hello(device)) if self.greeted.insert(*device) => Entry::Hello { device: *device, log_ns },
            Some(Channel::Hello(_) | Channel::Other) | None => return Some(None),
        };
        link_bytes::decode(&data, segment)?;
        Some(Some(entry))
    }
}

/// The entries of a metadata record, if it has settings of a board.
fn metadata(record: &[u8]) -> Option<BTreeMap<String, String>> {
    match mcap::parse_record(op::METADATA, record) {
        Ok(Record::Metadata(metadata)) if metadata.name == METADATA => Some(metadata.metadata),
        _ => None,
    }
}

//! The interpretation of records: the board to which a channel, a scene or a calibration belongs.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use mcap::records::{Record, op};

use super::file::TOML;
use super::records::attachment;
use super::setup::{METADATA, Setup, SetupError, Texts};
use super::{Entry, link_bytes};
use crate::link::{DeviceId, Segment};
use crate::ros::{self, cdr::decode_note};
use slitpose_head::scene_file::fnv1a_64;
use slitpose_head::text_file::MAX_TEXT_BYTES;

/// Most bytes of texts that are kept.
const MAX_KEPT_BYTES: usize = 1 << 28;

/// Most boards accepted, more than one host can follow.
const MAX_BOARDS: usize = 256;

/// Most texts accepted: each board may have had several in turn.
const MAX_TEXTS: usize = 4 * MAX_BOARDS;

/// Most topics that are named where nothing can be replayed.
const MAX_TOPICS: usize = 20;

/// Channels, scenes and boards, which give records their meaning.
#[derive(Default)]
pub(super) struct Index {
    channels: BTreeMap<u16, Channel>,
    texts: Texts,
    kept_bytes: usize,
    setups: BTreeMap<DeviceId, Setup>,
    /// The last settings of each board whose scene or calibration has not been read yet, by number of the board.
    waiting: BTreeMap<String, BTreeMap<String, String>>,
    /// New settings that have not been returned.
    pub(super) ready: VecDeque<Box<Setup>>,
    pub(super) topics: BTreeSet<String>,
    /// Boards whose last hello has been read: copies of it are skipped.
    pub(super) greeted: BTreeSet<DeviceId>,
    /// Whether settings may be missing, so that later copies must be searched.
    pub(super) misses_settings: bool,
    /// Log time and monotonic time of the last message of each link.
    last_ns: BTreeMap<DeviceId, [u64; 2]>,
    /// Messages of links that stand behind later ones.
    pub(super) unordered_messages: u64,
    pub(super) damaged_records: u64,
    pub(super) damaged_bytes: u64,
    /// The first settings that cannot be used, though nothing damaged them.
    refused: Option<SetupError>,
}

#[derive(Clone, Copy)]
enum Channel {
    Link(DeviceId),
    Hello(DeviceId),
    Notes,
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
            op::ATTACHMENT => self.take_attachment(record).map(|_| None),
            op::METADATA => self.take_metadata(record).map(|()| None),
            op::MESSAGE => self.take_message(record, segment),
            _ => Some(None),
        };
        if taken.is_none() {
            self.count_damage(record.len() as u64);
        }
        taken.flatten()
    }

    /// Reads a scene or the settings of a board from further on in the file. Returns whether the settings of a
    /// board are then known. Only the next settings of each board count.
    pub(super) fn take_ahead(&mut self, opcode: u8, record: &[u8]) -> bool {
        match opcode {
            op::ATTACHMENT => self.take_attachment(record) == Some(true),
            op::METADATA => metadata(record).is_some_and(|entries| {
                let device = entries.get("device");
                let is_later = self.ready.iter().any(|setup| device == Some(&setup.device.to_string()));
                is_later || self.settle(entries).is_ok()
            }),
            _ => false,
        }
    }

    /// Whether settings of `device` have been read.
    pub(super) fn is_settled(&self, device: DeviceId) -> bool {
        self.setups.contains_key(&device)
    }

    /// Why settings cannot be used, if some cannot: damage is counted apart.
    pub(super) fn refused(&self) -> Option<SetupError> {
        let missing = || Setup::from_metadata(self.waiting.values().next()?, &self.texts).err();
        self.refused.clone().or_else(missing)
    }

    fn take_channel(&mut self, record: &[u8]) -> Option<()> {
        let Ok(Record::Channel(channel)) = mcap::parse_record(op::CHANNEL, record) else {
            return None;
        };
        let channel_is = match ros::board_of(&channel.topic) {
            _ if channel.topic == ros::NOTES => Channel::Notes,
            Some((device, "link")) => Channel::Link(device),
            Some((device, "hello")) => Channel::Hello(device),
            _ => Channel::Other,
        };
        if self.topics.len() < MAX_TOPICS {
            self.topics.insert(channel.topic);
        }
        self.channels.insert(channel.id, channel_is);
        Some(())
    }

    /// Reads a scene or a calibration; returns whether settings of a board were waiting for it.
    fn take_attachment(&mut self, record: &[u8]) -> Option<bool> {
        let (_, media_type, data) = attachment(record)?;
        if media_type != TOML || data.len() > MAX_TEXT_BYTES {
            return Some(false);
        }
        let hash = fnv1a_64(data);
        let is_kept = self.texts.len() < MAX_TEXTS && self.kept_bytes + data.len() <= MAX_KEPT_BYTES;
        if !is_kept || self.texts.contains_key(&hash) {
            return Some(false);
        }
        self.texts.insert(hash, std::str::from_utf8(data).ok()?.into());
        self.kept_bytes += data.len();
        let waiting = std::mem::take(&mut self.waiting).into_values();
        Some(waiting.filter_map(|entries| self.settle(entries).ok()).count() > 0)
    }

    fn take_metadata(&mut self, record: &[u8]) -> Option<()> {
        let Some(entries) = metadata(record) else { return Some(()) };
        match self.settle(entries) {
            Ok(()) => {}
            Err(SetupError::Damaged) => {
                self.misses_settings = true;
                return None;
            }
            // The text may follow; if it was damaged, there may be another copy.
            Err(SetupError::Scene { .. } | SetupError::Calibration { .. }) => self.misses_settings = true,
            Err(refused) => drop(self.refused.get_or_insert(refused)),
        }
        Some(())
    }

    /// Reads the settings of a board, which are then ready if they are new.
    fn settle(&mut self, entries: BTreeMap<String, String>) -> Result<(), SetupError> {
        let (setup, channels) = match Setup::from_metadata(&entries, &self.texts) {
            Err(error @ (SetupError::Scene { .. } | SetupError::Calibration { .. })) => {
                let device = entries.get("device").cloned().unwrap_or_default();
                if self.waiting.len() < MAX_BOARDS || self.waiting.contains_key(&device) {
                    self.waiting.insert(device, entries);
                }
                return Err(error);
            }
            read => read?,
        };
        let device = setup.device;
        if self.setups.len() >= MAX_BOARDS && !self.setups.contains_key(&device) {
            return Err(SetupError::TooMany { limit: MAX_BOARDS });
        }
        self.waiting.remove(&device.to_string());
        // In case the chunk with the channels is damaged. An edited file may have other numbers.
        self.channels.entry(channels.link).or_insert(Channel::Link(device));
        self.channels.entry(channels.hello).or_insert(Channel::Hello(device));
        if self.setups.get(&device) != Some(&setup) {
            self.setups.insert(device, setup.clone());
            self.ready.push_back(Box::new(setup));
        }
        Ok(())
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
            Some(Channel::Notes) => {
                segment.clear();
                return decode_note(&data).map(|(stamp_ns, text)| Some(Entry::Note { stamp_ns, text, log_ns }));
            }
            Some(Channel::Hello(_) | Channel::Other) | None => return Some(None),
        };
        link_bytes::decode(&data, segment)?;
        if let Entry::Link { device: Some(device), .. } = entry {
            let monotonic_ns = segment.reads.iter().find_map(|read| read.at).map_or(log_ns, |at| at.monotonic_ns);
            let last_ns = self.last_ns.insert(device, [log_ns, monotonic_ns]);
            // UTC alone may have been set back.
            let is_behind = last_ns.is_some_and(|[log, monotonic]| log_ns < log && monotonic_ns < monotonic);
            self.unordered_messages += u64::from(is_behind);
        }
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

//! A capture from its beginning to its end, one chunk in memory at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::str::Utf8Error;
use std::vec;

use mcap::records::op;
use slitpose_head::special_file;
use slitpose_protocol::DELIMITER;

use super::index::Index;
use super::link_bytes::last_hello;
use super::records::{ChunkRecords, Next, Records, is_capture, is_rewritten};
use super::{CaptureError, Entry, SetupError};
use crate::link::{self, DeviceId, Segment};

/// Bytes of a plain byte stream in a segment: some 20 ms of a board at 4 kHz.
const RAW_BYTES: usize = 4096;

/// Most bytes of messages that are sorted, which is done in memory: some 10 minutes of a board at 4 kHz.
const MAX_SORTED_BYTES: usize = 1 << 28;

/// Bytes in which a capture with a damaged beginning is recognised: a scene and the metadata after it.
const BEGIN_BYTES: u64 = 1 << 16;

/// The next step after a file of another kind.
const GIVE: &str = "give a capture written by `run --record` or `simulate`";

/// Magic, kind and next step of files that are taken for captures.
const FOREIGN: [(&[u8], &str, &str); 6] = [
    (b"version https://git-lfs.github.com/spec/", "a Git LFS pointer", "fetch the capture with `git lfs pull`"),
    (b"#ROSBAG V", "a ROS 1 bag", GIVE),
    (b"SQLite format 3\0", "a SQLite database", GIVE),
    (b"\x1f\x8b\x08", "compressed by gzip", "unpack it with `gunzip` first"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd", "unpack it with `unzstd` first"),
    (b"PK\x03\x04", "a ZIP archive", "unpack it first"),
];

/// How a capture ended, and what of it could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct End {
    /// Whether the recorder ended the file. If not, it was cut off, or is still being recorded;
    /// the missing data came after the last flush, or after the cut.
    pub finished: bool,
    /// Bytes of the file up to the end of its last whole record.
    pub whole_bytes: u64,
    /// Bytes of the file that could not be read: damaged records, and all bytes after the last whole one.
    pub lost_bytes: u64,
    /// Number of damaged places: chunks of up to a second, other records, and bytes that are not a record.
    pub damaged_records: u64,
    /// Whether the checksum over all records is wrong.
    pub checksum_failed: bool,
    /// Whether the index after the records is damaged.
    pub index_damaged: bool,
    /// Bytes behind the end of the capture, which are not read.
    pub trailing_bytes: u64,
    /// The first settings of a board that are undamaged but cannot be used.
    pub refused: Option<SetupError>,
    /// Messages of a board's link that stand behind later ones.
    pub unordered_messages: u64,
    /// Names of the first topics.
    pub topics: BTreeSet<String>,
}

impl End {
    /// Whether data are or may be missing.
    pub fn has_loss(&self) -> bool {
        !self.finished || self.is_damaged() || self.refused.is_some() || self.unordered_messages > 0
    }

    /// Whether bytes of the file are not those that were written.
    pub fn is_damaged(&self) -> bool {
        self.damaged_records > 0 || self.checksum_failed || self.index_damaged || self.trailing_bytes > 0
    }
}

/// Reads a capture, or a plain byte stream as it comes from a port, which has no times.
///
/// ```
/// use std::{io::Cursor, path::Path};
/// use slitpose_tracking::{capture::CaptureReader, link::Segment};
/// // The bytes of a port, as `simulate --raw` writes them, are a capture, too.
/// let bytes = b"\x01\x02\x00".repeat(100);
/// let mut reader = CaptureReader::new(Path::new("port.bin"), Cursor::new(bytes))?;
/// let (mut segment, mut read) = (Segment::default(), 0);
/// while reader.next(&mut segment)?.is_some() {
///     read += segment.bytes.len();
/// }
/// assert_eq!(read, 300);
/// # Ok::<(), slitpose_tracking::capture::CaptureError>(())
/// ```
pub struct CaptureReader<R = File> {
    path: PathBuf,
    input: Input<R>,
    from_ns: u64,
    /// Last hellos from the skipped time, to be returned before each board's data.
    owed: BTreeMap<DeviceId, Vec<u8>>,
    /// The entry to return after such a hello.
    held: Option<(Entry, Segment)>,
    end: End,
}

enum Input<R> {
    Mcap(Box<McapInput<R>>),
    /// The entries of a file in another order.
    Sorted(vec::IntoIter<(Entry, Segment)>),
    Raw(io::Chain<io::Cursor<Vec<u8>>, R>),
}

struct McapInput<R> {
    records: Records<R>,
    chunk: Option<ChunkRecords>,
    index: Index,
    /// The entry to return after its settings.
    held: Option<(Entry, Segment)>,
    /// Up to where settings were searched ahead of their place.
    searched_to: u64,
    /// Whether another program has written the file.
    is_rewritten: bool,
    is_over: bool,
}

impl CaptureReader {
    /// Opens the file `path`.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let error = |source| CaptureError::Open { path: path.to_owned(), source };
        if special_file::is_special(path) {
            let (what, next_step) = ("a pipe or a device", "write it to a regular file first");
            return Err(CaptureError::Foreign { path: path.to_owned(), what, next_step });
        }
        let file = File::open(path).map_err(error)?;
        Self::new(path, file)
    }
}

impl<R: Read + Seek> CaptureReader<R> {
    /// Reads from `input`; `path` names it in messages.
    pub fn new(path: &Path, mut input: R) -> Result<Self, CaptureError> {
        let mut begin = Vec::new();
        let read = input.by_ref().take(BEGIN_BYTES).read_to_end(&mut begin);
        read.map_err(|source| CaptureError::Open { path: path.to_owned(), source })?;
        let read = |source| CaptureError::Read { path: path.to_owned(), bytes: 0, source };
        let mut end = End::default();
        let input = if is_capture(&begin) {
            match if is_rewritten(&begin) { sorted(&begin, &mut input).map_err(read)? } else { None } {
                Some((entries, of)) => {
                    end = of;
                    Input::Sorted(entries.into_iter())
                }
                None => Input::Mcap(Box::new(McapInput::new(begin, input))),
            }
        } else if let Some((what, next_step)) = foreign(&begin) {
            return Err(CaptureError::Foreign { path: path.to_owned(), what, next_step });
        } else {
            Input::Raw(io::Cursor::new(begin).chain(input))
        };
        Ok(Self { path: path.to_owned(), input, from_ns: 0, owed: BTreeMap::new(), held: None, end })
    }

    /// Skips the data of links before `log_ns`. Setups are still returned, and the data of each board begin
    /// with its last hello from before. A plain byte stream has no times and is read as a whole.
    #[must_use]
    pub fn starting_at(mut self, log_ns: u64) -> Self {
        self.from_ns = log_ns;
        self
    }

    /// The next entry, with its bytes in `segment`, whose memory is reused. `None` at the
    /// [end](Self::end).
    ///
    /// Damage is no error: it is skipped and counted.
    pub fn next(&mut self, segment: &mut Segment) -> Result<Option<Entry>, CaptureError> {
        if let Some((entry, mut held)) = self.held.take() {
            std::mem::swap(segment, &mut held);
            return Ok(Some(entry));
        }
        loop {
            let advanced = match &mut self.input {
                Input::Mcap(input) => input.next(segment, &mut self.end),
                Input::Sorted(entries) => Ok(entries.next().map(|(entry, of)| {
                    *segment = of;
                    entry
                })),
                Input::Raw(input) => next_raw(input, segment, &mut self.end),
            };
            let bytes = self.end.whole_bytes;
            let entry = advanced.map_err(|source| CaptureError::Read { path: self.path.clone(), bytes, source })?;
            match entry {
                None => return Ok(None),
                Some(entry) => {
                    if let Some(entry) = self.admit(entry, segment) {
                        return Ok(Some(entry));
                    }
                }
            }
        }
    }

    /// How the capture ended, or its state so far.
    pub fn end(&self) -> End {
        self.end.clone()
    }

    /// The entry to return now, if `entry` is not skipped.
    fn admit(&mut self, entry: Entry, segment: &mut Segment) -> Option<Entry> {
        match entry {
            Entry::Hello { device, log_ns } if log_ns < self.from_ns => {
                self.owed.insert(device, segment.bytes.clone());
                None
            }
            Entry::Link { device: Some(device), log_ns } if log_ns < self.from_ns => {
                if let Some(hello) = last_hello(&segment.bytes) {
                    self.owed.insert(device, hello.to_owned());
                }
                None
            }
            Entry::Link { device: Some(device), log_ns } => {
                // UTC may be set back later: nothing after the start is skipped.
                self.from_ns = 0;
                let Some(hello) = self.owed.remove(&device) else {
                    return Some(entry);
                };
                self.held = Some((entry, std::mem::take(segment)));
                segment.push(&hello, None);
                Some(Entry::Hello { device, log_ns })
            }
            entry => Some(entry),
        }
    }
}

/// What a file is that begins like this and is no capture, and the next step.
fn foreign(begin: &[u8]) -> Option<(&'static str, &'static str)> {
    let kind = FOREIGN.iter().find(|(magic, ..)| begin.starts_with(magic));
    // The packets of a board end with a delimiter, which no text holds.
    let is_text = || {
        let is_cut = |error: Utf8Error| error.error_len().is_none();
        !begin.is_empty() && !begin.contains(&DELIMITER) && std::str::from_utf8(begin).err().is_none_or(is_cut)
    };
    kind.map(|(_, what, next_step)| (*what, *next_step)).or_else(|| is_text().then_some(("a text", GIVE)))
}

/// Entries in the order of `log_time`, and how the file ended.
type Sorted = (Vec<(Entry, Segment)>, End);

/// The entries of a capture by `log_time`, settings first, if its messages stand in another order and are not too many.
fn sorted<R: Read + Seek>(begin: &[u8], input: &mut R) -> io::Result<Option<Sorted>> {
    let mut end = End::default();
    let mut capture = McapInput::new(begin.to_owned(), &mut *input);
    while capture.index.unordered_messages == 0 && capture.next(&mut Segment::default(), &mut end)?.is_some() {}
    let is_sorted = capture.index.unordered_messages == 0;
    let (mut entries, mut bytes) = (Vec::new(), 0);
    input.seek(SeekFrom::Start(begin.len() as u64))?;
    let mut capture = McapInput::new(begin.to_owned(), &mut *input);
    while !is_sorted && bytes <= MAX_SORTED_BYTES {
        let mut segment = Segment::default();
        // Which hello is the first is known when all are sorted.
        capture.index.greeted.clear();
        let Some(entry) = capture.next(&mut segment, &mut end)? else { break };
        bytes += segment.bytes.len() + size_of_val(&segment.reads[..]);
        entries.push((entry, segment));
    }
    input.seek(SeekFrom::Start(begin.len() as u64))?;
    if is_sorted || bytes > MAX_SORTED_BYTES {
        return Ok(None);
    }
    entries.sort_by_key(|(entry, _)| match entry {
        Entry::Setup(_) => (0, 0),
        Entry::Hello { log_ns, .. } => (*log_ns, 1),
        Entry::Link { log_ns, .. } | Entry::Note { log_ns, .. } => (*log_ns, 2),
    });
    let mut greeted = BTreeSet::new();
    entries.retain(|(entry, _)| match entry {
        Entry::Hello { device, .. } => greeted.insert(Some(*device)),
        Entry::Link { device, .. } => {
            greeted.insert(*device);
            true
        }
        Entry::Setup(_) | Entry::Note { .. } => true,
    });
    Ok(Some((entries, End { unordered_messages: 0, ..end })))
}

/// The next piece of a plain byte stream.
fn next_raw(input: &mut impl Read, segment: &mut Segment, end: &mut End) -> io::Result<Option<Entry>> {
    segment.clear();
    input.by_ref().take(RAW_BYTES as u64).read_to_end(&mut segment.bytes)?;
    let bytes = segment.bytes.len();
    if bytes == 0 {
        end.finished = true;
        return Ok(None);
    }
    segment.reads.push(link::Read { bytes, at: None });
    end.whole_bytes += bytes as u64;
    Ok(Some(Entry::Link { device: None, log_ns: 0 }))
}

impl<R: Read + Seek> McapInput<R> {
    /// Reads from the beginning of the file; `begin` was taken from `input`.
    fn new(begin: Vec<u8>, input: R) -> Self {
        Self {
            is_rewritten: is_rewritten(&begin),
            records: Records::new(begin, input),
            chunk: None,
            index: Index::default(),
            held: None,
            searched_to: 0,
            is_over: false,
        }
    }

    fn next(&mut self, segment: &mut Segment, end: &mut End) -> io::Result<Option<Entry>> {
        loop {
            if let Some(setup) = self.index.ready.pop_front() {
                return Ok(Some(Entry::Setup(setup)));
            }
            if let Some((entry, mut held)) = self.held.take() {
                std::mem::swap(segment, &mut held);
                return Ok(Some(entry));
            }
            if self.is_over {
                return Ok(None);
            }
            let entry = match self.next_in_chunk(segment) {
                None => self.next_record(segment, end)?,
                entry => entry,
            };
            if let Some(entry) = entry {
                if let Entry::Link { device: Some(device), .. } | Entry::Hello { device, .. } = &entry {
                    self.search_settings(Some(*device))?;
                }
                self.held = Some((entry, std::mem::take(segment)));
            }
        }
    }

    /// Reads the next record, which may be a chunk.
    fn next_record(&mut self, segment: &mut Segment, end: &mut End) -> io::Result<Option<Entry>> {
        let Self { records, chunk, index, .. } = self;
        let mut behind_bytes = 0;
        let mut entry = None;
        match records.next()? {
            Next::Chunk(records) => *chunk = Some(records),
            Next::Record(opcode, record) => entry = index.interpret(opcode, record, segment),
            Next::Damaged(bytes) => {
                index.count_damage(bytes);
                index.misses_settings = true;
            }
            Next::Finished { checksum_failed, index_damaged, trailing_bytes } => {
                self.is_over = true;
                *end = End { finished: true, checksum_failed, index_damaged, trailing_bytes, ..End::default() };
            }
            Next::Cut(bytes) => {
                self.is_over = true;
                behind_bytes = bytes;
            }
        }
        end.whole_bytes = records.whole_bytes;
        end.lost_bytes = behind_bytes + index.damaged_bytes;
        end.damaged_records = index.damaged_records;
        if self.is_over {
            end.refused = index.refused();
            // The recorder writes messages as they come, also where clocks are set back.
            end.unordered_messages = if self.is_rewritten { index.unordered_messages } else { 0 };
            end.topics = std::mem::take(&mut index.topics);
        }
        if self.chunk.is_some() {
            self.search_settings(None)?;
        }
        Ok(entry)
    }

    /// Before a chunk, or data of `device`: searches the rest of the file for settings, if damage may have hit them, or
    /// those of `device` are not known. Other programs write them anywhere, this one repeats them before the next chunk.
    fn search_settings(&mut self, device: Option<DeviceId>) -> io::Result<()> {
        let Self { records, index, searched_to, .. } = self;
        let after_damage = std::mem::take(&mut index.misses_settings) && records.position() >= *searched_to;
        let is_settled = |index: &Index| device.is_none_or(|device| index.is_settled(device));
        if is_settled(index) && !after_damage {
            return Ok(());
        }
        let from = records.position().max(*searched_to);
        if from == u64::MAX {
            return Ok(());
        }
        let found = records.look_ahead(from, |records| {
            let mut is_found = false;
            loop {
                let at = records.position();
                match records.next()? {
                    Next::Chunk(_) if is_found && is_settled(index) => return Ok(at),
                    Next::Record(opcode, record) => is_found |= index.take_ahead(opcode, record),
                    Next::Chunk(_) | Next::Damaged(_) => {}
                    Next::Finished { .. } | Next::Cut(_) => return Ok(u64::MAX),
                }
            }
        })?;
        *searched_to = found.unwrap_or(u64::MAX);
        Ok(())
    }

    /// The next entry of the chunk that is being read.
    fn next_in_chunk(&mut self, segment: &mut Segment) -> Option<Entry> {
        while let Some((opcode, record)) = self.chunk.as_mut()?.next() {
            // Attachments and metadata stand outside.
            if matches!(opcode, op::CHANNEL | op::MESSAGE)
                && let Some(entry) = self.index.interpret(opcode, record, segment)
            {
                return Some(entry);
            }
        }
        self.chunk = None;
        None
    }
}

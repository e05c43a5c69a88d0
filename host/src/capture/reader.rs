//! A capture from its beginning to its end, one chunk in memory at a time.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::entry::Entry;
use super::index::Index;
use super::packets::last_hello;
use super::records::{ChunkRecords, Next, Records, is_capture};
use super::{CaptureError, SetupError};
use crate::link::{self, DeviceId, Segment};

/// Bytes of a plain byte stream in a segment: some 20 ms of a board at 4 kHz.
const RAW_BYTES: usize = 4096;

/// Bytes in which a capture with a damaged beginning is recognised: a scene and the metadata after it.
const BEGIN_BYTES: u64 = 1 << 16;

/// How a capture ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct End {
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
}

impl End {
    /// Whether data are or may be missing.
    pub(crate) fn has_loss(&self) -> bool {
        !self.finished || self.is_damaged() || self.refused.is_some()
    }

    /// Whether the file is damaged.
    pub(crate) fn is_damaged(&self) -> bool {
        self.damaged_records > 0 || self.checksum_failed || self.index_damaged || self.trailing_bytes > 0
    }
}

/// Reads a capture, or a plain byte stream as it comes from a port, which has no times.
pub(crate) struct CaptureReader<R = File> {
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
    Raw(io::Chain<io::Cursor<Vec<u8>>, R>),
}

struct McapInput<R> {
    records: Records<R>,
    /// The chunk that is being read.
    chunk: Option<ChunkRecords>,
    index: Index,
    /// Settings from further on.
    ahead: VecDeque<Entry>,
    /// Whether no settings follow.
    is_last: bool,
    is_over: bool,
}

impl CaptureReader {
    /// Opens the file `path`.
    ///
    /// # Errors
    /// If it cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, CaptureError> {
        let error = |source| CaptureError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(error)?;
        Self::new(path, file).map_err(error)
    }
}

impl<R: Read + Seek> CaptureReader<R> {
    /// Reads from `input`; `path` names it in messages.
    ///
    /// # Errors
    /// If nothing can be read.
    pub(crate) fn new(path: &Path, mut input: R) -> io::Result<Self> {
        let mut begin = Vec::new();
        input.by_ref().take(BEGIN_BYTES).read_to_end(&mut begin)?;
        let input = if is_capture(&begin) {
            Input::Mcap(Box::new(McapInput {
                records: Records::new(begin, input),
                chunk: None,
                index: Index::default(),
                ahead: VecDeque::new(),
                is_last: false,
                is_over: false,
            }))
        } else {
            Input::Raw(io::Cursor::new(begin).chain(input))
        };
        Ok(Self { path: path.to_owned(), input, from_ns: 0, owed: BTreeMap::new(), held: None, end: End::default() })
    }

    /// Skips the data of links before `log_ns`. Setups are still returned, and the data of each board begin
    /// with its last hello from before. A plain byte stream has no times and is read as a whole.
    #[must_use]
    pub(crate) fn starting_at(mut self, log_ns: u64) -> Self {
        self.from_ns = log_ns;
        self
    }

    /// The next entry, with its bytes in `segment`, whose memory is reused. `None` at the
    /// [end](Self::end).
    ///
    /// Damage is no error: it is skipped and counted.
    ///
    /// # Errors
    /// Errors of the disk.
    pub(crate) fn next(&mut self, segment: &mut Segment) -> Result<Option<Entry>, CaptureError> {
        if let Some((entry, mut held)) = self.held.take() {
            std::mem::swap(segment, &mut held);
            return Ok(Some(entry));
        }
        loop {
            let advanced = match &mut self.input {
                Input::Mcap(input) => input.next(segment, &mut self.end),
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
    pub(crate) fn end(&self) -> End {
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
    fn next(&mut self, segment: &mut Segment, end: &mut End) -> io::Result<Option<Entry>> {
        while !self.is_over {
            if let Some(entry) = self.ahead.pop_front() {
                return Ok(Some(entry));
            }
            if let Some(entry) = self.next_in_chunk(segment) {
                return Ok(Some(entry));
            }
            let Self { records, chunk, index, .. } = self;
            let mut behind_bytes = 0;
            let mut entry = None;
            match records.next()? {
                Next::Record(op::CHUNK, record) => {
                    *chunk = ChunkRecords::new(record);
                    if chunk.is_none() {
                        index.count_damage(record.len() as u64);
                    }
                }
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
            if self.chunk.is_some() {
                self.look_ahead()?;
            }
            let Self { records, index, .. } = self;
            end.whole_bytes = records.whole_bytes();
            end.lost_bytes = behind_bytes + index.damaged_bytes;
            end.damaged_records = index.damaged_records;
            end.refused.clone_from(&index.refused);
            if entry.is_some() {
                return Ok(entry);
            }
        }
        Ok(None)
    }

    /// After damage that may have hit settings, and before a chunk: searches for their next copy, which is
    /// after that chunk or further on.
    fn look_ahead(&mut self) -> io::Result<()> {
        if !std::mem::take(&mut self.index.misses_settings) || self.is_last {
            return Ok(());
        }
        let Self { records, index, ahead, is_last, .. } = self;
        let found = records.look_ahead(|records| {
            let mut is_found = false;
            loop {
                match records.next()? {
                    Next::Record(op::CHUNK, _) if is_found => return Ok(true),
                    Next::Record(opcode, record) => {
                        if let Some(entry) = index.take_ahead(opcode, record) {
                            is_found = true;
                            ahead.extend(entry);
                        }
                    }
                    Next::Damaged(_) => {}
                    Next::Finished { .. } | Next::Cut(_) => return Ok(is_found),
                }
            }
        })?;
        *is_last = found == Some(false);
        Ok(())
    }

    /// The next entry of the chunk that is being read.
    fn next_in_chunk(&mut self, segment: &mut Segment) -> Option<Entry> {
        let Self { chunk, index, .. } = self;
        while let Some(records) = chunk {
            match records.next(|opcode, record| index.interpret(opcode, record, segment)) {
                Ok(Some(Some(entry))) => return Some(entry),
                Ok(Some(None)) => {}
                Ok(None) => *chunk = None,
                Err(_) => {
                    index.count_damage(records.bytes());
                    *chunk = None;
                }
            }
        }
        None
    }
}

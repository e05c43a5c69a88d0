//! A capture from its beginning to its end, one chunk in memory at a time.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::index::Index;
use super::packets::last_hello;
use super::records::{ChunkRecords, Next, Records};
use super::{CaptureError, Setup};
use crate::device::DeviceId;
use crate::pipeline::{self, Segment};

/// Bytes of a plain byte stream in a segment: some 20 ms of a board at 4 kHz.
const RAW_BYTES: usize = 4096;

/// What comes next in a capture.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// A board, ahead of what it says.
    Setup(Box<Setup>),
    /// The last hello of a board, said before what follows; the segment holds its packet.
    Hello {
        /// Which board.
        device: DeviceId,
        /// When it was written.
        log_ns: u64,
    },
    /// The segment holds what the link of a board delivered.
    Link {
        /// Which board; `None` if the file is a plain byte stream.
        device: Option<DeviceId>,
        /// When: UTC of the first read, or what the recorder gave for it, in nanoseconds. 0 in a
        /// plain byte stream.
        log_ns: u64,
    },
}

/// How a capture ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct End {
    /// Whether the recorder ended the file. If not, it was cut off, or is still being recorded;
    /// what is missing came after the last flush, or after the cut.
    pub finished: bool,
    /// Bytes of the file up to the end of its last whole record.
    pub whole_bytes: u64,
    /// Bytes of the file that could not be read: damaged records, and all behind the last whole one.
    pub lost_bytes: u64,
    /// Chunks and other records that are damaged; each chunk held up to a second.
    pub damaged_records: u64,
    /// The checksum over all records does not agree.
    pub checksum_failed: bool,
}

impl End {
    /// Whether something is or may be missing.
    pub fn has_loss(&self) -> bool {
        !self.finished || self.lost_bytes > 0 || self.damaged_records > 0 || self.checksum_failed
    }
}

/// Reads a capture, or a plain byte stream as it comes from a port, which has no times.
pub struct CaptureReader<R = File> {
    path: PathBuf,
    input: Input<R>,
    from_ns: u64,
    /// Hellos of the time that is skipped.
    owed: BTreeMap<DeviceId, Vec<u8>>,
    /// What comes behind a hello that was owed.
    held: Option<(Entry, Segment)>,
    end: End,
}

enum Input<R> {
    Mcap(Box<McapInput<R>>),
    Raw { begin: Vec<u8>, input: R },
}

struct McapInput<R> {
    records: Records<R>,
    /// The chunk that is being read.
    chunk: Option<ChunkRecords>,
    index: Index,
    is_over: bool,
}

impl CaptureReader {
    /// Opens the file `path`.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let error = |source| CaptureError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(error)?;
        Self::new(path, file).map_err(error)
    }
}

impl<R: Read> CaptureReader<R> {
    /// Reads from `input`; `path` names it in messages.
    ///
    /// # Errors
    /// If nothing can be read.
    pub fn new(path: &Path, mut input: R) -> io::Result<Self> {
        let mut begin = Vec::new();
        input.by_ref().take(mcap::MAGIC.len() as u64).read_to_end(&mut begin)?;
        let input = if !begin.is_empty() && mcap::MAGIC.starts_with(&begin) {
            let records = Records::new(&begin, input);
            Input::Mcap(Box::new(McapInput { records, chunk: None, index: Index::default(), is_over: false }))
        } else {
            Input::Raw { begin, input }
        };
        Ok(Self { path: path.to_owned(), input, from_ns: 0, owed: BTreeMap::new(), held: None, end: End::default() })
    }

    /// Passes over what links delivered before `log_ns`; setups come all the same, and where a board
    /// goes on, its last hello from before comes first. A plain byte stream has no times and comes
    /// as a whole.
    #[must_use]
    pub fn starting_at(mut self, log_ns: u64) -> Self {
        self.from_ns = log_ns;
        self
    }

    /// The next entry; what it says of bytes is in `segment`, whose memory is used again. `None` at
    /// the [end](Self::end).
    ///
    /// Damage is no error: it is passed over and counted.
    ///
    /// # Errors
    /// Those of the disk.
    pub fn next(&mut self, segment: &mut Segment) -> Result<Option<Entry>, CaptureError> {
        if let Some((entry, mut held)) = self.held.take() {
            std::mem::swap(segment, &mut held);
            return Ok(Some(entry));
        }
        loop {
            let advanced = match &mut self.input {
                Input::Mcap(input) => input.next(segment, &mut self.end),
                Input::Raw { begin, input } => next_raw(begin, input, segment, &mut self.end),
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

    /// How the capture ended; so far, if it has not.
    pub fn end(&self) -> End {
        self.end
    }

    /// The entry that is to come now, if `entry` is not passed over.
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
                // UTC may be put back later: what has begun goes on.
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

/// The next piece of a plain byte stream; `begin` was taken from `input` before.
fn next_raw(
    begin: &mut Vec<u8>,
    input: &mut impl Read,
    segment: &mut Segment,
    end: &mut End,
) -> io::Result<Option<Entry>> {
    segment.clear();
    segment.bytes.append(begin);
    let wanted = RAW_BYTES - segment.bytes.len();
    input.take(wanted as u64).read_to_end(&mut segment.bytes)?;
    let bytes = segment.bytes.len();
    if bytes == 0 {
        end.finished = true;
        return Ok(None);
    }
    segment.reads.push(pipeline::Read { bytes, at: None });
    end.whole_bytes += bytes as u64;
    Ok(Some(Entry::Link { device: None, log_ns: 0 }))
}

/// What a record outside chunks leads to.
enum Step {
    Entry(Entry),
    Next,
    Over { finished: bool, checksum_failed: bool },
}

impl<R: Read> McapInput<R> {
    fn next(&mut self, segment: &mut Segment, end: &mut End) -> io::Result<Option<Entry>> {
        while !self.is_over {
            if let Some(entry) = self.next_in_chunk(segment) {
                return Ok(Some(entry));
            }
            let Self { records, chunk, index, .. } = self;
            let step = records.next(|next| match next {
                Next::Record(op::CHUNK, record) => {
                    *chunk = ChunkRecords::new(record);
                    if chunk.is_none() {
                        index.count_damage(record.len() as u64);
                    }
                    Step::Next
                }
                Next::Record(opcode, record) => index.take(opcode, record, segment).map_or(Step::Next, Step::Entry),
                Next::Finished => Step::Over { finished: true, checksum_failed: false },
                Next::FinishedDamaged => Step::Over { finished: true, checksum_failed: true },
                Next::Cut => Step::Over { finished: false, checksum_failed: false },
            })?;
            end.whole_bytes = records.whole_bytes();
            match step {
                Step::Entry(entry) => return Ok(Some(entry)),
                Step::Next => {}
                Step::Over { finished, checksum_failed } => {
                    let behind_bytes = if finished { 0 } else { records.drain()? };
                    *end = End {
                        finished,
                        checksum_failed,
                        whole_bytes: records.whole_bytes(),
                        lost_bytes: behind_bytes + index.damaged_bytes,
                        damaged_records: index.damaged_records,
                    };
                    self.is_over = true;
                }
            }
        }
        Ok(None)
    }

    /// The next entry of the chunk that is being read.
    fn next_in_chunk(&mut self, segment: &mut Segment) -> Option<Entry> {
        let Self { chunk, index, .. } = self;
        while let Some(records) = chunk {
            match records.next(|opcode, record| index.take(opcode, record, segment)) {
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

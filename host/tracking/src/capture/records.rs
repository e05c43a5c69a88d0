//! The records of an MCAP file, from its beginning to its end, even if it is damaged.
//!
//! A record begins with its length, after which the next one begins. Where there is no sound record, the reader searches
//! byte by byte for the next one that a checksum, or consistent lengths, prove.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::vec;

use crc32fast::Hasher;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Longest record accepted, which limits the memory for a damaged length: a chunk has some 128 KiB, and
/// other MCAP writers stay far below.
const MAX_RECORD_BYTES: usize = 64 << 20;

/// Bytes that are unpacked or verified, at most: so many for each byte of the file, and some for its beginning. The
/// recorder's chunks unpack to 4 times their length, with the noise of the simulated board.
const MAX_WORK_PER_BYTE: u64 = 256;
const MAX_WORK_AT_BEGIN: u64 = 16 << 20;

/// The library that the header of each capture names begins so.
pub(super) const PROGRAM: &str = "slitpose ";

/// Opcode and length ahead of each record.
const FRAME_BYTES: usize = 1 + 8;

/// Offset of a chunk's compression: two instants, the length and the checksum of the records precede it.
const COMPRESSION_AT: usize = FRAME_BYTES + 8 + 8 + 8 + 4;

/// The compressions of MCAP, each with its length before it.
const COMPRESSIONS: [&[u8]; 3] = [b"\x04\0\0\0zstd", b"\x03\0\0\0lz4", b"\0\0\0\0"];

/// The frame of a chunk with its lengths.
const CHUNK_BEGIN_BYTES: usize = COMPRESSION_AT + 8 + 8;

/// Bytes searched before they are dropped from memory.
const SEARCHED_BYTES: usize = 1 << 20;

/// Checksum and magic at the end of a file.
const END_BYTES: usize = 4 + mcap::MAGIC.len();

/// The last record of the index: two offsets and a checksum.
const FOOTER_BYTES: usize = FRAME_BYTES + 8 + 8 + 4;

pub(super) struct Records<R> {
    window: Window<R>,
    /// Length of the record returned last.
    given: usize,
    /// Bytes up to the end of the last whole record.
    pub(super) whole_bytes: u64,
    /// End of the bytes that were returned as damaged last.
    damaged_to: u64,
    /// Whether bytes were skipped, so that the checksum over all records is meaningless.
    has_gap: bool,
    is_begun: bool,
    /// Bytes that were unpacked or verified, here and by [`Self::look_ahead`].
    work_bytes: [u64; 2],
}

pub(super) enum Next<'a> {
    Chunk(ChunkRecords),
    Record(u8, &'a [u8]),
    /// This many bytes are not a sound record.
    Damaged(u64),
    /// The last record of the data; copies and an index follow.
    Finished {
        /// Whether the checksum of the records is wrong.
        checksum_failed: bool,
        index_damaged: bool,
        /// Bytes behind the end of the file's format, such as another capture's.
        trailing_bytes: u64,
    },
    /// The file ends without its last record, this many bytes after the last whole one, or after what was damaged.
    Cut(u64),
}

/// What stands at a place of the window, up to `end`.
enum Found {
    Record {
        opcode: u8,
        body: Range<usize>,
        end: usize,
    },
    Chunk {
        records: ChunkRecords,
        end: usize,
    },
    /// A chunk that is damaged, or unpacks out of proportion; another record follows it.
    Damaged {
        end: usize,
    },
    Nothing,
}

impl<R: Read> Records<R> {
    /// Reads from the beginning of the file; `begin` was taken from `input`.
    pub(super) fn new(begin: Vec<u8>, input: R) -> Self {
        Self::within(Window::new(begin, input, 0), false, 0)
    }

    fn within(window: Window<R>, is_begun: bool, work_bytes: u64) -> Self {
        let (whole_bytes, work_bytes) = (window.offset, [work_bytes, 0]);
        Self { whole_bytes, damaged_to: 0, window, given: 0, has_gap: false, is_begun, work_bytes }
    }

    pub(super) fn next(&mut self) -> io::Result<Next<'_>> {
        let given = std::mem::take(&mut self.given);
        self.window.advance(given);
        if !std::mem::replace(&mut self.is_begun, true)
            && let Some(damage) = self.begin()?
        {
            return Ok(damage);
        }
        let found = self.record_at(0, true)?;
        if let Found::Record { end, .. } | Found::Chunk { end, .. } | Found::Damaged { end } = &found {
            self.given = *end;
            self.whole_bytes = self.window.offset + *end as u64;
        }
        match found {
            Found::Record { opcode: op::DATA_END, body, end } => {
                let stated = self.window.bytes()[body].try_into().map_or(0, u32::from_le_bytes);
                let sum = self.window.take_checksum();
                self.given = 0;
                self.window.advance(end);
                let checksum_failed = self.has_gap || (stated != 0 && stated != sum);
                let (index_damaged, trailing_bytes) = self.pass_index()?;
                Ok(Next::Finished { checksum_failed, index_damaged, trailing_bytes })
            }
            Found::Record { opcode: op::FOOTER, .. } => {
                Ok(Next::Finished { checksum_failed: true, index_damaged: true, trailing_bytes: 0 })
            }
            Found::Record { opcode, body, .. } => Ok(Next::Record(opcode, &self.window.bytes()[body])),
            Found::Chunk { records, .. } => Ok(Next::Chunk(records)),
            Found::Damaged { end } => Ok(Next::Damaged(end as u64)),
            Found::Nothing => self.search(),
        }
    }

    pub(super) fn position(&self) -> u64 {
        self.window.offset + self.given as u64
    }

    fn begin(&mut self) -> io::Result<Option<Next<'static>>> {
        let length = mcap::MAGIC.len();
        let bytes = self.window.fill(length)?;
        if bytes.len() < length {
            return Ok(Some(Next::Cut(bytes.len() as u64)));
        }
        let is_magic = bytes.starts_with(mcap::MAGIC);
        self.window.advance(length);
        if is_magic {
            self.whole_bytes = self.window.offset;
            return Ok(None);
        }
        Ok(Some(self.damaged(length as u64)))
    }

    /// The bytes before the window are damaged.
    fn damaged(&mut self, bytes: u64) -> Next<'static> {
        (self.has_gap, self.damaged_to) = (true, self.window.offset);
        Next::Damaged(bytes)
    }

    fn search(&mut self) -> io::Result<Next<'static>> {
        let (mut passed, mut at) = (0, 1);
        loop {
            if at >= SEARCHED_BYTES {
                self.window.advance(at);
                (passed, at) = (passed + at as u64, 0);
            }
            let bytes = self.window.fill(at + CHUNK_BEGIN_BYTES)?;
            if at >= bytes.len() {
                let rest = bytes.len();
                self.window.advance(rest);
                return Ok(Next::Cut(self.window.offset - self.whole_bytes.max(self.damaged_to)));
            }
            if may_begin(&bytes[at..]) && !matches!(self.record_at(at, false)?, Found::Nothing) {
                self.window.advance(at);
                return Ok(self.damaged(passed + at as u64));
            }
            at += 1;
        }
    }

    /// The record at `at`: if it does not follow another one directly, only one that is proven.
    fn record_at(&mut self, at: usize, follows: bool) -> io::Result<Found> {
        let bytes = &self.window.fill(at + CHUNK_BEGIN_BYTES)?[at..];
        let Some((opcode, Some(length))) = frame(bytes) else { return Ok(Found::Nothing) };
        let is_consistent = match opcode {
            op::CHUNK => chunk_bytes(bytes) == Some(length),
            op::METADATA | op::ATTACHMENT => true,
            op::DATA_END => length == 4,
            op::FOOTER => FRAME_BYTES + length == FOOTER_BYTES,
            op::MESSAGE_INDEX => follows && index_bytes(bytes) == Some(length),
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | 0x80.. => follows,
            _ => false,
        };
        let (begin, end) = (at + FRAME_BYTES, at + FRAME_BYTES + length);
        if !is_consistent || self.window.fill(end)?.len() < end || !(follows || self.is_continued(opcode, end)?) {
            return Ok(Found::Nothing);
        }
        let body = begin..end;
        let is_in_proportion = matches!(opcode, op::MESSAGE_INDEX | 0x80..) || self.can_verify(opcode, &body);
        if opcode == op::CHUNK {
            let records = if is_in_proportion { ChunkRecords::read(&self.window.bytes()[body]) } else { None };
            return Ok(match records {
                Some(records) => Found::Chunk { records, end },
                // Where bytes are missing in it, the next chunk may begin within its length.
                None if follows && self.is_record_or_end(end)? => Found::Damaged { end },
                None => Found::Nothing,
            });
        }
        let bytes = &self.window.bytes()[body.clone()];
        let is_sound = is_in_proportion
            && match opcode {
                op::METADATA => is_metadata(bytes),
                op::ATTACHMENT => attachment(bytes).is_some(),
                op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE => mcap::parse_record(opcode, bytes).is_ok(),
                _ => true,
            };
        Ok(if is_sound { Found::Record { opcode, body, end } } else { Found::Nothing })
    }

    /// Whether what follows a record at `end` may follow it, as far as nothing else proves the record.
    fn is_continued(&mut self, opcode: u8, end: usize) -> io::Result<bool> {
        match opcode {
            op::DATA_END => self.is_record_or_end(end),
            op::FOOTER => {
                let behind = &self.window.fill(end + mcap::MAGIC.len())?[end..];
                Ok(mcap::MAGIC.starts_with(&behind[..behind.len().min(mcap::MAGIC.len())]))
            }
            _ => Ok(true),
        }
    }

    /// Whether a record may begin at `at`, or the file ends there.
    fn is_record_or_end(&mut self, at: usize) -> io::Result<bool> {
        let bytes = &self.window.fill(at + FRAME_BYTES)?[at..];
        let is_known = |opcode| (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        Ok(frame(bytes).is_none_or(|(opcode, length)| is_known(opcode) && length.is_some()))
    }

    /// Whether the work of verifying or unpacking a record is in proportion to the file up to its end; counts it.
    fn can_verify(&mut self, opcode: u8, body: &Range<usize>) -> bool {
        let bytes = &self.window.bytes()[body.clone()];
        let unpacked = bytes.get(16..).and_then(|bytes| bytes.first_chunk());
        let unpacked = unpacked.filter(|_| opcode == op::CHUNK).map_or(0, |bytes| u64::from_le_bytes(*bytes));
        let work_bytes = self.work_bytes[0].saturating_add(unpacked.max(bytes.len() as u64));
        let is_fit = work_bytes <= MAX_WORK_AT_BEGIN + MAX_WORK_PER_BYTE * (self.window.offset + body.end as u64);
        if is_fit {
            self.work_bytes[0] = work_bytes;
        }
        is_fit
    }

    /// Reads to the end of the file; returns whether its index is damaged, and how many bytes follow the end.
    fn pass_index(&mut self) -> io::Result<(bool, u64)> {
        self.window.take_checksum();
        loop {
            let bytes = self.window.fill(FOOTER_BYTES + mcap::MAGIC.len())?;
            let end = match frame(bytes) {
                Some((op::FOOTER, Some(length))) if FRAME_BYTES + length == FOOTER_BYTES => break,
                Some((op::SCHEMA..=op::SUMMARY_OFFSET, Some(length))) => FRAME_BYTES + length,
                Some((0x80.., Some(length))) => FRAME_BYTES + length,
                _ => return Ok((true, 0)),
            };
            if self.window.fill(end)?.len() < end {
                return Ok((true, 0));
            }
            self.window.advance(end);
        }
        if self.window.fill(FOOTER_BYTES)?.len() < FOOTER_BYTES {
            return Ok((true, 0));
        }
        self.window.advance(FOOTER_BYTES - size_of::<u32>());
        let sum = self.window.take_checksum();
        let bytes = self.window.fill(END_BYTES)?;
        let Some((stated, magic)) = bytes.split_first_chunk() else { return Ok((true, 0)) };
        let stated = u32::from_le_bytes(*stated);
        let is_damaged = !magic.starts_with(mcap::MAGIC) || (stated != 0 && stated != sum);
        let end = END_BYTES.min(bytes.len());
        self.window.advance(end);
        let mut trailing_bytes = 0;
        loop {
            let length = self.window.fill(SEARCHED_BYTES)?.len();
            if length == 0 {
                return Ok((is_damaged, trailing_bytes));
            }
            self.window.advance(length);
            trailing_bytes += length as u64;
        }
    }
}

impl<R: Read + Seek> Records<R> {
    /// Passes the records from offset `from` on to `look`, then restores the position; `None` if the input, such as
    /// a pipe, cannot seek.
    pub(super) fn look_ahead<T>(
        &mut self,
        from: u64,
        look: impl FnOnce(&mut Records<&mut R>) -> io::Result<T>,
    ) -> io::Result<Option<T>> {
        let Some(window) = self.window.look_ahead(from) else { return Ok(None) };
        let mut ahead = Records::within(window, true, self.work_bytes[1]);
        let seen = look(&mut ahead);
        self.work_bytes[1] = ahead.work_bytes[0];
        // Back to where it was, for the window to go on.
        let read = self.window.offset + self.window.bytes().len() as u64;
        self.window.input.seek(SeekFrom::Start(read))?;
        seen.map(Some)
    }
}

/// Whether these bytes are the beginning of a capture: its magic, or what remains of one.
pub(super) fn is_capture(begin: &[u8]) -> bool {
    let magic = mcap::MAGIC;
    if begin.len() < magic.len() {
        return !begin.is_empty() && magic.starts_with(begin);
    }
    let agreeing = magic.iter().zip(begin).filter(|(a, b)| a == b).count();
    let is_metadata_at = |at: usize| {
        let Some((op::METADATA, Some(length))) = frame(&begin[at..]) else { return false };
        begin[at + FRAME_BYTES..].get(..length).is_some_and(is_metadata)
    };
    2 * agreeing >= magic.len() || (0..begin.len()).any(is_metadata_at)
}

/// Whether the header at the `begin` of a file names another program.
pub(super) fn is_rewritten(begin: &[u8]) -> bool {
    let record = begin.strip_prefix(mcap::MAGIC).and_then(|record| record.strip_prefix(&[op::HEADER]));
    let body = record.and_then(|record| record.get(8..));
    let library = body.and_then(text).and_then(|(_, rest)| text(rest));
    library.is_some_and(|(library, _)| !library.starts_with(PROGRAM))
}

/// Opcode and length of a record; no length if it is none.
fn frame(bytes: &[u8]) -> Option<(u8, Option<usize>)> {
    let [opcode, length @ ..] = *bytes.first_chunk::<FRAME_BYTES>()?;
    let length = usize::try_from(u64::from_le_bytes(length)).ok().filter(|length| *length <= MAX_RECORD_BYTES);
    Some((opcode, length))
}

/// Whether a record that can be proven may begin with these bytes.
fn may_begin(bytes: &[u8]) -> bool {
    let opcodes = [op::CHUNK, op::METADATA, op::ATTACHMENT, op::DATA_END, op::FOOTER];
    opcodes.contains(&bytes[0]) && bytes.get(5..FRAME_BYTES) == Some(&[0; 4])
}

/// Length of a chunk, from the fields after its frame.
fn chunk_bytes(bytes: &[u8]) -> Option<usize> {
    let compression = bytes.get(COMPRESSION_AT..)?;
    let name = COMPRESSIONS.iter().find(|name| compression.starts_with(name))?;
    let records = u64::from_le_bytes(*compression[name.len()..].first_chunk()?);
    let records = usize::try_from(records).ok().filter(|records| *records <= MAX_RECORD_BYTES)?;
    Some(COMPRESSION_AT - FRAME_BYTES + name.len() + 8 + records)
}

/// Length of an index of messages, from its fields.
fn index_bytes(bytes: &[u8]) -> Option<usize> {
    let entries = bytes.get(FRAME_BYTES + 2..)?.first_chunk()?;
    Some(u32::from_le_bytes(*entries) as usize + 2 + 4)
}

/// Whether `body` is exactly a name and a sequence of pairs of texts.
fn is_metadata(body: &[u8]) -> bool {
    let pairs = || {
        let (_, rest) = text(body)?;
        let (length, mut rest) = rest.split_first_chunk()?;
        if u32::from_le_bytes(*length) as usize != rest.len() {
            return None;
        }
        while !rest.is_empty() {
            let (_, behind) = text(rest)?;
            (_, rest) = text(behind)?;
        }
        Some(())
    };
    pairs().is_some()
}

/// The records of a chunk whose checksum is right.
pub(super) struct ChunkRecords {
    bytes: Vec<u8>,
    records: vec::IntoIter<(u8, Range<usize>)>,
}

impl ChunkRecords {
    /// The records of `chunk`, which is without its frame; `None` if it is damaged.
    fn read(chunk: &[u8]) -> Option<Self> {
        let Ok(Record::Chunk { header, data }) = mcap::parse_record(op::CHUNK, chunk) else {
            return None;
        };
        // The reader does not check lengths within an uncompressed chunk.
        if header.compression.is_empty() && !is_framed(&data) {
            return None;
        }
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        let mut reader = LinearReader::new_with_options(options);
        let length = FRAME_BYTES + chunk.len();
        let buffer = reader.insert(length);
        buffer[0] = op::CHUNK;
        buffer[1..FRAME_BYTES].copy_from_slice(&(chunk.len() as u64).to_le_bytes());
        buffer[FRAME_BYTES..length].copy_from_slice(chunk);
        reader.notify_read(length);
        let (mut bytes, mut records) = (Vec::new(), Vec::new());
        while let Some(event) = reader.next_event() {
            match event.ok()? {
                LinearReadEvent::Record { opcode, data } => {
                    let begin = bytes.len();
                    bytes.extend_from_slice(data);
                    records.push((opcode, begin..bytes.len()));
                }
                // There is no more: an end between two chunks, an error within one.
                LinearReadEvent::ReadRequest(_) => reader.notify_read(0),
            }
        }
        Some(Self { bytes, records: records.into_iter() })
    }

    pub(super) fn next(&mut self) -> Option<(u8, &[u8])> {
        let (opcode, record) = self.records.next()?;
        Some((opcode, &self.bytes[record]))
    }
}

/// Whether `records` is a sequence of whole records.
fn is_framed(mut records: &[u8]) -> bool {
    while let Some((frame, rest)) = records.split_first_chunk::<FRAME_BYTES>() {
        let [_, length @ ..] = *frame;
        let Some(rest) = usize::try_from(u64::from_le_bytes(length)).ok().and_then(|length| rest.get(length..)) else {
            return false;
        };
        records = rest;
    }
    records.is_empty()
}

/// Name, media type and data of an attachment; `None` if its lengths or its checksum do not agree.
pub(super) fn attachment(record: &[u8]) -> Option<(&str, &str, &[u8])> {
    let (before, checksum) = record.split_last_chunk()?;
    // Two instants come first.
    let (name, rest) = text(before.get(16..)?)?;
    let (media_type, rest) = text(rest)?;
    let (length, data) = rest.split_first_chunk()?;
    let checksum = u32::from_le_bytes(*checksum);
    let is_sound =
        u64::from_le_bytes(*length) == data.len() as u64 && (checksum == 0 || checksum == crc32fast::hash(before));
    is_sound.then_some((name, media_type, data))
}

fn text(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some((std::str::from_utf8(text).ok()?, rest))
}

const READ_BYTES: usize = 1 << 18;

/// The bytes of a file from an offset on, as many as requested.
struct Window<R> {
    input: R,
    buffer: Vec<u8>,
    start: usize,
    /// Offset of the window in the file.
    offset: u64,
    is_at_end: bool,
    hasher: Hasher,
}

impl<R: Read> Window<R> {
    /// Begins with `begin`, which was taken from `input` and stands at `offset` of the file.
    fn new(begin: Vec<u8>, input: R, offset: u64) -> Self {
        Self { input, buffer: begin, start: 0, offset, is_at_end: false, hasher: Hasher::new() }
    }

    /// All bytes at hand: `wanted` at least, unless the file ends before.
    fn fill(&mut self, wanted: usize) -> io::Result<&[u8]> {
        while self.buffer.len() - self.start < wanted && !self.is_at_end {
            if self.start > READ_BYTES {
                self.buffer.drain(..self.start);
                self.start = 0;
            }
            let length = self.buffer.len();
            self.buffer.resize(length + READ_BYTES, 0);
            let read = loop {
                match self.input.read(&mut self.buffer[length..]) {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    read => break read,
                }
            };
            self.buffer.truncate(length + *read.as_ref().unwrap_or(&0));
            self.is_at_end = read? == 0;
        }
        Ok(self.bytes())
    }

    fn bytes(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// Moves on by `length` of the bytes at hand.
    fn advance(&mut self, length: usize) {
        self.hasher.update(&self.buffer[self.start..self.start + length]);
        self.start += length;
        self.offset += length as u64;
    }

    /// CRC-32 of all bytes passed since the window was made, or since the last call.
    fn take_checksum(&mut self) -> u32 {
        std::mem::take(&mut self.hasher).finalize()
    }
}

impl<R: Read + Seek> Window<R> {
    /// Another window, at `offset` of the file. `None` if the input, such as a pipe, cannot seek.
    /// The input must seek back before this window is used again.
    fn look_ahead(&mut self, offset: u64) -> Option<Window<&mut R>> {
        self.input.seek(SeekFrom::Start(offset)).ok()?;
        Some(Window::new(Vec::new(), &mut self.input, offset))
    }
}

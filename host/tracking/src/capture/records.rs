//! The records of an MCAP file, from its beginning to its end, even if it is damaged.
//!
//! A record begins with its length, after which the next one begins. Where the length is impossible, the reader
//! searches byte by byte for the next record that is proven by a checksum, or by consistent lengths.

use std::io::{self, Read, Seek};
use std::ops::Range;

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::medium::Window;

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

/// Reads records from `input`; chunks are not unpacked.
pub(super) struct Records<R> {
    window: Window<R>,
    /// Length of the record returned last.
    given: usize,
    whole_bytes: u64,
    /// End of the bytes that were returned as damaged last.
    damaged_to: u64,
    /// Whether bytes were skipped, so that the checksum over all records is meaningless.
    has_gap: bool,
    is_begun: bool,
    /// Bytes that were unpacked or verified, here and by [`Self::look_ahead`].
    work_bytes: [u64; 2],
}

#[derive(Debug)]
pub(super) enum Next<'a> {
    Record(u8, &'a [u8]),
    /// This many bytes are not a record; a record follows.
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

/// Where a record stands in the window.
enum Found {
    Record {
        opcode: u8,
        body: Range<usize>,
        end: usize,
    },
    /// There is no record here.
    None,
    /// The file ends before a record could end.
    End,
}

impl<R: Read> Records<R> {
    /// Reads from the beginning of the file; `begin` was taken from `input`.
    pub(super) fn new(begin: Vec<u8>, input: R) -> Self {
        Self::within(Window::new(begin, input, 0), false, 0)
    }

    fn within(window: Window<R>, is_begun: bool, work_bytes: u64) -> Self {
        let (whole_bytes, work_bytes) = (window.offset(), [work_bytes, 0]);
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
        match self.record_at(0)? {
            Found::Record { opcode: op::DATA_END, body, end } => {
                let stated = self.window.slice(body).try_into().map_or(0, u32::from_le_bytes);
                let sum = self.window.take_checksum();
                self.window.advance(end);
                self.whole_bytes = self.window.offset();
                let checksum_failed = self.has_gap || (stated != 0 && stated != sum);
                let (index_damaged, trailing_bytes) = self.pass_index()?;
                Ok(Next::Finished { checksum_failed, index_damaged, trailing_bytes })
            }
            Found::Record { opcode: op::FOOTER, .. } => {
                Ok(Next::Finished { checksum_failed: true, index_damaged: true, trailing_bytes: 0 })
            }
            Found::Record { opcode, body, end } => {
                self.given = end;
                self.whole_bytes = self.window.offset() + end as u64;
                let is_small = opcode != op::CHUNK || self.can_verify(opcode, &body);
                Ok(if is_small { Next::Record(opcode, self.window.slice(body)) } else { Next::Damaged(end as u64) })
            }
            Found::None | Found::End => self.search(),
        }
    }

    pub(super) fn position(&self) -> u64 {
        self.window.offset() + self.given as u64
    }

    /// Bytes up to the end of the last whole record.
    pub(super) fn whole_bytes(&self) -> u64 {
        self.whole_bytes
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
            self.whole_bytes = self.window.offset();
            return Ok(None);
        }
        self.has_gap = true;
        self.damaged_to = self.window.offset();
        Ok(Some(Next::Damaged(length as u64)))
    }

    fn search(&mut self) -> io::Result<Next<'static>> {
        let (mut passed, mut at) = (0, 1);
        loop {
            if at >= SEARCHED_BYTES {
                self.window.advance(at);
                passed += at as u64;
                at = 0;
            }
            let bytes = self.window.fill(at + CHUNK_BEGIN_BYTES)?;
            if at >= bytes.len() {
                let rest = self.window.bytes().len();
                self.window.advance(rest);
                return Ok(Next::Cut(self.window.offset() - self.whole_bytes.max(self.damaged_to)));
            }
            // Up to where a chunk's beginning would be cut off; at the end of the file one byte at a time.
            let last = bytes.len().saturating_sub(CHUNK_BEGIN_BYTES).max(at);
            let Some(passed_over) = (at..=last).position(|at| may_begin(&bytes[at..])) else {
                at = last + 1;
                continue;
            };
            at += passed_over;
            if matches!(self.proven_at(at)?, Found::Record { .. }) {
                self.window.advance(at);
                self.has_gap = true;
                self.damaged_to = self.window.offset();
                return Ok(Next::Damaged(passed + at as u64));
            }
            at += 1;
        }
    }

    /// The record at `at`, directly after another one.
    fn record_at(&mut self, at: usize) -> io::Result<Found> {
        let bytes = &self.window.fill(at + CHUNK_BEGIN_BYTES)?[at..];
        let Some((opcode, length)) = frame(bytes) else { return Ok(Found::End) };
        let chunk = chunk_bytes(bytes);
        if opcode == op::CHUNK && length.is_some() && chunk == length {
            let found = self.found(at, opcode, length)?;
            let Found::Record { body, end, .. } = &found else { return Ok(found) };
            // Where bytes are missing in it, the next chunk may begin within its length.
            let is_right = self.is_record_or_end(*end)?
                || (self.can_verify(opcode, body) && ChunkRecords::is_whole(self.window.slice(body.clone())));
            return Ok(if is_right { found } else { Found::None });
        }
        if chunk.is_some_and(|_| !is_uncompressed(bytes)) {
            // A chunk whose frame is damaged.
            return self.proven_at(at);
        }
        match opcode {
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE => self.checked(at, opcode, length, parses),
            op::MESSAGE_INDEX => {
                let stated = bytes.get(FRAME_BYTES + 2..).and_then(|bytes| bytes.first_chunk());
                let stated = stated.map(|stated| u32::from_le_bytes(*stated) as usize + 2 + 4);
                if stated == length { self.found(at, opcode, length) } else { Ok(Found::None) }
            }
            0x80.. => self.found(at, opcode, length),
            _ => self.proven_at(at),
        }
    }

    /// The record at `at`, if it is proven.
    fn proven_at(&mut self, at: usize) -> io::Result<Found> {
        let bytes = &self.window.fill(at + CHUNK_BEGIN_BYTES)?[at..];
        let Some((opcode, length)) = frame(bytes) else { return Ok(Found::End) };
        let chunk = chunk_bytes(bytes);
        // Compressed data are a chunk, even if the frame is damaged.
        if chunk.is_some() && (!is_uncompressed(bytes) || (opcode == op::CHUNK && chunk == length)) {
            let found = self.checked(at, op::CHUNK, chunk, |_, body| ChunkRecords::is_whole(body))?;
            // Bytes after the compressed data would not be detected.
            let is_followed = match &found {
                Found::Record { end, .. } => self.is_record_or_end(*end)?,
                Found::None | Found::End => true,
            };
            return Ok(if is_followed { found } else { Found::None });
        }
        match opcode {
            op::METADATA => self.checked(at, opcode, length, |_, body| is_metadata(body)),
            op::ATTACHMENT => self.checked(at, opcode, length, |_, body| attachment(body).is_some()),
            op::DATA_END if length == Some(4) => self.found(at, opcode, length),
            op::FOOTER if length == Some(8 + 8 + 4) => self.found(at, opcode, length),
            _ => Ok(Found::None),
        }
    }

    /// Whether a record may begin at `at`, or the file ends there.
    fn is_record_or_end(&mut self, at: usize) -> io::Result<bool> {
        let bytes = &self.window.fill(at + FRAME_BYTES)?[at..];
        let is_known = |opcode| (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        Ok(frame(bytes).is_none_or(|(opcode, length)| is_known(opcode) && length.is_some()))
    }

    /// The record of this length at `at`, if the file holds all of it.
    fn found(&mut self, at: usize, opcode: u8, length: Option<usize>) -> io::Result<Found> {
        let Some(length) = length else { return Ok(Found::None) };
        let (begin, end) = (at + FRAME_BYTES, at + FRAME_BYTES + length);
        let is_there = self.window.fill(end)?.len() >= end;
        Ok(if is_there { Found::Record { opcode, body: begin..end, end } } else { Found::End })
    }

    /// Whether the work of verifying or unpacking a record is in proportion to the file up to its end; counts it.
    fn can_verify(&mut self, opcode: u8, body: &Range<usize>) -> bool {
        let bytes = self.window.slice(body.clone());
        let unpacked = bytes.get(16..).and_then(|bytes| bytes.first_chunk());
        let unpacked = unpacked.filter(|_| opcode == op::CHUNK).map_or(0, |bytes| u64::from_le_bytes(*bytes));
        let work_bytes = self.work_bytes[0].saturating_add(unpacked.max(bytes.len() as u64));
        let is_fit = work_bytes <= MAX_WORK_AT_BEGIN + MAX_WORK_PER_BYTE * (self.window.offset() + body.end as u64);
        if is_fit {
            self.work_bytes[0] = work_bytes;
        }
        is_fit
    }

    /// As [`Self::found`], if the record is also `sound`.
    fn checked(
        &mut self,
        at: usize,
        opcode: u8,
        length: Option<usize>,
        sound: impl FnOnce(u8, &[u8]) -> bool,
    ) -> io::Result<Found> {
        let found = self.found(at, opcode, length)?;
        match &found {
            Found::Record { body, .. }
                if !self.can_verify(opcode, body) || !sound(opcode, self.window.slice(body.clone())) =>
            {
                Ok(Found::None)
            }
            _ => Ok(found),
        }
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
        self.window.come_back()?;
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
    let proves = |(opcode, length): (u8, Option<usize>), body: &[u8]| {
        let body = length.and_then(|length| body.get(..length));
        opcode == op::METADATA && body.is_some_and(is_metadata)
    };
    let has_metadata = || {
        (0..begin.len()).any(|at| {
            let bytes = &begin[at..];
            may_begin(bytes) && frame(bytes).is_some_and(|frame| proves(frame, &bytes[FRAME_BYTES..]))
        })
    };
    2 * agreeing >= magic.len() || has_metadata()
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
    let is_short = bytes.get(5..FRAME_BYTES) == Some(&[0; 4]);
    let opcodes = [op::CHUNK, op::METADATA, op::ATTACHMENT, op::DATA_END, op::FOOTER];
    (is_short && opcodes.contains(&bytes[0])) || chunk_bytes(bytes).is_some_and(|_| !is_uncompressed(bytes))
}

/// Length of a chunk, from the fields after its frame.
fn chunk_bytes(bytes: &[u8]) -> Option<usize> {
    let compression = bytes.get(COMPRESSION_AT..)?;
    let name = COMPRESSIONS.iter().find(|name| compression.starts_with(name))?;
    let records = u64::from_le_bytes(*compression[name.len()..].first_chunk()?);
    let records = usize::try_from(records).ok().filter(|records| *records <= MAX_RECORD_BYTES)?;
    Some(COMPRESSION_AT - FRAME_BYTES + name.len() + 8 + records)
}

fn is_uncompressed(bytes: &[u8]) -> bool {
    bytes[COMPRESSION_AT..].starts_with(&[0; 4])
}

fn parses(opcode: u8, body: &[u8]) -> bool {
    mcap::parse_record(opcode, body).is_ok()
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

pub(super) struct ChunkRecords {
    reader: LinearReader,
    bytes: u64,
}

impl ChunkRecords {
    /// The records of `chunk`, which is without its frame; `None` if it is damaged.
    pub(super) fn new(chunk: &[u8]) -> Option<Self> {
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
        let bytes = FRAME_BYTES + chunk.len();
        let buffer = reader.insert(bytes);
        buffer[0] = op::CHUNK;
        buffer[1..FRAME_BYTES].copy_from_slice(&(chunk.len() as u64).to_le_bytes());
        buffer[FRAME_BYTES..bytes].copy_from_slice(chunk);
        reader.notify_read(bytes);
        Some(Self { reader, bytes: bytes as u64 })
    }

    /// Whether all records of a chunk can be read.
    fn is_whole(chunk: &[u8]) -> bool {
        let Some(mut records) = Self::new(chunk) else { return false };
        loop {
            match records.next(|_, _| ()) {
                Ok(Some(())) => {}
                Ok(None) => return true,
                Err(_) => return false,
            }
        }
    }

    /// Length of the chunk in the file.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Passes the next record to `take`, if there is one.
    pub(super) fn next<T>(&mut self, take: impl FnOnce(u8, &[u8]) -> T) -> Result<Option<T>, McapError> {
        loop {
            match self.reader.next_event() {
                Some(Ok(LinearReadEvent::Record { opcode, data })) => return Ok(Some(take(opcode, data))),
                // There is no more: an end between two chunks, an error within one.
                Some(Ok(LinearReadEvent::ReadRequest(_))) => self.reader.notify_read(0),
                Some(Err(error)) => return Err(error),
                None => return Ok(None),
            }
        }
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

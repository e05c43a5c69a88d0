//! The records of an MCAP file, from its beginning until it ends or makes no sense any more.

use std::io::{self, Read};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// No record of a capture is longer, so that a damaged length cannot ask for more memory than this:
/// a chunk has some 1 MiB, and other programs that write MCAP stay far below.
const MAX_RECORD_BYTES: usize = 64 << 20;

/// Opcode and length ahead of each record.
const FRAME_BYTES: usize = 1 + 8;

/// Bytes read at once.
const READ_BYTES: usize = 1 << 18;

/// Takes bytes from `input` and gives records, chunks as they are.
pub(super) struct Records<R> {
    input: R,
    reader: LinearReader,
    /// Bytes of whole records, and of the magic before them.
    whole_bytes: u64,
    read_bytes: u64,
}

/// What comes next in a file.
pub(super) enum Next<'a> {
    /// A record, and what follows its frame.
    Record(u8, &'a [u8]),
    /// The last record of the data; what follows only repeats and indexes.
    Finished,
    /// As [`Finished`](Self::Finished), but what was read is not what was written.
    FinishedDamaged,
    /// The file ends without its last record, or goes on with what is no record.
    Cut,
}

impl<R: Read> Records<R> {
    /// Reads on from `begin`, which was taken from `input`.
    pub(super) fn new(begin: &[u8], input: R) -> Self {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_skip_end_magic(true)
            .with_validate_data_section_crc(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        let mut reader = LinearReader::new_with_options(options);
        reader.insert(begin.len())[..begin.len()].copy_from_slice(begin);
        reader.notify_read(begin.len());
        Self { input, reader, whole_bytes: 0, read_bytes: begin.len() as u64 }
    }

    /// Hands the next record to `take`: a borrowed one could not be returned from within a loop.
    pub(super) fn next<T>(&mut self, take: impl FnOnce(Next<'_>) -> T) -> io::Result<T> {
        loop {
            let next = match self.reader.next_event() {
                Some(Ok(LinearReadEvent::ReadRequest(bytes))) => {
                    self.fetch(bytes)?;
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { opcode: op::DATA_END, .. })) => Next::Finished,
                Some(Ok(LinearReadEvent::Record { opcode, data })) if is_known(opcode) => {
                    self.whole_bytes = self.whole_bytes.max(mcap::MAGIC.len() as u64);
                    self.whole_bytes += (FRAME_BYTES + data.len()) as u64;
                    Next::Record(opcode, data)
                }
                Some(Err(McapError::BadDataCrc { .. })) => Next::FinishedDamaged,
                None | Some(Ok(_) | Err(_)) => Next::Cut,
            };
            return Ok(take(next));
        }
    }

    fn fetch(&mut self, bytes: usize) -> io::Result<()> {
        let buffer = self.reader.insert(bytes.max(READ_BYTES));
        let length = loop {
            match self.input.read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => break read?,
            }
        };
        self.reader.notify_read(length);
        self.read_bytes += length as u64;
        Ok(())
    }

    /// Bytes up to the end of the last whole record.
    pub(super) fn whole_bytes(&self) -> u64 {
        self.whole_bytes
    }

    /// Reads to the end of the input and gives how many bytes came behind the last whole record.
    pub(super) fn drain(&mut self) -> io::Result<u64> {
        self.read_bytes += io::copy(&mut self.input, &mut io::sink())?;
        Ok(self.read_bytes - self.whole_bytes)
    }
}

/// Whether the specification knows such a record, or leaves it to others. Bytes that are no record
/// often pretend to be one of another kind: a disk that lost its power shows zeros.
fn is_known(opcode: u8) -> bool {
    (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80
}

/// The records in a chunk.
pub(super) struct ChunkRecords {
    reader: LinearReader,
    bytes: u64,
}

impl ChunkRecords {
    /// Takes a chunk as it stands behind its frame; `None` if it is damaged.
    pub(super) fn new(chunk: &[u8]) -> Option<Self> {
        let Ok(Record::Chunk { header, data }) = mcap::parse_record(op::CHUNK, chunk) else {
            return None;
        };
        // The reader trusts lengths within a chunk that is not compressed.
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

    /// Length of the chunk in the file.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Hands the next record to `take`, if there is one.
    ///
    /// # Errors
    /// If the chunk is damaged; unless it has no checksum, that is told ahead of all records.
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

/// Whether `records` is a row of whole records.
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

/// Name, media type and data of an attachment; `None` if it is shorter than it says.
pub(super) fn attachment(record: &[u8]) -> Option<(&str, &str, &[u8])> {
    // Two instants come first.
    let rest = record.get(16..)?;
    let (name, rest) = text(rest)?;
    let (media_type, rest) = text(rest)?;
    let (length, rest) = rest.split_first_chunk()?;
    let data = rest.get(..usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some((name, media_type, data))
}

fn text(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    let (text, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some((std::str::from_utf8(text).ok()?, rest))
}

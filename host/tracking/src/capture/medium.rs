//! The file under a capture: written with the number of its bytes that are on the disk, read by a moving window.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crc32fast::Hasher;

const BUFFER_BYTES: usize = 1 << 18;

/// A medium to which a capture can be written.
pub(super) trait Medium: Write {
    /// Waits until all written bytes would survive a power cut.
    fn sync(&mut self) -> io::Result<()>;

    /// Drops all bytes after the first `length`; nothing is written afterwards.
    fn truncate(&mut self, length: u64) -> io::Result<()>;
}

impl Medium for File {
    fn sync(&mut self) -> io::Result<()> {
        match self.sync_data() {
            // A pipe or a device has nothing to sync.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            synced => synced,
        }
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.sync()
    }
}

/// A medium behind a buffer. A flush reaches the disk.
#[derive(Debug)]
pub(super) struct Sink<M> {
    medium: M,
    buffer: Vec<u8>,
    position: Arc<AtomicU64>,
    safe: u64,
}

impl<M: Medium> Sink<M> {
    pub(super) fn new(medium: M) -> Self {
        Self { medium, buffer: Vec::with_capacity(BUFFER_BYTES), position: Arc::default(), safe: 0 }
    }

    /// The number of bytes written, which the MCAP writer does not report.
    pub(super) fn position(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.position)
    }

    /// After a failure: drops, if possible, the bytes after the last flush; returns the safe length and
    /// the medium.
    pub(super) fn cut_back(mut self) -> (u64, M) {
        // Otherwise a record without an end remains, which readers skip.
        let _ = self.medium.truncate(self.safe);
        (self.safe, self.medium)
    }

    fn drain(&mut self) -> io::Result<()> {
        self.medium.write_all(&self.buffer)?;
        self.buffer.clear();
        Ok(())
    }
}

impl<M: Medium> Write for Sink<M> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.buffer.len() + bytes.len() > BUFFER_BYTES {
            self.drain()?;
        }
        if bytes.len() > BUFFER_BYTES {
            self.medium.write_all(bytes)?;
        } else {
            self.buffer.extend_from_slice(bytes);
        }
        self.position.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.drain()?;
        self.medium.sync()?;
        self.safe = self.position.load(Ordering::Relaxed);
        Ok(())
    }
}

/// Only reports its position: the MCAP writer does not seek.
impl<M: Medium> Seek for Sink<M> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position.load(Ordering::Relaxed)),
            _ => Err(io::ErrorKind::Unsupported.into()),
        }
    }
}

const READ_BYTES: usize = 1 << 18;

/// The bytes of a file from an offset on, as many as requested.
pub(super) struct Window<R> {
    input: R,
    buffer: Vec<u8>,
    /// Offset of the window in `buffer`.
    start: usize,
    /// Offset of the window in the file.
    offset: u64,
    is_at_end: bool,
    hasher: Hasher,
}

impl<R: Read> Window<R> {
    /// Begins with `begin`, which was taken from `input` and stands at `offset` of the file.
    pub(super) fn new(begin: Vec<u8>, input: R, offset: u64) -> Self {
        Self { input, buffer: begin, start: 0, offset, is_at_end: false, hasher: Hasher::new() }
    }

    /// All bytes at hand: `wanted` at least, unless the file ends before.
    pub(super) fn fill(&mut self, wanted: usize) -> io::Result<&[u8]> {
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

    /// All bytes at hand.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// Some of the bytes at hand.
    pub(super) fn slice(&self, range: Range<usize>) -> &[u8] {
        &self.bytes()[range]
    }

    /// Moves on by `length` of the bytes at hand.
    pub(super) fn advance(&mut self, length: usize) {
        self.hasher.update(&self.buffer[self.start..self.start + length]);
        self.start += length;
        self.offset += length as u64;
    }

    /// Where in the file the window begins.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// CRC-32 of all bytes passed since the window was made, or since the last call.
    pub(super) fn take_checksum(&mut self) -> u32 {
        std::mem::take(&mut self.hasher).finalize()
    }
}

impl<R: Read + Seek> Window<R> {
    /// Another window, at `offset` of the file. `None` if the input, such as a pipe, cannot seek.
    /// [`Self::come_back`] must be called before this window is used again.
    pub(super) fn look_ahead(&mut self, offset: u64) -> Option<Window<&mut R>> {
        self.input.seek(SeekFrom::Start(offset)).ok()?;
        Some(Window::new(Vec::new(), &mut self.input, offset))
    }

    /// Restores the position before [`Self::look_ahead`].
    pub(super) fn come_back(&mut self) -> io::Result<()> {
        let read = self.offset + self.bytes().len() as u64;
        self.input.seek(SeekFrom::Start(read)).map(drop)
    }
}

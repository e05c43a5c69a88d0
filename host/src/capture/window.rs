//! A file as a stretch of bytes that moves from its beginning to its end.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use crc32fast::Hasher;

/// Bytes read at once.
const READ_BYTES: usize = 1 << 18;

/// The bytes from some place of a file on, as many as are asked for.
pub(super) struct Window<R> {
    input: R,
    buffer: Vec<u8>,
    /// Where in `buffer` the window begins.
    start: usize,
    /// Where in the file that is.
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

    /// CRC-32 of all bytes moved over since the window was made, or since this was asked for.
    pub(super) fn take_checksum(&mut self) -> u32 {
        std::mem::take(&mut self.hasher).finalize()
    }
}

impl<R: Read + Seek> Window<R> {
    /// Another window from `offset` bytes behind this one on. `None` if the input cannot go back, as a
    /// pipe. [`Self::come_back`] must be called before this one is used again.
    pub(super) fn look_ahead(&mut self, offset: usize) -> Option<Window<&mut R>> {
        let offset = self.offset + offset as u64;
        self.input.seek(SeekFrom::Start(offset)).ok()?;
        Some(Window::new(Vec::new(), &mut self.input, offset))
    }

    /// Goes on where it was before [`Self::look_ahead`].
    pub(super) fn come_back(&mut self) -> io::Result<()> {
        let read = self.offset + self.bytes().len() as u64;
        self.input.seek(SeekFrom::Start(read)).map(drop)
    }
}

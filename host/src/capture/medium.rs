//! The file under a capture, and the number of its bytes that are on the disk.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Size of the buffer.
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

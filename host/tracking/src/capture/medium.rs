//! The medium under a capture: a file, or what else takes its bytes.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const BUFFER_BYTES: usize = 1 << 18;

/// A medium to which a capture can be written.
pub trait Medium: Write {
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

impl Medium for Box<dyn Medium + Send> {
    fn sync(&mut self) -> io::Result<()> {
        (**self).sync()
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        (**self).truncate(length)
    }
}

/// A medium behind a buffer. A flush reaches the disk.
#[derive(Debug)]
pub(super) struct Sink<M: Write> {
    medium: BufWriter<M>,
    position: Arc<AtomicU64>,
    safe: u64,
}

impl<M: Medium> Sink<M> {
    pub(super) fn new(medium: M) -> Self {
        Self { medium: BufWriter::with_capacity(BUFFER_BYTES, medium), position: Arc::default(), safe: 0 }
    }

    /// The number of bytes written, which the MCAP writer does not report.
    pub(super) fn position(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.position)
    }

    /// After a failure: drops, if possible, the bytes after the last flush; returns the safe length and
    /// the medium.
    pub(super) fn cut_back(self) -> (u64, M) {
        // What is in the buffer still is not written.
        let (mut medium, _) = self.medium.into_parts();
        // Otherwise a record without an end remains, which readers skip.
        let _ = medium.truncate(self.safe);
        (self.safe, medium)
    }
}

impl<M: Medium> Write for Sink<M> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.medium.write(bytes)?;
        self.position.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.medium.flush()?;
        self.medium.get_mut().sync()?;
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

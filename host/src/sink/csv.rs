//! CSV: one row per scan, with the columns of `solve` and those of a stream.

use std::io;
use std::io::Write;

use super::{Accounts, Sink};
use slitpose_tracking::columns::CsvRows;
use slitpose_tracking::pipeline::Record;

pub(super) struct Csv<W: Write> {
    output: W,
    rows: CsvRows,
    line: Vec<u8>,
    has_begun: bool,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(output: W) -> Self {
        Self { output, rows: CsvRows::default(), line: Vec::new(), has_begun: false }
    }

    /// Puts the header into the line if it has not been written.
    fn begin(&mut self) {
        self.line.clear();
        if !std::mem::replace(&mut self.has_begun, true) {
            self.rows.header(&mut self.line);
        }
    }
}

impl<W: Write> Sink for Csv<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.begin();
        self.rows.row(record, &mut self.line);
        self.output.write_all(&self.line)
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.begin();
        self.output.write_all(&self.line)?;
        self.output.flush()
    }
}

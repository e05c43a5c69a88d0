//! CSV: one row per scan, with the columns of `solve` and those of a stream.

use std::io;
use std::io::Write;

use super::{Accounts, Sink, json};
use slitpose_tracking::columns::{Column, Fields, Row, of_tables};
use slitpose_tracking::pipeline::Record;

pub(super) struct Csv<W: Write> {
    output: W,
    columns: Vec<&'static Column>,
    line: Line,
    has_begun: bool,
}

/// The fields of a row, each behind a comma. None needs quotes.
struct Line(Vec<u8>);

impl Fields for Line {
    fn integer(&mut self, value: Option<u64>) {
        self.0.push(b',');
        value.iter().for_each(|value| json(&mut self.0, value));
    }

    fn number(&mut self, value: Option<f64>) {
        self.0.push(b',');
        value.iter().for_each(|value| json(&mut self.0, value));
    }

    fn word(&mut self, value: &str) {
        self.0.push(b',');
        self.0.extend_from_slice(value.as_bytes());
    }

    fn flag(&mut self, value: bool) {
        self.word(if value { "true" } else { "false" });
    }
}

impl<W: Write> Csv<W> {
    pub(super) fn new(output: W) -> Self {
        Self { output, columns: of_tables(true), line: Line(Vec::new()), has_begun: false }
    }

    fn begin(&mut self) -> io::Result<()> {
        if std::mem::replace(&mut self.has_begun, true) {
            return Ok(());
        }
        let names: Vec<String> = self.columns.iter().flat_map(|column| column.names()).collect();
        writeln!(self.output, "{}", names.join(","))
    }
}

impl<W: Write> Sink for Csv<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.begin()?;
        let Self { output, columns, line, .. } = self;
        line.0.clear();
        let row = Row::from(record);
        columns.iter().for_each(|column| column.put(&row, line));
        line.0.push(b'\n');
        output.write_all(&line.0[1..])
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.begin()?;
        self.output.flush()
    }
}

//! CSV: one row per scan, with the columns of `solve` and those of a stream.

use std::io;
use std::io::Write;

use super::{Accounts, Sink, json};
use slitpose_tracking::columns::{Column, Field, Row, of_tables};
use slitpose_tracking::pipeline::Record;

pub(super) struct Csv<W: Write> {
    output: W,
    columns: Vec<&'static Column>,
    line: Vec<u8>,
    has_begun: bool,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(output: W) -> Self {
        Self { output, columns: of_tables(true), line: Vec::new(), has_begun: false }
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
        line.clear();
        let row = Row::from(record);
        // Each behind a comma. None needs quotes.
        let mut put = |field: Field<'_>| {
            line.push(b',');
            match field {
                Field::Integer(value) => value.iter().for_each(|value| json(line, value)),
                Field::Number(value) => value.iter().for_each(|value| json(line, value)),
                Field::Word(word) => line.extend_from_slice(word.as_bytes()),
                Field::Flag(flag) => json(line, &flag),
            }
        };
        columns.iter().for_each(|column| column.put(&row, &mut put));
        line.push(b'\n');
        output.write_all(&line[1..])
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.begin()?;
        self.output.flush()
    }
}

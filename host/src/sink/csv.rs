//! CSV, one row per scan: the columns of `solve`, and those of a stream.

use std::io::{self, Write};

use super::{Accounts, Note, Sink};
use slitpose_head::table::SOLUTION_COLUMNS;
use slitpose_tracking::pipeline::Record;

/// Columns of a stream. The host's time of the pose is empty while unknown.
const STREAM_COLUMNS: [&str; 5] = ["simulated", "device", "host_monotonic_ns", "host_utc_ns", "host_uncertainty_ns"];

pub(super) struct Csv<W: Write> {
    writer: csv::Writer<W>,
    begun: bool,
    field: String,
}

impl<W: Write> Csv<W> {
    pub(super) fn new(output: W) -> Self {
        Self { writer: csv::Writer::from_writer(output), begun: false, field: String::new() }
    }

    fn begin(&mut self) -> io::Result<()> {
        if !self.begun {
            self.begun = true;
            let columns = ["seq", "device_time_s"].into_iter().chain(SOLUTION_COLUMNS).chain(STREAM_COLUMNS);
            self.writer.write_record(columns)?;
        }
        Ok(())
    }

    fn text(&mut self, value: impl std::fmt::Display) -> io::Result<()> {
        use std::fmt::Write;
        self.field.clear();
        // Writing to a String cannot fail.
        let _ = write!(self.field, "{value}");
        Ok(self.writer.write_field(&self.field)?)
    }

    fn number(&mut self, value: Option<f64>) -> io::Result<()> {
        use std::fmt::Write;
        self.field.clear();
        if let Some(value) = value {
            // Writing to a String cannot fail.
            let _ = write!(self.field, "{value:?}");
        }
        Ok(self.writer.write_field(&self.field)?)
    }

    fn write(&mut self, record: &Record) -> io::Result<()> {
        self.text(record.sequence)?;
        self.number(Some(record.device_time_s))?;
        let row = slitpose_head::table::SolutionRow::of(&record.solution);
        self.writer.write_field(row.status)?;
        for value in row.numbers {
            self.number(value)?;
        }
        self.text(row.iterations)?;
        self.text(row.cells_used)?;
        self.writer.write_field(row.free_directions)?;
        self.writer.write_field(row.excluded_cells)?;
        self.writer.write_field(row.verified)?;
        self.writer.write_field(row.reason)?;
        self.writer.write_field(if record.simulated { "true" } else { "false" })?;
        self.text(record.device)?;
        let time = record.host_time;
        for ns in
            [time.map(|time| time.monotonic_ns), time.map(|time| time.utc_ns), time.map(|time| time.uncertainty_ns)]
        {
            match ns {
                Some(ns) => self.text(ns)?,
                None => self.writer.write_field("")?,
            }
        }
        Ok(self.writer.write_record(None::<&[u8]>)?)
    }
}

impl<W: Write> Sink for Csv<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.begin()?;
        self.write(record)
    }

    fn note(&mut self, _: &Note) -> io::Result<()> {
        Ok(())
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.writer.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.begin()?;
        self.writer.flush()
    }
}

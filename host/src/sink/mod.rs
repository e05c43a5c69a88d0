//! Outputs for poses: NDJSON, CSV, or a summary for people.

mod csv;
mod ndjson;
mod note;
mod summary;
#[cfg(test)]
mod tests;

use std::io::{self, Write};

use clap::ValueEnum;

pub(crate) use note::Note;

use crate::pipeline::Record;
use crate::telemetry::{BoardReport, RecorderReport};

/// How poses are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Rates, losses, health, pose and accuracy, renewed in place on a terminal
    Summary,
    /// One JSON object a scan
    Ndjson,
    /// One row a scan
    Csv,
    /// Nothing: for a daemon that is read by datagrams, or only records
    None,
}

/// The state of boards and recording.
#[derive(Clone, Debug, Default)]
pub(crate) struct Account {
    /// Each board.
    pub boards: Vec<BoardReport>,
    /// The capture that is written.
    pub recorder: RecorderReport,
}

/// Returns the present account.
pub(crate) type Accounts<'a> = dyn Fn() -> Account + 'a;

/// An output for poses.
pub(crate) trait Sink {
    /// Writes the solution of the next scan.
    ///
    /// # Errors
    /// Errors of the output.
    fn pose(&mut self, record: &Record) -> io::Result<()>;

    /// Whether each pose must be written, however late.
    fn needs_each(&self) -> bool {
        true
    }

    /// Writes a note.
    ///
    /// # Errors
    /// Errors of the output.
    fn note(&mut self, note: &Note) -> io::Result<()>;

    /// Flushes or redraws; called regularly, even without poses.
    ///
    /// # Errors
    /// Errors of the output.
    fn tick(&mut self, accounts: &Accounts<'_>) -> io::Result<()>;

    /// Ends the output.
    ///
    /// # Errors
    /// Errors of the output.
    fn finish(&mut self, accounts: &Accounts<'_>) -> io::Result<()>;
}

/// The sink of a format, `None` for [`Format::None`]. `live`: `output` is a terminal that can be redrawn in place.
pub(crate) fn open<'a>(
    format: Format,
    output: impl Write + Send + 'a,
    live: bool,
) -> Option<Box<dyn Sink + Send + 'a>> {
    match format {
        Format::Summary => Some(Box::new(summary::Summary::new(output, live))),
        Format::Ndjson => Some(Box::new(ndjson::Ndjson::new(output))),
        Format::Csv => Some(Box::new(csv::Csv::new(output))),
        Format::None => None,
    }
}

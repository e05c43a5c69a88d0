//! Outputs for poses: NDJSON, CSV, Parquet, or a summary for people.

mod csv;
mod ndjson;
mod note;
#[cfg(feature = "parquet")]
mod parquet;
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
    /// One row a scan, in columns with types
    #[cfg(feature = "parquet")]
    Parquet,
    /// Nothing: for a daemon that is read by datagrams, or only records
    None,
}

impl Format {
    /// How names of files in this format end; `None`: it is for no file.
    pub(crate) fn ending(self) -> Option<&'static str> {
        match self {
            Self::Ndjson => Some(".ndjson"),
            Self::Csv => Some(".csv"),
            #[cfg(feature = "parquet")]
            Self::Parquet => Some(".parquet"),
            Self::Summary | Self::None => None,
        }
    }

    /// Whether people can read it.
    pub(crate) fn is_text(self) -> bool {
        #[cfg(feature = "parquet")]
        if self == Self::Parquet {
            return false;
        }
        true
    }
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
        #[cfg(feature = "parquet")]
        Format::Parquet => Some(Box::new(parquet::Parquet::new(output))),
        Format::None => None,
    }
}

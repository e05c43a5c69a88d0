//! Where poses go: NDJSON, CSV, or a summary for people.

mod csv;
mod ndjson;
mod summary;

use std::io::{self, Write};

use clap::ValueEnum;

pub use summary::Accuracy;

use crate::pipeline::{Counts, Item};

/// How poses are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Rates, losses, pose and accuracy, renewed in place on a terminal
    Summary,
    /// One JSON object a scan
    Ndjson,
    /// One row a scan
    Csv,
}

/// Something poses are written to.
pub trait Sink {
    /// Takes the next item.
    ///
    /// # Errors
    /// Those of the output.
    fn take(&mut self, item: &Item<'_>) -> io::Result<()>;

    /// Called now and then while nothing may come.
    ///
    /// # Errors
    /// Those of the output.
    fn tick(&mut self, counts: &Counts) -> io::Result<()>;

    /// Ends the output.
    ///
    /// # Errors
    /// Those of the output.
    fn finish(&mut self, counts: &Counts) -> io::Result<()>;
}

/// The sink of a format; `live` tells whether `output` is a terminal.
pub fn open<'a>(format: Format, output: impl Write + 'a, live: bool) -> Box<dyn Sink + 'a> {
    match format {
        Format::Summary => Box::new(summary::Summary::new(output, live)),
        Format::Ndjson => Box::new(ndjson::Ndjson::new(output)),
        Format::Csv => Box::new(csv::Csv::new(output)),
    }
}

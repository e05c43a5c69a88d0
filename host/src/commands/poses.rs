//! How a stream of poses is solved, where it ends, and how it is written.

use std::io::Write;

use slitpose_model::Tier;

use super::CommandError;
use super::talk::talk;
use crate::pipeline::Following;
use crate::sink::{self, Format, Sink};
pub(super) use crate::solving::parse_duration;
use crate::solving::{Filter, Solving};
use crate::terminal;

/// When a stream of poses ends, how it is written and how it is solved.
#[derive(clap::Args, Debug)]
pub(super) struct PoseOptions {
    /// End after this much time of the board's clock, such as 10s; else at the end of the data, or at an interrupt
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) duration: Option<f64>,
    /// How poses are written
    #[arg(long, value_enum)]
    format: Option<Format>,
    #[command(flatten)]
    pub(super) solving: Solving,
}

impl PoseOptions {
    /// The format to write in; `live` tells whether somebody looks.
    pub(super) fn format(&self, live: bool) -> Format {
        self.format_or(if live { Format::Summary } else { Format::Ndjson })
    }

    /// The format that was asked for.
    pub(super) fn asked_format(&self) -> Option<Format> {
        self.format
    }

    /// The format to write in, `usual` unless one was asked for.
    pub(super) fn format_or(&self, usual: Format) -> Format {
        self.format.unwrap_or(usual)
    }

    /// The sink of `format`. Says so if that leaves out what was asked for.
    ///
    /// # Errors
    /// A format that is no text, on a terminal.
    pub(super) fn open_sink<'a>(
        &self,
        format: Format,
        output: impl Write + Send + 'a,
        is_terminal: bool,
    ) -> Result<Option<Box<dyn Sink + Send + 'a>>, CommandError> {
        if is_terminal && !format.is_text() {
            return Err(CommandError::NoText);
        }
        if format == Format::Csv && matches!(self.solving.filter, Some(Filter(Some(_)))) {
            talk(format_args!("--filter: CSV has no columns for the filtered pose; --format ndjson has it"));
        }
        Ok(sink::open(format, output, is_terminal && terminal::is_live()))
    }

    /// How scans are followed.
    pub(super) fn following(&self) -> Following {
        self.solving.following_or(None)
    }

    /// The tier to solve in.
    pub(super) fn tier(&self) -> Tier {
        self.solving.tier_or(None)
    }
}

//! `slitpose status`: the state of a daemon, its boards and their cells.

use std::io::Write;

use anyhow::bail;
use clap::ValueEnum;

use super::{CommandError, Outcome};
use crate::address::Address;
use crate::telemetry::{DEFAULT_STATUS_ADDRESS, fetch, status_address};
use crate::terminal;
use crate::terminal::Tone;
use slitpose_head::foreign::{printable, printable_lines};
use slitpose_head::table::{Output, OutputError};

/// Shows the state of a running daemon, its boards and their cells.
///
/// Asks the daemon that was started with `slitpose run --status ADDRESS`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose status\n  slitpose status --address unix:/run/slitpose/status --format json"
)]
pub(super) struct Args {
    /// Where the daemon serves its status: HOST:PORT or unix:PATH
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_STATUS_ADDRESS, value_parser = status_address)]
    address: Address,
    /// For people, for programs, or for Prometheus
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
    Prometheus,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let path = match args.format {
        Format::Text => "/",
        Format::Json => "/status",
        Format::Prometheus => "/metrics",
    };
    let (status, text) = fetch(&args.address, path)?;
    if status != 200 {
        bail!("{} answers {status} to {path}: {}", args.address, printable(text.trim_end()));
    }
    let output = Output::open(None)?;
    match args.format {
        // Whatever listens there may have written it.
        Format::Text => write_lines(output, &printable_lines(&text))?,
        Format::Json | Format::Prometheus => output.write_text(&text)?,
    }
    Ok(Outcome::Done)
}

/// Lines of findings are coloured on a terminal.
fn write_lines(mut output: Output, text: &str) -> Result<(), OutputError> {
    let has_colours = terminal::has_colours(output.is_terminal());
    for line in text.lines() {
        let is_wrong = ["wrong ", "  ! "].iter().any(|name| line.starts_with(name));
        let tone = if is_wrong { Tone::Wrong } else { Tone::Plain };
        if let Err(source) = writeln!(output, "{}", tone.paint(line, has_colours)) {
            return Err(output.error(source));
        }
    }
    output.finish()
}

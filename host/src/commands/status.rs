//! `slitpose status`: how a daemon does.

use clap::ValueEnum;

use super::{CommandError, Outcome};
use crate::foreign::printable_lines;
use crate::table::Output;
use crate::telemetry::{DEFAULT_STATUS_ADDRESS, StatusAddress, fetch};

/// Tells how a running daemon, its boards and their cells do.
///
/// Asks the daemon that was started with `slitpose run --status ADDRESS`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose status\n  slitpose status --address unix:/run/slitpose/status --format json"
)]
pub(super) struct Args {
    /// Where the daemon serves its status: HOST:PORT or unix:PATH
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_STATUS_ADDRESS)]
    address: StatusAddress,
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
    let text = fetch(&args.address, path)?;
    let output = Output::open(None)?;
    match args.format {
        // Whatever listens there may have written it.
        Format::Text => output.write_text(&printable_lines(&text))?,
        Format::Json | Format::Prometheus => output.write_text(&text)?,
    }
    Ok(Outcome::Done)
}

//! `slitpose scene check`: what a scene can do, and warnings of what it cannot.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{CommandError, Outcome};
use crate::commands::options;
use crate::commands::options::{CalibrationOption, Jobs, open_scene};
use crate::terminal::{Amount, Progress};
use slitpose_design::survey::Survey;
use slitpose_head::table::Output;

/// Shows what a scene can do, and warns of what it cannot.
///
/// Each cell at home, over the workspace and along every axis; cross-talk of emitters that are lit
/// together; timing. Ends with 0 also if there are warnings, with 1 if the scene cannot be used.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene check wide\n  slitpose scene check mine.toml --format json")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// For people, or for programs (SI units)
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// How many poses to spread over the workspace
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = args.calibration.head_as_drawn(open_scene(&args.scene)?)?.file;
    let output = Output::open(args.output.as_deref())?;
    let samples = args.samples as usize;
    args.jobs.apply();
    let mut progress = Progress::new("check", Survey::poses_of(samples) as u64, Amount::Of("poses"));
    let mut done = 0;
    let survey = Survey::of(&file, samples, |poses| {
        done += poses as u64;
        progress.at(done);
    })?;
    drop(progress);
    let text = match args.format {
        Format::Text => survey.report(),
        Format::Json => serde_json::to_string_pretty(&survey).map_err(|error| output.error(error.into()))? + "\n",
    };
    output.write_text(&text)?;
    Ok(Outcome::Done)
}

//! The command line: a file for each verb, and for what several share.
//!
//! A verb has its arguments (`Args`) and a function (`run`), which returns how it ended. To add one, add both, its line
//! in `Verb` and its line in `run`.

mod bench;
mod calibrate;
mod compare;
mod completions;
mod config;
mod device;
mod doctor;
mod faults;
mod identify;
mod live;
mod model;
mod options;
mod playback;
mod player;
mod record;
mod replay;
mod report;
mod run;
mod scene;
mod schema;
mod simulate;
mod solve;
mod status;
mod zero;

use std::ffi::OsString;
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use thiserror::Error;

pub use config::configured_options;

use crate::device::DeviceError;
use crate::platform;
use crate::terminal::{complain, hide_progress};
use options::{interrupt, talk};
use slitpose_head::causes::with_causes;
use slitpose_head::faults::FaultError;
use slitpose_head::table::OutputError;
use slitpose_tracking::playback::PlaybackError;

/// Six slits, six light spots, one pose: tools for a contactless 6-DoF tracker.
///
/// Results go to standard output, messages to standard error. Exit codes: 0 done, 1 failed,
/// 2 wrong usage, 3 finished, but input data was damaged or lost.
#[derive(Debug, Parser)]
#[command(after_help = "Examples:\n  slitpose run --device sim\n  slitpose doctor\n  slitpose help run")]
#[command(name = "slitpose", version, propagate_version = true, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Run(Box<run::Args>),
    Replay(replay::ReplayArgs),
    Export(replay::ExportArgs),
    Device(device::Args),
    Status(status::Args),
    Zero(zero::Args),
    Doctor(doctor::Args),
    Simulate(simulate::Args),
    Faults(faults::Args),
    Model(model::Args),
    Solve(solve::Args),
    Identify(identify::Args),
    Calibrate(calibrate::Args),
    Bench(bench::Args),
    Paper(report::PaperArgs),
    Report(report::ReportArgs),
    Scene(scene::Args),
    Compare(compare::Args),
    Schema(schema::Args),
    Completions(completions::CompletionsArgs),
    Man(completions::ManArgs),
}

/// How a command that did its work ended; the worst last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Outcome {
    Done,
    /// Done with what there was; input data were damaged or lost.
    DataLost,
    Failed,
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::SUCCESS,
            Outcome::DataLost => Self::from(3),
            Outcome::Failed => Self::FAILURE,
        }
    }
}

/// Why a command could not do its work: the error of whatever it called, or one of those below.
pub(crate) type CommandError = anyhow::Error;

/// Wrong usage: options that do not go together, or not with what they are about.
#[derive(Debug, Error)]
#[error("{0}")]
pub(crate) struct UsageError(String);

/// [`UsageError`] with a text to be formatted.
macro_rules! usage {
    ($($text:tt)*) => {
        crate::commands::UsageError(format!($($text)*))
    };
}
pub(crate) use usage;

/// Whether the reader of the result has gone: an ordinary end, not a failure.
fn is_broken_pipe(error: &CommandError) -> bool {
    error.downcast_ref().is_some_and(OutputError::is_broken_pipe)
}

fn exit_code(error: &CommandError) -> ExitCode {
    let is_usage = error.is::<UsageError>()
        || error.is::<FaultError>()
        || matches!(error.downcast_ref(), Some(OutputError::Twice { .. }))
        || matches!(error.downcast_ref(), Some(PlaybackError::Fault(_) | PlaybackError::Range { .. }))
        || matches!(error.downcast_ref(), Some(DeviceError::NotAPath { .. } | DeviceError::Pattern { .. }));
    if is_usage { ExitCode::from(2) } else { ExitCode::FAILURE }
}

/// The command line as it can be typed here: options of `run` may stand in the environment, too, and help
/// shows the defaults.
pub fn command() -> clap::Command {
    completions::in_help(Cli::command()).mut_subcommand("run", config::with_environment)
}

/// Does what `arguments`, the name of the program first, ask for, and says why if it cannot; ends the program if they
/// are wrong, or only ask for help.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    match run(&arguments) {
        Ok(outcome) => outcome.into(),
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            complain(format_args!("{}", with_causes(error.as_ref())));
            exit_code(&error)
        }
    }
}

fn run(arguments: &[OsString]) -> Result<Outcome, CommandError> {
    let matches = command().get_matches_from(arguments);
    let configured = config::configured(command(), &matches)?;
    let matches = configured.command.clone().get_matches_from(arguments);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    platform::prepare().context("cannot listen to signals")?;
    slitpose_head::interrupt::say_by(|error| {
        hide_progress();
        complain(format_args!("{error}"));
    });
    match cli.verb {
        Verb::Run(args) if args.print_config => options::print(&config::print(&configured, &matches)),
        Verb::Run(mut args) => run::run(&mut args),
        Verb::Replay(args) => replay::replay(&args),
        Verb::Export(args) => replay::export(&args),
        Verb::Device(args) => device::run(&args),
        Verb::Status(args) => status::run(&args),
        Verb::Zero(args) => zero::run(&args),
        Verb::Doctor(args) => doctor::run(&args),
        Verb::Simulate(args) => simulate::run(&args),
        Verb::Faults(args) => faults::run(&args),
        Verb::Model(args) => model::run(&args),
        Verb::Solve(args) => solve::run(&args),
        Verb::Identify(args) => identify::run(&args),
        Verb::Calibrate(args) => calibrate::run(&args),
        Verb::Bench(args) => bench::run(&args),
        Verb::Paper(args) => report::paper(&args),
        Verb::Report(args) => report::report(&args),
        Verb::Compare(args) => compare::run(&args),
        Verb::Schema(args) => schema::run(&args),
        Verb::Scene(args) => scene::run(&args),
        Verb::Completions(args) => completions::completions(&args),
        Verb::Man(args) => completions::man(&args),
    }
}

//! The command line: one verb, one file.
//!
//! A verb has its arguments (`Args`) and a function `run`, which returns how it ended. To add
//! one, add its file, its line in `Verb` and its line in [`run`].

mod identify;
mod model;
mod options;
mod paper;
mod replay;
mod report;
mod run;
mod scene;
mod simulate;
mod solve;
mod stream;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use slitpose_model::SceneError;
use thiserror::Error;

pub use identify::CellProfileError;
pub use stream::StreamError;

use crate::front_end::TimingError;
use crate::plot::PlotError;
use crate::report::ReportError;
use crate::scene_file::SceneFileError;
use crate::simulator::{PathError, SimulatorError};
use crate::table::{OutputError, TableError};

/// Six slits, six light spots, one pose: tools for a contactless 6-DoF tracker.
///
/// Data goes to standard output, talk to standard error. Exit codes: 0 done, 1 failed,
/// 2 wrong usage, 3 finished, but input data was damaged or lost.
#[derive(Debug, Parser)]
#[command(name = "slitpose", version, propagate_version = true, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Run(run::Args),
    Replay(replay::Args),
    Simulate(simulate::Args),
    Model(model::Args),
    Solve(solve::Args),
    Identify(identify::Args),
    Paper(paper::Args),
    Report(report::Args),
    Scene(scene::Args),
}

/// How a command that did its work ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Done.
    Done,
    /// Done with what there was; input data were damaged or lost.
    DataLost,
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::SUCCESS,
            Outcome::DataLost => Self::from(3),
        }
    }
}

/// Why a command could not do its work.
#[derive(Debug, Error)]
pub enum CommandError {
    /// The scene.
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    /// The optics of a scene that was put together by a command.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A picture.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A cell that the scene does not have.
    #[error("there is no cell {number}; the scene has the cells 0 to {last}")]
    NoSuchCell {
        /// The number asked for.
        number: usize,
        /// The last cell's number.
        last: usize,
    },
    /// A table that was read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Currents from which no profile follows.
    #[error(transparent)]
    Profile(#[from] CellProfileError),
    /// The schedule of a scene.
    #[error(transparent)]
    Timing(#[from] TimingError),
    /// A simulated board.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// A motion of the tool.
    #[error(transparent)]
    Path(#[from] PathError),
    /// An option that means nothing to a real board.
    #[error("{option} is for simulated boards and means nothing to {device}; leave it out, or give --device sim")]
    OnlySimulated {
        /// The option.
        option: &'static str,
        /// The device asked for.
        device: String,
    },
    /// A stream of scans.
    #[error(transparent)]
    Stream(StreamError),
    /// A study of errors and times.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The result.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError {
    /// Whether the reader of the result has gone: an ordinary end, not a failure.
    pub fn is_broken_pipe(&self) -> bool {
        match self {
            Self::Output(error) => error.is_broken_pipe(),
            Self::Stream(error) => error.is_broken_pipe(),
            _ => false,
        }
    }

    /// What the program ends with.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::OnlySimulated { .. } => ExitCode::from(2),
            _ => ExitCode::FAILURE,
        }
    }
}

/// Does what the command line asks for.
pub fn run(cli: Cli) -> Result<Outcome, CommandError> {
    match cli.verb {
        Verb::Identify(args) => identify::run(&args),
        Verb::Run(args) => run::run(&args),
        Verb::Replay(args) => replay::run(&args),
        Verb::Simulate(args) => simulate::run(&args),
        Verb::Model(args) => model::run(&args),
        Verb::Solve(args) => solve::run(&args),
        Verb::Paper(args) => paper::run(&args),
        Verb::Report(args) => report::run(&args),
        Verb::Scene(args) => scene::run(&args),
    }
}

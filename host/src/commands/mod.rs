//! The command line: one verb, one file.
//!
//! A verb has its arguments (`Args`) and a function `run`, which returns how it ended. To add
//! one, add its file, its line in `Verb` and its line in `run`.

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
mod simulate;
mod solve;
mod status;
mod talk;

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use slitpose_model::SceneError;
use thiserror::Error;

pub(crate) use config::{ConfigError, configured_options};
pub(crate) use identify::CellProfileError;
pub(crate) use playback::SeveralBoards;

use crate::capture::CaptureError;
use crate::comparison::NothingMatches;
use crate::daemon::BoardError;
use crate::datagram::DatagramError;
use crate::device::DeviceError;
use crate::live::{AccessError, FoxgloveError, LiveError};
use crate::measurements::MeasurementsError;
use crate::playback::PlaybackError;
use crate::spacenav::SpacenavError;
use crate::telemetry::{FetchError, StatusError};
use crate::terminal::{complain, hide_progress};
use crate::zenoh::ZenohError;
use slitpose_bench::BenchError;
use slitpose_calibration::{CalibrateError, CalibrationFileError};
use slitpose_design::optimise::OptimiseError;
use slitpose_design::plot::PlotError;
use slitpose_design::report::ReportError;
use slitpose_head::causes::with_causes;
use slitpose_head::faults::FaultError;
use slitpose_head::foreign::printable;
use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::SceneFileError;
use slitpose_head::simulator::{PathError, SimulatorError};
use slitpose_head::table::{Output, OutputError, TableError};
use talk::{interrupt, talk};

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

/// Endings of names that say how poses are written.
const ENDINGS: &str = if cfg!(feature = "parquet") { ".csv, .ndjson or .parquet" } else { ".csv or .ndjson" };

/// Why a command could not do its work.
#[derive(Debug, Error)]
pub(crate) enum CommandError {
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    #[error(
        "scene `{scene}` gives no pose anywhere in its workspace, so there is none for tolerances to move; \
         --tolerance-study is for heads that have poses, such as the shipped scene `wide`"
    )]
    NoPosesToStudy { scene: String },
    #[error(transparent)]
    Optimise(#[from] OptimiseError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error(transparent)]
    Plot(#[from] PlotError),
    #[error("there is no cell {number}; the scene has the cells 0 to {last}")]
    NoSuchCell {
        number: usize,
        /// The last cell's number.
        last: usize,
    },
    #[error(transparent)]
    Table(#[from] TableError),
    #[error(transparent)]
    Profile(#[from] CellProfileError),
    #[error(transparent)]
    Measurements(#[from] MeasurementsError),
    #[error(transparent)]
    Bench(#[from] BenchError),
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    #[error(transparent)]
    Path(#[from] PathError),
    #[error(
        "no motion is called {}{}; the motions are {known}, or give a table of one",
        printable(name),
        nearest.as_ref().map_or_else(String::new, |name| format!(" (did you mean `{name}`?)"))
    )]
    NoMotion {
        name: String,
        /// The motion that is spelt almost like it.
        nearest: Option<String>,
        known: String,
        /// Why it is no table.
        source: Box<TableError>,
    },
    #[error(transparent)]
    NothingMatches(#[from] NothingMatches),
    #[error(transparent)]
    Fault(#[from] FaultError),
    #[error("{option} is for simulated boards and means nothing to {device}; leave it out, or give --device sim")]
    OnlySimulated { option: &'static str, device: String },
    #[error(
        "{option} says how this program solves poses, and with --stream pose the board does; leave one of both out"
    )]
    OnlyHere { option: &'static str },
    #[error("{scenes} scenes for {devices} boards; give one for all, or one for each, in the same order")]
    Scenes { scenes: usize, devices: usize },
    #[error(
        "{calibrations} calibrations for {devices} boards; give one for each, in the same order, or `none` for one"
    )]
    Calibrations { calibrations: usize, devices: usize },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Board(#[from] BoardError),
    #[error(transparent)]
    Device(#[from] DeviceError),
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(
        "the name {} does not say how poses are to be written; give one that ends in {ENDINGS}, or --format",
        path.display()
    )]
    Extension { path: PathBuf },
    /// Poses of several captures, and no folder for them, or a folder and no poses.
    #[error(
        "with --jobs each capture has its own file of poses; give --output DIR with --format ndjson or csv, or neither"
    )]
    FormatOfEach,
    #[cfg(not(feature = "parquet"))]
    #[error(
        "this build cannot write {} as Parquet; build with `cargo build --release -p slitpose --features parquet`, or \
         give a name that ends in .csv or .ndjson",
        path.display()
    )]
    NoParquet { path: PathBuf },
    #[error("Parquet is no text for a terminal; redirect standard output, or choose another --format")]
    NoText,
    #[error(transparent)]
    Playback(#[from] PlaybackError),
    #[error(transparent)]
    SeveralBoards(#[from] SeveralBoards),
    #[error(transparent)]
    Datagram(#[from] DatagramError),
    #[error(transparent)]
    Status(#[from] StatusError),
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error(transparent)]
    Spacenav(#[from] SpacenavError),
    #[error(transparent)]
    Live(#[from] LiveError),
    #[error(transparent)]
    Zenoh(#[from] ZenohError),
    #[error(transparent)]
    Foxglove(#[from] FoxgloveError),
    #[error("the service manager that NOTIFY_SOCKET names cannot be reached; start the program without it")]
    Service(#[source] io::Error),
    #[error("cannot read from standard input; give --yes to go on without questions")]
    Input(#[source] io::Error),
    #[error("cannot listen to signals")]
    Interrupt(#[source] io::Error),
    #[error(transparent)]
    Fetch(#[from] FetchError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError {
    /// Whether the reader of the result has gone: an ordinary end, not a failure.
    fn is_broken_pipe(&self) -> bool {
        match self {
            Self::Output(error) => error.is_broken_pipe(),
            _ => false,
        }
    }

    fn printing(source: io::Error) -> Self {
        Self::Output(OutputError::Write { target: "standard output".to_owned(), source })
    }

    fn exit_code(&self) -> ExitCode {
        match self {
            #[cfg(not(feature = "parquet"))]
            Self::NoParquet { .. } => ExitCode::from(2),
            Self::Fault(_)
            | Self::Playback(PlaybackError::Fault(_))
            | Self::OnlySimulated { .. }
            | Self::OnlyHere { .. }
            | Self::Scenes { .. }
            | Self::Calibrations { .. }
            | Self::Config(_)
            | Self::Extension { .. }
            | Self::NoText
            | Self::FormatOfEach
            | Self::Output(OutputError::Twice { .. })
            | Self::Playback(PlaybackError::Range { .. })
            | Self::Device(DeviceError::NotAPath { .. } | DeviceError::Pattern { .. }) => ExitCode::from(2),
            _ => ExitCode::FAILURE,
        }
    }
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
        Err(error) if error.is_broken_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            let code = error.exit_code();
            complain(format_args!("{}", with_causes(&error)));
            code
        }
    }
}

fn run(arguments: &[OsString]) -> Result<Outcome, CommandError> {
    let matches = command().get_matches_from(arguments);
    let configured = config::configured(command(), &matches)?;
    let matches = configured.command.clone().get_matches_from(arguments);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    talk::outlive_file_limits()?;
    slitpose_head::interrupt::say_by(|error| {
        hide_progress();
        complain(format_args!("{error}"));
    });
    match cli.verb {
        Verb::Run(args) if args.print_config => {
            Ok(Output::open(None)?.write_text(&config::print(&configured, &matches)).map(|()| Outcome::Done)?)
        }
        Verb::Run(args) => run::run(&args),
        Verb::Replay(args) => replay::replay(&args),
        Verb::Export(args) => replay::export(&args),
        Verb::Device(args) => device::run(&args),
        Verb::Status(args) => status::run(&args),
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
        Verb::Scene(args) => scene::run(&args),
        Verb::Completions(args) => completions::completions(&args),
        Verb::Man(args) => completions::man(&args),
    }
}

//! `slitpose scene`: everything about scenes that needs no device.

mod export;
mod map;
mod optimise;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::anyhow;
use clap::Subcommand;
use clap::builder::PossibleValuesParser;
use slitpose_design::plot::{cell_picture, scene_picture};
use slitpose_design::survey::Survey;
use slitpose_model::{CompiledScene, Pose, Tier};

use super::live::AccessOptions;
use super::options::{CalibrationOption, Jobs, TextOrJson, open_scene, parse_pose};
use super::{CommandError, Outcome, interrupt, options};
use crate::live::{DEFAULT_LIVE_ADDRESS, LiveBoard, LivePlan, live_address};
use crate::terminal::{Amount, Progress};
use slitpose_head::scene_file::{SHIPPED, Shipped};
use slitpose_head::table::Output;
use slitpose_tracking::page::{Order, Refusal, SceneView};

/// Checks, maps, draws, lists and shows scenes.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Check(CheckArgs),
    Export(export::Args),
    /// Lists the scenes that come with the program
    #[command(after_help = "Example:\n  slitpose scene list")]
    List,
    Map(map::Args),
    Optimise(optimise::Args),
    Plot(PlotArgs),
    Show(ShowArgs),
    View(ViewArgs),
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    match &args.verb {
        Verb::Check(args) => check(args),
        Verb::Export(args) => export::run(args),
        Verb::List => list(),
        Verb::Map(args) => map::run(args),
        Verb::Optimise(args) => optimise::run(args),
        Verb::Plot(args) => plot(args),
        Verb::Show(args) => show(args),
        Verb::View(args) => view(args),
    }
}

fn list() -> Result<Outcome, CommandError> {
    let lines: String = SHIPPED.iter().map(|shipped| format!("{:<9} {}\n", shipped.name, shipped.about)).collect();
    options::print(&lines)
}

/// Prints the scene file of a shipped scene: the place to start one's own from.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose scene show wide > mine.toml")]
struct ShowArgs {
    /// Its name
    #[arg(value_parser = PossibleValuesParser::new(SHIPPED.map(|shipped| shipped.name)))]
    name: String,
}

fn show(args: &ShowArgs) -> Result<Outcome, CommandError> {
    // The argument parser lets no other names through.
    let text = Shipped::named(&args.name).map_or("", |shipped| shipped.text);
    options::print(text)
}

/// Shows what a scene can do, and warns of what it cannot.
///
/// Each cell at home, over the workspace and along every axis; cross-talk of emitters that are lit
/// together; timing. Ends with 0 also if there are warnings, with 1 if the scene cannot be used.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene check wide\n  slitpose scene check mine.toml --format json")]
struct CheckArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// For people, or for programs (SI units)
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
    /// How many poses to spread over the workspace
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

fn check(args: &CheckArgs) -> Result<Outcome, CommandError> {
    let file = args.calibration.head_as_drawn(open_scene(&args.scene)?)?.file;
    let output = Output::open(args.output.as_deref())?;
    let samples = args.samples as usize;
    args.jobs.apply();
    let mut progress = Progress::new("check", Survey::poses_of(samples) as u64, Amount::Of("poses"));
    let survey = Survey::of(&file, samples, |poses| progress.add(poses as u64))?;
    drop(progress);
    let text = match args.format {
        TextOrJson::Text => survey.report(),
        TextOrJson::Json => serde_json::to_string_pretty(&survey).map_err(|error| output.error(error.into()))? + "\n",
    };
    output.write_text(&text)?;
    Ok(Outcome::Done)
}

const TOLERANCE: f64 = 1e-6;

/// Draws a scene as SVG: three views with slits, emitters and beams, and the light on each detector.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene plot wide --pose 2,0,-3,0,5,10 --output wide.svg\n  \
                        slitpose scene plot bench --cell 0 --pose 3,0,0,0,0,0 --output cell.svg")]
struct PlotArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Pose of the tool: translation in mm, rotation vector in degrees
    #[arg(long, value_name = "TX,TY,TZ,RX,RY,RZ", allow_hyphen_values = true, value_parser = parse_pose)]
    pose: Option<Pose>,
    /// Draw this cell only, from the side, with its dimensions
    #[arg(long, value_name = "K")]
    cell: Option<usize>,
    /// The picture
    #[arg(long, value_name = "FILE.svg")]
    output: PathBuf,
}

fn plot(args: &PlotArgs) -> Result<Outcome, CommandError> {
    let file = args.calibration.head_as_drawn(open_scene(&args.scene)?)?.file;
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance: TOLERANCE })?;
    let pose = args.pose.unwrap_or(Pose::HOME);
    let picture = match args.cell {
        None => scene_picture(&file.name, &file.scene, &plan, &pose),
        Some(number) => {
            let last = file.scene.cells.len() - 1;
            let missing = || anyhow!("there is no cell {number}; the scene has the cells 0 to {last}");
            let cell = file.scene.cells.get(number).ok_or_else(missing)?;
            cell_picture(&file.name, number, cell, &plan, &pose)
        }
    };
    Output::open(Some(&args.output))?.write_text(&picture)?;
    Ok(Outcome::Done)
}

/// Shows a scene on a page: drag the tool, and see the light on each detector and the accuracy of a frame there.
///
/// Accuracy is the Cramér–Rao bound of one frame; a scene without front end and noise has none. Runs until it is
/// interrupted.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene view wide --open\n  \
                        slitpose scene view head.toml --calibration calibration.toml --live 127.0.0.1:8000")]
struct ViewArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Where the page is served
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_LIVE_ADDRESS, value_parser = live_address)]
    live: SocketAddr,
    #[command(flatten)]
    access: AccessOptions,
}

/// Longest time until an interrupt is answered.
const MOMENT: Duration = Duration::from_millis(50);

fn view(args: &ViewArgs) -> Result<Outcome, CommandError> {
    let head = args.calibration.head_as_drawn(open_scene(&args.scene)?)?;
    let stop = interrupt()?;
    let _server = args.access.start(LivePlan {
        access: args.access.at(args.live)?,
        source: "scene",
        scene: Some(SceneView::of(&head)?),
        boards: vec![LiveBoard { name: head.file.name.clone(), head }],
        // Nothing of a scene can be changed.
        control: Box::new(|order| {
            Err(match order {
                Order::Record(_) | Order::Note(..) => Refusal::NO_RECORDER,
                Order::Frame(..) => Refusal::NO_FRAME,
                Order::Player(_) => Refusal::NO_PLAYER,
            })
        }),
        report: None,
        recordings: None,
    })?;
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(MOMENT);
    }
    Ok(Outcome::Done)
}

//! `slitpose scene map`: how accurate a head is, and where.

use std::path::PathBuf;

use anyhow::bail;
use slitpose_design::map::{Fineness, Map, Schedules, tolerances};
use slitpose_design::report::{Folder, map_report};

use super::super::options::{CalibrationOption, Jobs, number, open_scene, publish};
use super::super::{CommandError, Outcome, options};
use crate::terminal::{Amount, Progress};

/// Shows how accurate a head is, and where.
///
/// Of single frames of the scene's front end: the Cramér–Rao bound of the pose over the workspace, which solving reaches;
/// its condition; what a fault of one cell can do unnoticed; how far currents are from the limits. The folder gets a page
/// (index.html, needs nothing else), the pictures as SVG, and all poses as CSV. Without a folder, the summary is printed.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose scene map wide\n  slitpose scene map mine.toml --calibration mine-calibrated.toml --output map\n  \
                  slitpose scene map wide --tolerance-study --output map\n  \
                  slitpose scene map wide --schedule 2000"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Make this folder with the page, its tables and pictures
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// How many poses to spread over the workspace
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    samples: u32,
    /// Points along each side of the pictures
    #[arg(long, value_name = "N", default_value_t = 33, value_parser = clap::value_parser!(u32).range(3..=201))]
    side: u32,
    /// Say what the tolerance of each kind of part costs, before calibration and after it
    #[arg(long)]
    tolerance_study: bool,
    /// Propose the schedule with the least σ at this frame rate, hertz
    #[arg(long, value_name = "HZ", value_parser = number(|rate_hz| rate_hz > 0.0 && rate_hz.is_finite(), "give frames a second, such as 4000"))]
    schedule: Option<f64>,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    args.jobs.apply();
    let head = args.calibration.head_as_drawn(open_scene(&args.scene)?)?;
    let folder = args.output.as_deref().map(Folder::create).transpose()?;
    let schedules = args.schedule.map(|rate_hz| Schedules::of(&head.file, rate_hz)).transpose()?;
    // Planes are for pictures.
    let side = if folder.is_some() { args.side as usize } else { 0 };
    let fineness = Fineness { samples: args.samples as usize, side, ..Fineness::default() };
    let mut progress = Progress::new("map", fineness.poses() as u64, Amount::Of("poses"));
    let map = Map::of(head.clone(), fineness, || progress.add(1))?;
    drop(progress);
    if args.tolerance_study && map.share(|view| view.sigma.is_some()) == 0.0 {
        bail!(
            "scene `{}` gives no pose anywhere in its workspace, so there is none for tolerances to move; \
             --tolerance-study is for heads that have poses, such as the shipped scene `wide`",
            head.file.origin
        );
    }
    let costs = args.tolerance_study.then(|| tolerances(&head.simulated)).transpose()?;
    publish(&map_report(&head, &map, costs.as_ref(), schedules.as_ref()), folder.as_ref())?;
    Ok(Outcome::Done)
}

//! `slitpose scene map`: how accurate a head is, and where.

use std::path::PathBuf;

use super::{CommandError, Outcome};
use crate::commands::options::CalibrationOption;
use crate::commands::{names, talk};
use crate::terminal::{Amount, Progress};
use slitpose_design::map::{Fineness, Map};
use slitpose_design::report::{Folder, map_report};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::Output;

/// Shows how accurate a head is, and where.
///
/// Of single frames of the scene's front end: the Cramér–Rao bound of the pose over the workspace, which solving reaches;
/// its condition; what a fault of one cell can do unnoticed; how far currents are from the limits. The folder gets a page
/// (index.html, needs nothing else), the pictures as SVG, and all poses as CSV. Without a folder, the summary is printed.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose scene map wide\n  slitpose scene map mine.toml --calibration mine-calibrated.toml --output map"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = names::scenes(), hide_possible_values = true)]
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
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let head = args.calibration.head_as_drawn(SceneFile::open(&args.scene)?)?;
    let folder = args.output.as_deref().map(Folder::create).transpose()?;
    let fineness = Fineness { samples: args.samples as usize, side: args.side as usize, ..Fineness::default() };
    let mut progress = Progress::new("map", fineness.poses() as u64, Amount::Of("poses"));
    let mut done = 0;
    let map = Map::of(head.clone(), fineness, || {
        done += 1;
        progress.at(done);
    })?;
    drop(progress);
    let report = map_report(&head, &map);
    for warning in &report.warnings {
        talk(format_args!("{warning}"));
    }
    match folder {
        None => Output::open(None)?.write_text(&report.in_short())?,
        Some(folder) => {
            for path in folder.write(&report)? {
                talk(format_args!("wrote {}", path.display()));
            }
        }
    }
    Ok(Outcome::Done)
}

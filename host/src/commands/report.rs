//! `slitpose report`: error against run time, and what happens in extreme cases.

use std::path::PathBuf;

use super::options::{Jobs, open_scene};
use super::talk::store;
use super::{CommandError, Outcome, options};
use crate::terminal::{Amount, Progress};
use slitpose_design::report::{Folder, POSES, QUICK_POSES, SECTIONS, Settings, study};
use slitpose_head::scene_file::WIDE;

/// Measures how exact and how fast everything is, for one scene, and makes a page of it.
///
/// The folder gets one page (index.html, needs nothing else), the same tables as Markdown
/// (report.md) and as CSV, and the pictures as SVG. Sections: the forward model, the solver against
/// the Cramér–Rao bound, what each optional effect costs, and stiff and extreme cases. Errors follow
/// from the seed; times are those of this machine, one thread, least and median of interleaved
/// rounds. Nothing is measured on hardware.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose report --output report\n  slitpose report head.toml --output report --quick"
)]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(default_value = WIDE.name, value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Make this folder with the page, its tables and pictures
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Poses of the workspace
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    poses: Option<u32>,
    /// Seed of the noise
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Fewer poses and rounds: a quarter of the time
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    let default = if args.quick { QUICK_POSES } else { POSES };
    let settings =
        Settings { poses: args.poses.map_or(default, |poses| poses as usize), seed: args.seed, quick: args.quick };
    let folder = Folder::create(&args.output)?;
    args.jobs.apply();
    let mut progress = Progress::new("report", SECTIONS, Amount::Of("sections"));
    let mut done = 0;
    let report = study(&file, &settings, |title| {
        progress.step(done, title);
        done += 1;
    })?;
    drop(progress);
    store(&report, &folder)?;
    Ok(Outcome::Done)
}

//! `slitpose report` and `slitpose paper`: studies of the method, in folders.

use std::path::PathBuf;

use slitpose_design::paper::{Study, experiments, paper_report};
use slitpose_design::report::{Folder, POSES, QUICK_POSES, SECTIONS, Settings, study};

use super::options::{Jobs, open_scene, store};
use super::{CommandError, Outcome, options};
use crate::terminal::{Amount, Progress};
use slitpose_head::scene_file::{BENCH, WIDE};
use slitpose_head::table::Output;

/// Measures how exact and how fast everything is, for one scene, and makes a page of it.
///
/// The folder gets one page (index.html, needs nothing else), the same tables as Markdown
/// (report.md) and as CSV, and the pictures as SVG. Sections: the solver against the
/// Cramér–Rao bound, what each digit and each optional effect costs, and stiff and extreme cases. Errors follow
/// from the seed; times are those of this machine, one thread, least and median of interleaved
/// rounds. Nothing is measured on hardware.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose report --output report\n  slitpose report head.toml --output report --quick"
)]
pub(super) struct ReportArgs {
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

pub(super) fn report(args: &ReportArgs) -> Result<Outcome, CommandError> {
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

/// Calculates the experiments of De La Cruz et al. 2018 with the shipped scene `bench`.
///
/// Experiment 1 moves the emitter along the detector, experiment 2 turns it. Both are given as
/// equations (1) to (6) are printed (paper tier) and integrated over the spot (exact tier). The
/// paper's measured points were published without numbers and do not appear.
///
/// With --output the folder also gets a page (index.html, report.md) with the figures, and on the four errors that the paper
/// does publish as numbers: simulated benches with imperfect parts that have the same errors.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose paper > experiments.csv\n  slitpose paper --output paper-figures")]
pub(super) struct PaperArgs {
    /// Make this folder with the table and its figures, instead of the table on standard output
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub(super) fn paper(args: &PaperArgs) -> Result<Outcome, CommandError> {
    let folder = args.output.as_deref().map(Folder::create).transpose()?;
    let bench = BENCH.read()?;
    let study = Study::of(&bench)?;
    match folder {
        Some(folder) => store(&paper_report(&study, &bench)?, &folder)?,
        None => experiments(&study).write(Output::open(None)?)?,
    }
    Ok(Outcome::Done)
}

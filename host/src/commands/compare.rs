//! `slitpose compare`: several heads beside each other.

use std::path::PathBuf;

use slitpose_design::map::{Fineness, Map};
use slitpose_design::report::{Folder, comparison};
use slitpose_head::causes::with_causes;
use slitpose_head::front_end::configuration;
use slitpose_head::scene_file::SceneFile;

use super::options::publish;
use super::options::{self, Jobs, open_scene};
use super::{CommandError, Outcome, talk};
use crate::terminal::{Amount, Progress};

/// Compares the accuracy of several heads: one table and one picture.
///
/// Of single frames, each over its own workspace and with its own noise; see `slitpose scene map`. Where one has no front
/// end, or one whose slots do not fit into its frame, all are compared by their measuring channels. Without a folder the table
/// is printed.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose compare wide base\n  slitpose compare wide mine.toml --output comparison"
)]
pub(super) struct Args {
    /// Scene files, or names of shipped scenes
    #[arg(required = true, value_name = "SCENE", value_parser = options::scenes(), hide_possible_values = true)]
    scenes: Vec<String>,
    /// Make this folder with the page, its table and picture
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// How many poses to spread over each workspace
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    samples: u32,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    args.jobs.apply();
    let mut files: Vec<SceneFile> = args.scenes.iter().map(|scene| open_scene(scene)).collect::<Result<_, _>>()?;
    let (framed, others): (Vec<_>, Vec<_>) = files.iter().map(configuration).partition(Result::is_ok);
    if let (Some(_), Some(Err(error))) = (framed.first(), others.first()) {
        let reason = with_causes(error);
        talk(format_args!("{reason}; all are compared by the measuring channel of their [noise]"));
        files.iter_mut().for_each(|file| file.front_end = None);
    }
    let folder = args.output.as_deref().map(Folder::create).transpose()?;
    let fineness = Fineness { samples: args.samples as usize, side: 0, behind: 0 };
    let mut progress = Progress::new("compare", (files.len() * fineness.poses()) as u64, Amount::Of("poses"));
    let mut maps = Vec::new();
    for file in files {
        let map = Map::of(file.clone().into(), fineness, || progress.add(1))?;
        maps.push((file, map));
    }
    drop(progress);
    publish(&comparison(&maps), folder.as_ref())?;
    Ok(Outcome::Done)
}

//! `slitpose compare`: several heads beside each other.

use std::fs;
use std::num::NonZero;
use std::path::{Path, PathBuf};

use slitpose_design::map::{Fineness, Map};
use slitpose_design::report::{Folder, comparison};
use slitpose_head::causes::with_causes;
use slitpose_head::faults::Fault;
use slitpose_head::front_end::configuration;
use slitpose_head::pace::Speed;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{Output, OutputError, TableWriter, refuse_twice};
use slitpose_head::threads::in_order;
use slitpose_tracking::pipeline::Outcomes;

use super::faults::FaultOptions;
use super::options::publish;
use super::options::{self, Jobs, PoseOptions, open_scene};
use super::playback::{PlayOptions, Playback, Printing};
use super::{CommandError, Outcome, complain, replay, talk, usage};
use crate::sink::{Account, Format};
use crate::telemetry::BoardReport;
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

/// Several captures, each replayed on its own.
#[derive(clap::Args, Debug)]
pub(super) struct SideBySide {
    /// Replay each file on its own, so many at a time
    #[arg(long, value_name = "N", conflicts_with_all = ["live", "speed", "compare"])]
    pub(super) jobs: Option<NonZero<usize>>,
    /// With --jobs: make this folder with a file of poses for each capture, named as the capture
    #[arg(long, value_name = "DIR", requires = "jobs")]
    output: Option<PathBuf>,
}

/// A capture, and the file of its poses.
struct Job<'a> {
    capture: &'a PathBuf,
    poses: Option<PathBuf>,
}

impl SideBySide {
    /// Replays `files`, `jobs` at a time.
    pub(super) fn replay(
        &self,
        jobs: NonZero<usize>,
        files: &[PathBuf],
        options: (&PlayOptions, &PoseOptions),
        faults: &FaultOptions,
    ) -> Result<Outcome, CommandError> {
        let (play, poses) = options;
        let usual = if self.output.is_some() { Format::Ndjson } else { Format::None };
        let format = poses.format_or(usual);
        let work: Vec<Job> = match (&self.output, format.ending()) {
            (None, None) => files.iter().map(|capture| Job { capture, poses: None }).collect(),
            (Some(folder), Some(ending)) => self.targets(folder, ending, files, play)?,
            _ => {
                return Err(usage!(
                    "with --jobs each capture has its own file of poses; give --output DIR with --format ndjson or csv, \
                     or neither"
                )
                .into());
            }
        };
        faults.tell();
        let faults: &[Fault] = &faults.fault;
        let outcomes = Outcomes::default().by_name().map(|(name, _)| name);
        let columns = ["capture", "ended", "boards", "scans"].into_iter().chain(outcomes);
        let mut table = TableWriter::new(Output::open(None)?, columns)?;
        let mut progress = Progress::new("replay", files.len() as u64, Amount::Of("captures"));
        let (mut waiting, mut ended, mut done) = (work.iter(), Outcome::Done, 0);
        in_order(
            jobs,
            || Ok::<_, CommandError>(waiting.next()),
            |job| (job, job.run(format, options, faults.to_vec())),
            |(job, result)| {
                let name = job.capture.display().to_string();
                let (outcome, account) = result.unwrap_or_else(|error| {
                    complain(format_args!("{name}: {}", with_causes(error.as_ref())));
                    (Outcome::Failed, Account::default())
                });
                ended = ended.max(outcome);
                write(&mut table, &name, outcome, &account)?;
                done += 1;
                progress.step(done, "");
                Ok(())
            },
        )?;
        drop(progress);
        table.finish()?;
        Ok(ended)
    }

    /// The captures with the files of their poses, in a folder that is made.
    fn targets<'a>(
        &self,
        folder: &Path,
        ending: &str,
        files: &'a [PathBuf],
        play: &PlayOptions,
    ) -> Result<Vec<Job<'a>>, CommandError> {
        fs::create_dir_all(folder).map_err(|source| OutputError::Create { path: folder.to_owned(), source })?;
        let mut work = Vec::<Job>::new();
        for capture in files {
            let name = Path::new(capture.file_stem().unwrap_or(capture.as_os_str())).to_owned();
            let mut poses = folder.join(name).into_os_string();
            poses.push(ending);
            let poses = PathBuf::from(poses);
            let others = work.iter().filter_map(|job| job.poses.as_deref());
            refuse_twice(&poses, files.iter().map(PathBuf::as_path).chain(play.sources()).chain(others))?;
            work.push(Job { capture, poses: Some(poses) });
        }
        Ok(work)
    }
}

impl Job<'_> {
    fn run(
        &self,
        format: Format,
        options: (&PlayOptions, &PoseOptions),
        faults: Vec<Fault>,
    ) -> Result<(Outcome, Account), CommandError> {
        let files = std::slice::from_ref(self.capture);
        let name = self.capture.display().to_string();
        if let Some(poses) = &self.poses {
            return replay::write(poses, format, files, options, faults, Some(&name));
        }
        let (play, poses) = options;
        let printing = Printing { sink: None, target: "", format, is_terminal: false, name: Some(&name) };
        Playback::new(files, play, poses, faults, Speed::Max, printing)?.play()
    }
}

fn write(table: &mut TableWriter, name: &str, outcome: Outcome, account: &Account) -> Result<(), OutputError> {
    table.text(name);
    table.text(match outcome {
        Outcome::Done => "whole",
        Outcome::DataLost => "data_lost",
        Outcome::Failed => "failed",
    });
    table.text(&account.boards.len().to_string());
    let total = |count: &dyn Fn(&BoardReport) -> u64| account.boards.iter().map(count).sum::<u64>().to_string();
    table.text(&total(&|board| board.scans));
    for outcome in 0..Outcomes::default().by_name().len() {
        table.text(&total(&|board| board.outcomes.by_name()[outcome].1));
    }
    table.end_row()
}

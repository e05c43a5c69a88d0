//! `slitpose doctor`: what may be wrong, and what to do about it.

use std::io::Write;
use std::path::PathBuf;

use super::device::BoardOptions;
use super::poses::parse_duration;
use super::{CommandError, Outcome};
use super::{names, talk};
use crate::doctor::{Bundle, Subject, examine};
use crate::terminal::{self, Tone};
use slitpose_head::finding::Grade;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{Output, OutputError};

/// Looks at everything between a board and its poses, and says what to do about what is wrong.
///
/// Ports and permissions, the board and its scene, what it measures, clock, disk and priorities of this host. The
/// board measures for a while by the schedule of the scene; nothing is stored on it. Ends with 1 if a check failed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose doctor\n  slitpose doctor --device sim\n  \
                  slitpose doctor --scene head.toml --folder /var/lib/slitpose --bundle report.tar.gz")]
pub(super) struct Args {
    #[command(flatten)]
    board: BoardOptions,
    /// The scene of its head: a file, or the name of a shipped scene
    #[arg(long, value_name = "SCENE", value_parser = names::scenes(), hide_possible_values = true)]
    scene: Option<String>,
    /// Where recordings go
    #[arg(long, value_name = "DIR", default_value = ".")]
    folder: PathBuf,
    /// How long the board measures
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = parse_duration)]
    duration: f64,
    /// Pack what was found into this file, for a report of a fault
    #[arg(long, value_name = "FILE.tar.gz")]
    bundle: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let scene = args.scene.as_deref().map(SceneFile::open).transpose()?;
    // An impossible place is told before anything is measured.
    let file = args.bundle.as_deref().map(Output::file).transpose()?;
    let mut output = Output::open(None)?;
    let examination = examine(&Subject {
        device: &args.board.device,
        search: &args.board.search,
        scene: scene.as_ref(),
        folder: &args.folder,
        duration_s: args.duration,
    });
    let has_colours = terminal::has_colours(output.is_terminal());
    for check in &examination.checks {
        let text = Tone::from(check.grade).paint(&format!("{check:#}"), has_colours);
        if let Err(source) = writeln!(output, "{text}") {
            return Err(output.error(source).into());
        }
    }
    output.finish()?;
    if let Some(file) = file {
        let target = file.target().to_owned();
        let bundle = Bundle::of(&examination);
        let written = bundle.and_then(|bundle| bundle.write(file).map(|file| (bundle, file)));
        let (bundle, file) = written.map_err(|source| OutputError::Write { target: target.clone(), source })?;
        file.finish()?;
        talk(format_args!("{target} holds, for you to look at before you send it:"));
        for (name, meaning) in bundle.contents() {
            talk(format_args!("  {name}: {meaning}"));
        }
        talk(format_args!("no environment, and no names of users or hosts"));
    }
    let [failed, warnings] = [Grade::Failed, Grade::Warning].map(|grade| examination.count(grade));
    talk(format_args!("{failed} checks failed, {warnings} with warnings, of {}", examination.checks.len()));
    Ok(if failed == 0 { Outcome::Done } else { Outcome::Failed })
}

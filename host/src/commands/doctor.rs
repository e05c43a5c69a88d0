//! `slitpose doctor`: what may be wrong, and what to do about it.

use std::io;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

use anyhow::Context;

use super::device::BoardOptions;
use super::options::parse_duration;
use super::{CommandError, Outcome, options, talk};
use crate::device::Selector;
use crate::doctor::{BringUp, Step, Subject, continuity, examine, pack};
use crate::terminal;
use crate::terminal::Tone;
use slitpose_head::finding::{Finding, Grade};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{Output, OutputError};

/// Looks at everything between a board and its poses, and says what to do about what is wrong.
///
/// Ports and permissions, the board and its scene, what it measures, clock, disk and priorities of this host. The
/// board measures for a while by the schedule of the scene; nothing is stored on it. Ends with 1 if a check failed.
///
/// With --bring-up it walks through the steps for a new board instead. The first asks what your multimeter says of the
/// unpowered board. Each other one says what to connect, measures by schedules of its own, and compares with what is
/// expected. The last step stores settings, unless there are some, and erases them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose doctor\n  slitpose doctor --device sim\n  \
                  slitpose doctor --scene head.toml --folder /var/lib/slitpose --bundle report.tar.gz\n  \
                  slitpose doctor --bring-up --scene head.toml\n  \
                  slitpose doctor --bring-up --step crosstalk")]
pub(super) struct Args {
    #[command(flatten)]
    board: BoardOptions,
    /// The scene of its head: a file, or the name of a shipped scene
    #[arg(long, value_name = "SCENE", value_parser = options::scenes(), hide_possible_values = true)]
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
    /// Walk through the bring-up of a new board, step by step
    #[arg(long, conflicts_with_all = ["folder", "duration", "bundle"])]
    bring_up: bool,
    /// Only this step of the bring-up
    #[arg(long, value_name = "STEP", requires = "bring_up", long_help = step_help())]
    step: Option<Step>,
    /// Do not wait for Enter before a step; reboot the board instead of a power cut
    #[arg(long, requires = "bring_up")]
    yes: bool,
}

fn step_help() -> String {
    let steps = Step::ALL.map(|step| format!("\n  {:2} {:10} {}", step.number(), step.name, step.expectation));
    format!("Only this step of the bring-up, by number or name:\n{}", steps.concat())
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let scene = args.scene.as_deref().map(SceneFile::open).transpose()?;
    if args.bring_up {
        return bring_up(args, scene.as_ref());
    }
    // An impossible place is told before anything is measured.
    let file = args.bundle.as_deref().map(Output::file).transpose()?;
    let mut report = Report::open()?;
    let examination = examine(&Subject {
        device: &args.board.device,
        search: &args.board.search,
        scene: scene.as_ref(),
        folder: &args.folder,
        duration_s: args.duration,
    });
    examination.checks.iter().try_for_each(|check| report.finding(check))?;
    let (failed, warnings) = report.finish()?;
    if let Some(file) = file {
        let target = file.target().to_owned();
        let packed = pack(&examination, file);
        let (file, files) = packed.map_err(|source| OutputError::Write { target: target.clone(), source })?;
        file.finish()?;
        talk(format_args!("{target} holds, for you to look at before you send it:"));
        for (name, meaning) in files {
            talk(format_args!("  {name}: {meaning}"));
        }
        talk(format_args!("no environment, and no names of users or hosts"));
    }
    talk(format_args!("of {} checks {failed} failed, {warnings} with warnings", examination.checks.len()));
    Ok(if failed == 0 { Outcome::Done } else { Outcome::Failed })
}

/// Standard output with the findings printed to it, and their number by grade.
struct Report {
    output: Output,
    has_colours: bool,
    failed: usize,
    warnings: usize,
}

impl Report {
    fn open() -> Result<Self, OutputError> {
        let output = Output::open(None)?;
        let has_colours = terminal::has_colours(output.is_terminal());
        Ok(Self { output, has_colours, failed: 0, warnings: 0 })
    }

    fn finish(self) -> Result<(usize, usize), OutputError> {
        self.output.finish()?;
        Ok((self.failed, self.warnings))
    }

    fn finding(&mut self, finding: &Finding) -> Result<(), OutputError> {
        self.failed += usize::from(finding.grade == Grade::Failed);
        self.warnings += usize::from(finding.grade == Grade::Warning);
        let text = Tone::from(finding.grade).paint(&format!("{finding:#}"), self.has_colours);
        self.line(&text)
    }

    fn step(&mut self, step: &Step) -> Result<(), OutputError> {
        self.line(&format!("{step}: {}", step.preparation))?;
        self.line(&format!("{:8} {}", "expected", step.expectation))
    }

    fn line(&mut self, text: &str) -> Result<(), OutputError> {
        writeln!(self.output, "{text}").and_then(|()| self.output.flush()).map_err(|source| self.output.error(source))
    }
}

fn bring_up(args: &Args, given: Option<&SceneFile>) -> Result<Outcome, CommandError> {
    let mut report = Report::open()?;
    let asks = !args.yes && io::stdin().is_terminal();
    let steps = args.step.map_or_else(|| Step::ALL.to_vec(), |step| vec![step]);
    let (by_hand, steps): (Vec<_>, Vec<_>) = steps.into_iter().partition(Step::is_by_hand);
    for step in &by_hand {
        report.step(step)?;
        // A simulated board has no contacts.
        let asks = asks && args.board.device != Selector::Sim;
        let ask = |question: &str| {
            asks.then(|| {
                answer_to(&format!("{question}? Enter, or n")).is_ok_and(|answer| !answer.starts_with(['n', 'N']))
            })
        };
        continuity(ask).try_for_each(|finding| report.finding(&finding))?;
    }
    if report.failed > 0 {
        talk(format_args!("put this right before you apply power"));
        return Ok(Outcome::Failed);
    }
    if steps.is_empty() {
        return Ok(Outcome::Done);
    }
    if asks && !by_hand.is_empty() {
        answer_to("connect what the next step needs, with power, and press Enter")?;
    }
    let mut findings = Vec::new();
    let plugs = "take all cables off the board for two seconds, plug them in again, and press Enter";
    let cut_power = Box::new(move || asks && answer_to(plugs).is_ok());
    let begun = BringUp::begin(args.board.contact(), given, cut_power, &mut findings);
    findings.iter().try_for_each(|finding| report.finding(finding))?;
    let mut failed_steps = Vec::new();
    if let Some(mut bring_up) = begun {
        for step in steps {
            report.step(&step)?;
            if asks {
                answer_to("press Enter when it is so")?;
            }
            let before = report.failed;
            bring_up.take(step).iter().try_for_each(|finding| report.finding(finding))?;
            if report.failed > before {
                failed_steps.push(step.name);
            }
        }
        if let Err(finding) = bring_up.restore() {
            report.finding(&finding)?;
        }
    }
    let (failed, warnings) = report.finish()?;
    talk(format_args!("findings: {failed} failed, {warnings} with warnings"));
    if !failed_steps.is_empty() {
        talk(format_args!("put right what failed and take these steps again: {}", failed_steps.join(", ")));
    }
    Ok(if failed == 0 { Outcome::Done } else { Outcome::Failed })
}

/// Asks on standard error and waits for a line of standard input; its end counts as one.
fn answer_to(question: &str) -> Result<String, CommandError> {
    talk(format_args!("{question}"));
    let mut answer = String::new();
    io::stdin()
        .read_line(&mut answer)
        .context("cannot read from standard input; give --yes to go on without questions")?;
    Ok(answer)
}

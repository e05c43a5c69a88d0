//! Captures through the pipeline, for `replay` and `export`.

use std::cell::RefCell;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::bail;

use super::options::{CalibrationOption, PoseOptions, parse_duration};
use super::player::Player;
use super::{CommandError, Outcome, interrupt, options, talk};
use crate::comparison::Comparison;
use crate::sink::{Format, Note, Sink};
use crate::terminal::{Amount, Progress};
use slitpose_head::faults::Fault;
use slitpose_head::pace::{Pace, Speed};
use slitpose_head::table::OutputError;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::page::Sampler;
use slitpose_tracking::pipeline::Item;
use slitpose_tracking::playback::{self, Choice, Event, PlaybackError, Yields};
use slitpose_tracking::telemetry::{BoardStatistics, DaemonReport, RecorderReport};

/// Which part of captures is solved, and how.
#[derive(clap::Args, Debug, Default)]
pub(super) struct PlayOptions {
    /// Scene file, or the name of a shipped scene, also if it is not the one of the capture
    #[arg(long, value_name = "SCENE", value_parser = options::scenes(), hide_possible_values = true)]
    scene: Option<String>,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Begin this long after the beginning; the first poses are then found from nothing
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    from: Option<f64>,
    /// End this long after the beginning
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) to: Option<f64>,
    /// Report on standard error how far poses are from those of this CSV table, which has the columns of a
    /// pose and seq, or time_s; and by which other clock, units or axes they agree, if by the given they do not
    #[arg(long, value_name = "CSV")]
    compare: Option<String>,
}

impl PlayOptions {
    pub(super) fn sources(&self) -> impl Iterator<Item = &Path> {
        self.scene.iter().chain(&self.compare).map(Path::new).chain(self.calibration.file())
    }
}

pub(super) struct Printing<'a> {
    pub(super) sink: Option<Box<dyn Sink + Send + 'a>>,
    pub(super) target: &'a str,
    pub(super) format: Format,
    pub(super) is_terminal: bool,
    /// Whether messages are nobody's: those of another program's work would be taken for its own.
    pub(super) is_silent: bool,
}

/// A capture that rests looks this often for orders.
const MOMENT: Duration = Duration::from_millis(20);

pub(super) struct Playback<'a> {
    files: &'a [PathBuf],
    choice: Choice,
    captures: playback::Playback,
    speed: Speed,
    /// From the first bytes on, or from where the page changed it.
    pace: Option<Pace>,
    /// Device time at the beginning of that, seconds.
    paced_from_s: f64,
    stop: Arc<AtomicBool>,
    /// Drawn while nothing else shows how far it has come.
    progress: Option<Progress>,
    output: Outputs<'a>,
    player: Option<Player>,
    began: HostInstant,
}

struct Outputs<'a> {
    sink: Option<Box<dyn Sink + Send + 'a>>,
    target: &'a str,
    is_silent: bool,
    comparison: Option<Comparison>,
    statistics: Vec<RefCell<BoardStatistics>>,
    /// Of each board, if a page shows them.
    samplers: Vec<Sampler>,
    outcome: Outcome,
}

impl<'a> Playback<'a> {
    pub(super) fn new(
        files: &'a [PathBuf],
        play: &PlayOptions,
        poses: &PoseOptions,
        faults: Vec<Fault>,
        speed: Speed,
        Printing { sink, target, format, is_terminal, is_silent }: Printing<'a>,
    ) -> Result<Self, CommandError> {
        let choice = Choice {
            scene: play.scene.clone(),
            calibration: play.calibration.given().map(Path::to_owned),
            solving: poses.solving(),
            from_s: play.from,
            to_s: play.to,
            duration_s: poses.duration,
            // Only people look at the cells.
            is_watched: format == Format::Summary,
            yields: Yields::Poses,
            faults,
            view: poses.frame.view()?,
        };
        let captures = playback::Playback::open(files.to_vec(), choice.clone())?;
        let comparison = play.compare.as_deref().map(Comparison::open).transpose()?;
        let bytes = files.iter().filter_map(|file| fs::metadata(file).ok()).map(|metadata| metadata.len()).sum();
        // Poses that run over the screen show it themselves.
        let is_drawn = !is_terminal || matches!(format, Format::Summary | Format::None);
        let progress = is_drawn.then(|| Progress::new("progress", bytes, Amount::Bytes));
        let stop = interrupt()?;
        let (statistics, samplers, outcome) = (Vec::new(), Vec::new(), Outcome::Done);
        let output = Outputs { sink, target, is_silent, comparison, statistics, samplers, outcome };
        let (pace, paced_from_s, player, began) = (None, 0.0, None, HostInstant::now());
        Ok(Self { files, choice, captures, speed, pace, paced_from_s, stop, progress, output, player, began })
    }

    /// Plays them as `player` says, until the program is interrupted or nobody looks any more.
    pub(super) fn played_by(mut self, player: Player) -> Result<Self, CommandError> {
        self.choice.is_watched = true;
        // The page shows how far it has come.
        self.progress = None;
        self.player = Some(player);
        self.leap(self.choice.from_s.unwrap_or(0.0))?;
        Ok(self)
    }

    pub(super) fn run(mut self) -> Result<Outcome, CommandError> {
        loop {
            let next = !self.is_stopped() && {
                let Self { captures, output, .. } = &mut self;
                captures.step(|event| output.hear(event))?
            };
            if next {
                let began = self.began;
                self.output.print(|sink, statistics| sink.tick(&|| report(began, &self.captures, statistics)))?;
                self.show();
            } else if self.player.is_none() || self.captures.boards.is_empty() || self.is_stopped() {
                break;
            }
            if let Some(progress) = &mut self.progress {
                progress.at(self.captures.read_bytes());
            }
            if let Some(from_s) = self.keep_pace(!next) {
                self.leap(from_s)?;
            }
        }
        let Self { mut captures, progress, mut output, player, began, .. } = self;
        drop(progress);
        output.print(|sink, statistics| sink.finish(&|| report(began, &captures, statistics)))?;
        let ended = captures.end(|event| output.hear(event));
        let matched = output.comparison.as_mut().map_or(Ok(()), |comparison| {
            comparison.lines().iter().chain(&comparison.suspicion()).for_each(|line| talk(format_args!("{line}")));
            comparison.require_match()
        });
        match ended {
            // Interrupted where the page had led it.
            Err(error)
                if player.is_some()
                    && !captures.boards.is_empty()
                    && matches!(
                        error.downcast_ref(),
                        Some(PlaybackError::NoScan { .. } | PlaybackError::Beyond { .. })
                    ) =>
            {
                Ok(output.outcome)
            }
            ended => {
                ended?;
                matched?;
                Ok(output.outcome)
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.player.as_ref().is_some_and(Player::is_left)
    }

    /// Waits until the next bytes are due, or at the `end` for orders; returns the place of a leap, if one was ordered.
    fn keep_pace(&mut self, end: bool) -> Option<f64> {
        while !self.is_stopped() {
            let leap = self.heed(end);
            if leap.is_some() {
                return leap;
            }
            if self.player.as_ref().is_some_and(|player| end || !player.is_playing()) {
                std::thread::sleep(MOMENT);
                continue;
            }
            let due_s = self.captures.elapsed_s() - self.paced_from_s;
            let speed = self.speed;
            if self.pace.get_or_insert_with(|| Pace::new(speed)).nap(due_s) {
                break;
            }
        }
        None
    }

    /// Carries out the orders of the page and sends it the state of the player; returns the place of a leap, if one was
    /// ordered.
    fn heed(&mut self, end: bool) -> Option<f64> {
        let player = self.player.as_mut()?;
        let (was_playing, speed) = (player.is_playing(), self.speed);
        let leap = player.obey(&mut self.speed);
        let elapsed_s = self.captures.elapsed_s();
        if self.speed != speed || player.is_playing() != was_playing {
            (self.pace, self.paced_from_s) = (None, elapsed_s);
        }
        let position_s = leap.unwrap_or(self.choice.from_s.unwrap_or(0.0) + elapsed_s);
        let report = || report(self.began, &self.captures, &self.output.statistics);
        player.tell(position_s, self.speed, end && leap.is_none(), report);
        leap
    }

    /// Continues at another place, seconds after the beginning.
    fn leap(&mut self, from_s: f64) -> Result<(), CommandError> {
        self.choice.from_s = (from_s > 0.0).then_some(from_s);
        self.captures = playback::Playback::open(self.files.to_vec(), self.choice.clone())?;
        self.output.statistics.clear();
        self.output.samplers.clear();
        (self.pace, self.paced_from_s) = (None, 0.0);
        Ok(())
    }

    fn show(&mut self) {
        let Self { player: Some(player), captures, output, .. } = self else { return };
        let boards = &captures.boards;
        if output.samplers.len() != boards.len() {
            output.samplers = player.show(boards);
        }
        let now = HostInstant::now();
        for (number, (sampler, board)) in output.samplers.iter_mut().zip(boards).enumerate() {
            sampler.send(board.pipeline.last_photocurrents(), now, |sample| player.live.sample(number, sample));
        }
    }
}

impl Outputs<'_> {
    fn hear(&mut self, event: Event<'_>) -> Result<(), CommandError> {
        match event {
            Event::Board { number, device } => {
                let name = device.map_or_else(|| "capture".to_owned(), |device| device.to_string());
                let statistics = RefCell::new(BoardStatistics::new(name, HostInstant::now()));
                // A board that begins anew is shown anew.
                self.samplers.clear();
                match self.statistics.get_mut(number) {
                    Some(before) => *before = statistics,
                    None => self.statistics.push(statistics),
                }
                if self.comparison.is_some() && self.statistics.len() > 1 {
                    bail!("--compare compares one board, and the capture holds several; record them apart");
                }
                Ok(())
            }
            Event::Item { number, device, item } => {
                self.statistics[number].get_mut().update(&item, None, None);
                if let (Item::Pose(record), Some(sampler)) = (&item, self.samplers.get_mut(number)) {
                    sampler.add(record);
                }
                self.write(device, &item)
            }
            Event::Remark(remark) => {
                self.say(&remark);
                Ok(())
            }
            Event::Loss(loss) => {
                self.say(&loss);
                self.outcome = Outcome::DataLost;
                Ok(())
            }
            // Not asked for.
            Event::Currents { .. } => Ok(()),
        }
    }

    fn say(&self, message: &dyn Display) {
        if !self.is_silent {
            talk(format_args!("{message}"));
        }
    }

    fn write(&mut self, device: Option<DeviceId>, item: &Item<'_>) -> Result<(), CommandError> {
        if let Item::Oddity { oddity, .. } = item {
            self.say(&oddity);
        }
        if let Item::Pose(record) = item {
            if let Some(comparison) = &mut self.comparison {
                comparison.add(record)?;
            }
            return self.print(|sink, _| sink.pose(record));
        }
        let note = Note::of(device, item);
        note.map_or(Ok(()), |note| self.print(|sink, _| sink.note(&note)))
    }

    /// Prints to the sink, if there is one.
    fn print(
        &mut self,
        print: impl FnOnce(&mut (dyn Sink + Send), &[RefCell<BoardStatistics>]) -> std::io::Result<()>,
    ) -> Result<(), CommandError> {
        let Some(sink) = &mut self.sink else { return Ok(()) };
        let target = || self.target.to_owned();
        Ok(print(&mut **sink, &self.statistics).map_err(|source| OutputError::Write { target: target(), source })?)
    }
}

/// How all of them did; nothing is recorded.
fn report(began: HostInstant, captures: &playback::Playback, statistics: &[RefCell<BoardStatistics>]) -> DaemonReport {
    let (boards, now) = (captures.boards.iter().zip(statistics), HostInstant::now());
    let boards = boards.map(|(board, statistics)| board.report(&mut statistics.borrow_mut(), now));
    DaemonReport::of(began, now, boards.collect(), RecorderReport::default())
}

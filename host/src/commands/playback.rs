//! Captures through the pipeline, for `replay` and `export`.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use slitpose_calibration::Head;
use thiserror::Error;

use super::capture_files::{first_log_ns, scene_hash, tell_of_end, tell_of_scene};
use super::host_clock::HostClock;
use super::options::CalibrationOption;
use super::player::Player;
use super::poses::{PoseOptions, parse_duration};
use super::{CommandError, Outcome, interrupt, losses, names, talk};
use crate::capture::{CaptureReader, CapturedBasis, Entry, Setup};
use crate::clock::HostInstant;
use crate::comparison::Comparison;
use crate::link::{DeviceId, Segment};
use crate::live::{LiveBoard, Sampler};
use crate::pipeline::{Item, Pipeline, PipelineError, SceneMatch};
use crate::sink::{Account, Format, Note, Sink};
use crate::telemetry::{BoardReport, BoardStatistics, DaemonReport, LinkReport, LinkState, RecorderReport};
use crate::terminal::{Amount, Progress};
use slitpose_head::pace::{Pace, Speed};
use slitpose_head::scene_file::{SceneFile, Shipped, WIDE};
use slitpose_head::table::OutputError;

/// Boards are recorded a piece at a time: what one said before the end may stand so far behind it.
const LATEST_NS: u64 = 1_000_000_000;

/// A capture that rests looks this often for orders.
const MOMENT: Duration = Duration::from_millis(20);

/// Which part of captures is solved, and how.
#[derive(clap::Args, Debug)]
pub(super) struct PlayOptions {
    /// Scene file, or the name of a shipped scene, also if it is not the one of the capture
    #[arg(long, value_name = "SCENE", value_parser = names::scenes(), hide_possible_values = true)]
    scene: Option<String>,
    #[command(flatten)]
    calibration: CalibrationOption,
    /// Begin this long after the beginning; the first poses are then found from nothing
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    from: Option<f64>,
    /// End this long after the beginning
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    to: Option<f64>,
    /// Report on standard error how far poses are from those of this CSV table, which has the columns of a
    /// pose and seq, or time_s
    #[arg(long, value_name = "CSV")]
    compare: Option<String>,
}

impl PlayOptions {
    /// Files that are read besides captures.
    pub(super) fn sources(&self) -> impl Iterator<Item = &Path> {
        self.scene.iter().chain(&self.compare).map(Path::new).chain(self.calibration.file())
    }
}

/// Why a capture cannot be solved.
#[derive(Debug, Error)]
pub(crate) enum PlaybackError {
    /// A capture without a single scan.
    #[error(
        "{} holds no scan: {bytes} bytes of links, {packets} readable packets; \
         give a capture written by `run --record` or `simulate`", path.display()
    )]
    NoScan {
        /// The file.
        path: PathBuf,
        /// Bytes that came over links.
        bytes: u64,
        /// Packets in them.
        packets: u64,
    },
    /// Nothing of the capture lies in the part that was asked for.
    #[error("there is no scan from {from_s} s after the beginning of {} on; give an earlier --from", path.display())]
    Beyond {
        /// The file.
        path: PathBuf,
        /// The beginning asked for, seconds.
        from_s: f64,
    },
    /// A reference for one board, and several of them.
    #[error("--compare compares one board, and the capture holds several; record them apart")]
    SeveralBoards,
    /// A range of time that holds nothing.
    #[error("--to {to_s} s does not lie behind --from {from_s} s; give a later end")]
    Range {
        /// The beginning, seconds.
        from_s: f64,
        /// The end, seconds.
        to_s: f64,
    },
}

/// Output and format of poses.
pub(super) struct Printing<'a> {
    /// `None`: nowhere.
    pub(super) sink: Option<Box<dyn Sink + Send + 'a>>,
    /// The name of the output.
    pub(super) target: &'a str,
    pub(super) format: Format,
    /// Whether that is a terminal.
    pub(super) is_terminal: bool,
}

/// The head of `file` as it was known in the recording. With another scene than the recorded one, its calibration says
/// nothing.
fn head_of(file: SceneFile, setup: &Setup, is_scene_given: bool) -> Result<Head, CommandError> {
    Ok(match &setup.basis {
        CapturedBasis::Calibration(calibration) if file.hash == setup.scene.hash => {
            Head::calibrated(file, calibration.parse()?)?
        }
        CapturedBasis::Tolerances => Head::uncalibrated(file)?,
        CapturedBasis::Scene if !is_scene_given => file.into(),
        CapturedBasis::Scene | CapturedBasis::Calibration(_) => Head::as_scene_says(file)?,
    })
}

/// Captures being solved.
pub(super) struct Playback<'a> {
    files: &'a [PathBuf],
    play: &'a PlayOptions,
    poses: &'a PoseOptions,
    speed: Speed,
    /// From the first bytes on, or from where the speed was changed.
    pace: Option<Pace>,
    /// Device time at the beginning of that, seconds.
    paced_from_s: f64,
    /// Where it began, seconds after the beginning of the capture.
    from_s: f64,
    /// The page, if there is one.
    player: Option<Player>,
    began: HostInstant,
    sink: Option<Box<dyn Sink + Send + 'a>>,
    /// Where that writes.
    target: &'a str,
    format: Format,
    comparison: Option<Comparison>,
    boards: Vec<Board>,
    /// Boards that the capture names without data.
    unsettled: BTreeSet<DeviceId>,
    stop: Arc<AtomicBool>,
    /// Drawn while nothing else shows how far it has come.
    progress: Option<Progress>,
}

/// What ended the play of a file.
enum Played {
    /// Its end.
    File,
    /// The end that was asked for.
    Enough,
    /// A leap to another place, seconds after the beginning.
    Leap(f64),
}

/// A board of a capture.
struct Board {
    /// `None` in the bytes of a port, which are of one board.
    device: Option<DeviceId>,
    setup: Option<Box<Setup>>,
    head: Head,
    pipeline: Pipeline,
    statistics: RefCell<BoardStatistics>,
    sampler: Option<Sampler>,
    host_clock: HostClock,
    /// Nothing more can be made of it until its link was opened anew.
    is_unusable: bool,
}

impl<'a> Playback<'a> {
    pub(super) fn new(
        files: &'a [PathBuf],
        play: &'a PlayOptions,
        poses: &'a PoseOptions,
        speed: Speed,
        Printing { sink, target, format, is_terminal }: Printing<'a>,
    ) -> Result<Self, CommandError> {
        if let (Some(from_s), Some(to_s)) = (play.from, play.to)
            && to_s <= from_s
        {
            return Err(PlaybackError::Range { from_s, to_s }.into());
        }
        let comparison = play.compare.as_deref().map(Comparison::open).transpose()?;
        let bytes = files.iter().filter_map(|file| fs::metadata(file).ok()).map(|metadata| metadata.len()).sum();
        // Poses that run over the screen show it themselves.
        let is_drawn = !is_terminal || matches!(format, Format::Summary | Format::None);
        let progress = is_drawn.then(|| Progress::new("progress", bytes, Amount::Bytes));
        let stop = interrupt()?;
        Ok(Self {
            files,
            play,
            poses,
            speed,
            pace: None,
            paced_from_s: 0.0,
            from_s: play.from.unwrap_or(0.0),
            player: None,
            began: HostInstant::now(),
            sink,
            target,
            format,
            comparison,
            boards: Vec::new(),
            unsettled: BTreeSet::new(),
            stop,
            progress,
        })
    }

    /// Plays as `player` says, until the program is interrupted.
    pub(super) fn played_by(self, player: Player) -> Self {
        Self { player: Some(player), ..self }
    }

    /// Solves all of them.
    pub(super) fn run(mut self) -> Result<Outcome, CommandError> {
        let start_ns = self.files.first().map(|file| first_log_ns(file)).transpose()?.unwrap_or(0);
        let at_ns = |offset_s: f64| start_ns.saturating_add((offset_s * 1e9) as u64);
        let to_ns = self.play.to.map_or(u64::MAX, at_ns);
        loop {
            let mut outcome = Outcome::Done;
            let from_ns = if self.from_s > 0.0 { at_ns(self.from_s) } else { 0 };
            let mut played = self.play_all(from_ns, to_ns, &mut outcome)?;
            self.progress = None;
            while self.player.is_some() && !matches!(played, Played::Leap(_)) && !self.stop.load(Ordering::Relaxed) {
                std::thread::sleep(MOMENT);
                if let Some(from_s) = self.heed(true) {
                    played = Played::Leap(from_s);
                }
            }
            match played {
                Played::Leap(from_s) => self.rewind(from_s),
                Played::File => return self.end(outcome, false),
                Played::Enough => return self.end(outcome, true),
            }
        }
    }

    /// Solves all files from a place on.
    fn play_all(&mut self, from_ns: u64, to_ns: u64, outcome: &mut Outcome) -> Result<Played, CommandError> {
        let mut read_bytes = 0;
        for path in self.files {
            let mut reader = CaptureReader::open(path)?.starting_at(from_ns);
            match self.play_file(path, &mut reader, to_ns, read_bytes)? {
                Played::File => {}
                played => return Ok(played),
            }
            read_bytes += fs::metadata(path).map_or(0, |metadata| metadata.len());
            if tell_of_end(path, &reader.end()) == Outcome::DataLost {
                *outcome = Outcome::DataLost;
            }
        }
        Ok(Played::File)
    }

    /// Solves one file.
    fn play_file(
        &mut self,
        path: &Path,
        reader: &mut CaptureReader,
        to_ns: u64,
        read_bytes: u64,
    ) -> Result<Played, CommandError> {
        let mut segment = Segment::default();
        while let Some(entry) = reader.next(&mut segment)? {
            match entry {
                Entry::Setup(setup) => self.set_up(setup)?,
                Entry::Hello { device, .. } => self.feed(path, Some(device), &segment)?,
                Entry::Link { log_ns, .. } if log_ns > to_ns.saturating_add(LATEST_NS) => return Ok(Played::Enough),
                Entry::Link { log_ns, .. } if log_ns > to_ns => {}
                Entry::Link { device, .. } => self.feed(path, device, &segment)?,
            }
            if let Some(progress) = &mut self.progress {
                progress.at(read_bytes + reader.end().whole_bytes);
            }
            if let Some(from_s) = self.keep_pace() {
                return Ok(Played::Leap(from_s));
            }
            if self.is_over() {
                return Ok(Played::Enough);
            }
        }
        Ok(Played::File)
    }

    /// Waits until it is time for the next bytes; returns where to go on from if that is elsewhere.
    fn keep_pace(&mut self) -> Option<f64> {
        while !self.stop.load(Ordering::Relaxed) {
            let leap = self.heed(false);
            if leap.is_some() {
                return leap;
            }
            if self.player.as_ref().is_some_and(|player| !player.is_playing()) {
                std::thread::sleep(MOMENT);
                continue;
            }
            let due_s = self.elapsed_s() - self.paced_from_s;
            let speed = self.speed;
            if self.pace.get_or_insert_with(|| Pace::new(speed)).nap(due_s) {
                break;
            }
        }
        None
    }

    /// Does what the page asks for, and tells it where the capture is; returns where to go on from if that is elsewhere.
    fn heed(&mut self, ended: bool) -> Option<f64> {
        let elapsed_s = self.elapsed_s();
        let player = self.player.as_mut()?;
        let (was_playing, speed) = (player.is_playing(), self.speed);
        let leap = player.obey(&mut self.speed);
        if self.speed != speed || player.is_playing() != was_playing {
            (self.pace, self.paced_from_s) = (None, elapsed_s);
        }
        let (began, boards) = (self.began, &self.boards);
        player.tell(self.from_s + elapsed_s, self.speed, ended && leap.is_none(), || {
            let Account { boards, recorder } = account(boards);
            DaemonReport::of_now(began, boards, recorder)
        });
        leap
    }

    /// Begins anew, `from_s` after the beginning of the capture.
    fn rewind(&mut self, from_s: f64) {
        self.boards.clear();
        self.unsettled.clear();
        (self.pace, self.paced_from_s, self.from_s) = (None, 0.0, from_s);
    }

    fn is_over(&self) -> bool {
        let is_complete = !self.boards.is_empty() && self.boards.iter().all(|board| board.pipeline.is_complete());
        is_complete || self.stop.load(Ordering::Relaxed)
    }

    fn elapsed_s(&self) -> f64 {
        self.boards.iter().map(|board| board.pipeline.elapsed_s()).fold(0.0, f64::max)
    }

    /// Prepares for a board, unless it goes on as it was.
    fn set_up(&mut self, setup: Box<Setup>) -> Result<(), CommandError> {
        let known = self.boards.iter().position(|board| board.device == Some(setup.device));
        if known.is_some_and(|at| self.boards[at].setup.as_ref() == Some(&setup)) {
            return Ok(());
        }
        let (file, scene_match) = match &self.play.scene {
            Some(scene) => (SceneFile::open(scene)?, SceneMatch::Waived),
            // Also by another calibration than the board belongs to.
            None if self.play.calibration.is_given() => (setup.scene.parse()?, SceneMatch::Waived),
            None => (setup.scene.parse()?, SceneMatch::Required),
        };
        tell_of_scene(&file, Some(setup.scene.hash), scene_match);
        let head = self.play.calibration.head(file, |file| head_of(file, &setup, self.play.scene.is_some()))?;
        let pipeline = self.pipeline(head.clone(), scene_match, Some(&setup));
        let device = Some(setup.device);
        let board = Board::new(device, Some(setup), head, pipeline);
        match known {
            Some(at) => self.boards[at] = board,
            None => self.boards.push(board),
        }
        self.show_boards();
        Ok(())
    }

    /// Shows the page which boards there are.
    fn show_boards(&mut self) {
        let Some(player) = &self.player else { return };
        let live = player.live();
        for (number, board) in self.boards.iter_mut().enumerate() {
            board.sampler = Some(Sampler::new(number, live.clone()));
        }
        let shown = |board: &Board| LiveBoard { name: board.name(), head: Some(board.head.clone()) };
        live.boards(self.boards.iter().map(shown).collect());
    }

    fn pipeline(&self, head: Head, scene_match: SceneMatch, setup: Option<&Setup>) -> Pipeline {
        let settings = setup.map(|setup| setup.settings);
        let pipeline = Pipeline::new(head, self.poses.tier_or(settings.map(|settings| settings.tier)), scene_match)
            .until(self.poses.duration)
            .following(self.poses.following_or(settings.map(|settings| settings.following)));
        // Only people look at the cells.
        if self.format == Format::Summary || self.player.is_some() { pipeline.watched() } else { pipeline }
    }

    fn feed(&mut self, path: &Path, device: Option<DeviceId>, segment: &Segment) -> Result<(), CommandError> {
        let at = match self.boards.iter().position(|board| board.device == device) {
            Some(at) => at,
            None if device.is_some() && self.play.scene.is_none() => {
                self.pass_over(path, device);
                return Ok(());
            }
            // Bytes of a port, whose nothing says; or of a board, of which no more is known.
            None => {
                let (file, scene_match) = self.scene_of_bytes(path)?;
                let head = self.play.calibration.head(file, Head::uncalibrated)?;
                let pipeline = self.pipeline(head.clone(), scene_match, None);
                self.boards.push(Board::new(device, None, head, pipeline));
                self.show_boards();
                self.boards.len() - 1
            }
        };
        if self.comparison.is_some() && self.boards.len() > 1 {
            return Err(PlaybackError::SeveralBoards.into());
        }
        let Self { boards, sink, comparison, target, .. } = self;
        let printing = |source| OutputError::Write { target: (*target).to_owned(), source };
        let Board { pipeline, statistics, sampler, host_clock, is_unusable, .. } = &mut boards[at];
        let statistics = statistics.get_mut();
        *is_unusable &= !segment.opened;
        if *is_unusable {
            return Ok(());
        }
        for set_by_s in segment.reads.iter().filter_map(|read| host_clock.set_by_s(read.at?)) {
            talk(format_args!("the clock of the host was set by {set_by_s:+.3} s while it recorded"));
        }
        let fed = pipeline.feed(segment, |item| {
            statistics.update(&item, None, None);
            match item {
                Item::Pose(record) => {
                    if let Some(comparison) = comparison {
                        comparison.add(record)?;
                    }
                    if let Some(sampler) = sampler {
                        sampler.add(record);
                    }
                    if let Some(sink) = sink {
                        sink.pose(record).map_err(printing)?;
                    }
                }
                Item::Hello(hello) => {
                    if let Some(sink) = sink {
                        sink.note(&Note::hello(hello)).map_err(printing)?;
                    }
                }
                Item::Event { severity, device_time_s, text } => {
                    if let Some(sink) = sink {
                        let note = Note::Event { device, severity, device_time_s, text: text.to_owned() };
                        sink.note(&note).map_err(printing)?;
                    }
                }
                Item::Oddity { device_time_s, oddity } => {
                    talk(format_args!("{oddity}"));
                    if let Some(sink) = sink {
                        let (severity, text) = (slitpose_protocol::Severity::Warning, oddity.to_string());
                        sink.note(&Note::Event { device, severity, device_time_s, text }).map_err(printing)?;
                    }
                }
                // What a board was asked is history.
                Item::Scan(_) | Item::Status(_) | Item::Reply(_) => {}
            }
            Ok::<_, CommandError>(())
        });
        match fed {
            // Then the daemon had lost its board, and looked for it again.
            Err(CommandError::Board(error)) if pipeline.counts().scans > 0 => {
                talk(format_args!("{error}; going on where the link was opened anew"));
                *is_unusable = true;
            }
            fed => drop(fed?),
        }
        if let Some(sampler) = sampler {
            sampler.send(pipeline.photocurrents(), HostInstant::now());
        }
        let account = || account(&self.boards);
        match &mut self.sink {
            Some(sink) => Ok(sink.tick(&account).map_err(printing)?),
            None => Ok(()),
        }
    }

    /// Says that nothing can be made of the bytes of a board.
    fn pass_over(&mut self, path: &Path, device: Option<DeviceId>) {
        if let Some(device) = device
            && self.unsettled.insert(device)
        {
            talk(format_args!(
                "{}: the settings of board {device} cannot be read anywhere, and its bytes are passed over; \
                 give --scene, and --tier, --tolerance and --filter as they were",
                path.display()
            ));
        }
    }

    /// The scene for the bytes of a port: that asked for, else the shipped one that the board names.
    fn scene_of_bytes(&self, path: &Path) -> Result<(SceneFile, SceneMatch), CommandError> {
        let hash = scene_hash(path)?;
        let (file, scene_match) = match &self.play.scene {
            Some(scene) => (SceneFile::open(scene)?, SceneMatch::Waived),
            None => {
                let file = hash.and_then(Shipped::with_hash).map_or_else(|| WIDE.read(), Ok)?;
                (file, SceneMatch::Required)
            }
        };
        tell_of_scene(&file, hash, scene_match);
        Ok((file, scene_match))
    }

    fn end(mut self, mut outcome: Outcome, is_over: bool) -> Result<Outcome, CommandError> {
        let account = || account(&self.boards);
        if let Some(sink) = &mut self.sink {
            let target = self.target.to_owned();
            sink.finish(&account).map_err(|source| OutputError::Write { target, source })?;
        }
        let (mut scans, mut bytes, mut packets) = (0, 0, 0);
        for board in &self.boards {
            let counts = board.pipeline.counts();
            scans += counts.scans;
            bytes += counts.decoder.bytes;
            packets += counts.decoder.packets;
            let name = board.device.map_or_else(|| "capture".to_owned(), |device| format!("board {device}"));
            if losses::tell(&name, &counts, is_over) == Outcome::DataLost {
                outcome = Outcome::DataLost;
            }
        }
        if !self.unsettled.is_empty() {
            outcome = Outcome::DataLost;
        }
        if let Some(comparison) = &self.comparison {
            comparison.lines().iter().for_each(|line| talk(format_args!("{line}")));
        }
        match self.files.first() {
            // Interrupted where the page had led it.
            _ if self.player.is_some() => Ok(outcome),
            Some(path) if scans == 0 && self.play.from.is_some() => {
                Err(PlaybackError::Beyond { path: path.clone(), from_s: self.play.from.unwrap_or_default() }.into())
            }
            Some(path) if scans == 0 => Err(PlaybackError::NoScan { path: path.clone(), bytes, packets }.into()),
            _ => Ok(outcome),
        }
    }
}

/// How all of them did; nothing is recorded.
fn account(boards: &[Board]) -> Account {
    Account { boards: boards.iter().map(Board::report).collect(), recorder: RecorderReport::default() }
}

impl Board {
    fn new(device: Option<DeviceId>, setup: Option<Box<Setup>>, head: Head, pipeline: Pipeline) -> Self {
        let statistics = RefCell::new(BoardStatistics::new(name_of(device), HostInstant::now()));
        let host_clock = HostClock::default();
        Self { device, setup, head, pipeline, statistics, sampler: None, host_clock, is_unusable: false }
    }

    fn name(&self) -> String {
        name_of(self.device)
    }

    fn report(&self) -> BoardReport {
        let now = HostInstant::now();
        let report = self.statistics.borrow_mut().report(&self.pipeline.counts(), self.pipeline.health(), now);
        // What a capture has to say it has said.
        let link = LinkReport { state: LinkState::Ended, since_utc_ns: now.utc_ns, ..LinkReport::default() };
        BoardReport { link, ..report }
    }
}

fn name_of(device: Option<DeviceId>) -> String {
    device.map_or_else(|| "capture".to_owned(), |device| device.to_string())
}

impl From<PipelineError> for CommandError {
    fn from(error: PipelineError) -> Self {
        Self::Board(error.into())
    }
}

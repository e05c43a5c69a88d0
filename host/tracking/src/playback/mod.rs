//! Captures through the pipeline again, as `replay` and `export` do.
//!
//! [`Playback::step`] solves the next entry of the captures and passes the results on, [`Playback::end`] reports what was
//! lost. The same bytes give the same poses, bit for bit, with one exception: a part that does not begin at the beginning
//! finds its first pose from nothing. [`Yields::PosesOfPart`] is for parts that are to give what the whole gives.

mod board;
mod files;

use std::collections::{BTreeSet, VecDeque};
use std::fs::{self, File};
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use serde::Serialize;
use slitpose_calibration::Head;
use slitpose_head::scene_file::{SceneFile, Shipped, WIDE};
use slitpose_model::Photocurrents;

pub use crate::capture::CaptureError;
use crate::capture::{CaptureReader, CapturedBasis, Entry, Setup};
use crate::clock::UtcWatch;
use crate::link::{DeviceId, Segment};
use crate::pipeline::{Item, Pipeline, PipelineError, Scan, SceneMatch};
use crate::solving::head_by;
pub use board::{Board, Choice, PlaybackError, Seam, Yields};
pub use files::Survey;

use board::{Faulty, Past, Phase};

/// Boards are recorded a piece at a time: what one said before the end may stand so far behind it.
const LATEST_NS: u64 = 1_000_000_000;

/// Time between bytes and a part that begins right behind them: reads are farther apart.
const AFTER_S: f64 = 1e-6;

/// A result of playing captures. Boards have the `number` that they have in [`Playback::boards`]; `device` is `None` in the
/// bytes of a port.
#[derive(Debug)]
#[allow(missing_docs, reason = "fields are named by what they are")]
pub enum Event<'a> {
    /// There is a board, or it begins anew with other settings.
    Board { number: usize, device: Option<DeviceId> },
    /// What the pipeline of a board gave.
    Item { number: usize, device: Option<DeviceId>, item: Item<'a> },
    /// A scan that is not solved.
    Currents { number: usize, device: Option<DeviceId>, scan: &'a Scan, currents: &'a Photocurrents },
    /// Something the user wants to know.
    Remark(&'a str),
    /// Data that were damaged or lost.
    Loss(&'a str),
}

/// What captures hold besides poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outline {
    /// Time between the first bytes and the last, seconds; zero where bytes have no times.
    pub length_s: f64,
    /// What persons noted while they were recorded.
    pub notes: Vec<OutlineNote>,
}

/// What a person noted of an instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutlineNote {
    /// The instant, seconds after the first bytes.
    pub at_s: f64,
    /// Its text.
    pub text: String,
}

/// Where captures are read from.
pub trait Shelf {
    /// What a capture is read from.
    type Input: Read + Seek;

    /// Opens the capture called `path`.
    ///
    /// # Errors
    /// What is not there, or is no capture.
    fn open(&self, path: &Path) -> Result<CaptureReader<Self::Input>, CaptureError>;

    /// Its length, bytes; zero if it cannot be told.
    fn length(&self, path: &Path) -> u64;
}

/// The file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

impl Shelf for Disk {
    type Input = File;

    fn open(&self, path: &Path) -> Result<CaptureReader, CaptureError> {
        CaptureReader::open(path)
    }

    fn length(&self, path: &Path) -> u64 {
        fs::metadata(path).map_or(0, |metadata| metadata.len())
    }
}

/// Captures being solved.
///
/// ```
/// use slitpose_head::{scene_file::WIDE, simulator::{SimulatedBoard, Trajectory, TrajectoryKind}};
/// use slitpose_model::Tier;
/// use slitpose_tracking::{pipeline::Item, playback::{Choice, Event, Playback, PlaybackError}};
///
/// let still = Trajectory::of_kind(TrajectoryKind::Still, 1, f64::INFINITY);
/// let mut board = SimulatedBoard::new(&WIDE.read()?, still, Tier::Paper, 1)?;
/// board.ask(1, slitpose_protocol::Command::Start);
/// let mut bytes = Vec::new();
/// (0..400).for_each(|_| board.step(&mut bytes));
/// let path = std::env::temp_dir().join(format!("slitpose-example-{}.bin", std::process::id()));
/// std::fs::write(&path, bytes)?;
/// let (mut poses, mut playback) = (0, Playback::open(vec![path.clone()], Choice::default())?);
/// while playback.step(|event| {
///     poses += usize::from(matches!(event, Event::Item { item: Item::Pose(_), .. }));
///     Ok::<_, PlaybackError>(())
/// })? {}
/// assert_eq!(poses, 400);
/// # std::fs::remove_file(path)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Playback<S: Shelf = Disk> {
    shelf: S,
    choice: Choice,
    files: VecDeque<PathBuf>,
    first: Option<PathBuf>,
    reader: Option<(PathBuf, CaptureReader<S::Input>)>,
    segment: Segment,
    turns_ns: [u64; 3],
    start_ns: u64,
    /// The boards so far.
    pub boards: Vec<Board>,
    /// Boards that the capture names without data.
    unsettled: BTreeSet<DeviceId>,
    /// Names of the first topics of the captures.
    topics: BTreeSet<String>,
    read_bytes: u64,
    is_over: bool,
}

impl Playback {
    /// The captures `files`, those of a series in their order.
    ///
    /// # Errors
    /// A first file that cannot be read, what is no regular file, a file given twice, and a part that ends before it begins.
    pub fn open(files: Vec<PathBuf>, choice: Choice) -> Result<Self, PlaybackError> {
        choice.check()?;
        files::check(&files)?;
        Self::on(Disk, files, choice)
    }

    /// Length and notes of the captures `files`; reads all of them, as long as `goes_on` allows, which is given the length
    /// so far.
    ///
    /// # Errors
    /// Files that cannot be read.
    pub fn outline(files: &[PathBuf], goes_on: &mut dyn FnMut(f64) -> bool) -> Result<Outline, PlaybackError> {
        let mut survey = Survey::of(files);
        while survey.step(&Disk)? {
            if !goes_on(survey.length_s()) {
                return Ok(Outline::default());
            }
        }
        Ok(survey.outline())
    }
}

impl<S: Shelf> Playback<S> {
    /// The captures called `files` on `shelf`, those of a series in their order.
    ///
    /// # Errors
    /// A first one that cannot be read, and a part that ends before it begins.
    pub fn on(shelf: S, files: Vec<PathBuf>, choice: Choice) -> Result<Self, PlaybackError> {
        choice.check()?;
        let start_ns = files.first().map(|file| files::first_log_ns(&shelf, file)).transpose()?.unwrap_or(0);
        let at_ns = |offset_s: f64| start_ns.saturating_add((offset_s * 1e9) as u64);
        let warm_up_s = match choice.yields {
            Yields::PosesOfPart { warm_up_s } => warm_up_s,
            Yields::Poses | Yields::Currents => 0.0,
        };
        // A part without a beginning has everything from the first byte on.
        let from_ns = choice.from_s.map_or(0, at_ns);
        let warm_ns = choice.from_s.map_or(0, |from_s| if from_s > warm_up_s { at_ns(from_s - warm_up_s) } else { 0 });
        let turns_ns = [warm_ns, from_ns, choice.to_s.map_or(u64::MAX, at_ns)];
        Ok(Self {
            shelf,
            choice,
            first: files.first().cloned(),
            files: files.into(),
            reader: None,
            segment: Segment::default(),
            turns_ns,
            start_ns,
            boards: Vec::new(),
            unsettled: BTreeSet::new(),
            topics: BTreeSet::new(),
            read_bytes: 0,
            is_over: false,
        })
    }

    /// Bytes of the files that have been read.
    pub fn read_bytes(&self) -> u64 {
        self.read_bytes + self.reader.as_ref().map_or(0, |(_, reader)| reader.end().whole_bytes)
    }

    /// Device time since the first scan, of the board with the most, seconds.
    pub fn elapsed_s(&self) -> f64 {
        self.boards.iter().map(|board| board.pipeline.elapsed_s()).fold(0.0, f64::max)
    }

    /// Of each board, what its poses depended on at both ends of the part.
    pub fn seams(&self) -> impl Iterator<Item = (Option<DeviceId>, Seam)> {
        self.boards.iter().map(|board| (board.device, board.past.seam))
    }

    /// Of each board, when its sessions began, seconds after the beginning of the captures. A part that begins then, and
    /// is warmed up for a moment, has a tracker without a past, as the whole has. The first session is not among them.
    pub fn sessions(&self) -> impl Iterator<Item = (Option<DeviceId>, &[f64])> {
        self.boards.iter().map(|board| (board.device, board.past.sessions_s.as_slice()))
    }

    /// Solves the next entry of the captures and passes the results to `hear`; returns whether there was an entry.
    ///
    /// # Errors
    /// Files that cannot be read, boards that do not suit the scene, and errors of `hear`.
    pub fn step<E: From<PlaybackError>>(
        &mut self,
        mut hear: impl FnMut(Event<'_>) -> Result<(), E>,
    ) -> Result<bool, E> {
        let hear: Hear<'_, E> = &mut hear;
        while !self.is_over {
            let Some((path, mut reader)) = self.reader.take() else {
                let Some(path) = self.files.pop_front() else { return Ok(false) };
                let reader = self.shelf.open(&path).map_err(PlaybackError::from)?;
                // A part is decoded from the beginning.
                let from_ns = if self.is_part() { 0 } else { self.turns_ns[1] };
                self.reader = Some((path, reader.starting_at(from_ns)));
                continue;
            };
            let mut segment = std::mem::take(&mut self.segment);
            let next = reader.next(&mut segment).map_err(PlaybackError::from)?;
            let taken = match next {
                Some(entry) => self.take(entry, &path, &segment, hear),
                None => {
                    self.read_bytes += self.shelf.length(&path);
                    let end = reader.end();
                    files::losses(&path, &end).iter().try_for_each(|loss| hear(Event::Loss(loss)))?;
                    self.topics.extend(end.topics);
                    continue;
                }
            };
            (self.reader, self.segment) = (Some((path, reader)), segment);
            taken?;
            let is_complete = !self.boards.is_empty() && self.boards.iter().all(|board| board.pipeline.is_complete());
            self.is_over |= is_complete;
            return Ok(true);
        }
        Ok(false)
    }

    /// Reports missing data to `hear`.
    ///
    /// # Errors
    /// No scan, and errors of `hear`.
    pub fn end<E: From<PlaybackError>>(&mut self, mut hear: impl FnMut(Event<'_>) -> Result<(), E>) -> Result<(), E> {
        // Then the bytes after that were not waited for.
        let is_cut = self.is_over || self.reader.is_some();
        let mut totals = [0; 3];
        let Choice { scene, calibration, from_s, to_s, duration_s, .. } = &self.choice;
        let is_whole = from_s.or(*to_s).or(*duration_s).is_none();
        let are_settings_checked = is_whole && (scene.is_none() || calibration.is_none());
        for (number, board) in self.boards.iter_mut().enumerate() {
            if let (Some(faulty), false) = (&mut board.faulty, board.is_unusable) {
                let device = board.device;
                let listen = |item: Item<'_>| hear(Event::Item { number, device, item }).map_err(Broken::Heard);
                match board.pipeline.feed(faulty.finish(), listen) {
                    Ok(_) => {}
                    Err(Broken::Board(error)) => return Err(PlaybackError::Board(error).into()),
                    Err(Broken::Heard(error)) => return Err(error),
                }
            }
            let board_totals = board.totals();
            (0..3).for_each(|k| totals[k] += board_totals[k]);
            board.past.unused_settings += u64::from(board.is_unused());
            if board.past.unused_settings > 0 && board_totals[0] > 0 && are_settings_checked {
                hear(Event::Loss(&format!(
                    "{}: {} of its settings apply to no bytes: the program that rewrote the capture has moved them, and \
                     {} scans may be solved with the wrong ones; replay the captures as they were recorded, or give \
                     --scene and --calibration",
                    board.name(),
                    board.past.unused_settings,
                    board_totals[0]
                )))?;
            }
            if board.phase == Phase::Within {
                board.past.seam.behind = board.pipeline.state();
            }
            if let Some(losses) = board.pipeline.counts().losses(is_cut) {
                hear(Event::Loss(&format!("{}: {losses}", board.name())))?;
            }
        }
        let [scans, bytes, packets] = totals;
        match (&self.first, self.choice.from_s) {
            // A part may hold nothing.
            _ if self.is_part() => Ok(()),
            (Some(path), Some(from_s)) if scans == 0 => {
                Err(PlaybackError::Beyond { path: path.clone(), from_s }.into())
            }
            (Some(path), None) if scans == 0 => {
                let topics = std::mem::take(&mut self.topics);
                Err(PlaybackError::NoScan { path: path.clone(), bytes, packets, topics }.into())
            }
            _ => Ok(()),
        }
    }

    fn is_part(&self) -> bool {
        matches!(self.choice.yields, Yields::PosesOfPart { .. })
    }

    fn take<E: From<PlaybackError>>(
        &mut self,
        entry: Entry,
        path: &Path,
        segment: &Segment,
        hear: Hear<'_, E>,
    ) -> Result<(), E> {
        let [_, _, to_ns] = self.turns_ns;
        match entry {
            Entry::Setup(setup) => self.set_up(setup, hear),
            Entry::Note { stamp_ns, text, .. } => {
                let is_wanted = (self.turns_ns[1]..=self.turns_ns[2]).contains(&stamp_ns) && !self.is_part();
                let remark = || format!("note at {:.3} s: {text}", files::since_s(self.start_ns, stamp_ns));
                if is_wanted { hear(Event::Remark(&remark())) } else { Ok(()) }
            }
            Entry::Hello { device, .. } => self.feed(path, Some(device), None, segment, hear),
            Entry::Link { device, log_ns } => {
                let is_late = log_ns > to_ns.saturating_add(LATEST_NS);
                if self.is_part() {
                    self.feed(path, device, Some(log_ns), segment, hear)?;
                    self.is_over = is_late && self.boards.iter().all(|board| board.phase == Phase::Behind);
                    return Ok(());
                }
                self.is_over = is_late;
                if log_ns > to_ns { Ok(()) } else { self.feed(path, device, Some(log_ns), segment, hear) }
            }
        }
    }

    /// Prepares for a board, unless it goes on as it was.
    fn set_up<E: From<PlaybackError>>(&mut self, setup: Box<Setup>, hear: Hear<'_, E>) -> Result<(), E> {
        let known = self.boards.iter().position(|board| board.device == Some(setup.device));
        if known.is_some_and(|at| self.boards[at].setup.as_ref() == Some(&setup)) {
            return Ok(());
        }
        let hash = Some(setup.scene.hash);
        self.open_board(Some(setup.device), Some(setup), hash, hear).map(drop)
    }

    /// A board with the scene of `hash`, known or new; a known one goes on with these settings. Gives its number.
    fn open_board<E: From<PlaybackError>>(
        &mut self,
        device: Option<DeviceId>,
        setup: Option<Box<Setup>>,
        hash: Option<u64>,
        hear: Hear<'_, E>,
    ) -> Result<usize, E> {
        let (file, scene_match) = self.scene_of(setup.as_deref(), hash)?;
        if let Some(remark) = files::other_scene(&file, hash, scene_match) {
            hear(Event::Remark(&remark))?;
        }
        let is_scene_given = self.choice.scene.is_some();
        let head = head_by(self.choice.calibration.as_deref(), file, |file| match &setup {
            Some(setup) => head_of(file, setup, is_scene_given),
            None => Head::uncalibrated(file).map_err(PlaybackError::from),
        })?;
        let pipeline = self.pipeline(head.clone(), scene_match, setup.as_deref());
        let mut board = Board {
            device,
            pipeline,
            setup,
            phase: if self.is_part() { Phase::Before } else { Phase::Within },
            faulty: None,
            utc: UtcWatch::default(),
            is_unusable: false,
            begins_anew: false,
            past: Past::default(),
            head,
        };
        let known = self.boards.iter().position(|known| known.device == device);
        match known {
            Some(at) => {
                let before = &mut self.boards[at];
                if let Some(losses) = before.pipeline.counts().losses(true) {
                    hear(Event::Loss(&format!("{}: {losses}", before.name())))?;
                }
                let (earlier, unused) = (before.totals(), u64::from(before.is_unused()));
                (board.phase, board.faulty) = (before.phase, before.faulty.take());
                board.past = std::mem::take(&mut before.past);
                (board.past.earlier, board.past.unused_settings) = (earlier, board.past.unused_settings + unused);
                *before = board;
            }
            None => {
                board.faulty =
                    Faulty::of(&self.choice, board.head.file.scene.cells.len()).map_err(PlaybackError::from)?;
                self.boards.push(board);
            }
        }
        let number = known.unwrap_or(self.boards.len() - 1);
        hear(Event::Board { number, device })?;
        Ok(number)
    }

    /// The scene asked for, else that of the settings; for the bytes of a port the shipped one that the board names.
    fn scene_of(&self, setup: Option<&Setup>, hash: Option<u64>) -> Result<(SceneFile, SceneMatch), PlaybackError> {
        Ok(match (&self.choice.scene, setup) {
            (Some(scene), _) => (SceneFile::open(scene)?, SceneMatch::Waived),
            // Also by another calibration than the board belongs to.
            (None, Some(setup)) if self.choice.calibration.is_some() => (setup.scene.parse()?, SceneMatch::Waived),
            (None, Some(setup)) => (setup.scene.parse()?, SceneMatch::Required),
            (None, None) => (hash.and_then(Shipped::with_hash).map_or_else(|| WIDE.read(), Ok)?, SceneMatch::Required),
        })
    }

    fn pipeline(&self, head: Head, scene_match: SceneMatch, setup: Option<&Setup>) -> Pipeline {
        let (settings, solving) = (setup.map(|setup| setup.settings), &self.choice.solving);
        let pipeline = Pipeline::new(head, solving.tier_or(settings.map(|settings| settings.tier)), scene_match)
            .until(self.choice.duration_s)
            .following(solving.following_or(settings.map(|settings| settings.following)))
            .in_frame(self.choice.view);
        if self.choice.is_watched { pipeline.watched() } else { pipeline }
    }

    fn feed<E: From<PlaybackError>>(
        &mut self,
        path: &Path,
        device: Option<DeviceId>,
        log_ns: Option<u64>,
        segment: &Segment,
        hear: Hear<'_, E>,
    ) -> Result<(), E> {
        let Some(number) = self.number_of(path, device, hear)? else { return Ok(()) };
        let turns_ns = self.turns_ns;
        let (yields, is_part, start_ns) = (self.choice.yields, self.is_part(), self.start_ns);
        let board = &mut self.boards[number];
        let sessions = board.pipeline.sessions();
        if let Some(log_ns) = log_ns.filter(|_| is_part) {
            if device.is_none() && turns_ns != [0, 0, u64::MAX] {
                return Err(PlaybackError::Timeless { path: path.to_owned() }.into());
            }
            board.advance(log_ns, turns_ns);
        }
        if board.phase == Phase::Behind {
            return Ok(());
        }
        board.is_unusable &= !segment.opened;
        if board.is_unusable {
            return Ok(());
        }
        let is_heard = board.phase == Phase::Within;
        for set_by_s in segment.reads.iter().filter_map(|read| board.utc.step_s(read.at?)) {
            if is_heard {
                let remark = format!("the clock of the host was set by {set_by_s:+.3} s while it recorded");
                hear(Event::Remark(&remark))?;
            }
        }
        let listen = |item: Item<'_>| match is_heard {
            true => hear(Event::Item { number, device, item }).map_err(Broken::Heard),
            false => Ok(()),
        };
        let segment = match &mut board.faulty {
            Some(faulty) => faulty.pass(segment),
            None => segment,
        };
        let pipeline = &mut board.pipeline;
        let fed = if yields == Yields::Currents || board.phase == Phase::Before {
            pipeline.receive(segment, listen)
        } else {
            pipeline.feed(segment, listen)
        };
        match fed {
            Ok(_) => {}
            // Then the daemon had lost its board, and looked for it again.
            Err(Broken::Board(error)) if pipeline.counts().scans > 0 => {
                board.is_unusable = true;
                if is_heard {
                    hear(Event::Remark(&format!("{error}; going on where the link was opened anew")))?;
                }
            }
            Err(Broken::Board(error)) => return Err(PlaybackError::Board(error).into()),
            Err(Broken::Heard(error)) => return Err(error),
        }
        let begins = pipeline.sessions() > sessions;
        board.begins_anew |= begins && std::mem::replace(&mut board.past.has_begun, true);
        if let Some(log_ns) = log_ns.filter(|_| board.begins_anew) {
            board.begins_anew = false;
            // Behind these bytes, ahead of the next.
            board.past.sessions_s.push(log_ns.saturating_sub(start_ns) as f64 * 1e-9 + AFTER_S);
        }
        if yields == Yields::Currents {
            while let Some((scan, currents)) = pipeline.take_currents() {
                hear(Event::Currents { number, device, scan: &scan, currents: &currents })?;
            }
        } else {
            pipeline.skip(pipeline.queue().waiting);
        }
        Ok(())
    }

    /// The number of a board; `None` if nothing can be made of its bytes.
    fn number_of<E: From<PlaybackError>>(
        &mut self,
        path: &Path,
        device: Option<DeviceId>,
        hear: Hear<'_, E>,
    ) -> Result<Option<usize>, E> {
        if let Some(number) = self.boards.iter().position(|board| board.device == device) {
            return Ok(Some(number));
        }
        if let Some(device) = device
            && self.choice.scene.is_none()
        {
            if self.unsettled.insert(device) {
                hear(Event::Loss(&format!(
                    "{}: the settings of board {device} cannot be read anywhere, and its bytes are passed over; \
                     give --scene and --calibration (`none`: it had none), and --tier, --tolerance and --filter as they \
                     were; `mcap filter` keeps settings with --include-metadata --include-attachments",
                    path.display()
                )))?;
            }
            return Ok(None);
        }
        if let Some(device) = device
            && self.choice.calibration.is_none()
        {
            hear(Event::Loss(&format!(
                "{}: the settings of board {device} cannot be read, and it is solved without a calibration; give \
                 --calibration, or `--calibration none` if it had none",
                path.display()
            )))?;
        }
        // Bytes of a port, whose nothing says; or of a board, of which no more is known.
        let hash = files::scene_hash(&self.shelf, path).map_err(PlaybackError::from)?;
        self.open_board(device, None, hash, hear).map(Some)
    }
}

type Hear<'a, E> = &'a mut dyn FnMut(Event<'_>) -> Result<(), E>;

/// Why a segment was not taken whole.
enum Broken<E> {
    Board(PipelineError),
    Heard(E),
}

impl<E> From<PipelineError> for Broken<E> {
    fn from(error: PipelineError) -> Self {
        Self::Board(error)
    }
}

impl Board {
    /// Goes on to the phase of `log_ns`, never back: UTC may be set back.
    fn advance(&mut self, log_ns: u64, [warm_ns, from_ns, to_ns]: [u64; 3]) {
        let phase = match log_ns {
            _ if log_ns >= to_ns => Phase::Behind,
            _ if log_ns >= from_ns => Phase::Within,
            _ if log_ns >= warm_ns => Phase::WarmUp,
            _ => Phase::Before,
        };
        if self.phase < Phase::Within && phase == Phase::Within {
            self.past.seam.before = self.pipeline.state();
        }
        if self.phase == Phase::Within && phase == Phase::Behind {
            self.past.seam.behind = self.pipeline.state();
        }
        self.phase = self.phase.max(phase);
    }
}

/// The head of `file` as it was known in the recording. With another scene than the recorded one, its calibration says
/// nothing.
fn head_of(file: SceneFile, setup: &Setup, is_scene_given: bool) -> Result<Head, PlaybackError> {
    Ok(match &setup.basis {
        CapturedBasis::Calibration(calibration) if file.hash == setup.scene.hash => {
            Head::calibrated(file, calibration.parse()?)?
        }
        CapturedBasis::Tolerances => Head::uncalibrated(file)?,
        CapturedBasis::Scene if !is_scene_given => file.into(),
        CapturedBasis::Scene | CapturedBasis::Calibration(_) => Head::as_scene_says(file)?,
    })
}

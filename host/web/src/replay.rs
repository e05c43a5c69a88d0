//! Captures that are played to the page, and turned into tables.

use std::collections::VecDeque;
use std::path::PathBuf;

use serde_json::json;
use slitpose_head::causes::with_causes;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::columns::CsvRows;
use slitpose_tracking::page::{PlayerOrder, PlayerState, Refusal};
use slitpose_tracking::pipeline::Item;
use slitpose_tracking::playback::{Board, Choice, Event, Playback, PlaybackError, Shelf, Survey};
use slitpose_tracking::telemetry::{BoardStatistics, DaemonReport, RecorderReport};

use crate::Files;
use crate::shown::{Outbox, Shown};

/// Longest time for which captures are read at a stretch: messages of the page wait meanwhile.
const STRETCH_NS: u64 = 12_000_000;

/// Time between messages on the state of the player.
const TELL_EVERY_NS: u64 = 250_000_000;

pub(crate) struct Replay {
    files: Vec<PathBuf>,
    captures: Playback<Files>,
    state: PlayerState,
    from_s: f64,
    /// The instant from which on it is played at its speed, and the place then.
    paced_from: Option<(u64, f64)>,
    /// Reads ahead for length and notes.
    survey: Option<Survey<<Files as Shelf>::Input>>,
    pub(crate) shown: Vec<Shown>,
    statistics: Vec<BoardStatistics>,
    told_ns: u64,
}

impl Replay {
    /// Plays the captures called `files`.
    ///
    /// # Errors
    /// A first one that cannot be read.
    pub(crate) fn new(files: Vec<PathBuf>) -> Result<Self, PlaybackError> {
        let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        Ok(Self {
            captures: Self::captures(&files, 0.0)?,
            state: PlayerState { playing: true, speed: Some(1.0), file: names.join(", "), ..PlayerState::default() },
            from_s: 0.0,
            paced_from: None,
            survey: Some(Survey::of(&files)),
            files,
            shown: Vec::new(),
            statistics: Vec::new(),
            told_ns: 0,
        })
    }

    fn captures(files: &[PathBuf], from_s: f64) -> Result<Playback<Files>, PlaybackError> {
        let from_s = Some(from_s).filter(|from_s| *from_s > 0.0);
        Playback::on(Files, files.to_vec(), Choice { from_s, is_watched: true, ..Choice::default() })
    }

    pub(crate) fn names(&self) -> Vec<String> {
        self.captures.boards.iter().map(Board::name).collect()
    }

    /// The message on the state of the player.
    pub(crate) fn message(&self) -> String {
        self.state.message()
    }

    pub(crate) fn obey(&mut self, order: &PlayerOrder) -> Result<(), Refusal> {
        order.check()?;
        (self.paced_from, self.told_ns) = (None, 0);
        let Some(from_s) = self.state.obey(order) else { return Ok(()) };
        self.from_s = from_s;
        // What could be read once can be read again.
        if let Ok(captures) = Self::captures(&self.files, from_s) {
            self.captures = captures;
        }
        self.shown.clear();
        self.statistics.clear();
        Ok(())
    }

    /// Plays on until the next bytes are due. Returns whether its boards are others than before.
    ///
    /// # Errors
    /// Captures that cannot be read or solved.
    pub(crate) fn tick(&mut self, clock: &dyn Fn() -> HostInstant, out: &mut Outbox) -> Result<bool, PlaybackError> {
        let began_ns = clock().monotonic_ns;
        let is_in_time = || clock().monotonic_ns.saturating_sub(began_ns) < STRETCH_NS;
        let mut has_other_boards = false;
        while self.state.is_playing() && self.is_due(clock().monotonic_ns) {
            let Self { captures, statistics, shown, .. } = self;
            let goes_on = captures.step(|event| hear(event, statistics, shown, clock(), out))?;
            if !goes_on {
                self.state.ended = true;
                self.told_ns = 0;
                match captures.end(|event| hear(event, statistics, shown, clock(), out)) {
                    // A place behind the last scan.
                    Err(PlaybackError::Beyond { .. }) => {}
                    ended => ended?,
                }
            }
            if self.shown.len() != self.captures.boards.len() {
                let of = |(number, board): (usize, &Board)| Shown::new(number, &board.head);
                self.shown = self.captures.boards.iter().enumerate().map(of).collect();
                has_other_boards = true;
            }
            for (shown, board) in self.shown.iter_mut().zip(&self.captures.boards) {
                if !has_other_boards {
                    shown.send(board.pipeline.last_photocurrents(), clock(), out);
                }
            }
            if has_other_boards || !is_in_time() {
                break;
            }
        }
        while let Some(survey) = &mut self.survey
            && is_in_time()
        {
            let goes_on = survey.step(&Files)?;
            self.state.duration_s = survey.length_s();
            if !goes_on {
                self.state.notes = survey.outline().notes;
                self.survey = None;
            }
        }
        Ok(has_other_boards)
    }

    fn is_due(&mut self, now_ns: u64) -> bool {
        let elapsed_s = self.captures.elapsed_s();
        let (since_ns, from_s) = *self.paced_from.get_or_insert((now_ns, elapsed_s));
        let passed_s = now_ns.saturating_sub(since_ns) as f64 * 1e-9;
        self.state.speed.is_none_or(|speed| elapsed_s - from_s <= passed_s * speed)
    }

    /// Tells the page how far it is, four times a second; returns whether it did.
    pub(crate) fn tell(&mut self, now: HostInstant, out: &mut Outbox) -> bool {
        if now.monotonic_ns.saturating_sub(self.told_ns) < TELL_EVERY_NS {
            return false;
        }
        self.told_ns = now.monotonic_ns;
        self.state.position_s = self.from_s + self.captures.elapsed_s();
        self.state.duration_s = self.state.duration_s.max(self.state.position_s);
        out.push(self.state.message());
        true
    }

    pub(crate) fn report(&mut self, began: HostInstant, now: HostInstant) -> DaemonReport {
        let boards = self.statistics.iter_mut().zip(&self.captures.boards);
        let boards = boards.map(|(statistics, board)| board.report(statistics, now));
        DaemonReport::of(began, now, boards.collect(), RecorderReport::default())
    }
}

fn hear(
    event: Event<'_>,
    statistics: &mut Vec<BoardStatistics>,
    shown: &mut Vec<Shown>,
    now: HostInstant,
    out: &mut Outbox,
) -> Result<(), PlaybackError> {
    match event {
        Event::Board { number, device } => {
            let name = device.map_or_else(|| "capture".to_owned(), |device| device.to_string());
            statistics.truncate(number);
            statistics.push(BoardStatistics::new(name, now));
            // A board that begins anew is shown anew.
            shown.clear();
        }
        Event::Item { number, item, .. } => {
            statistics[number].update(&item, None, None);
            if let (Item::Pose(record), Some(shown)) = (&item, shown.get_mut(number)) {
                shown.add(record);
            }
        }
        Event::Remark(text) | Event::Loss(text) => out.notice(text),
        // Not asked for.
        Event::Currents { .. } => {}
    }
    Ok(())
}

/// Every pose of captures as CSV, byte for byte as `slitpose export` writes it.
pub(crate) struct Export {
    captures: Playback<Files>,
    rows: CsvRows,
    total_bytes: u64,
    has_begun: bool,
    /// What was damaged or lost.
    losses: VecDeque<String>,
}

impl Export {
    /// Of the captures called `files`.
    ///
    /// # Errors
    /// A first one that cannot be read.
    pub(crate) fn new(files: Vec<PathBuf>) -> Result<Self, PlaybackError> {
        let total_bytes = files.iter().map(|file| Files.length(file)).sum();
        let captures = Playback::on(Files, files, Choice::default())?;
        Ok(Self { captures, rows: CsvRows::default(), total_bytes, has_begun: false, losses: VecDeque::new() })
    }

    /// Appends the next rows to `text`; returns the share that is done, and 1 with the last rows.
    ///
    /// # Errors
    /// Captures that cannot be read or solved.
    pub(crate) fn step(&mut self, clock: &dyn Fn() -> HostInstant, text: &mut Vec<u8>) -> Result<f64, PlaybackError> {
        let began_ns = clock().monotonic_ns;
        if !std::mem::replace(&mut self.has_begun, true) {
            self.rows.header(text);
        }
        let Self { captures, rows, losses, .. } = self;
        let mut hear = |event: Event<'_>| {
            match event {
                Event::Item { item: Item::Pose(record), .. } => rows.row(record, text),
                Event::Loss(loss) => losses.push_back(loss.to_owned()),
                _ => {}
            }
            Ok::<_, PlaybackError>(())
        };
        while clock().monotonic_ns.saturating_sub(began_ns) < STRETCH_NS {
            if !captures.step(&mut hear)? {
                captures.end(&mut hear)?;
                return Ok(1.0);
            }
        }
        Ok((captures.read_bytes() as f64 / self.total_bytes.max(1) as f64).min(0.999))
    }

    /// What was damaged or lost so far.
    pub(crate) fn losses(&mut self) -> impl Iterator<Item = String> {
        self.losses.drain(..)
    }
}

/// The message that nothing more comes, because of `error`.
pub(crate) fn ended(error: &PlaybackError) -> String {
    json!({"kind": "ended", "reason": with_causes(error)}).to_string()
}

//! What is behind the page in place of a daemon: one source at a time, and the messages that LIVE.md describes.
//!
//! Time comes in by a clock, bytes by calls; nothing waits.

use std::path::PathBuf;

use glam::DVec3;
use serde_json::json;
use slitpose_calibration::{Calibration, CalibrationFileError, Head};
use slitpose_head::causes::with_causes;
use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::{SceneFile, SceneFileError, Shipped};
use slitpose_model::{Pose, SceneError};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::{COARSE_S, Order, Refusal, Request, SceneView, hello, report_message};
use slitpose_tracking::playback::{PlaybackError, Shelf};
use thiserror::Error;

use crate::followed::{Far, Followed, configuration_of};
use crate::recording::Written;
use crate::replay::{Export, Replay, ended};
use crate::shown::{Outbox, Shown};
use crate::simulated::{SimulatedHead, Simulation, SimulationError};

/// Interval of reports.
const REPORT_EVERY_NS: u64 = 500_000_000;

/// Longest time of a zero, seconds.
const MAX_ZERO_S: f64 = 60.0;

/// No dragged tool is farther from home than this, metres and radians: beyond it all cells are dark.
const FARTHEST: f64 = 10.0;

/// Most characters of a note.
const MAX_NOTE: usize = 500;

/// Why a source cannot be shown.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum SourceError {
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error(transparent)]
    Simulation(#[from] Box<dyn std::error::Error + Send + Sync>),
    #[error(transparent)]
    Playback(#[from] PlaybackError),
}

impl From<SimulationError> for SourceError {
    fn from(error: SimulationError) -> Self {
        Self::Simulation(Box::new(error))
    }
}

/// A text with the name of its file.
#[derive(Clone, Copy, Debug)]
pub struct NamedText<'a> {
    /// The name; that of a shipped scene stands for it if there are no bytes.
    pub name: &'a str,
    /// The bytes.
    pub bytes: &'a [u8],
}

/// The head of `scene`, by `calibration` if there is one.
///
/// # Errors
/// Files that are none, or do not belong together.
pub fn read_head(scene: NamedText<'_>, calibration: Option<NamedText<'_>>) -> Result<Head, SourceError> {
    let file = match Shipped::named(scene.name).filter(|_| scene.bytes.is_empty()) {
        Some(shipped) => shipped.read()?,
        None => SceneFile::from_bytes(scene.name, scene.bytes)?,
    };
    Ok(match calibration {
        Some(NamedText { name, bytes }) => Head::calibrated(file, Calibration::from_bytes(name, bytes)?)?,
        None => Head::uncalibrated(file)?,
    })
}

enum Source<S: Shelf> {
    Nothing,
    Board(Box<Followed>),
    Replay(Box<Replay<S>>),
    Scene { view: Box<SceneView>, head: String, name: String },
}

/// Everything behind a page.
pub struct Station<S: Shelf> {
    clock: Box<dyn Fn() -> HostInstant>,
    began: HostInstant,
    source: Source<S>,
    export: Option<Export<S>>,
    out: Outbox,
    recorded: Written,
    report_due_ns: u64,
    /// Frames of a scene without a board.
    drawn: u64,
    is_greeted: bool,
}

impl<S: Shelf + Clone> Station<S> {
    /// Shows nothing yet; `clock` reads the clocks of the host.
    pub fn new(clock: Box<dyn Fn() -> HostInstant>) -> Self {
        Self {
            began: clock(),
            clock,
            source: Source::Nothing,
            export: None,
            out: Outbox::default(),
            recorded: Written::default(),
            report_due_ns: 0,
            drawn: 0,
            is_greeted: false,
        }
    }

    /// Shows a simulated head from now on.
    ///
    /// # Errors
    /// A head that cannot be simulated.
    pub fn simulate(&mut self, head: Head, simulation: &Simulation) -> Result<(), SourceError> {
        let (now, configuration) = ((self.clock)(), configuration_of(&head)?);
        let far = Far::Simulated(Box::new(SimulatedHead::new(&head.file, &configuration, simulation, now)?));
        self.choose(Source::Board(Box::new(Followed::new("sim", head, configuration, far, now))));
        Ok(())
    }

    /// Shows a board with `head` from now on, whose port the page [opens](Self::port_opened), reads and writes.
    ///
    /// # Errors
    /// A head that no board can measure.
    pub fn follow(&mut self, head: Head) -> Result<(), SourceError> {
        let configuration = configuration_of(&head)?;
        let board = Followed::new("serial port", head, configuration, Far::Port(false), (self.clock)());
        self.choose(Source::Board(Box::new(board)));
        Ok(())
    }

    /// Plays the captures called `files` on `shelf` from now on.
    ///
    /// # Errors
    /// A first one that cannot be read.
    pub fn play(&mut self, shelf: S, files: Vec<PathBuf>) -> Result<(), SourceError> {
        self.choose(Source::Replay(Box::new(Replay::new(shelf, files)?)));
        Ok(())
    }

    /// Shows a scene without a board from now on, whose tool is placed by hand.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn view(&mut self, head: &Head) -> Result<(), SourceError> {
        let (view, name) = (Box::new(SceneView::of(head)?), head.file.name.clone());
        self.choose(Source::Scene { view, head: Shown::new(0, head).head, name });
        Ok(())
    }

    /// Shows nothing from now on; a recording ends.
    pub fn leave(&mut self) {
        self.choose(Source::Nothing);
    }

    fn choose(&mut self, source: Source<S>) {
        self.end_recording();
        self.source = source;
        self.report_due_ns = 0;
        if self.is_greeted {
            self.greet();
        }
    }

    /// Writes every pose of the captures called `files` on `shelf` as CSV to what is [recorded](Self::take_recorded).
    ///
    /// # Errors
    /// A first one that cannot be read.
    pub fn export(&mut self, shelf: S, files: Vec<PathBuf>) -> Result<(), SourceError> {
        self.export = Some(Export::new(shelf, files)?);
        Ok(())
    }

    /// Reads on for the export; returns the share that is done, and 1 at its end, or if there is none.
    ///
    /// # Errors
    /// Captures that cannot be read or solved.
    pub fn step_export(&mut self) -> Result<f64, SourceError> {
        let Some(export) = &mut self.export else { return Ok(1.0) };
        let mut text = Vec::new();
        let share = export.step(&self.clock, &mut text)?;
        export.losses().for_each(|loss| self.out.notice(&loss));
        self.recorded.append(&text);
        if share >= 1.0 {
            self.export = None;
        }
        Ok(share)
    }

    /// The port of the board is open.
    pub fn port_opened(&mut self) {
        if let Source::Board(board) = &mut self.source {
            board.opened((self.clock)());
        }
    }

    /// Bytes that were read from the port at `at`.
    pub fn port_received(&mut self, bytes: &[u8], at: HostInstant) {
        if let Source::Board(board) = &mut self.source {
            board.receive(bytes, at, &self.clock, &mut self.out);
        }
    }

    /// The port is gone.
    pub fn port_closed(&mut self, reason: &str) {
        if let Source::Board(board) = &mut self.source {
            board.closed(reason, (self.clock)());
        }
    }

    /// Tells the board to stop, before its port is closed.
    pub fn stop_board(&mut self) {
        if let Source::Board(board) = &mut self.source {
            board.stop();
        }
    }

    /// Blinks the board's indicator for so many seconds.
    pub fn identify(&mut self, seconds: u8) {
        if let Source::Board(board) = &mut self.source {
            board.identify(seconds);
        }
    }

    /// What is to be written to the port.
    pub fn take_outgoing(&mut self) -> Vec<u8> {
        match &mut self.source {
            Source::Board(board) => board.take_outgoing(),
            _ => Vec::new(),
        }
    }

    /// Begins a recording of the board, called `name`.
    pub fn record(&mut self, name: &str) {
        let refused = match &mut self.source {
            Source::Board(board) => board.record(name, self.recorded.clone()).err().map(|error| with_causes(&error)),
            _ => Some("there is no board to record; choose one".to_owned()),
        };
        if let Some(reason) = refused {
            self.refuse(&Refusal::Recording { reason });
        }
    }

    /// Whether a recording is under way.
    pub fn is_recording(&self) -> bool {
        matches!(&self.source, Source::Board(board) if board.is_recording())
    }

    /// The bytes of recording or export since this was last asked.
    pub fn take_recorded(&mut self) -> Vec<u8> {
        self.recorded.take()
    }

    fn end_recording(&mut self) {
        if let Source::Board(board) = &mut self.source {
            board.end_recording((self.clock)());
        }
    }

    /// The next message for the page.
    pub fn take_message(&mut self) -> Option<String> {
        self.out.take()
    }

    /// Does what is due now. To be called about a hundred times a second.
    pub fn tick(&mut self) {
        let Self { source, out, clock, .. } = self;
        match source {
            Source::Nothing | Source::Scene { .. } => {}
            Source::Board(board) => board.tick(clock, out),
            Source::Replay(replay) => match replay.tick(clock, out) {
                Ok(false) => {
                    if replay.tell(clock(), out) {
                        self.report_due_ns = 0;
                    }
                }
                Ok(true) => self.greet(),
                Err(error) => {
                    out.push(ended(&error));
                    self.source = Source::Nothing;
                }
            },
        }
        let now = (self.clock)();
        if now.monotonic_ns < self.report_due_ns || !self.is_greeted {
            return;
        }
        self.report_due_ns = now.monotonic_ns + REPORT_EVERY_NS;
        let report = match &mut self.source {
            Source::Board(board) => board.report(self.began, now),
            Source::Replay(replay) => replay.report(self.began, now),
            Source::Nothing | Source::Scene { .. } => return,
        };
        self.out.push(report_message(&report, now));
    }

    /// Says what is shown; all before is void.
    fn greet(&mut self) {
        let (source, names, heads) = match &self.source {
            Source::Nothing => ("run", Vec::new(), Vec::new()),
            Source::Board(board) => ("run", vec![board.name().to_owned()], vec![board.shown.head.clone()]),
            Source::Replay(replay) => {
                let heads = replay.shown.iter().map(|shown| shown.head.clone());
                ("replay", replay.names(), heads.chain([replay.message()]).collect())
            }
            Source::Scene { head, name, .. } => ("scene", vec![name.clone()], vec![head.clone()]),
        };
        let mut greeting = hello(source, &names, true);
        (greeting["has_zero"], greeting["has_folder"]) = (false.into(), false.into());
        self.out.push(greeting.to_string());
        heads.into_iter().for_each(|message| self.out.push(message));
    }

    /// Takes a message of the page.
    pub fn request(&mut self, text: &str) {
        let request = match Request::read(text) {
            Ok(request) => request,
            Err(error) => return self.refuse(&Refusal::Unreadable { reason: error.to_string() }),
        };
        let order = match request {
            Request::Hello { .. } => {
                self.out.restart();
                self.is_greeted = true;
                return self.greet();
            }
            Request::Ack { messages } => return self.out.acknowledge(messages),
            Request::Pose { t_m, r_rad } => {
                let drawn = self.draw(t_m, r_rad);
                return self.answer(drawn);
            }
            Request::Record { on } => Order::Record(on),
            Request::Note { text, ago_s } => {
                let text: String = text.chars().filter(|letter| !letter.is_control()).take(MAX_NOTE).collect();
                Order::Note(text, ago_s)
            }
            Request::Player(order) => Order::Player(order),
            Request::SetFrame { board, over_s } => Order::Frame(board, over_s),
            Request::Zero {} => Order::Zero,
            Request::Recordings {} | Request::Rename { .. } | Request::Download { .. } => {
                let instead = "a recording is in the file that was chosen for it";
                return self.refuse(&Refusal::NotHere { what: "folder of recordings", instead });
            }
        };
        let done = self.order(order);
        self.answer(done);
    }

    fn order(&mut self, order: Order) -> Result<Option<String>, Refusal> {
        let now = (self.clock)();
        let not_here = |what, instead| Err(Refusal::NotHere { what, instead });
        let value = |key, value, hint| Err(Refusal::Value { key, value, hint });
        match (order, &mut self.source) {
            (Order::Record(false), Source::Board(board)) => board.end_recording(now),
            // The page begins it with the name of its file.
            (Order::Record(true), _) => {}
            (Order::Note(_, ago_s), Source::Board(_)) if !(0.0..=COARSE_S as f64).contains(&ago_s) => {
                return value("ago_s", ago_s, "seconds from 0, 600 at most");
            }
            (Order::Note(text, ago_s), Source::Board(board)) if board.is_recording() => {
                board.note(&text, ago_s, now);
                return Ok(Some(json!({"kind": "noted", "text": text}).to_string()));
            }
            (Order::Frame(_, Some(over_s)), _) if !(over_s > 0.0 && over_s <= MAX_ZERO_S) => {
                return value("over_s", over_s, "seconds above 0, 60 at most");
            }
            (Order::Frame(_, over_s), Source::Board(board)) => board.zero(over_s),
            (Order::Player(order), Source::Replay(replay)) => replay.obey(&order)?,
            (Order::Player(_), _) => return not_here("player", "open a capture"),
            (Order::Zero, _) => return not_here("6-DoF mouse", "`slitpose run --spacenav PATH --live` has one"),
            (Order::Frame(..), _) => return not_here("frame to set", "choose a board or a simulated head"),
            (Order::Record(_) | Order::Note(..), _) => return not_here("recording", "begin one of a board"),
        }
        Ok(None)
    }

    fn draw(&mut self, t_m: [f64; 3], r_rad: [f64; 3]) -> Result<Option<String>, Refusal> {
        let Source::Scene { view, .. } = &self.source else {
            return Err(Refusal::NotHere { what: "tool to drag", instead: "choose to look at a scene" });
        };
        for (key, values) in [("t_m", t_m), ("r_rad", r_rad)] {
            if let Some(value) = values.into_iter().find(|value| value.abs() > FARTHEST) {
                return Err(Refusal::Value { key, value, hint: "metres and radians within the workspace" });
            }
        }
        self.drawn += 1;
        let pose = Pose::from_vectors(DVec3::from_array(t_m), DVec3::from_array(r_rad));
        Ok(Some(view.frame(self.drawn, &pose)))
    }

    fn answer(&mut self, done: Result<Option<String>, Refusal>) {
        match done {
            Ok(message) => message.into_iter().for_each(|message| self.out.push(message)),
            Err(refusal) => self.refuse(&refusal),
        }
    }

    fn refuse(&mut self, refusal: &Refusal) {
        self.out.push(json!({"kind": "refused", "reason": refusal.to_string()}).to_string());
    }
}

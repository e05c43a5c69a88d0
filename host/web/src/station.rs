//! What is behind the page in place of a daemon: one source at a time, and the messages that LIVE.md describes.
//!
//! Time comes in by a clock, bytes by calls; nothing waits. JavaScript calls the exported functions; what they throw are texts
//! for the user.

use std::path::PathBuf;

use serde_json::{Value, json};
use slitpose_calibration::{Calibration, Head};
use slitpose_head::front_end::board_configuration;
use slitpose_head::scene_file::{SceneFile, Shipped};
use slitpose_head::simulator::TrajectoryKind;
use slitpose_protocol::{Command, Configuration};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::{Order, Refusal, Request, SceneView, hello, report_message};
use wasm_bindgen::prelude::wasm_bindgen;

use crate::conversation::Conversation;
use crate::followed::{Far, Followed};
use crate::recording::Written;
use crate::replay::{Export, Replay, ended};
use crate::shown::{Outbox, Shown};
use crate::simulated::SimulatedHead;

const REPORT_EVERY_NS: u64 = 500_000_000;

/// Longest time of a zero, seconds.
const MAX_ZERO_S: f64 = 60.0;

/// A scene, and the calibration of its head if there is one: names and texts.
#[wasm_bindgen]
pub struct HeadFiles {
    scene: (String, Vec<u8>),
    calibration: Option<(String, Vec<u8>)>,
}

#[wasm_bindgen]
impl HeadFiles {
    /// The scene of this name, shipped if `text` is empty.
    #[wasm_bindgen(constructor)]
    pub fn new(name: String, text: Vec<u8>) -> Self {
        Self { scene: (name, text), calibration: None }
    }

    /// Adds a calibration.
    pub fn calibrate(&mut self, name: String, text: Vec<u8>) {
        self.calibration = Some((name, text));
    }
}

impl HeadFiles {
    fn read(&self) -> anyhow::Result<Head> {
        let (name, text) = &self.scene;
        let file = match Shipped::named(name).filter(|_| text.is_empty()) {
            Some(shipped) => shipped.read()?,
            None => SceneFile::from_bytes(name, text)?,
        };
        Ok(match &self.calibration {
            Some((name, text)) => Head::calibrated(file, Calibration::from_bytes(name, text)?)?,
            None => Head::uncalibrated(file)?,
        })
    }
}

enum Source {
    Nothing,
    /// What could not be played, with the message on it.
    Failed(String),
    Board(Box<Followed>),
    Replay(Box<Replay>),
    Scene {
        view: Box<SceneView>,
        head: String,
        name: String,
    },
}

/// Everything behind a page.
#[wasm_bindgen]
pub struct Station {
    clock: Box<dyn Fn() -> HostInstant>,
    began: HostInstant,
    source: Source,
    export: Option<Export>,
    out: Outbox,
    recorded: Written,
    report_due_ns: u64,
    /// Frames of a scene without a board.
    drawn: u64,
    is_greeted: bool,
}

/// What a failure is for JavaScript.
fn thrown<T>(done: Result<T, impl Into<anyhow::Error>>) -> Result<T, String> {
    done.map_err(|error| format!("{:#}", error.into()))
}

#[wasm_bindgen]
impl Station {
    /// Shows nothing yet.
    #[cfg(target_arch = "wasm32")]
    #[wasm_bindgen(constructor)]
    #[expect(clippy::new_without_default, reason = "JavaScript has no defaults")]
    pub fn new() -> Self {
        Self::by(Box::new(crate::browser::now))
    }

    /// Shows a simulated head: `motion` has the name of one, `faults` has a fault on each line.
    pub fn simulate(&mut self, head: &HeadFiles, motion: &str, seed: u32, faults: &str) -> Result<(), String> {
        let lines = faults.lines().map(str::trim).filter(|line| !line.is_empty());
        let motion = TrajectoryKind::named(motion).unwrap_or(TrajectoryKind::Hand);
        self.follow_by("sim", head, |head, configuration, now| {
            let faults = lines.map(str::parse).collect::<Result<_, _>>()?;
            let far = SimulatedHead::new(&head.simulated, configuration, (motion, seed.into()), faults, now)?;
            Ok(Far::Simulated(Box::new(far)))
        })
    }

    /// Shows a board, whose port the page opens, reads and writes.
    pub fn follow(&mut self, head: &HeadFiles) -> Result<(), String> {
        self.follow_by("serial port", head, |_, _, _| Ok(Far::Port(false)))
    }

    /// Shows a scene, whose tool is placed by hand.
    pub fn view(&mut self, head: &HeadFiles) -> Result<(), String> {
        let scene = || -> anyhow::Result<Source> {
            let head = head.read()?.in_simulation();
            let (view, name) = (Box::new(SceneView::of(&head)?), head.file.name.clone());
            Ok(Source::Scene { view, head: Shown::new(0, &head).head, name })
        };
        self.choose(thrown(scene())?);
        Ok(())
    }

    /// Shows nothing from now on; a recording ends.
    pub fn leave(&mut self) {
        self.choose(Source::Nothing);
    }

    /// Plays the captures of these names.
    pub fn play(&mut self, names: Vec<String>) -> Result<(), String> {
        let replay = thrown(Replay::new(names.into_iter().map(PathBuf::from).collect()))?;
        self.choose(Source::Replay(Box::new(replay)));
        Ok(())
    }

    /// Begins to write every pose of the captures of these names as CSV to what is recorded.
    pub fn export(&mut self, names: Vec<String>) -> Result<(), String> {
        self.export = Some(thrown(Export::new(names.into_iter().map(PathBuf::from).collect()))?);
        Ok(())
    }

    /// Reads on for an export; returns the share that is done, 1 at its end.
    pub fn step_export(&mut self) -> Result<f64, String> {
        let Some(export) = &mut self.export else { return Ok(1.0) };
        let mut text = Vec::new();
        let share = thrown(export.step(&self.clock, &mut text))?;
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

    /// Takes bytes of the port, read `at_ms` milliseconds after 1970 by the clock of the browser that is never set.
    pub fn port_received(&mut self, bytes: &[u8], at_ms: f64) {
        if let Source::Board(board) = &mut self.source {
            let at = HostInstant { monotonic_ns: (at_ms * 1e6) as u64, ..(self.clock)() };
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
        self.conversation(Conversation::stop);
    }

    /// Blinks the board's indicator for so many seconds.
    pub fn identify(&mut self, seconds: u8) {
        self.conversation(|conversation| conversation.command(Command::Identify { seconds }));
    }

    /// What is to be written to the port.
    pub fn take_outgoing(&mut self) -> Vec<u8> {
        match &mut self.source {
            Source::Board(board) => board.take_outgoing(),
            _ => Vec::new(),
        }
    }

    /// Begins a recording of the board, called `name`.
    pub fn record(&mut self, name: &str) -> Result<(), String> {
        match &mut self.source {
            Source::Board(board) => thrown(board.record(name, self.recorded.clone())),
            _ => Err("there is no board to record; choose one".to_owned()),
        }
    }

    /// Whether a recording is under way.
    pub fn is_recording(&self) -> bool {
        matches!(&self.source, Source::Board(board) if board.recording.is_some())
    }

    /// The bytes of recording or export since this was last asked.
    pub fn take_recorded(&mut self) -> Vec<u8> {
        self.recorded.take()
    }

    /// The next message for the page.
    pub fn take_message(&mut self) -> Option<String> {
        self.out.take()
    }

    /// Does what is due now. To be called about a hundred times a second.
    pub fn tick(&mut self) {
        let Self { source, out, clock, .. } = self;
        match source {
            Source::Nothing | Source::Failed(_) | Source::Scene { .. } => {}
            Source::Board(board) => board.tick(clock, out),
            Source::Replay(replay) => match replay.tick(clock, out) {
                Ok(false) if replay.tell(clock(), out) => self.report_due_ns = 0,
                Ok(false) => {}
                Ok(true) => self.greet(),
                Err(error) => {
                    out.push(ended(&error));
                    self.source = Source::Failed(ended(&error));
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
            Source::Nothing | Source::Failed(_) | Source::Scene { .. } => return,
        };
        self.out.push(report_message(&report, now));
    }

    /// Takes a message of the page.
    pub fn request(&mut self, text: &str) {
        let done = match Request::read(text) {
            Ok(request) => self.obey(request),
            Err(error) => Err(Refusal::Unreadable { reason: error.to_string() }),
        };
        let answer = done.unwrap_or_else(|refusal| Some(json!({"kind": "refused", "reason": refusal.to_string()})));
        answer.into_iter().for_each(|answer| self.out.push(answer.to_string()));
    }
}

impl Station {
    /// Shows nothing yet; `clock` reads the clocks of the host.
    pub fn by(clock: Box<dyn Fn() -> HostInstant>) -> Self {
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

    /// Shows a board with the head of `head`; `far` makes what is at the other end.
    fn follow_by(
        &mut self,
        name: &str,
        head: &HeadFiles,
        far: impl FnOnce(&Head, &Configuration, HostInstant) -> anyhow::Result<Far>,
    ) -> Result<(), String> {
        let now = (self.clock)();
        let board = || -> anyhow::Result<Source> {
            let head = head.read()?;
            let configuration = board_configuration(&head.file)?;
            let far = far(&head, &configuration, now)?;
            Ok(Source::Board(Box::new(Followed::new(name, head, configuration, far, now))))
        };
        self.choose(thrown(board())?);
        Ok(())
    }

    /// What `act` does with the conversation, if there is one.
    fn conversation<T>(&mut self, act: impl FnOnce(&mut Conversation) -> T) -> Option<T> {
        match &mut self.source {
            Source::Board(board) => board.conversation.as_mut().map(act),
            _ => None,
        }
    }

    fn choose(&mut self, source: Source) {
        if let Source::Board(board) = &mut self.source {
            board.end_recording((self.clock)());
        }
        self.source = source;
        self.report_due_ns = 0;
        if self.is_greeted {
            self.greet();
        }
    }

    /// Says what is shown; all before is void.
    fn greet(&mut self) {
        let (source, names, messages) = match &self.source {
            Source::Nothing => ("run", Vec::new(), Vec::new()),
            Source::Failed(message) => ("replay", Vec::new(), vec![message.clone()]),
            Source::Board(board) => ("run", vec![board.statistics.report.name.clone()], vec![board.shown.head.clone()]),
            Source::Replay(replay) => {
                let heads = replay.shown.iter().map(|shown| shown.head.clone());
                ("replay", replay.names(), heads.chain([replay.message()]).collect())
            }
            Source::Scene { head, name, .. } => ("scene", vec![name.clone()], vec![head.clone()]),
        };
        self.out.push(hello(source, &names, true).to_string());
        messages.into_iter().for_each(|message| self.out.push(message));
    }

    /// Does what the page asks for; returns the answer, if there is one.
    fn obey(&mut self, request: Request) -> Result<Option<Value>, Refusal> {
        let now = (self.clock)();
        let not_here = |what, instead| Err(Refusal::NotHere { what, instead });
        match (request, &mut self.source) {
            (Request::Hello { .. }, _) => {
                self.out.restart();
                self.is_greeted = true;
                self.greet();
            }
            (Request::Ack { messages }, _) => self.out.acknowledge(messages),
            (Request::Pose { t_m, r_rad }, Source::Scene { view, .. }) => {
                self.drawn += 1;
                self.out.push(view.frame(self.drawn, t_m, r_rad)?);
            }
            (Request::Map { plane, t_m, r_rad }, Source::Scene { view, .. }) => {
                return view.map(plane, t_m, r_rad).map(Some);
            }
            // The page begins one with the name of its file.
            (Request::Record { on: false }, Source::Board(board)) => board.end_recording(now),
            (Request::Note { text, ago_s }, Source::Board(board)) => {
                let (Order::Note(text, ago_s), Some(recording)) = (Order::note(&text, ago_s)?, &mut board.recording)
                else {
                    return not_here("recording", "begin one of a board");
                };
                let done = recording.note(&text, ago_s, now);
                board.settle_recording(done);
                return Ok(Some(json!({"kind": "noted", "text": text})));
            }
            (Request::SetFrame { over_s: Some(value), .. }, _) if !(value > 0.0 && value <= MAX_ZERO_S) => {
                return Err(Refusal::Value { key: "over_s", value, hint: "seconds above 0, 60 at most" });
            }
            (Request::SetFrame { over_s, .. }, Source::Board(board)) => board.pipeline.zero(over_s),
            (Request::Player(order), Source::Replay(replay)) => replay.obey(&order)?,
            (Request::Pose { .. } | Request::Map { .. }, _) => {
                return not_here("tool to drag", "choose to look at a scene");
            }
            (Request::Player(_), _) => return not_here("player", "open a capture"),
            (Request::SetFrame { .. }, _) => return not_here("frame to set", "choose a board or a simulated head"),
            (Request::Record { .. } | Request::Note { .. }, _) => {
                return not_here("recording", "begin one of a board");
            }
            (Request::Calibrate { .. }, _) => return not_here("calibration", "`slitpose calibrate` does it"),
            (Request::Recordings {} | Request::Rename { .. } | Request::Download { .. }, _) => {
                return not_here("folder of recordings", "each is in the file that was chosen for it");
            }
        }
        Ok(None)
    }
}

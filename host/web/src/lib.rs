//! slitpose in a browser: the live page with a simulated head, a board by Web Serial, or a capture, without a server.
//!
//! ```text
//!  page (host/src/live/page) ◀─messages of LIVE.md─▶ worker.js ──calls──▶ Host ──▶ Station ──▶ pipeline, captures, simulator
//!  port by Web Serial        ◀───────bytes─────────▶
//! ```
//!
//! [`Station`] stands behind the page in place of a daemon. It takes time from a clock and bytes from calls, so it runs
//! anywhere; [`Host`] is its thin shell for JavaScript, which runs in a worker, so that the page never waits for it.

mod conversation;
mod followed;
mod recording;
mod replay;
mod shelf;
mod shown;
mod simulated;
mod station;

use std::path::PathBuf;

use serde_json::json;
use slitpose_head::causes::with_causes;
use slitpose_head::faults::{Fault, KINDS};
use slitpose_head::scene_file::SHIPPED;
use slitpose_head::simulator::TrajectoryKind;
use slitpose_tracking::clock::HostInstant;
use wasm_bindgen::JsError;
use wasm_bindgen::prelude::wasm_bindgen;

use shelf::Files;
pub use simulated::Simulation;
pub use station::{NamedText, SourceError, Station, read_head};

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = performance, js_name = timeOrigin, thread_local_v2)]
    static TIME_ORIGIN_MS: f64;
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn now_ms() -> f64;
}

/// The instant `ms` milliseconds after 1970 by the clock of the browser that is never set; UTC is that of now.
fn instant(ms: f64) -> HostInstant {
    HostInstant { monotonic_ns: (ms * 1e6) as u64, utc_ns: (js_sys::Date::now() * 1e6) as u64 }
}

/// What the page offers, as JSON: the shipped scenes, the motions and the kinds of faults.
#[wasm_bindgen]
pub fn choices() -> String {
    let scenes = SHIPPED.iter().map(|scene| json!({"name": scene.name, "about": scene.about, "text": scene.text}));
    let faults = KINDS.iter().map(|kind| json!({"name": kind.name, "example": kind.example, "about": kind.what}));
    json!({
        "scenes": scenes.collect::<Vec<_>>(),
        "motions": TrajectoryKind::NAMED.map(|(name, _)| name),
        "faults": faults.collect::<Vec<_>>(),
    })
    .to_string()
}

/// [`Station`] for JavaScript. Errors are texts for the user.
#[wasm_bindgen]
pub struct Host {
    station: Station<Files>,
}

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

    fn read(&self) -> Result<slitpose_calibration::Head, SourceError> {
        fn named((name, bytes): &(String, Vec<u8>)) -> NamedText<'_> {
            NamedText { name, bytes }
        }
        read_head(named(&self.scene), self.calibration.as_ref().map(named))
    }
}

#[wasm_bindgen]
impl Host {
    /// Shows nothing yet.
    #[wasm_bindgen(constructor)]
    #[expect(clippy::new_without_default, reason = "JavaScript has no defaults")]
    pub fn new() -> Self {
        Self { station: Station::new(Box::new(|| instant(TIME_ORIGIN_MS.with(|origin_ms| *origin_ms) + now_ms()))) }
    }

    /// Shows a simulated head: `motion` is one of the choices, `faults` has a fault on each line.
    pub fn simulate(&mut self, head: &HeadFiles, motion: &str, seed: u32, faults: &str) -> Result<(), JsError> {
        let lines = faults.lines().map(str::trim).filter(|line| !line.is_empty());
        let faults = lines.map(str::parse::<Fault>).collect::<Result<_, _>>().map_err(|error| thrown(&error))?;
        let motion = TrajectoryKind::named(motion).unwrap_or(TrajectoryKind::Hand);
        let simulation = Simulation { motion, seed: seed.into(), faults };
        self.try_source(|station| station.simulate(head.read()?, &simulation))
    }

    /// Shows a board, whose port the page opens.
    pub fn follow(&mut self, head: &HeadFiles) -> Result<(), JsError> {
        self.try_source(|station| station.follow(head.read()?))
    }

    /// Plays captures.
    pub fn play(&mut self, files: Vec<web_sys::File>) -> Result<(), JsError> {
        let (shelf, names) = Files::new(files);
        self.try_source(|station| station.play(shelf, names))
    }

    /// Shows a scene, whose tool is placed by hand.
    pub fn view(&mut self, head: &HeadFiles) -> Result<(), JsError> {
        self.try_source(|station| station.view(&head.read()?))
    }

    /// Shows nothing from now on.
    pub fn leave(&mut self) {
        self.station.leave();
    }

    /// Begins to write the poses of captures as CSV to what is recorded.
    pub fn export(&mut self, files: Vec<web_sys::File>) -> Result<(), JsError> {
        let (shelf, names): (Files, Vec<PathBuf>) = Files::new(files);
        self.try_source(|station| station.export(shelf, names))
    }

    /// Reads on for the export; the share that is done, 1 at its end.
    pub fn step_export(&mut self) -> Result<f64, JsError> {
        self.try_source(Station::step_export)
    }

    /// See [`Station::port_opened`].
    pub fn port_opened(&mut self) {
        self.station.port_opened();
    }

    /// Takes bytes of the port, read `at_ms` milliseconds after 1970 by the clock that is never set.
    pub fn port_received(&mut self, bytes: &[u8], at_ms: f64) {
        self.station.port_received(bytes, instant(at_ms));
    }

    /// See [`Station::port_closed`].
    pub fn port_closed(&mut self, reason: &str) {
        self.station.port_closed(reason);
    }

    /// See [`Station::stop_board`].
    pub fn stop_board(&mut self) {
        self.station.stop_board();
    }

    /// See [`Station::identify`].
    pub fn identify(&mut self, seconds: u8) {
        self.station.identify(seconds);
    }

    /// See [`Station::take_outgoing`].
    pub fn take_outgoing(&mut self) -> Vec<u8> {
        self.station.take_outgoing()
    }

    /// See [`Station::record`].
    pub fn record(&mut self, name: &str) {
        self.station.record(name);
    }

    /// See [`Station::is_recording`].
    pub fn is_recording(&self) -> bool {
        self.station.is_recording()
    }

    /// See [`Station::take_recorded`].
    pub fn take_recorded(&mut self) -> Vec<u8> {
        self.station.take_recorded()
    }

    /// See [`Station::request`].
    pub fn request(&mut self, text: &str) {
        self.station.request(text);
    }

    /// See [`Station::tick`].
    pub fn tick(&mut self) {
        self.station.tick();
    }

    /// See [`Station::take_message`].
    pub fn take_message(&mut self) -> Option<String> {
        self.station.take_message()
    }

    fn try_source<T>(&mut self, act: impl FnOnce(&mut Station<Files>) -> Result<T, SourceError>) -> Result<T, JsError> {
        act(&mut self.station).map_err(|error| thrown(&error))
    }
}

fn thrown(error: &(dyn std::error::Error + 'static)) -> JsError {
    JsError::new(&with_causes(error))
}

//! The messages between a page and what it shows, as LIVE.md describes them, besides frames and heads.

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value, json};
use slitpose_head::finding::Finding;
use thiserror::Error;

use super::bins::{COARSE_HZ, FINE_HZ};
use super::frame::FRAMES_HZ;
use crate::clock::HostInstant;
use crate::playback::OutlineNote;
use crate::telemetry::DaemonReport;

/// The frames of the last minute are kept.
pub const HISTORY_S: u64 = 60;

/// The coarse bins of the last ten minutes are kept.
pub const COARSE_S: u64 = 600;

/// The first message: what is shown, of which boards. It may have further keys.
pub fn hello(source: &str, boards: &[String], may_write: bool) -> Value {
    json!({
        "kind": "hello",
        "program": "slitpose",
        "version": env!("CARGO_PKG_VERSION"),
        "source": source,
        "may_write": may_write,
        "frames_hz": FRAMES_HZ,
        "history_s": HISTORY_S,
        "fine_hz": FINE_HZ,
        "coarse_hz": COARSE_HZ,
        "coarse_s": COARSE_S,
        "boards": boards,
    })
}

#[derive(Serialize)]
#[serde(tag = "kind", rename = "report")]
struct ReportMessage<'a> {
    report: &'a DaemonReport,
    findings: Vec<Finding>,
}

/// The message with `report`, and what is found in it `now`.
pub fn report_message(report: &DaemonReport, now: HostInstant) -> String {
    text_of(&ReportMessage { findings: report.findings(now), report })
}

pub(super) fn text_of(message: &impl Serialize) -> String {
    // Its keys are texts, and nothing of it fails.
    serde_json::to_string(message).unwrap_or_default()
}

/// What a page may change.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Begin a recording, or end it.
    Record(bool),
    /// Note a text of an instant, so many seconds ago, in the capture being recorded.
    Note(String, f64),
    /// Play a capture otherwise.
    Player(PlayerOrder),
    /// Set the zero of the frame of a board to the mean pose of so many seconds; `None`: the frame is that of the start.
    Frame(usize, Option<f64>),
}

/// Most characters of a note.
const MAX_NOTE: usize = 500;

impl Order {
    /// Note `text` of an instant `ago_s` seconds ago: of the page's memory.
    ///
    /// # Errors
    /// An instant that the page cannot know.
    pub fn note(text: &str, ago_s: f64) -> Result<Self, Refusal> {
        if !(0.0..=COARSE_S as f64).contains(&ago_s) {
            return Err(Refusal::Value { key: "ago_s", value: ago_s, hint: "seconds from 0, 600 at most" });
        }
        Ok(Self::Note(text.chars().filter(|letter| !letter.is_control()).take(MAX_NOTE).collect(), ago_s))
    }
}

/// How a capture is to be played; what is `None` stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayerOrder {
    /// Whether it is played, or paused.
    pub playing: Option<bool>,
    /// Device seconds per second; `Some(None)`: as fast as it goes.
    #[serde(default, deserialize_with = "given")]
    pub speed: Option<Option<f64>>,
    /// Go on from here, seconds after the beginning.
    pub seek_s: Option<f64>,
}

/// The message on the state of a player.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(tag = "kind", rename = "player")]
pub struct PlayerState {
    /// Whether it is played.
    pub playing: bool,
    /// Device seconds per second; `None`: as fast as it goes.
    pub speed: Option<f64>,
    /// Place in the capture, seconds after its beginning.
    pub position_s: f64,
    /// Length of the capture, seconds.
    pub duration_s: f64,
    /// Name of the capture.
    pub file: String,
    /// Whether its end has been reached.
    pub ended: bool,
    /// What persons noted while it was recorded.
    pub notes: Vec<OutlineNote>,
}

/// Why an order is not carried out.
#[derive(Clone, Debug, PartialEq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum Refusal {
    #[error("this page may look only; start slitpose with --live-writes to change that")]
    ReadOnly,
    #[error("the token is missing or wrong; add #token= and the secret of --live-token to the address")]
    Token,
    #[error("as many clients look already as there are places; close one of them")]
    Full,
    #[error("there is no {what} here; {instead}")]
    NotHere { what: &'static str, instead: &'static str },
    #[error("cannot read the request: {reason}")]
    Unreadable { reason: String },
    #[error("{key} is {value}; give {hint}")]
    Value { key: &'static str, value: f64, hint: &'static str },
    #[error("{reason}")]
    Recording { reason: String },
}

impl Refusal {
    /// Of a recording, where nothing records.
    pub const NO_RECORDER: Self = Self::NotHere { what: "recorder", instead: "`slitpose run --live` has one" };

    /// Of a player, where nothing is played.
    pub const NO_PLAYER: Self = Self::NotHere { what: "player", instead: "`slitpose replay FILE --live` has one" };

    /// Of a frame, where there is none to set.
    pub const NO_FRAME: Self =
        Self::NotHere { what: "frame to set", instead: "`slitpose run --live` has one for each board" };
}

/// Least and greatest speed of a player, device seconds per second.
const SPEEDS: [f64; 2] = [1e-3, 1e3];

/// What is left to play at least, seconds.
const MIN_S: f64 = 0.05;

impl PlayerOrder {
    /// Refuses speeds and places that are none.
    ///
    /// # Errors
    /// The value that is none.
    pub fn check(&self) -> Result<(), Refusal> {
        if let Some(Some(value)) = self.speed
            && !(SPEEDS[0]..=SPEEDS[1]).contains(&value)
        {
            return Err(Refusal::Value { key: "speed", value, hint: "0.001 to 1000, or null" });
        }
        if let Some(value) = self.seek_s
            && !(0.0..1e9).contains(&value)
        {
            return Err(Refusal::Value { key: "seek_s", value, hint: "seconds after the beginning" });
        }
        Ok(())
    }
}

/// The message on a calibration from recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename = "calibration")]
pub struct CalibrationState {
    /// `running`, `done` or `failed`.
    pub state: &'static str,
    /// Per cent.
    pub done: u64,
    /// The file of the result, once it is there.
    pub file: String,
    /// What is being done, what was found, or why it failed; a sentence each.
    pub said: Vec<String>,
}

impl CalibrationState {
    /// The message.
    pub fn message(&self) -> String {
        text_of(self)
    }
}

impl PlayerState {
    /// Carries out `order`; returns the place of a leap, seconds after the beginning, if one is due.
    pub fn obey(&mut self, order: &PlayerOrder) -> Option<f64> {
        if let Some(speed) = order.speed {
            self.speed = speed;
        }
        // Played again from the beginning.
        let again = (self.ended && order.playing == Some(true)).then_some(0.0);
        self.playing = order.playing.unwrap_or(self.playing);
        // Not so near the end that nothing is left to play.
        let seek_s = order.seek_s.map(|seek_s| seek_s.min(self.duration_s - MIN_S).max(0.0)).or(again);
        if let Some(seek_s) = seek_s {
            (self.position_s, self.ended) = (seek_s, false);
        }
        seek_s
    }

    /// Whether it is played and has not ended.
    pub fn is_playing(&self) -> bool {
        self.playing && !self.ended
    }

    /// The message, in which a capture at its end is not played.
    pub fn message(&self) -> String {
        text_of(&Self { playing: self.is_playing(), ..self.clone() })
    }
}

/// What a page asks for.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[allow(missing_docs, reason = "fields are named by what they are")]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// The first one.
    Hello {
        /// The server's token, if it asks for one.
        token: Option<String>,
        /// The capture to be played to this client; absent: what the server shows.
        recording: Option<String>,
    },
    /// How many messages have been received since the connection began.
    Ack { messages: u64 },
    /// Begin a recording, or end it.
    Record { on: bool },
    /// Note a text in the capture being recorded.
    Note {
        text: String,
        /// Seconds between the instant and now.
        ago_s: f64,
    },
    /// The captures in the folder of the recordings.
    Recordings {},
    /// Where one of them can be fetched.
    Download { file: String },
    /// Give one of them another name.
    Rename { file: String, to: String },
    /// Calibrate the head of the only board from recordings: of free motion, of the tip in a cone, of steps along a line and of
    /// returns to a stop.
    Calibrate { free: Vec<String>, pivot: Vec<String>, stage: Vec<String>, rest: Vec<String> },
    /// Play the capture otherwise.
    Player(PlayerOrder),
    /// Make the mean pose of so many seconds the zero of the frame of a board; `null`: the frame is that of the start.
    SetFrame { board: usize, over_s: Option<f64> },
    /// Where the tool is in a scene.
    Pose {
        /// Translation, metres.
        t_m: [f64; 3],
        r_rad: [f64; 3],
    },
    /// The accuracy over a plane of the workspace, for a tool that is at this place otherwise.
    Map {
        plane: Plane,
        /// Translation, metres.
        t_m: [f64; 3],
        r_rad: [f64; 3],
    },
}

/// A plane of the base frame, by its axes: across, then up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs, reason = "named by their axes")]
pub enum Plane {
    Xy,
    Xz,
    Yz,
}

impl Request {
    /// The request in `text`: an object. Of a list serde would take the first value for its kind.
    pub fn read(text: &str) -> serde_json::Result<Self> {
        let object: Map<String, Value> = serde_json::from_str(text)?;
        serde_json::from_value(Value::Object(object))
    }
}

/// Tells a `null` from a key that is absent.
fn given<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Option<f64>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Option<Request> {
        Request::read(text).ok()
    }

    #[test]
    fn requests_are_read_or_refused() {
        assert_eq!(read(r#"{"kind":"hello"}"#), Some(Request::Hello { token: None, recording: None }));
        let frame = |over_s| Some(Request::SetFrame { board: 1, over_s });
        assert_eq!(read(r#"{"kind":"set_frame","board":1,"over_s":0.5}"#), frame(Some(0.5)));
        assert_eq!(read(r#"{"kind":"set_frame","board":1,"over_s":null}"#), frame(None));
        assert_eq!(read(r#"{"kind":"ack","messages":7}"#), Some(Request::Ack { messages: 7 }));
        let player = |playing, speed, seek_s| Some(Request::Player(PlayerOrder { playing, speed, seek_s }));
        assert_eq!(read(r#"{"kind":"player","playing":true}"#), player(Some(true), None, None));
        assert_eq!(read(r#"{"kind":"player","speed":null}"#), player(None, Some(None), None));
        assert_eq!(read(r#"{"kind":"player","speed":0.5,"seek_s":3}"#), player(None, Some(Some(0.5)), Some(3.0)));
        for text in [
            "",
            "7",
            r#"["ack",7]"#,
            r#"{"kind":"erase"}"#,
            r#"{"kind":"ack"}"#,
            r#"{"kind":"ack","messages":-1}"#,
            r#"{"kind":"record","on":true,"file":"/etc/passwd"}"#,
            r#"{"kind":"player","playing":true,"file":"/etc/passwd"}"#,
            r#"{"kind":"pose","t_m":[1,2],"r_rad":[0,0,0]}"#,
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }
}

//! What a page may change, who may look at it and change it, and how that is refused.

use std::net::SocketAddr;

use anyhow::{Result, bail, ensure};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use thiserror::Error;

use crate::address::{Address, tcp_address};
use crate::http::BindScope;
use slitpose_tracking::playback::OutlineNote;

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Order {
    Record(bool),
    /// Note a text of an instant, so many seconds ago, in the capture being recorded.
    Note(String, f64),
    Player(PlayerOrder),
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero,
    /// Set the zero of the frame of a board to the mean pose of so many seconds; `None`: the frame is that of the start.
    Frame(usize, Option<f64>),
}

/// How a capture is to be played; what is `None` stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PlayerOrder {
    pub playing: Option<bool>,
    /// Device seconds per second; `Some(None)`: as fast as it goes.
    #[serde(default, deserialize_with = "given")]
    pub speed: Option<Option<f64>>,
    /// Go on from here, seconds after the beginning.
    pub seek_s: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(tag = "kind", rename = "player")]
pub(crate) struct PlayerState {
    pub playing: bool,
    /// Device seconds per second; `None`: as fast as it goes.
    pub speed: Option<f64>,
    pub position_s: f64,
    /// Length of the capture, seconds.
    pub duration_s: f64,
    pub file: String,
    pub ended: bool,
    pub notes: Vec<OutlineNote>,
}

/// How far a calibration from recordings is.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename = "calibration")]
pub(crate) struct CalibrationState {
    /// `running`, `done` or `failed`.
    pub state: &'static str,
    /// Per cent.
    pub done: u64,
    /// The file of the result, once it is there.
    pub file: String,
    /// What is being done, what was found, or why it failed; a sentence each.
    pub said: Vec<String>,
}

/// Why an order is not carried out.
#[derive(Clone, Debug, PartialEq, Error)]
pub(crate) enum Refusal {
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
    pub(crate) const NO_RECORDER: Self = Self::NotHere { what: "recorder", instead: "`slitpose run --live` has one" };

    pub(crate) const NO_PLAYER: Self =
        Self::NotHere { what: "player", instead: "`slitpose replay FILE --live` has one" };

    pub(crate) const NO_FRAME: Self =
        Self::NotHere { what: "frame to set", instead: "`slitpose run --live` has one for each board" };

    pub(crate) const NO_MOUSE: Self =
        Self::NotHere { what: "6-DoF mouse", instead: "`slitpose run --spacenav PATH --live` has one" };
}

/// Carries out an order, or begins to.
pub(crate) type Control = Box<dyn Fn(Order) -> Result<(), Refusal> + Send + Sync>;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Request {
    /// The first one.
    Hello {
        /// The server's token, if it asks for one.
        token: Option<String>,
        /// The capture to be played to this client; absent: what the server shows.
        recording: Option<String>,
    },
    /// How many messages have been received since the connection began.
    Ack {
        messages: u64,
    },
    Record {
        on: bool,
    },
    /// Note a text in the capture being recorded.
    Note {
        text: String,
        /// Seconds between the instant and now.
        ago_s: f64,
    },
    /// The captures in the folder of the recordings.
    Recordings {},
    /// Where one of them can be fetched.
    Download {
        file: String,
    },
    Rename {
        file: String,
        to: String,
    },
    /// Calibrate the head of the first board from recordings: of free motion, of the tip in a cone, of steps along a line
    /// and of returns to a stop.
    Calibrate {
        free: Vec<String>,
        pivot: Vec<String>,
        stage: Vec<String>,
        rest: Vec<String>,
    },
    Player(PlayerOrder),
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero {},
    /// Make the mean pose of so many seconds the zero of the frame of a board; `null`: the frame is that of the start.
    SetFrame {
        board: usize,
        over_s: Option<f64>,
    },
    Pose {
        /// Translation, metres.
        t_m: [f64; 3],
        r_rad: [f64; 3],
    },
}

impl Request {
    /// The request in `text`: an object. Of a list serde would take the first value for its kind.
    pub(super) fn read(text: &str) -> serde_json::Result<Self> {
        let object: Map<String, Value> = serde_json::from_str(text)?;
        serde_json::from_value(Value::Object(object))
    }
}

pub(crate) fn is_request(text: &str) -> bool {
    Request::read(text).is_ok()
}

/// Tells a `null` from a key that is absent.
fn given<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Option<f64>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// The address of the page unless another is given.
pub(crate) const DEFAULT_LIVE_ADDRESS: &str = "127.0.0.1:7451";

/// Shortest token: 16 characters are beyond guessing over a network.
const MIN_TOKEN: usize = 16;

/// The host and port that `text` names.
pub(crate) fn live_address(text: &str) -> Result<SocketAddr, String> {
    let hint =
        || format!("`{text}` is no address; give one such as {DEFAULT_LIVE_ADDRESS}, [::1]:7451 or 0.0.0.0:7451");
    tcp_address(text).ok_or_else(hint)
}

#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Access {
    pub(super) address: SocketAddr,
    token: Option<String>,
    pub(crate) may_write: bool,
}

impl Access {
    /// Pages at `address`. Those of other hosts need `token`, and change something only if `writes` allows it.
    pub(crate) fn new(address: SocketAddr, token: Option<String>, writes: bool) -> Result<Self> {
        if let Some(token) = &token {
            let is_plain = |letter: &char| letter.is_ascii_alphanumeric() || "-_.~".contains(*letter);
            if let Some(letter) = token.chars().find(|letter| !is_plain(letter)) {
                bail!("a token has letters, digits, `-`, `_`, `.` and `~` only; `{letter}` is none of them");
            }
            let (found, hint) = (token.len(), format!("give --live-token with {MIN_TOKEN} characters or more"));
            ensure!(found >= MIN_TOKEN, "a token of {found} characters can be guessed; {hint}");
        }
        let is_local = address.ip().is_loopback();
        ensure!(
            is_local || token.is_some(),
            "{address} can be reached from other hosts: give --live-token with a secret of {MIN_TOKEN} characters or more, or \
             listen on 127.0.0.1"
        );
        Ok(Self { address, token, may_write: is_local || writes })
    }

    pub(super) fn scope(&self) -> BindScope {
        if self.address.ip().is_loopback() { BindScope::Loopback } else { BindScope::Anywhere }
    }

    /// Whether `token` is the right one, or none is needed. Takes the same time for every wrong one of the right length.
    pub(super) fn admits(&self, token: Option<&str>) -> bool {
        let Some(own) = &self.token else { return true };
        let token = token.unwrap_or_default();
        let differences = own.bytes().zip(token.bytes()).fold(0, |sum, (own, other)| sum | (own ^ other));
        own.len() == token.len() && std::hint::black_box(differences) == 0
    }

    /// The URL of the page at the address that was bound.
    pub(super) fn url(&self, bound: &Address) -> String {
        let (Address::Tcp(bound) | Address::Udp(bound)) = bound else { return bound.to_string() };
        let token = self.token.as_ref().map_or(String::new(), |token| format!("#token={token}"));
        // A browser cannot ask for "every address".
        let host = match bound.ip() {
            ip if ip.is_unspecified() => "127.0.0.1".to_owned(),
            std::net::IpAddr::V6(ip) => format!("[{ip}]"),
            ip => ip.to_string(),
        };
        format!("http://{host}:{}/{token}", bound.port())
    }
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
            r#"["zero"]"#,
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

    const TOKEN: &str = "correct-horse-battery";

    fn access(address: &str, token: Option<&str>, writes: bool) -> Result<Access> {
        Access::new(live_address(address).unwrap(), token.map(str::to_owned), writes)
    }

    #[test]
    fn other_hosts_need_a_token_and_leave_to_write() {
        for local in [DEFAULT_LIVE_ADDRESS, "localhost:0", "[::1]:7451", "127.8.9.1:80"] {
            let open = access(local, None, false).unwrap();
            assert!(open.may_write && open.scope() == BindScope::Loopback && open.admits(None), "{local}");
        }
        for wide in ["0.0.0.0:7451", "[::]:7451", "192.0.2.1:80"] {
            let refused = access(wide, None, true).err().unwrap().to_string();
            assert!(refused.contains("from other hosts: give --live-token"), "{refused}");
            let guarded = access(wide, Some(TOKEN), false).unwrap();
            assert!(!guarded.may_write && guarded.scope() == BindScope::Anywhere, "{wide}");
            assert!(access(wide, Some(TOKEN), true).unwrap().may_write, "{wide}");
        }
    }

    #[test]
    fn only_the_whole_token_admits() {
        for address in ["127.0.0.1:0", "0.0.0.0:0"] {
            let guarded = access(address, Some(TOKEN), false).unwrap();
            assert!(guarded.admits(Some(TOKEN)));
            for wrong in [None, Some(""), Some("correct-horse-batterz"), Some("correct-horse-batter"), Some("correct")]
            {
                assert!(!guarded.admits(wrong), "{wrong:?}");
            }
            assert!(!guarded.admits(Some(&format!("{TOKEN}s"))));
        }
        for (token, words) in [("short", "of 5 characters can be guessed"), ("a token with spaces", "` ` is none")] {
            let refused = access("127.0.0.1:0", Some(token), false).err().unwrap().to_string();
            assert!(refused.contains(words), "{refused}");
        }
    }

    #[test]
    fn a_page_has_an_address_that_a_browser_can_open() {
        let guarded = access("0.0.0.0:0", Some(TOKEN), false).unwrap();
        assert_eq!(
            guarded.url(&Address::Tcp("0.0.0.0:80".parse().unwrap())),
            format!("http://127.0.0.1:80/#token={TOKEN}")
        );
        assert_eq!(
            access("[::1]:0", None, false).unwrap().url(&Address::Tcp("[::1]:5".parse().unwrap())),
            "http://[::1]:5/"
        );
    }
}

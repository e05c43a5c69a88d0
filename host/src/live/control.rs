//! What a page may change, and how that is refused.

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use thiserror::Error;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Order {
    Record(bool),
    Player(PlayerOrder),
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero,
}

/// How a capture is to be played; what is `None` stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PlayerOrder {
    pub playing: Option<bool>,
    /// Device seconds per second; `Some(None)`: as fast as it goes.
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
    /// There is no recorder.
    pub(crate) const NO_RECORDER: Self = Self::NotHere { what: "recorder", instead: "`slitpose run --live` has one" };

    /// There is no player.
    pub(crate) const NO_PLAYER: Self =
        Self::NotHere { what: "player", instead: "`slitpose replay FILE --live` has one" };

    /// There is no 6-DoF mouse.
    pub(crate) const NO_MOUSE: Self =
        Self::NotHere { what: "6-DoF mouse", instead: "`slitpose run --spacenav PATH --live` has one" };
}

pub(crate) trait Control: Send + Sync {
    /// Carries out `order`, or begins to.
    fn order(&self, order: Order) -> Result<(), Refusal>;
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Request {
    /// The first one.
    Hello {
        /// The server's token, if it asks for one.
        token: Option<String>,
    },
    /// How many messages have been received since the connection began.
    Ack {
        messages: u64,
    },
    Record {
        on: bool,
    },
    Player {
        playing: Option<bool>,
        /// Device seconds per second; `null`: as fast as it goes.
        #[serde(default, deserialize_with = "given")]
        speed: Option<Option<f64>>,
        /// Go on from here, seconds after the beginning.
        seek_s: Option<f64>,
    },
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero {},
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

/// Whether `text` is a request.
pub(crate) fn is_request(text: &str) -> bool {
    Request::read(text).is_ok()
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
        assert_eq!(read(r#"{"kind":"hello"}"#), Some(Request::Hello { token: None }));
        assert_eq!(read(r#"{"kind":"ack","messages":7}"#), Some(Request::Ack { messages: 7 }));
        let player = |playing, speed, seek_s| Some(Request::Player { playing, speed, seek_s });
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
            r#"{"kind":"pose","t_m":[1,2],"r_rad":[0,0,0]}"#,
        ] {
            assert_eq!(read(text), None, "{text}");
        }
    }
}

//! What a page asks for.

use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

/// A request, as JSON.
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
        /// That number.
        messages: u64,
    },
    /// Start or end a recording.
    Record {
        /// Whether to record.
        on: bool,
    },
    /// Play a capture otherwise.
    Player {
        /// Go on, or pause.
        playing: Option<bool>,
        /// Device seconds per second; `null`: as fast as it goes.
        #[serde(default, deserialize_with = "given")]
        speed: Option<Option<f64>>,
        /// Go on from here, seconds after the beginning.
        seek_s: Option<f64>,
    },
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero {},
    /// The tool was dragged here.
    Pose {
        /// Translation, metres.
        t_m: [f64; 3],
        /// Rotation vector, radians.
        r_rad: [f64; 3],
    },
}

impl Request {
    /// The request in `text`: an object. Of a list serde would take the first value for its kind.
    ///
    /// # Errors
    /// If it is none.
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

//! What a page may change, and how that is refused.

use serde::Serialize;
use thiserror::Error;

/// A change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Order {
    /// Start or end a recording.
    Record(bool),
    /// Play a capture otherwise.
    Player(PlayerOrder),
    /// Make the present pose the zero of the 6-DoF mouse.
    Zero,
}

/// How a capture is to be played; what is `None` stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PlayerOrder {
    /// Go on, or pause.
    pub playing: Option<bool>,
    /// Device seconds per second; `Some(None)`: as fast as it goes.
    pub speed: Option<Option<f64>>,
    /// Go on from here, seconds after the beginning.
    pub seek_s: Option<f64>,
}

/// How a capture is played.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(tag = "kind", rename = "player")]
pub(crate) struct PlayerState {
    /// Whether it goes on.
    pub playing: bool,
    /// Device seconds per second; `None`: as fast as it goes.
    pub speed: Option<f64>,
    /// Seconds after the beginning.
    pub position_s: f64,
    /// Length of the capture, seconds.
    pub duration_s: f64,
    /// The file.
    pub file: String,
    /// Whether its end is reached.
    pub ended: bool,
}

/// Why an order is not carried out.
#[derive(Clone, Debug, PartialEq, Error)]
pub(crate) enum Refusal {
    /// Looking only.
    #[error("this page may look only; start slitpose with --live-writes to change that")]
    ReadOnly,
    /// The token.
    #[error("the token is missing or wrong; add #token= and the secret of --live-token to the address")]
    Token,
    /// Too many clients.
    #[error("as many clients look already as there are places; close one of them")]
    Full,
    /// Something that this kind of program does not have.
    #[error("there is no {what} here; {instead}")]
    NotHere {
        /// What was asked for.
        what: &'static str,
        /// Where there is one.
        instead: &'static str,
    },
    /// A request that cannot be read.
    #[error("cannot read the request: {reason}")]
    Unreadable {
        /// Why.
        reason: String,
    },
    /// A value beyond its limits.
    #[error("{key} is {value}; give {hint}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// A good one.
        hint: &'static str,
    },
    /// The recording could not be started or ended.
    #[error("{reason}")]
    Recording {
        /// Why, with the next step.
        reason: String,
    },
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

/// Carries out orders.
pub(crate) trait Control: Send + Sync {
    /// Carries out `order`, or begins to.
    ///
    /// # Errors
    /// If it cannot be carried out.
    fn order(&self, order: Order) -> Result<(), Refusal>;
}

//! Events in the stream of poses.

use slitpose_protocol::{BoardKind, Hello, Severity};

use crate::link::DeviceId;

/// An event in the stream of poses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Note {
    /// A board introduced itself.
    Hello {
        /// Its number.
        device: DeviceId,
        /// Its name.
        board: String,
        /// Whether its photocurrents are measured or computed.
        kind: BoardKind,
        /// Its firmware.
        firmware: String,
        /// Frames a second of its schedule.
        frame_rate_hz: f64,
    },
    /// Something happened on a board.
    Event {
        /// The board; `None` if it has not introduced itself.
        device: Option<DeviceId>,
        /// Its severity.
        severity: Severity,
        /// Its time by the board's clock, seconds.
        device_time_s: f64,
        /// Its description.
        text: String,
    },
}

impl Note {
    /// The note for a hello.
    pub(crate) fn hello(hello: &Hello<'_>) -> Self {
        Self::Hello {
            device: DeviceId(hello.device_id),
            board: hello.board.to_owned(),
            kind: hello.kind,
            firmware: hello.firmware.to_owned(),
            frame_rate_hz: hello.schedule.frame_rate_hz(),
        }
    }
}

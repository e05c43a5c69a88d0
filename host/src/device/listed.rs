//! A port as it is listed: its USB descriptors, its state, what the board there says of itself.

use std::path::{MAIN_SEPARATOR, Path};

use serde::{Serialize, Serializer};
use serde_json::json;
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{AdcScaling, BoardKind, Hashes, Hello, PROTOCOL, ProtocolVersion, ResetCause, Schedule};

use crate::platform::{HAS_USB_TEXTS, is_port_name, real_port};
use slitpose_tracking::link::DeviceId;

/// USB vendor and product number of a board: a pair for tests, shared with other devices, so that the texts must match,
/// too.
pub(super) const BOARD: (u16, u16) = (0x1209, 0x0001);
const MANUFACTURER: &str = "slitpose";
const PRODUCT: &str = "slitpose board";

/// Debuggers whose serial port may lead to a board: ST-LINK/V2-1 and V3, as Nucleo boards have them
/// (ST's 49-stlinkv2-1.rules and 49-stlinkv3.rules).
const ST: u16 = 0x0483;
const DEBUGGERS: [u16; 9] = [0x374a, 0x374b, 0x374e, 0x374f, 0x3752, 0x3753, 0x3754, 0x3755, 0x3757];

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct UsbId {
    pub vid: u16,
    pub pid: u16,
    /// Serial number, if any; that of a debugger is not that of the board behind it.
    pub serial: Option<String>,
    pub manufacturer: Option<String>,
    pub product: Option<String>,
}

impl UsbId {
    /// Whether this is a board with its own USB port.
    pub(crate) fn is_board(&self) -> bool {
        self.is_board_by(HAS_USB_TEXTS)
    }

    /// The same by the texts of the device, or where the system has others, by a serial number of 12 bytes.
    pub(super) fn is_board_by(&self, has_texts: bool) -> bool {
        let texts = [self.manufacturer.as_deref(), self.product.as_deref()];
        let is_number = || self.serial.as_deref().is_some_and(|serial| serial.parse::<DeviceId>().is_ok());
        (self.vid, self.pid) == BOARD
            && if has_texts { texts == [Some(MANUFACTURER), Some(PRODUCT)] } else { is_number() }
    }

    /// The board, if its USB descriptors name it.
    pub(crate) fn device(&self) -> Option<DeviceId> {
        self.serial.as_deref().filter(|_| self.is_board())?.parse().ok()
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    pub name: String,
    /// Descriptors of the USB device, if it is one.
    pub(crate) usb: Option<UsbId>,
}

impl Port {
    /// The port at `name`, with its USB descriptors if `ports` has it, also under another name.
    pub(super) fn at(name: &str, ports: &[Self]) -> Self {
        let real = real_port(name);
        let usb = ports.iter().find(|port| real_port(&port.name) == real).and_then(|port| port.usb.clone());
        Self { name: name.to_owned(), usb }
    }

    /// Whether this is a board by its USB descriptors.
    pub(crate) fn is_board(&self) -> bool {
        self.usb.as_ref().is_some_and(UsbId::is_board)
    }

    /// Whether it is a debugger, which must be asked for a board.
    pub(crate) fn is_debugger(&self) -> bool {
        self.usb.as_ref().is_some_and(|usb| usb.vid == ST && DEBUGGERS.contains(&usb.pid))
    }

    /// The board on it, if its USB descriptors name it.
    pub fn device(&self) -> Option<DeviceId> {
        self.usb.as_ref()?.device()
    }
}

/// Whether `name` looks like the path of a port, and not like the name of a board.
pub(super) fn is_path(name: &str) -> bool {
    name.contains(['/', MAIN_SEPARATOR]) || is_port_name(name) || Path::new(name).exists()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PortState {
    NotAsked,
    Free,
    InUse,
    NoPermission,
    NoAnswer,
    OtherVersion(ProtocolVersion),
}

impl PortState {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::NotAsked => "not asked",
            Self::Free => "free",
            Self::InUse => "in use",
            Self::NoPermission => "no permission",
            Self::NoAnswer => "no answer",
            Self::OtherVersion(_) => "other version",
        }
    }
}

/// A port, its state and its board.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed {
    pub port: Port,
    pub(crate) state: PortState,
    pub(crate) board: Option<BoardInfo>,
}

impl Listed {
    /// A port that has not been asked.
    pub fn new(port: Port) -> Self {
        Self { port, state: PortState::NotAsked, board: None }
    }

    /// Number of the board, from its hello or from USB, if known.
    pub fn device(&self) -> Option<DeviceId> {
        self.board.as_ref().map(|board| board.device).or(self.port.device())
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BoardInfo {
    pub device: DeviceId,
    pub kind: BoardKind,
    pub board: String,
    pub firmware: String,
    pub protocol: ProtocolVersion,
    /// The first kind of message with another layout than in this program, if any.
    pub mismatch: Option<SchemaMismatch>,
    /// Cause of its last reset.
    pub reset_cause: ResetCause,
    pub hashes: Hashes,
    pub scaling: AdcScaling,
    pub configuration: u16,
    pub schedule: Schedule,
}

impl From<&Hello<'_>> for BoardInfo {
    fn from(hello: &Hello<'_>) -> Self {
        Self {
            device: DeviceId(hello.device_id),
            kind: hello.kind,
            board: hello.board.to_owned(),
            firmware: hello.firmware.to_owned(),
            protocol: hello.protocol,
            mismatch: hello.check_schemas().err(),
            reset_cause: hello.reset_cause,
            hashes: hello.hashes,
            scaling: hello.scaling,
            configuration: hello.configuration,
            schedule: hello.schedule.clone(),
        }
    }
}

impl BoardInfo {
    pub(crate) fn kind_name(&self) -> &'static str {
        match self.kind {
            BoardKind::Physical => "physical",
            BoardKind::Simulated => "simulated",
        }
    }

    /// Cause of its last reset, in one word, such as `power_on`.
    pub(crate) fn reset_cause_name(&self) -> String {
        in_words(&format!("{:?}", self.reset_cause)).replace(' ', "_")
    }
}

/// `PowerOn` as `power on`.
pub(crate) fn in_words(name: &str) -> String {
    let letters = name.char_indices().flat_map(|(i, letter)| {
        let space = (i > 0 && letter.is_uppercase()).then_some(' ');
        space.into_iter().chain(letter.to_lowercase())
    });
    letters.collect()
}

impl Serialize for BoardInfo {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // 16 digits, as in messages: JSON numbers do not hold 64 bits everywhere.
        let hex = |hash: Option<u64>| hash.map(|hash| format!("{hash:016x}"));
        let fields = json!({
            "serial": self.device,
            "board": self.board,
            "kind": self.kind_name(),
            "firmware": self.firmware,
            "protocol": self.protocol.to_string(),
            "program_protocol": PROTOCOL.to_string(),
            "mismatch": self.mismatch.map(|mismatch| mismatch.name),
            "reset_cause": self.reset_cause_name(),
            "scene_hash": hex(self.hashes.scene),
            "calibration_hash": hex(self.hashes.calibration),
            "full_scale_a": self.scaling.full_scale_a(),
            "scaling": self.scaling,
            "frame_rate_hz": self.schedule.frame_rate_hz(),
            "configuration": self.configuration,
            "schedule": self.schedule,
        });
        fields.serialize(serializer)
    }
}

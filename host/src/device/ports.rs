//! Serial ports of this host and their USB descriptors; and what answers at a port, asked by one Hello, so that other
//! devices are not disturbed.

use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use serde::{Serialize, Serializer};
use serde_json::json;
use serialport::{SerialPortInfo, SerialPortType};
use slitpose_protocol::schema::SchemaMismatch;
use slitpose_protocol::{AdcScaling, BoardKind, Hashes, Hello, PROTOCOL, ProtocolVersion, ResetCause, Schedule};

use super::{Conversation, DeviceError, SerialDevice};
use slitpose_tracking::link::DeviceId;

/// USB vendor and product number of a board: a pair for tests, shared with other devices, so that the texts must match,
/// too.
pub(super) const BOARD: (u16, u16) = (0x1209, 0x0001);
const MANUFACTURER: &str = "slitpose";
const PRODUCT: &str = "slitpose board";

/// Debuggers whose serial port may lead to a board: ST-LINK/V2-1 and V3, as Nucleo boards have them
/// (ST's 49-stlinkv2-1.rules and 49-stlinkv3.rules).
const DEBUGGERS: [(u16, u16); 9] = [
    (0x0483, 0x374a),
    (0x0483, 0x374b),
    (0x0483, 0x374e),
    (0x0483, 0x374f),
    (0x0483, 0x3752),
    (0x0483, 0x3753),
    (0x0483, 0x3754),
    (0x0483, 0x3755),
    (0x0483, 0x3757),
];

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
        (self.vid, self.pid) == BOARD
            && self.manufacturer.as_deref() == Some(MANUFACTURER)
            && self.product.as_deref() == Some(PRODUCT)
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
        let real = real_path(name);
        let usb = ports.iter().find(|port| real_path(&port.name) == real).and_then(|port| port.usb.clone());
        Self { name: name.to_owned(), usb }
    }

    /// Whether this is a board by its USB descriptors.
    pub(crate) fn is_board(&self) -> bool {
        self.usb.as_ref().is_some_and(UsbId::is_board)
    }

    /// Whether it is a debugger, which must be asked for a board.
    pub(crate) fn is_debugger(&self) -> bool {
        self.usb.as_ref().is_some_and(|usb| DEBUGGERS.contains(&(usb.vid, usb.pid)))
    }

    /// The board on it, if its USB descriptors name it.
    pub fn device(&self) -> Option<DeviceId> {
        self.usb.as_ref()?.device()
    }
}

/// The serial ports of this host.
pub fn ports() -> Result<Vec<Port>, DeviceError> {
    // The library panics without this folder; a system without it has no ports.
    if !Path::new("/sys/class/tty").is_dir() {
        return Ok(Vec::new());
    }
    let listed = serialport::available_ports().map_err(|source| DeviceError::Ports { source })?;
    Ok(from_system(listed))
}

/// The ports as the system lists them, sorted by name.
fn from_system(listed: Vec<SerialPortInfo>) -> Vec<Port> {
    let mut ports: Vec<_> = listed
        .into_iter()
        .map(|info| Port {
            name: info.port_name,
            usb: match info.port_type {
                SerialPortType::UsbPort(usb) => Some(UsbId {
                    vid: usb.vid,
                    pid: usb.pid,
                    serial: usb.serial_number,
                    manufacturer: usb.manufacturer,
                    product: usb.product,
                }),
                _ => None,
            },
        })
        .collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    ports
}

/// Additional ports to search: a path in which `*` matches any characters, `?` any one, and `[…]` one of
/// those listed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Search(String);

impl FromStr for Search {
    type Err = DeviceError;

    fn from_str(pattern: &str) -> Result<Self, Self::Err> {
        match glob::Pattern::new(pattern) {
            Ok(_) => Ok(Self(pattern.to_owned())),
            Err(source) => Err(DeviceError::Pattern { pattern: pattern.to_owned(), source }),
        }
    }
}

impl Search {
    /// The character devices that match, sorted by name. Unreadable paths do not match.
    pub(super) fn names(&self) -> Vec<String> {
        let is_port = |path: &PathBuf| std::fs::metadata(path).is_ok_and(|found| found.file_type().is_char_device());
        let matches = glob::glob(&self.0).into_iter().flatten().flatten();
        matches.filter(is_port).filter_map(|path| path.into_os_string().into_string().ok()).collect()
    }
}

/// The target of a path, or the path itself if it does not exist.
pub(super) fn real_path(name: &str) -> PathBuf {
    std::fs::canonicalize(name).unwrap_or_else(|_| name.into())
}

// Asking a port for a board.

/// Timeout: a running board answers within milliseconds; the rest is for a busy host.
pub(super) const ANSWER_WITHIN: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PortState {
    NotAsked,
    Free,
    InUse,
    /// This user may not open it.
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

    pub fn ask(port: Port) -> Self {
        let board = SerialDevice::open(&port.name).and_then(|device| Conversation::open(Box::new(device)));
        match board.and_then(|mut board| board.introduce(ANSWER_WITHIN)) {
            Ok(board) => {
                let state = match board.mismatch {
                    None => PortState::Free,
                    Some(_) => PortState::OtherVersion(board.protocol),
                };
                Self { port, state, board: Some(board) }
            }
            Err(error) => {
                let state = match error {
                    DeviceError::Busy { .. } => PortState::InUse,
                    DeviceError::Forbidden { .. } => PortState::NoPermission,
                    DeviceError::Version { versions, .. } => PortState::OtherVersion(versions.board),
                    _ => PortState::NoAnswer,
                };
                Self { port, state, board: None }
            }
        }
    }

    /// Asks all at once, so that silent ones do not add up.
    pub(crate) fn ask_all(ports: Vec<Port>) -> Vec<Self> {
        std::thread::scope(|scope| {
            let asked: Vec<_> = ports
                .into_iter()
                .map(|port| {
                    let fallback = Self::new(port.clone());
                    (fallback, scope.spawn(move || Self::ask(port)))
                })
                .collect();
            asked.into_iter().map(|(fallback, thread)| thread.join().unwrap_or(fallback)).collect()
        })
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
    pub(crate) fn reset_cause_name(&self) -> &'static str {
        match self.reset_cause {
            ResetCause::Unknown => "unknown",
            ResetCause::PowerOn => "power_on",
            ResetCause::BrownOut => "brown_out",
            ResetCause::Pin => "pin",
            ResetCause::Software => "software",
            ResetCause::Watchdog => "watchdog",
            ResetCause::Panic => "panic",
            ResetCause::StackOverflow => "stack_overflow",
        }
    }
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

#[cfg(test)]
mod tests {
    use serialport::UsbPortInfo;

    use super::*;

    fn info(name: &str, port_type: SerialPortType) -> SerialPortInfo {
        SerialPortInfo { port_name: name.to_owned(), port_type }
    }

    fn usb(vid: u16, pid: u16, texts: [&str; 3]) -> SerialPortType {
        let [serial_number, manufacturer, product] = texts.map(|text| Some(text.to_owned()));
        SerialPortType::UsbPort(UsbPortInfo { vid, pid, serial_number, manufacturer, product })
    }

    #[test]
    fn a_board_is_known_by_number_and_texts() {
        let serial = "0036002900544850025A0320";
        let ports = from_system(vec![
            info("/dev/ttyUSB0", usb(0x0403, 0x6001, ["A1", "FTDI", "FT232R"])),
            info("/dev/ttyACM2", usb(0x0483, 0x374e, ["0031", "STMicroelectronics", "STLINK-V3"])),
            info("/dev/ttyACM1", usb(0x1209, 0x0001, [serial, "slitpose", "slitpose board"])),
            info("/dev/ttyACM0", usb(0x1209, 0x0001, [serial, "somebody", "else"])),
            info("/dev/ttyS0", SerialPortType::Unknown),
        ]);
        let names: Vec<_> = ports.iter().map(|port| port.name.as_str()).collect();
        assert_eq!(names, ["/dev/ttyACM0", "/dev/ttyACM1", "/dev/ttyACM2", "/dev/ttyS0", "/dev/ttyUSB0"]);
        let boards: Vec<_> = ports.iter().map(Port::is_board).collect();
        assert_eq!(boards, [false, true, false, false, false]);
        let debuggers: Vec<_> = ports.iter().map(Port::is_debugger).collect();
        assert_eq!(debuggers, [false, false, true, false, false]);
        // The firmware writes its number in large digits on USB, and as 12 bytes in its hello, in one order.
        let hello = DeviceId([0x00, 0x36, 0x00, 0x29, 0x00, 0x54, 0x48, 0x50, 0x02, 0x5a, 0x03, 0x20]);
        assert_eq!(ports[1].device(), Some(hello));
        assert_eq!(ports[0].device(), None);
    }

    #[test]
    fn patterns_match_devices_only() {
        let names = |pattern: &str| pattern.parse::<Search>().unwrap().names();
        assert_eq!(names("/dev/nul?"), ["/dev/null"]);
        assert_eq!(names("/dev/[n]ull"), ["/dev/null"]);
        assert!(names("/de*").is_empty() && names("/etc/passw?").is_empty());
        assert!("/dev/tty[".parse::<Search>().is_err());
    }

    #[test]
    fn a_link_to_a_port_is_that_port() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("board");
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        let usb = UsbId { vid: 7, ..UsbId::default() };
        let ports = [Port { name: "/dev/null".to_owned(), usb: Some(usb.clone()) }];
        assert_eq!(Port::at(link.to_str().unwrap(), &ports).usb, Some(usb));
        assert_eq!(Port::at("/dev/zero", &ports).usb, None);
    }
}

//! Lists the serial ports of this host. Whether a board answers there is asked by one Hello, so that other devices are
//! not disturbed.

use std::str::FromStr;
use std::time::Duration;

use serialport::{SerialPortInfo, SerialPortType};

use super::conversation::Conversation;
use super::error::DeviceError;
use super::listed::{Listed, Port, PortState, UsbId};
use super::serial::SerialDevice;
use crate::platform::{can_list_ports, ports_like, real_port};

/// The serial ports of this host.
pub fn ports() -> Result<Vec<Port>, DeviceError> {
    if !can_list_ports() {
        return Ok(Vec::new());
    }
    let listed = serialport::available_ports().map_err(|source| DeviceError::Ports { source })?;
    Ok(from_system(listed))
}

/// Whether the system lists the port `name`, in whatever spelling.
pub(super) fn is_listed(name: &str) -> bool {
    ports().is_ok_and(|ports| ports.iter().any(|port| real_port(&port.name) == real_port(name)))
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
    // macOS lists each port twice; the one for callers does not wait for a carrier.
    let callers: Vec<_> =
        ports.iter().filter_map(|port| port.name.strip_prefix("/dev/cu.").map(str::to_owned)).collect();
    ports.retain(|port| port.name.strip_prefix("/dev/tty.").is_none_or(|name| !callers.iter().any(|it| it == name)));
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
    /// The ports that match, sorted by name.
    pub(super) fn names(&self) -> Vec<String> {
        ports_like(&self.0)
    }
}

// Asking a port for a board.

/// Timeout: a running board answers within milliseconds; the rest is for a busy host.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(1);

impl Listed {
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
}

#[cfg(test)]
mod tests {
    use serialport::UsbPortInfo;

    use super::*;
    use slitpose_tracking::link::DeviceId;

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
        // On Windows the texts are those of the driver.
        let texts = ["Microsoft", "USB Serial Device (COM3)"].map(|text| Some(text.to_owned()));
        let by_driver = |serial: &str| {
            let [manufacturer, product] = texts.clone();
            UsbId { vid: 0x1209, pid: 0x0001, serial: Some(serial.to_owned()), manufacturer, product }
        };
        assert!(by_driver(serial).is_board_by(false) && !by_driver(serial).is_board_by(true));
        assert!(!by_driver("A1").is_board_by(false));
    }

    #[test]
    fn ports_that_are_listed_twice_count_once() {
        let port = |name| info(name, SerialPortType::Unknown);
        let ports = from_system(vec![port("/dev/tty.usb1"), port("/dev/cu.usb1"), port("/dev/tty.other")]);
        let names: Vec<_> = ports.into_iter().map(|port| port.name).collect();
        assert_eq!(names, ["/dev/cu.usb1", "/dev/tty.other"]);
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

//! Finds boards.
//!
//! A board with its own USB port is identified by its USB descriptors, without a request, and is found again at any
//! port. A board behind a debugger's serial port, or at a place that the user names ([`Search`]), must be asked for its
//! number: its port is opened exclusively, and one Hello is sent. Ports in use are left alone.
//!
//! Debuggers are asked only if no board has its own USB port: a board serves the port that asked last for two seconds,
//! and both cables of a Nucleo may be plugged in.

use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::conversation::Conversation;
use super::error::DeviceError;
use super::listed::{BoardInfo, Listed, Port, PortState, is_path};
use super::ports::{ANSWER_WITHIN, Search, ports};
use super::serial::SerialDevice;
use crate::platform::{is_port_name, real_port};
use slitpose_tracking::link::DeviceId;

/// Interval of attempts to open a board that is to come back.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A board that is opened again and again, at whatever port it is then.
#[derive(Debug)]
pub(crate) struct Contact {
    pub(crate) selector: Selector,
    search: Vec<Search>,
    /// Where it was last, and its number if known.
    pub(crate) port: Option<Port>,
    device: Option<DeviceId>,
}

impl Contact {
    /// With the board that `selector` names, which is sought in the places of `search`, too.
    pub(crate) fn new(selector: Selector, search: Vec<Search>) -> Self {
        Self { selector, search, port: None, device: None }
    }

    /// Opens the board's port, even if its name has changed.
    pub(crate) fn open(&mut self) -> Result<SerialDevice, DeviceError> {
        let (port, device) = match locate(&self.selector, self.port.as_ref(), self.device) {
            // Keeps the USB identity, by which the board is found again under another name.
            Some(port) => (port, self.device),
            None => (find(&self.selector, &self.search)?, None),
        };
        self.device = port.device().or(device);
        SerialDevice::open(&self.port.insert(port).name)
    }

    /// Waits for the board, which restarts or was unplugged, until it answers again, `within` this time. `open`: at a port
    /// that stays, as that of a debugger outlives the board behind it.
    pub(crate) fn await_return(
        &self,
        mut open: Option<Conversation>,
        within: Duration,
    ) -> Result<(Conversation, BoardInfo), DeviceError> {
        let name = self.port.as_ref().map_or_else(|| self.selector.to_string(), |port| port.name.clone());
        let until = Instant::now() + within;
        while Instant::now() < until {
            // It may be there and not yet be allowed to this user, or not yet be ready.
            let reopened = || {
                let there = locate(&self.selector, self.port.as_ref(), self.device)?;
                Conversation::open(Box::new(SerialDevice::open(&there.name).ok()?)).ok()
            };
            let Some(mut board) = open.take().or_else(reopened) else {
                sleep(LOOK_EVERY);
                continue;
            };
            match board.introduce(ANSWER_WITHIN) {
                Ok(info) => return Ok((board, info)),
                Err(DeviceError::Gone { .. }) => {}
                Err(DeviceError::Silent { .. } | DeviceError::NoHello { .. }) => open = Some(board),
                Err(error) => return Err(error),
            }
        }
        Err(DeviceError::NotBack { name, seconds: within.as_secs_f64() })
    }

    /// The board that was opened last has introduced itself.
    pub(crate) fn greeted(&mut self, device: DeviceId) {
        self.device = Some(device);
    }

    /// Whether the board was last at its own USB port.
    pub(crate) fn has_own_port(&self) -> bool {
        self.port.as_ref().is_some_and(Port::is_board)
    }
}

/// Searches for the board that `selector` names, also in the places of `search`.
///
/// A path is accepted as it is: opening shows whether there is a board.
pub(crate) fn find(selector: &Selector, search: &[Search]) -> Result<Port, DeviceError> {
    match selector {
        // A simulated board has no port.
        Selector::Sim => Err(DeviceError::NoBoard { asked: Vec::new() }),
        // A path works even without a list of ports.
        Selector::Path(path) => Ok(Port::at(path, &ports().unwrap_or_default())),
        Selector::Serial(device) => {
            let ports = ports()?;
            if let Some(port) = ports.iter().find(|port| port.device() == Some(*device)) {
                return Ok(port.clone());
            }
            choose(selector, Listed::ask_all(unsure(&ports, search, true)))
        }
        Selector::Auto => {
            let ports = ports()?;
            let boards: Vec<_> = ports.iter().filter(|port| port.is_board()).cloned().map(Listed::new).collect();
            let asked = Listed::ask_all(unsure(&ports, search, boards.is_empty()));
            choose(selector, boards.into_iter().chain(asked).collect())
        }
    }
}

/// All boards, and all ports that might have one. With `ask` these ports are asked; boards in use are left
/// alone.
pub(crate) fn list(search: &[Search], ask: bool) -> Result<Vec<Listed>, DeviceError> {
    let ports = ports()?;
    let unsure = unsure(&ports, search, true);
    let boards: Vec<_> = ports.into_iter().filter(Port::is_board).collect();
    if !ask {
        return Ok(boards.into_iter().chain(unsure).map(Listed::new).collect());
    }
    // One after the other: a board answers at one port at a time.
    let mut listed = Listed::ask_all(boards);
    listed.extend(Listed::ask_all(unsure));
    Ok(listed)
}

/// Finds the board that `selector` names without asking any port: fast enough for several calls per second. `last`: its
/// last place, and `device` its number, if known. `None` if it is missing, or, without `last`, if only [`find`] can
/// identify it.
fn locate(selector: &Selector, last: Option<&Port>, device: Option<DeviceId>) -> Option<Port> {
    // Fast: the list comes from files of the system, not from devices.
    let ports = ports().unwrap_or_default();
    Some(Port::at(&located(selector, last, device, &ports)?, &ports))
}

fn located(selector: &Selector, last: Option<&Port>, device: Option<DeviceId>, ports: &[Port]) -> Option<String> {
    let exists = |name: &str| (is_port_name(name) || Path::new(name).exists()).then(|| name.to_owned());
    let device = if let Selector::Serial(device) = selector { Some(*device) } else { device };
    let board = |port: &&Port| device.is_some() && port.device() == device;
    if let Some(port) = ports.iter().find(board) {
        return Some(port.name.clone());
    }
    match (last, selector) {
        (Some(Port { usb: Some(usb), name: port }), _) if !usb.is_board() || usb.device().is_none() => {
            // The same debugger or adapter; without a serial number, at the same place.
            let same = |it: &&Port| it.usb.as_ref() == Some(usb) && (usb.serial.is_some() || it.name == *port);
            // A debugger may have several ports.
            let mut same: Vec<_> = ports.iter().filter(same).map(|it| it.name.clone()).collect();
            let at = same.iter().position(|name| name == port).unwrap_or(0);
            (!same.is_empty()).then(|| same.swap_remove(at))
        }
        (Some(Port { usb: None, name }), _) => exists(name),
        (Some(_), _) => None,
        (None, Selector::Path(path)) => exists(path),
        (None, Selector::Auto) => {
            let mut boards = ports.iter().filter(|port| port.is_board());
            boards.next().filter(|_| boards.next().is_none()).map(|port| port.name.clone())
        }
        (None, _) => None,
    }
}

/// The ports that must be asked for a board.
fn unsure(ports: &[Port], search: &[Search], debuggers: bool) -> Vec<Port> {
    let mut unsure: Vec<_> = ports.iter().filter(|port| debuggers && port.is_debugger()).cloned().collect();
    for name in search.iter().flat_map(Search::names) {
        let known = ports.iter().filter(|port| port.is_board()).chain(&unsure);
        let real = real_port(&name);
        if !known.into_iter().any(|port| real_port(&port.name) == real) {
            unsure.push(Port::at(&name, ports));
        }
    }
    unsure
}

/// The board of `listed` that `selector` names.
fn choose(selector: &Selector, listed: Vec<Listed>) -> Result<Port, DeviceError> {
    let is_board = |listed: &Listed| listed.port.is_board() || listed.board.is_some();
    let mut boards: Vec<Listed> = Vec::new();
    for it in listed.iter().filter(|it| is_board(it)) {
        // A board with two cables counts once, by its own USB port.
        let twice = it.device().is_some() && boards.iter().any(|board| board.device() == it.device());
        if !twice {
            boards.push(it.clone());
        }
    }
    if let Selector::Serial(device) = selector {
        let board = boards.into_iter().find(|board| board.device() == Some(*device));
        return board.map(|board| board.port).ok_or(DeviceError::NoSuchBoard { device: *device, there: listed });
    }
    match boards.len() {
        0 => match <[Listed; 1]>::try_from(listed) {
            // The only candidate: opening it reports the reason.
            Ok([only]) if matches!(only.state, PortState::InUse | PortState::NoPermission) => Ok(only.port),
            Ok([only]) => Err(DeviceError::NoBoard { asked: vec![only] }),
            Err(asked) => Err(DeviceError::NoBoard { asked }),
        },
        1 => Ok(boards.swap_remove(0).port),
        _ => Err(DeviceError::SeveralBoards { boards }),
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Selector {
    Auto,
    Sim,
    /// The board with this number, at any port.
    Serial(DeviceId),
    Path(String),
}

impl FromStr for Selector {
    type Err = DeviceError;

    /// `auto`, `sim`, the serial number of a board, or the path of a port.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Self::Auto),
            "sim" => Ok(Self::Sim),
            _ => match text.parse() {
                Ok(device) => Ok(Self::Serial(device)),
                Err(_) if is_path(text) => Ok(Self::Path(text.to_owned())),
                Err(_) => Err(DeviceError::NotAPath { name: text.to_owned() }),
            },
        }
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Sim => f.write_str("sim"),
            Self::Serial(device) => device.fmt(f),
            Self::Path(path) => f.write_str(path),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::listed::UsbId;
    use super::*;

    const FIRST: &str = "0036002900544850025a0320";
    const SECOND: &str = "0036002900544850025a0321";

    fn usb(name: &str, vid: u16, pid: u16, serial: &str) -> Port {
        let board = (vid, pid) == super::super::listed::BOARD;
        let text = |text: &str| board.then(|| text.to_owned());
        let (manufacturer, product) = (text("slitpose"), text("slitpose board"));
        Port {
            name: name.to_owned(),
            usb: Some(UsbId { vid, pid, serial: Some(serial.to_owned()), manufacturer, product }),
        }
    }

    fn board(name: &str, serial: &str) -> Port {
        usb(name, 0x1209, 0x0001, &serial.to_uppercase())
    }

    fn debugger(name: &str, serial: &str) -> Port {
        usb(name, 0x0483, 0x374e, serial)
    }

    fn listed(ports: &[Port]) -> Vec<Listed> {
        ports.iter().cloned().map(Listed::new).collect()
    }

    fn serial(text: &str) -> Selector {
        Selector::Serial(text.parse().unwrap())
    }

    #[test]
    fn the_one_board_is_taken_and_of_several_the_user_chooses() {
        let error = choose(&Selector::Auto, Vec::new()).unwrap_err().to_string();
        assert!(error.contains("no board found") && error.contains("1209:0001"), "{error}");
        let one = choose(&Selector::Auto, listed(&[board("/dev/ttyACM0", FIRST)])).unwrap();
        assert_eq!((one.name.as_str(), one.device()), ("/dev/ttyACM0", Some(FIRST.parse().unwrap())));

        let both = listed(&[board("/dev/ttyACM0", FIRST), board("/dev/ttyACM1", SECOND)]);
        let error = choose(&Selector::Auto, both.clone()).unwrap_err().to_string();
        for part in ["2 boards", FIRST, SECOND, "/dev/ttyACM0", "/dev/ttyACM1", "--device SERIAL"] {
            assert!(error.contains(part), "{error}");
        }
        assert_eq!(choose(&serial(SECOND), both.clone()).unwrap().name, "/dev/ttyACM1");
        let error = choose(&serial("0036002900544850025a0322"), both).unwrap_err().to_string();
        assert!(error.contains("0036002900544850025a0322 is not there") && error.contains(FIRST), "{error}");
        // A board with two cables.
        let twice = listed(&[board("/dev/ttyACM0", FIRST), board("/dev/ttyACM1", FIRST)]);
        assert_eq!(choose(&Selector::Auto, twice).unwrap().name, "/dev/ttyACM0");
    }

    #[test]
    fn a_silent_port_has_no_board_and_a_busy_one_may_have() {
        let state = |name, state| Listed { state, ..Listed::new(debugger(name, "1")) };
        let silent = state("/dev/ttyACM0", PortState::NoAnswer);
        let used = state("/dev/ttyACM1", PortState::InUse);
        let error = choose(&Selector::Auto, vec![silent.clone(), used.clone()]).unwrap_err().to_string();
        assert!(error.contains("/dev/ttyACM0 (no answer), /dev/ttyACM1 (in use)"), "{error}");
        assert!(choose(&Selector::Auto, vec![silent]).is_err());
        assert_eq!(choose(&Selector::Auto, vec![used]).unwrap().name, "/dev/ttyACM1");
    }

    #[test]
    fn a_board_is_found_again_under_another_name() {
        let before = board("/dev/ttyACM0", FIRST);
        let last = |selector, ports: &[Port]| located(selector, Some(&before), before.device(), ports);
        let after = [board("/dev/ttyACM0", SECOND), board("/dev/ttyACM1", FIRST)];
        let path = Selector::Path("/dev/ttyACM0".to_owned());
        for selector in [&Selector::Auto, &path, &serial(FIRST)] {
            assert_eq!(last(selector, &after).as_deref(), Some("/dev/ttyACM1"));
            // Another board in its place is not it.
            assert_eq!(last(selector, &after[..1]), None);
        }
        assert_eq!(located(&serial(FIRST), None, None, &after).as_deref(), Some("/dev/ttyACM1"));
        assert_eq!(located(&Selector::Auto, None, None, &after), None, "which?");
        assert_eq!(located(&Selector::Auto, None, None, &after[1..]).as_deref(), Some("/dev/ttyACM1"));
    }

    #[test]
    fn a_board_behind_a_debugger_is_found_by_the_debugger() {
        let (last, device) = (debugger("/dev/ttyACM0", "0031"), FIRST.parse().ok());
        let after = [debugger("/dev/ttyACM2", "0032"), debugger("/dev/ttyACM1", "0031")];
        for selector in [Selector::Auto, serial(FIRST)] {
            assert_eq!(located(&selector, Some(&last), device, &after).as_deref(), Some("/dev/ttyACM1"));
            assert_eq!(located(&selector, Some(&last), device, &after[..1]), None);
            // `locate` asks no port.
            assert_eq!(located(&selector, None, None, &after), None);
        }
    }

    #[test]
    fn only_ports_that_may_have_a_board_are_asked() {
        let adapter = usb("/dev/zero", 0x0403, 0x6001, "A1");
        let ports = [board("/dev/null", FIRST), debugger("/dev/ttyACM1", "1"), adapter];
        let names = |search: &[&str], debuggers| {
            let search: Vec<Search> = search.iter().map(|pattern| pattern.parse().unwrap()).collect();
            unsure(&ports, &search, debuggers).into_iter().map(|port| port.name).collect::<Vec<_>>()
        };
        assert_eq!(names(&[], true), ["/dev/ttyACM1"]);
        assert!(names(&["/dev/null"], false).is_empty(), "the board itself");
        assert_eq!(names(&["/dev/zer*", "/dev/zero"], false), ["/dev/zero"]);
    }

    #[test]
    fn names_of_boards_are_no_paths() {
        for path in ["/dev/ttyACM0", "./port", "/dev/serial/by-id/board"] {
            assert_eq!(path.parse::<Selector>().unwrap(), Selector::Path(path.to_owned()));
        }
        for name in ["3600290054485002", "usb", "", "Auto"] {
            assert!(name.parse::<Selector>().is_err(), "{name}");
        }
    }
}

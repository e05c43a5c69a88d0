//! Windows, which has no Unix sockets here: binding one names what serves instead, and types stand in for theirs.

use std::io;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Result, bail};
use console::Term;
use slitpose_head::finding::Finding;
use thread_priority::{ThreadPriority, WinAPIThreadPriority};

use crate::address::Address;

// Sockets in the file system.

pub(crate) type LocalStream = TcpStream;
pub(crate) type AsyncLocalListener = tokio::net::TcpListener;
pub(crate) type AsyncLocalDatagram = tokio::net::UdpSocket;

#[derive(Debug)]
pub(crate) enum SocketFile {}

#[derive(Debug, PartialEq)]
pub(crate) struct PassedSocket {
    pub(crate) process: Option<i32>,
    pub(crate) user: Option<u32>,
}

impl PassedSocket {
    pub(crate) fn send(&self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

/// The error of a Unix socket at `path`.
fn refused<T>(path: &Path, instead: &str) -> Result<T> {
    let address = Address::Unix(path.to_owned());
    bail!("{address} is a Unix socket, and this program has none on this system; give {instead}")
}

pub(crate) fn listen_local(path: &Path) -> Result<(AsyncLocalListener, SocketFile)> {
    refused(path, "127.0.0.1:PORT for the status")
}

pub(crate) fn connect_local(_: &Path) -> io::Result<LocalStream> {
    Err(io::Error::new(io::ErrorKind::Unsupported, "Windows programs have no Unix sockets; give 127.0.0.1:PORT"))
}

pub(crate) fn bind_local(path: &Path) -> Result<(AsyncLocalDatagram, SocketFile)> {
    refused(path, "udp:127.0.0.1:PORT")
}

pub(crate) fn receive_local(_: &AsyncLocalDatagram, _: &mut [u8]) -> io::Result<(usize, Option<PassedSocket>)> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Whether there was no memory for a datagram at that moment.
pub(crate) fn is_out_of_memory(error: &io::Error) -> bool {
    // WSAENOBUFS.
    error.raw_os_error() == Some(10055)
}

// Serial ports.

/// A port, as an example.
pub(crate) const A_PORT: &str = "COM3";

/// Manufacturer and product of a USB device are those of its driver, the same for all boards.
pub(crate) const HAS_USB_TEXTS: bool = false;

/// Ports without a rate are unknown here.
pub(crate) const ANY_BAUD: Option<u32> = None;

/// Whether the ports can be listed.
pub(crate) fn can_list_ports() -> bool {
    true
}

/// The name of a device outside the file system.
const DEVICES: &str = r"\\.\";

/// Whether `name` is that of a port outside the file system: `COM3`, or `\\.\COM12`.
pub(crate) fn is_port_name(name: &str) -> bool {
    let number = |port: &str| port.get(3..).is_some_and(|number| number.parse::<u32>().is_ok());
    name.starts_with(DEVICES) || name.get(..3).is_some_and(|begin| begin.eq_ignore_ascii_case("COM")) && number(name)
}

/// The one name of the port `name`.
pub(crate) fn real_port(name: &str) -> PathBuf {
    name.strip_prefix(DEVICES).unwrap_or(name).to_ascii_uppercase().into()
}

/// The ports whose names match `pattern`, sorted.
pub(crate) fn ports_like(pattern: &str) -> Vec<String> {
    let Ok(pattern) = glob::Pattern::new(&pattern.to_ascii_uppercase()) else { return Vec::new() };
    let listed = serialport::available_ports().unwrap_or_default().into_iter().map(|port| port.port_name);
    let mut names: Vec<String> = listed.filter(|name| pattern.matches(&name.to_ascii_uppercase())).collect();
    names.sort();
    names
}

/// The programs that have a port open: Windows does not say.
pub(crate) fn holders(_: &str) -> Vec<String> {
    Vec::new()
}

/// Whether this user may open the port `name`.
pub(crate) fn port_permission(name: &str) -> Finding {
    Finding::ok("permission", format!("every user may open {name}"))
}

// Priorities.

/// Lets other threads go before the calling one.
pub(crate) fn go_behind() {
    let _ = ThreadPriority::Os(WinAPIThreadPriority::Lowest.into()).set_for_current();
}

/// Gives the calling thread the highest priority of a program without privileges, whatever the number.
pub(crate) fn claim_priority(_: u8) -> Result<(), &'static str> {
    let highest = ThreadPriority::Os(WinAPIThreadPriority::TimeCritical.into());
    highest.set_for_current().map_err(|_| "no higher priority for the threads of the board: leave --real-time out")
}

/// Which priorities this user may claim.
pub(crate) fn priority() -> Finding {
    Finding::ok("priority", "every user may use the highest priority of a thread, as --real-time does")
}

// The service manager, and the machine.

/// There is no service manager to be notified.
pub(crate) fn notify(_: &str) -> io::Result<()> {
    Ok(())
}

/// There is none.
pub(crate) fn watchdog() -> Option<Duration> {
    None
}

/// Before anything else: has consoles obey control sequences, as terminals do.
pub(crate) fn prepare() -> io::Result<()> {
    for console in [Term::stdout(), Term::stderr()] {
        // Asking turns them on.
        console.features().colors_supported();
    }
    Ok(())
}

pub(crate) fn system() -> String {
    let version = Command::new("cmd").args(["/c", "ver"]).stdin(Stdio::null()).output();
    version.map_or_else(
        |error| format!("no version: {error}\n"),
        |version| String::from_utf8_lossy(&version.stdout).trim_start().to_owned(),
    )
}

/// How to set the clock.
pub(crate) const SET_CLOCK: &str = "set the clock: w32tm /resync";

/// Whether the clock is synchronised: Windows says so in its user's language only.
pub(crate) fn synchronised() -> Option<String> {
    None
}

//! Notifies the service manager that the program is ready, alive or about to end.
//!
//! systemd's protocol (`sd_notify(3)`): one datagram per message, to the socket named in the environment. Without a
//! service manager nothing is sent.

use std::ffi::OsStr;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// The program follows its boards, or waits for them.
pub(crate) const READY: &str = "READY=1";

/// The program is alive: to be sent every [`Service::watchdog_every`].
pub(crate) const ALIVE: &str = "WATCHDOG=1";

pub(crate) const STOPPING: &str = "STOPPING=1";

/// The service manager, if there is one.
#[derive(Debug, Default)]
pub(crate) struct Service {
    manager: Option<(UnixDatagram, SocketAddr)>,
    watchdog_every: Option<Duration>,
}

impl Service {
    /// The manager that the environment names, if any.
    pub(crate) fn from_environment() -> io::Result<Self> {
        let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
        let manager = variable("NOTIFY_SOCKET").map(|name| open(&name)).transpose()?;
        let number = |name| variable(name)?.to_str()?.parse::<u64>().ok();
        // Set if the watchdog is for another process, such as the parent of this one.
        let is_other = number("WATCHDOG_PID").is_some_and(|process| process != u64::from(std::process::id()));
        let limit_us = number("WATCHDOG_USEC").filter(|_| !is_other);
        Ok(Self { manager, watchdog_every: limit_us.and_then(watchdog_every) })
    }

    /// Period of [`ALIVE`]: half the watchdog timeout of the manager; `None` without a watchdog.
    pub(crate) fn watchdog_every(&self) -> Option<Duration> {
        self.watchdog_every.filter(|_| self.manager.is_some())
    }

    /// Sends [`READY`], [`ALIVE`], [`STOPPING`], or a `STATUS=` line for people to the manager, if there is one.
    /// Never blocks, allocates nothing.
    pub(crate) fn notify(&self, state: &str) -> io::Result<()> {
        match &self.manager {
            Some((socket, address)) => socket.send_to_addr(state.as_bytes(), address).map(drop),
            None => Ok(()),
        }
    }
}

fn open(name: &OsStr) -> io::Result<(UnixDatagram, SocketAddr)> {
    let socket = UnixDatagram::unbound()?;
    socket.set_nonblocking(true)?;
    Ok((socket, address(name)?))
}

/// Half of the timeout; `None` for zero, which means no timeout.
fn watchdog_every(limit_us: u64) -> Option<Duration> {
    (limit_us > 0).then(|| Duration::from_micros(limit_us / 2).max(Duration::from_micros(1)))
}

/// The socket's address: a path, or after `@` a name in the abstract namespace.
fn address(name: &OsStr) -> io::Result<SocketAddr> {
    match name.as_bytes() {
        [b'/', ..] => SocketAddr::from_pathname(name),
        #[cfg(target_os = "linux")]
        [b'@', name @ ..] => <SocketAddr as std::os::linux::net::SocketAddrExt>::from_abstract_name(name),
        _ => Err(io::ErrorKind::Unsupported.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn service(name: &str) -> Service {
        Service { manager: Some(open(OsStr::new(name)).unwrap()), watchdog_every: watchdog_every(10_000_000) }
    }

    fn heard(manager: &UnixDatagram) -> String {
        let mut buffer = [0; 64];
        let length = manager.recv(&mut buffer).unwrap();
        String::from_utf8(buffer[..length].to_vec()).unwrap()
    }

    #[test]
    fn a_manager_at_a_path_hears_each_word() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        let service = service(path.to_str().unwrap());
        for state in [READY, "STATUS=waiting for a board", ALIVE, STOPPING] {
            service.notify(state).unwrap();
            assert_eq!(heard(&manager), state);
        }
        assert_eq!(service.watchdog_every(), Some(Duration::from_secs(5)));
        drop((manager, folder));
        assert!(service.notify(ALIVE).is_err(), "nobody is there any more");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_manager_without_a_file_hears_it() {
        use std::os::linux::net::SocketAddrExt;
        let name = format!("slitpose-test-{}", std::process::id());
        let manager = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        service(&format!("@{name}")).notify(READY).unwrap();
        assert_eq!(heard(&manager), READY);
    }

    #[test]
    fn a_deaf_service_manager_blocks_no_thread() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let _manager = UnixDatagram::bind(&path).unwrap();
        let service = service(path.to_str().unwrap());
        let refused = (0..1_000_000).find_map(|_| service.notify(ALIVE).err()).unwrap();
        assert_eq!(refused.kind(), io::ErrorKind::WouldBlock);
    }

    #[test]
    fn without_a_manager_nothing_happens() {
        let alone = Service::default();
        assert!(alone.notify(READY).is_ok());
        assert_eq!(alone.watchdog_every(), None);
        assert_eq!(watchdog_every(0), None);
        assert!(address(OsStr::new("vsock:2:1234")).is_err());
    }
}

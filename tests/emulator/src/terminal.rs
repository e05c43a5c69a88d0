//! A pseudo-terminal: the emulator's serial port as other programs open it.

use std::os::fd::AsFd;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd;
use thiserror::Error;

/// The operating system refuses.
#[derive(Debug, Error)]
#[error("pseudo-terminal: {action}")]
pub struct TerminalError {
    action: &'static str,
    source: Errno,
}

/// A raw pseudo-terminal. Nothing here waits.
#[derive(Debug)]
pub struct Terminal {
    master: OwnedFd,
    path: PathBuf,
}

impl Terminal {
    /// Makes one, which nobody has open yet.
    pub fn open() -> Result<Self, TerminalError> {
        let at = |action| move |source| TerminalError { action, source };
        let OpenptyResult { master, slave } = openpty(None, None).map_err(at("openpty"))?;
        let mut settings = tcgetattr(&slave).map_err(at("tcgetattr"))?;
        cfmakeraw(&mut settings);
        tcsetattr(&slave, SetArg::TCSANOW, &settings).map_err(at("tcsetattr"))?;
        let path = unistd::ttyname(&slave).map_err(at("ttyname"))?;
        let flags = OFlag::from_bits_retain(fcntl(&master, FcntlArg::F_GETFL).map_err(at("F_GETFL"))?);
        fcntl(&master, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK)).map_err(at("F_SETFL"))?;
        // Or a program started later would hold it, too, and never see it closed.
        fcntl(&master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).map_err(at("F_SETFD"))?;
        // Our own end of the slave is closed here, so that a hang-up means: nobody has it open.
        drop(slave);
        Ok(Self { master, path })
    }

    /// What other programs open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether some program has it open.
    pub fn is_open(&self) -> Result<bool, TerminalError> {
        let mut polled = [PollFd::new(self.master.as_fd(), PollFlags::empty())];
        poll(&mut polled, PollTimeout::ZERO).map_err(|source| TerminalError { action: "poll", source })?;
        Ok(!polled[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP)))
    }

    /// Reads what has been written by the other side, as much as `buffer` takes; nothing is nothing.
    pub fn read<'a>(&self, buffer: &'a mut [u8]) -> Result<&'a [u8], TerminalError> {
        match unistd::read(&self.master, buffer) {
            Ok(len) => Ok(&buffer[..len]),
            // EIO: nobody has the other side open.
            Err(Errno::EAGAIN | Errno::EINTR | Errno::EIO) => Ok(&[]),
            Err(source) => Err(TerminalError { action: "read", source }),
        }
    }

    /// Writes for the other side; returns how many bytes it took, which may be none while nobody
    /// reads there.
    pub fn write(&self, bytes: &[u8]) -> Result<usize, TerminalError> {
        match unistd::write(&self.master, bytes) {
            Ok(len) => Ok(len),
            Err(Errno::EAGAIN | Errno::EINTR | Errno::EIO) => Ok(0),
            Err(source) => Err(TerminalError { action: "write", source }),
        }
    }
}

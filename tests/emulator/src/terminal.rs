//! A pseudo-terminal: the emulator's serial port as other programs open it.

use std::os::fd::AsFd;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use nix::unistd;

/// A raw pseudo-terminal. Nothing here waits.
#[derive(Debug)]
pub struct Terminal {
    master: OwnedFd,
    path: PathBuf,
}

impl Terminal {
    /// Makes one, which nobody has open yet.
    pub fn open() -> Result<Self> {
        let OpenptyResult { master, slave } = openpty(None, None).context("pseudo-terminal: openpty")?;
        let mut settings = tcgetattr(&slave).context("pseudo-terminal: tcgetattr")?;
        cfmakeraw(&mut settings);
        tcsetattr(&slave, SetArg::TCSANOW, &settings).context("pseudo-terminal: tcsetattr")?;
        let path = unistd::ttyname(&slave).context("pseudo-terminal: ttyname")?;
        let flags = OFlag::from_bits_retain(fcntl(&master, FcntlArg::F_GETFL).context("pseudo-terminal: F_GETFL")?);
        fcntl(&master, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK)).context("pseudo-terminal: F_SETFL")?;
        // Or a program started later would hold it, too, and never see it closed.
        fcntl(&master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).context("pseudo-terminal: F_SETFD")?;
        // Our own end of the slave is closed here, so that a hang-up means: nobody has it open.
        drop(slave);
        Ok(Self { master, path })
    }

    /// What other programs open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether some program has it open.
    pub fn is_open(&self) -> Result<bool> {
        let mut polled = [PollFd::new(self.master.as_fd(), PollFlags::empty())];
        poll(&mut polled, PollTimeout::ZERO).context("pseudo-terminal: poll")?;
        Ok(!polled[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP)))
    }

    /// Reads what has been written by the other side, as much as `buffer` takes; nothing is nothing.
    pub fn read<'a>(&self, buffer: &'a mut [u8]) -> Result<&'a [u8]> {
        match unistd::read(&self.master, buffer) {
            Ok(len) => Ok(&buffer[..len]),
            // EIO: nobody has the other side open.
            Err(Errno::EAGAIN | Errno::EINTR | Errno::EIO) => Ok(&[]),
            error => error.context("pseudo-terminal: read").map(|_| &[][..]),
        }
    }

    /// Writes for the other side; returns how many bytes it took, which may be none while nobody
    /// reads there.
    pub fn write(&self, bytes: &[u8]) -> Result<usize> {
        match unistd::write(&self.master, bytes) {
            Ok(len) => Ok(len),
            Err(Errno::EAGAIN | Errno::EINTR | Errno::EIO) => Ok(0),
            error => error.context("pseudo-terminal: write"),
        }
    }
}

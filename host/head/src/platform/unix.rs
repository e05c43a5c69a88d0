//! Linux, macOS and other Unix systems.

use std::fs::{self, File, FileType, Permissions};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::time::{ClockId, clock_gettime};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::{Interrupt, folder};

/// From now on calls `handle` on a thread of its own for each SIGINT, SIGTERM and SIGHUP, which then do not end the
/// program. A SIGHUP that is ignored, as under `nohup`, stays so.
pub fn on_interrupt(handle: impl Fn(Interrupt) + Send + 'static) -> io::Result<()> {
    let ignored: Vec<_> = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| is_ignored(*signal)).collect();
    let hang_up = (!ignored.contains(&SIGHUP)).then_some(SIGHUP);
    let mut signals = Signals::new([SIGINT, SIGTERM].into_iter().chain(hang_up))?;
    let run = move || {
        signals.forever().for_each(|signal| match signal {
            SIGHUP => handle(Interrupt::TerminalClosed),
            _ if ignored.contains(&signal) => handle(Interrupt::Unheeded),
            _ => handle(Interrupt::Asked),
        });
    };
    std::thread::Builder::new().name("interrupt".to_owned()).spawn(run).map(drop)
}

/// Whether the program was started with `signal` ignored, where the system says so (`proc_pid_status(5)`, SigIgn).
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// A clock that is never set, ns: CLOCK_MONOTONIC, which all programs of this host share. 0 if it cannot be read.
pub fn monotonic_ns() -> u64 {
    clock_gettime(ClockId::CLOCK_MONOTONIC).map_or(0, |time| {
        let seconds = u64::try_from(time.tv_sec()).unwrap_or(0);
        seconds.saturating_mul(1_000_000_000).saturating_add(u64::try_from(time.tv_nsec()).unwrap_or(0))
    })
}

/// The folder of this user's settings.
pub fn user_folder() -> Option<PathBuf> {
    folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))
}

/// The folder of the settings of all users.
pub fn machine_folder() -> Option<PathBuf> {
    Some("/etc".into())
}

/// Permissions of a new file, before the user's umask. Temporary files are private by default, results are not.
pub fn default_permissions() -> Option<Permissions> {
    Some(Permissions::from_mode(0o666))
}

/// Whether there is something at `path` that is neither a regular file nor a folder.
pub fn is_special(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

/// What a file is that is neither a regular file nor a folder.
pub fn special_kind(kind: FileType) -> &'static str {
    match () {
        () if kind.is_fifo() => "pipe",
        () if kind.is_socket() => "socket",
        () => "device",
    }
}

/// Opens a special file for writing; `None` for a named pipe without a reader.
pub fn open_special(path: &Path) -> io::Result<Option<File>> {
    let is_pipe = fs::metadata(path)?.file_type().is_fifo();
    // A pipe that is opened the ordinary way waits where no signal ends it.
    let file = match File::options().write(true).custom_flags(OFlag::O_NONBLOCK.bits()).open(path) {
        Err(error) if is_pipe && error.raw_os_error() == Some(Errno::ENXIO as i32) => return Ok(None),
        opened => opened?,
    };
    let flags = OFlag::from_bits_retain(fcntl(&file, FcntlArg::F_GETFL)?);
    fcntl(&file, FcntlArg::F_SETFL(flags - OFlag::O_NONBLOCK))?;
    Ok(Some(file))
}

/// Standard output as a file.
pub fn standard_output() -> io::Result<File> {
    io::stdout().as_fd().try_clone_to_owned().map(File::from)
}

/// Keeps other programs from holding `file`, which is at `path`, until it is closed, where files can be locked; fails with
/// [`io::ErrorKind::WouldBlock`] if another one does.
pub fn hold(file: File, _path: &Path) -> io::Result<File> {
    match file.try_lock() {
        Err(fs::TryLockError::WouldBlock) => Err(io::ErrorKind::WouldBlock.into()),
        Ok(()) | Err(fs::TryLockError::Error(_)) => Ok(file),
    }
}

/// Whether `file`, once at `path`, was deleted or replaced: what is written to it is lost.
pub fn is_gone(file: &File, _path: &Path) -> bool {
    file.metadata().is_ok_and(|found| found.nlink() == 0)
}

//! Linux, macOS and other Unix systems.

use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use std::{fs, io};

use nix::unistd::{AccessFlags, Gid, Group, access};
use sd_notify::NotifyState;
use slitpose_head::finding::Finding;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

#[path = "unix_sockets.rs"]
mod sockets;

pub use sockets::UnixClient;
pub(crate) use sockets::*;

// Serial ports.

/// A port, as an example.
pub(crate) const A_PORT: &str = "/dev/ttyACM0";

/// The system passes on what USB devices call themselves.
pub(crate) const HAS_USB_TEXTS: bool = true;

/// The pseudo-terminals of macOS refuse every rate; this one leaves it alone there.
pub(crate) const ANY_BAUD: Option<u32> = if cfg!(target_os = "macos") { Some(0) } else { None };

/// Whether the ports can be listed: the library panics without this folder, and a system without it has none.
pub(crate) fn can_list_ports() -> bool {
    !cfg!(target_os = "linux") || Path::new("/sys/class/tty").is_dir()
}

/// Whether `name` is that of a port outside the file system.
pub(crate) fn is_port_name(_: &str) -> bool {
    false
}

/// The target of the path `name`, or the path itself if it does not exist.
pub(crate) fn real_port(name: &str) -> PathBuf {
    fs::canonicalize(name).unwrap_or_else(|_| name.into())
}

/// The character devices that match `pattern`, sorted by name. Unreadable paths do not match.
pub(crate) fn ports_like(pattern: &str) -> Vec<String> {
    let is_port = |path: &PathBuf| fs::metadata(path).is_ok_and(|found| found.file_type().is_char_device());
    let matches = glob::glob(pattern).into_iter().flatten().flatten();
    matches.filter(is_port).filter_map(|path| path.into_os_string().into_string().ok()).collect()
}

/// The programs that have the port `name` open, without those of other users, whose open files are hidden. Reads every open file of the system.
pub(crate) fn holders(name: &str) -> Vec<String> {
    let port = real_port(name);
    let number = |entry: fs::DirEntry| entry.file_name().to_str()?.parse::<u32>().ok();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(number);
    let mut holders: Vec<u32> = processes.filter(|process| has_open(*process, &port)).collect();
    holders.sort_unstable();
    holders.into_iter().map(|process| format!("{} (process {process})", program(process))).collect()
}

fn has_open(process: u32, port: &Path) -> bool {
    let Ok(files) = fs::read_dir(format!("/proc/{process}/fd")) else {
        return false;
    };
    files.flatten().any(|file| fs::read_link(file.path()).is_ok_and(|target| target == port))
}

fn program(process: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{process}/comm")).unwrap_or_default();
    name.trim_end().to_owned()
}

/// Whether this user may open the port `name`, and the group that may.
pub(crate) fn port_permission(name: &str) -> Finding {
    let group = fs::metadata(name).ok().and_then(|port| Group::from_gid(Gid::from_raw(port.gid())).ok().flatten());
    let group = group.map_or_else(|| "without a name".to_owned(), |group| group.name);
    match access(name, AccessFlags::R_OK | AccessFlags::W_OK) {
        Ok(()) => Finding::ok("permission", format!("this user may open {name}, which belongs to the group {group}")),
        Err(error) => Finding::failed(
            "permission",
            format!("this user may not open {name}, which belongs to the group {group}: {error}"),
            "install the udev rule (host/INSTALL.md), or join that group and log in again",
        ),
    }
}

// Priorities.

/// Lets other threads go before the calling one: this is the niceness of the thread alone.
pub(crate) fn go_behind() {
    let _ = rustix::process::nice(10);
}

/// Gives the calling thread this priority (SCHED_FIFO, 1 to 99). The error is advice for the user.
pub(crate) fn claim_priority(priority: u8) -> Result<(), &'static str> {
    const REMEDY: &str = "no real-time priority for the threads of the board: allow it with LimitRTPRIO=99 in the \
                          systemd unit, or in /etc/security/limits.conf, or leave --real-time out";
    let value = ThreadPriorityValue::try_from(priority).map_err(|_| REMEDY)?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|_| REMEDY)
}

/// The priority that the shipped service may use.
const PRIORITY: u64 = 50;

/// Which priorities this user may claim.
pub(crate) fn priority() -> Finding {
    if rustix::process::geteuid().is_root() {
        return Finding::ok("priority", "root may use real-time priorities");
    }
    let Some(limit) = real_time_limit() else {
        return Finding::skipped("priority", "this system does not say what is allowed");
    };
    let text = format!("real-time priorities up to {limit} are allowed");
    if limit >= PRIORITY {
        return Finding::ok("priority", text);
    }
    let text = format!("{text}, {PRIORITY} is needed: a busy host reads late");
    Finding::warning("priority", text, "allow them as host/INSTALL.md describes, or run the service")
}

/// The highest priority that this process may claim; `None` where systems have no such limit.
fn real_time_limit() -> Option<u64> {
    #[cfg(target_os = "linux")]
    return Some(rustix::process::getrlimit(rustix::process::Resource::Rtprio).current.unwrap_or(99));
    #[cfg(not(target_os = "linux"))]
    None
}

// The service manager, and the machine.

/// Notifies systemd in the words of its protocol, such as `READY=1`; without it nothing is sent.
pub(crate) fn notify(notice: &str) -> io::Result<()> {
    sd_notify::notify(&[NotifyState::Custom(notice)])
}

/// How often the service manager wants to be notified that this program is alive, if it does.
pub(crate) fn watchdog() -> Option<Duration> {
    sd_notify::watchdog_enabled()
}

/// Before anything else: lets a file that must not grow any more be an error of writing to it, as a full disk is, and not the
/// end of the program: its other work goes on.
pub(crate) fn prepare() -> io::Result<()> {
    // A signal that is taken notice of is not fatal.
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()).map(drop)
}

/// Kind and version of this operating system and its kernel.
pub(crate) fn system() -> String {
    let release = fs::read_to_string("/etc/os-release").unwrap_or_else(|_| "no /etc/os-release\n".to_owned());
    // Without the name of the host, which is private.
    let kernel = rustix::system::uname();
    let kernel = [kernel.sysname(), kernel.release(), kernel.version(), kernel.machine()];
    format!("{}\n{release}", kernel.map(|part| part.to_string_lossy()).join(" "))
}

/// How to set the clock.
pub(crate) const SET_CLOCK: &str = "set the clock: timedatectl set-ntp true";

/// Whether the clock is synchronised: `yes` or `no`, by systemd, if it runs.
pub(crate) fn synchronised() -> Option<String> {
    let asked = Command::new("timedatectl")
        .args(["show", "--property=NTPSynchronized", "--value"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    asked.status.success().then(|| String::from_utf8_lossy(&asked.stdout).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    #[test]
    fn a_port_that_is_not_there_may_not_be_opened() {
        assert_eq!(port_permission("/dev/null").grade, Grade::Ok);
        assert_eq!(port_permission("/dev/no-such-board").grade, Grade::Failed);
    }
}

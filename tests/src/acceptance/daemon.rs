//! `slitpose run` as a process that is watched while it runs.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use tempfile::TempDir;

use super::usage::Usage;
use super::wall_clock::WallClock;
use crate::process::Slitpose;

/// A busy machine may take long to start a program.
const STARTS_WITHIN: Duration = Duration::from_secs(30);

/// A daemon that runs; dropped, it is killed.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    folder: TempDir,
    stderr: Option<JoinHandle<String>>,
}

/// A daemon that has ended.
#[derive(Debug)]
pub struct Ended {
    /// How.
    pub status: ExitStatus,
    /// All it said.
    pub stderr: String,
    /// Its sockets and captures.
    pub folder: TempDir,
}

impl Daemon {
    /// Starts it with `arguments`, its status on a socket of its own. What it prints goes to `stdout`.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start<A: AsRef<OsStr>>(
        slitpose: Slitpose,
        folder: TempDir,
        arguments: impl IntoIterator<Item = A>,
        stdout: Stdio,
    ) -> Self {
        Self::start_by(None, slitpose, folder, arguments, stdout)
    }

    /// The same by a wall clock of its own.
    ///
    /// # Panics
    /// If it cannot be started.
    pub fn start_by<A: AsRef<OsStr>>(
        clock: Option<&WallClock>,
        slitpose: Slitpose,
        folder: TempDir,
        arguments: impl IntoIterator<Item = A>,
        stdout: Stdio,
    ) -> Self {
        let status = format!("unix:{}", folder.path().join("status").display());
        let mut command = slitpose.command(["run", "--status", &status]);
        command.envs(clock.map(WallClock::environment).into_iter().flatten());
        let mut child = command.args(arguments).stdout(stdout).spawn().expect("slitpose starts");
        let mut talk = child.stderr.take().expect("piped");
        // Read all the time, or a daemon that has much to say would wait.
        let stderr = std::thread::spawn(move || {
            let mut text = String::new();
            talk.read_to_string(&mut text).expect("talk is UTF-8");
            text
        });
        Self { child, folder, stderr: Some(stderr) }
    }

    /// Its folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// What it prints, if that was piped; once.
    ///
    /// # Panics
    /// If it was not, or was taken already.
    pub fn take_stdout(&mut self) -> ChildStdout {
        self.child.stdout.take().expect("piped")
    }

    /// Number of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it takes now; `None` if it has ended.
    pub fn usage(&self) -> Option<Usage> {
        Usage::of(self.child.id())
    }

    /// What it says of itself; `None` if it does not answer, as in its first moments.
    pub fn status(&self) -> Option<Value> {
        let mut stream = UnixStream::connect(self.folder.path().join("status")).ok()?;
        stream.set_read_timeout(Some(STARTS_WITHIN)).ok()?;
        stream.write_all(b"GET /status HTTP/1.0\r\n\r\n").ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()
    }

    /// Waits until its status `suits`, and gives that.
    ///
    /// # Panics
    /// If it does not come to it in half a minute.
    pub fn status_when(&self, suits: impl Fn(&Value) -> bool) -> Value {
        let since = Instant::now();
        loop {
            match self.status() {
                Some(status) if suits(&status) => return status,
                status => assert!(since.elapsed() < STARTS_WITHIN, "not in {STARTS_WITHIN:?}: {status:?}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Sends it a signal and waits for its end.
    ///
    /// # Panics
    /// If it has ended before.
    pub fn end_by(mut self, signal: Signal) -> Ended {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("running");
        let status = self.child.wait().expect("ends");
        let stderr = self.stderr.take().expect("once").join().expect("reader");
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir().expect("temporary folder"));
        Ended { status, stderr, folder }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // Both fail if it has ended, which is as well.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Scans of each board by a status, in the order of the command line.
pub fn scans(status: &Value) -> Vec<u64> {
    boards(status).map(|board| board["scans"].as_u64().unwrap_or(0)).collect()
}

/// The boards of a status.
pub fn boards(status: &Value) -> impl Iterator<Item = &Value> {
    status["boards"].as_array().into_iter().flatten()
}

/// A name in `folder`.
///
/// # Panics
/// If the folder's is not UTF-8.
pub fn name_in(folder: &Path, name: &str) -> String {
    let path: PathBuf = folder.join(name);
    path.into_os_string().into_string().expect("UTF-8 path")
}

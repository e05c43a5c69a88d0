//! `slitpose run` as a process under observation: its status, its use of memory and processor, and its clients.

use std::ffi::OsStr;
use std::fs;
use std::io::Read;
use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::Value;
use slitpose::datagram::{Mode, Request};
use slitpose::platform::UnixClient;
use tempfile::TempDir;
use tungstenite::Message;

use crate::process::{Slitpose, get, signal};

/// A busy machine may take long to start a program.
const STARTS_WITHIN: Duration = Duration::from_secs(30);

/// A daemon that runs, and its folder with sockets and captures; dropped, it is killed.
#[derive(Debug)]
pub struct Daemon {
    pub child: Child,
    folder: TempDir,
    stderr: Option<JoinHandle<String>>,
}

#[derive(Debug)]
pub struct Ended {
    pub status: ExitStatus,
    pub stderr: String,
    pub folder: TempDir,
}

impl Daemon {
    /// Starts it with `arguments`, its status on a socket of its own, by a wall clock of its own if there is one. What it
    /// prints goes to `stdout`.
    pub fn start<A: AsRef<OsStr>>(
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
        let stderr = spawn(move || {
            let mut text = String::new();
            talk.read_to_string(&mut text).expect("talk is UTF-8");
            text
        });
        Self { child, folder, stderr: Some(stderr) }
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// What it takes now; `None` if it has ended.
    pub fn usage(&self) -> Option<Usage> {
        Usage::of(self.child.id())
    }

    /// What it says of itself; `None` if it does not answer, as in its first moments.
    pub fn status(&self) -> Option<Value> {
        let stream = UnixStream::connect(self.folder.path().join("status")).ok()?;
        stream.set_read_timeout(Some(STARTS_WITHIN)).ok()?;
        serde_json::from_str(&get(stream, "/status")?.1).ok()
    }

    pub fn status_when(&self, suits: impl Fn(&Value) -> bool) -> Value {
        let since = Instant::now();
        loop {
            match self.status() {
                Some(status) if suits(&status) => return status,
                status => assert!(since.elapsed() < STARTS_WITHIN, "not in {STARTS_WITHIN:?}: {status:?}"),
            }
            sleep(Duration::from_millis(20));
        }
    }

    pub fn end_by(mut self, by: Signal) -> Ended {
        signal(&self.child, by);
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

pub fn boards(status: &Value) -> impl Iterator<Item = &Value> {
    status["boards"].as_array().into_iter().flatten()
}

/// Memory, threads, descriptors and processor time of a process, from Linux's /proc.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    pub resident_bytes: u64,
    pub peak_bytes: u64,
    pub threads: u64,
    /// Open files, sockets, and whatever else has a descriptor.
    pub descriptors: u64,
    /// Processor time taken so far, of all its threads, in user and system mode.
    pub cpu_s: f64,
}

impl Usage {
    /// Reads the usage of process `id`; `None` if it has ended.
    pub fn of(id: u32) -> Option<Self> {
        let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
        let field = |name: &str| -> Option<u64> {
            let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
            line.split_whitespace().next()?.parse().ok()
        };
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
        // Behind its name, which may hold anything, come the fields from the third on; 14 and 15 are times, in hundredths
        // of a second, whatever the kernel's own rate is (proc(5)).
        let (_, stat) = stat.rsplit_once(')')?;
        let ticks = stat.split_whitespace().skip(11).take(2).map(str::parse::<f64>);
        let descriptors = fs::read_dir(format!("/proc/{id}/fd")).ok()?.count() as u64;
        Some(Self {
            resident_bytes: field("VmRSS")? * 1024,
            peak_bytes: field("VmHWM")? * 1024,
            threads: field("Threads")?,
            descriptors,
            cpu_s: ticks.sum::<Result<f64, _>>().ok()? / 100.0,
        })
    }
}

/// A wall clock that can be set: a library for `LD_PRELOAD`, made here by the C compiler, and the file that it reads.
#[derive(Debug)]
pub struct WallClock {
    folder: TempDir,
    file: fs::File,
}

impl WallClock {
    /// One that goes right.
    pub fn make() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        let [source, library, ahead] = ["wall_clock.c", "wall_clock.so", "ahead"].map(|name| folder.path().join(name));
        fs::write(&source, include_str!("wall_clock.c")).expect("room");
        let made = Command::new("cc").args(["-shared", "-fPIC", "-O2", "-o"]).arg(&library).arg(&source).status();
        assert!(made.is_ok_and(|status| status.success()), "cc makes {}", library.display());
        fs::write(&ahead, 0_i64.to_ne_bytes()).expect("room");
        let file = fs::OpenOptions::new().write(true).open(&ahead).expect("just written");
        Self { folder, file }
    }

    /// The environment of a process that goes by it.
    fn environment(&self) -> [(&'static str, PathBuf); 2] {
        let path = |name| self.folder.path().join(name);
        [("LD_PRELOAD", path("wall_clock.so")), ("SLITPOSE_WALL_CLOCK", path("ahead"))]
    }

    /// Sets it ahead of the right time, or behind it.
    pub fn set_ahead(&self, nanoseconds: i64) {
        self.file.write_all_at(&nanoseconds.to_ne_bytes(), 0).expect("a file of eight bytes");
    }
}

/// A control loop that is sent every pose, and counts them.
pub struct Subscriber {
    over: Arc<AtomicBool>,
    thread: JoinHandle<u64>,
}

impl Subscriber {
    /// Follows the daemon whose socket is `server`, which may not be there yet.
    pub fn start(server: PathBuf) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&over);
        let thread = spawn(move || {
            let mut client = Follower::of(server);
            let mut count = 0;
            while !ends.load(Ordering::Relaxed) {
                count += u64::from(client.receive(&mut [0; 1024]));
            }
            count
        });
        Self { over, thread }
    }

    /// How many datagrams it was sent.
    pub fn end(self) -> u64 {
        self.over.store(true, Ordering::Relaxed);
        self.thread.join().expect("subscriber")
    }
}

pub struct Follower {
    client: UnixClient,
    server: PathBuf,
    asked: Option<Instant>,
}

impl Follower {
    /// The daemon whose socket is `server`, which may not be there yet.
    pub fn of(server: PathBuf) -> Self {
        let client = UnixClient::new().expect("socket");
        client.socket.set_read_timeout(Some(Duration::from_millis(100))).expect("settable");
        Self { client, server, asked: None }
    }

    /// Whether a datagram has come within a tenth of a second.
    pub fn receive(&mut self, datagram: &mut [u8]) -> bool {
        if self.asked.is_none_or(|asked| asked.elapsed() > Duration::from_millis(500)) {
            // There is no socket before the daemon has made it, and none when it has gone.
            let request = Request::new(Mode::Follow, None);
            self.asked = self.client.ask(&self.server, request).is_ok().then(Instant::now);
        }
        self.client.socket.recv(datagram).is_ok()
    }
}

/// Messages that a live page takes between two acknowledgements.
const ACKNOWLEDGED: usize = 8;

/// Starts live pages, which come back whenever they lose their daemon, and returns the address at which they look for one.
/// The first so many take no messages after their hello.
pub fn live_pages(count: usize, asleep: usize) -> SocketAddr {
    let address = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a free port");
    for number in 0..count {
        spawn(move || {
            loop {
                visit(number < asleep, address);
                sleep(Duration::from_millis(100));
            }
        });
    }
    address
}

/// Stays with the daemon at `address` until it is lost; at once if there is none.
fn visit(sleeps: bool, address: SocketAddr) {
    let Ok((mut socket, _)) = tungstenite::connect(format!("ws://{address}/live")) else { return };
    let mut sent = socket.send(Message::text(r#"{"kind":"hello"}"#));
    if sleeps {
        sleep(Duration::from_secs(3600));
    }
    let mut taken = 0;
    while sent.is_ok() && socket.read().is_ok() {
        taken += 1;
        if taken % ACKNOWLEDGED == 0 {
            sent = socket.send(Message::text(format!(r#"{{"kind":"ack","messages":{taken}}}"#)));
        }
    }
}

//! The `slitpose` command as a process.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// The command under test. Only a test knows where cargo put it: see [`slitpose!`](crate::slitpose).
#[derive(Clone, Copy, Debug)]
pub struct Slitpose {
    path: &'static str,
}

/// The `slitpose` command built with this test.
#[macro_export]
macro_rules! slitpose {
    () => {
        $crate::process::Slitpose::at(env!("CARGO_BIN_EXE_slitpose-under-test"))
    };
}

/// Compiles `source`, a path in the repository, as a user would whose control loop is in C.
pub fn compile(source: &str, folder: &Path) -> PathBuf {
    let repository = |path: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    let program = folder.join("compiled");
    let mut cc = Command::new("cc");
    cc.args(["-O2", "-std=c11", "-I"]).arg(repository("host/include")).arg("-o");
    let output = cc.args([&program, &repository(source)]).output().expect("a C compiler, as `cc`");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    program
}

#[derive(Clone, Debug)]
pub struct Finished {
    pub code: i32,
    pub stdout: Vec<u8>,
    pub stderr: String,
}

impl Slitpose {
    pub fn at(path: &'static str) -> Self {
        Self { path }
    }

    pub fn path(self) -> &'static str {
        self.path
    }

    /// Runs it with nothing on standard input.
    pub fn run<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>) -> Finished {
        self.run_with_input(arguments, "")
    }

    pub fn run_with_input<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>, input: &str) -> Finished {
        let mut child = self.command(arguments).stdin(Stdio::piped()).spawn().expect("slitpose starts");
        let mut stdin = child.stdin.take().expect("piped");
        let input = input.to_owned();
        // Fed beside the reading of its output, or both would wait for each other.
        let feeder = std::thread::spawn(move || {
            // A command that fails early does not read its input.
            let _ = stdin.write_all(input.as_bytes());
        });
        let finished = Finished::of(child);
        feeder.join().expect("feeder");
        finished
    }

    /// The command itself, its outputs captured, for tests that wire it up otherwise.
    pub fn command<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>) -> Command {
        let mut command = Command::new(self.path);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn spawn<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>) -> Child {
        self.command(arguments).spawn().expect("slitpose starts")
    }
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().expect("ends without a signal"),
            stdout: output.stdout,
            stderr: String::from_utf8(output.stderr).expect("talk is UTF-8"),
        }
    }
}

impl Finished {
    pub fn of(child: Child) -> Self {
        child.wait_with_output().expect("ends").into()
    }

    pub fn interrupted(child: Child) -> Self {
        signal(&child, Signal::SIGINT);
        Self::of(child)
    }

    pub fn text(&self) -> &str {
        std::str::from_utf8(&self.stdout).expect("data is UTF-8")
    }

    /// Standard output of a command that has done its work.
    #[track_caller]
    pub fn done(self) -> String {
        assert_eq!(self.code, 0, "stderr: {}", self.stderr);
        String::from_utf8(self.stdout).expect("data is UTF-8")
    }

    /// The same of one that had nothing to say.
    #[track_caller]
    pub fn silently_done(self) -> Vec<u8> {
        assert_eq!((self.code, self.stderr.as_str()), (0, ""));
        self.stdout
    }

    /// Asserts that the command failed with `code`, printed no data, and said all of `parts`.
    #[track_caller]
    pub fn assert_refused(&self, code: i32, parts: &[&str]) {
        assert!(self.stdout.is_empty(), "data in spite of failure: {}", String::from_utf8_lossy(&self.stdout));
        self.assert_said(code, parts);
    }

    #[track_caller]
    pub fn assert_said(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "stderr: {}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "`{part}` is not in: {}", self.stderr);
        }
    }
}

pub fn signal(child: &Child, signal: Signal) {
    kill(Pid::from_raw(i32::try_from(child.id()).expect("an id")), signal).expect("running");
}

pub fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8 path")
}

pub fn name_in(folder: &Path, name: &str) -> String {
    text(&folder.join(name)).to_owned()
}

/// The path of a new file in `folder`.
pub fn written(folder: &Path, name: &str, content: impl AsRef<[u8]>) -> String {
    let path = name_in(folder, name);
    std::fs::write(&path, content).expect("written");
    path
}

/// Names of the files in `folder`, hidden ones included.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// The address in the line that `child` begins its talk with, behind `what`. It says nothing more that could be lost.
pub fn address_said(child: &mut Child, what: &str) -> String {
    let mut line = String::new();
    BufReader::new(child.stderr.as_mut().expect("piped")).read_line(&mut line).expect("UTF-8");
    let address = line.trim_end().strip_prefix("slitpose: ").and_then(|said| said.strip_prefix(what));
    address.unwrap_or_else(|| panic!("{line}")).to_owned()
}

/// Code and body of what a server answers on `stream`; `None` if it does not.
pub fn get(mut stream: impl Read + Write, path: &str) -> Option<(u16, String)> {
    write!(stream, "GET {path} HTTP/1.0\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let (head, body) = answer.split_once("\r\n\r\n")?;
    Some((head.split(' ').nth(1)?.parse().ok()?, body.to_owned()))
}

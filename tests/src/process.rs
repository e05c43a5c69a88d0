//! The `slitpose` command as a process.

use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

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

/// A command that has ended.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The exit code.
    pub code: i32,
    /// All of standard output.
    pub stdout: Vec<u8>,
    /// All of standard error.
    pub stderr: String,
}

impl Slitpose {
    /// The executable at `path`.
    pub fn at(path: &'static str) -> Self {
        Self { path }
    }

    /// That of `path`, or the one that cargo has put beside the running example.
    ///
    /// # Panics
    /// If there is none.
    pub fn given_or_beside(path: Option<PathBuf>) -> Self {
        let path = path.unwrap_or_else(|| {
            let example = std::env::current_exe().expect("the running example has a path");
            example.parent().and_then(Path::parent).expect("a folder of examples").join("slitpose")
        });
        assert!(path.is_file(), "no {}; build it with `cargo build --release -p slitpose`", path.display());
        // Once in a process.
        Self { path: path.into_os_string().into_string().expect("UTF-8 path").leak() }
    }

    /// Where it is.
    pub fn path(self) -> &'static str {
        self.path
    }

    /// Runs it with nothing on standard input.
    pub fn run<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>) -> Finished {
        self.run_with_input(arguments, "")
    }

    /// Runs it with `input` on standard input.
    ///
    /// # Panics
    /// If it cannot be started, or ends by a signal.
    pub fn run_with_input<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>, input: &str) -> Finished {
        let mut child = self.command(arguments).stdin(Stdio::piped()).spawn().expect("slitpose starts");
        let mut stdin = child.stdin.take().expect("piped");
        let input = input.to_owned();
        // Fed beside the reading of its output, or both would wait for each other.
        let feeder = std::thread::spawn(move || {
            // A command that fails early does not read its input.
            let _ = stdin.write_all(input.as_bytes());
        });
        let output = child.wait_with_output().expect("slitpose ends");
        feeder.join().expect("feeder");
        output.into()
    }

    /// The command itself, its outputs captured, for tests that wire it up otherwise.
    pub fn command<A: AsRef<OsStr>>(self, arguments: impl IntoIterator<Item = A>) -> Command {
        let mut command = Command::new(self.path);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }
}

impl From<Output> for Finished {
    /// # Panics
    /// If the command ended by a signal.
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().expect("ends without a signal"),
            stdout: output.stdout,
            stderr: String::from_utf8(output.stderr).expect("talk is UTF-8"),
        }
    }
}

impl Finished {
    /// Standard output of a command that has done its work.
    ///
    /// # Panics
    /// If it has not, or has printed anything but text.
    pub fn done(self) -> String {
        assert_eq!(self.code, 0, "stderr: {}", self.stderr);
        String::from_utf8(self.stdout).expect("data is UTF-8")
    }

    /// Asserts that the command failed with `code`, printed no data, and said all of `parts`.
    ///
    /// # Panics
    /// If not.
    pub fn assert_refused(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "stderr: {}", self.stderr);
        assert!(self.stdout.is_empty(), "data in spite of failure: {}", String::from_utf8_lossy(&self.stdout));
        for part in parts {
            assert!(self.stderr.contains(part), "`{part}` is not in: {}", self.stderr);
        }
    }
}

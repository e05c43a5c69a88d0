//! The emulator as a process: `slitpose-emulator` with the image of `firmware/build`.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use slitpose_tests::process::Finished;
use slitpose_tests::slitpose;

/// The program with `arguments`, its streams piped.
pub(super) fn emulator(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_slitpose-emulator-under-test"));
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// An emulator under way.
pub(super) struct Emulator {
    child: Child,
    pub(super) stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
    /// What it printed first, without the end of the line.
    pub(super) path: String,
}

impl Emulator {
    /// Starts it; it has printed its path on return.
    pub(super) fn start(arguments: &[&str]) -> Self {
        println!("slitpose-emulator {arguments:?}");
        let mut child = emulator(arguments).spawn().expect("slitpose-emulator starts");
        let stdin = child.stdin.take().expect("piped");
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut path = String::new();
        stdout.read_line(&mut path).expect("UTF-8");
        let path = path.strip_suffix('\n').expect("a whole line").to_owned();
        Self { child, stdin, stdout, path }
    }

    /// `slitpose run` on its board, whose head is as its scene says.
    pub(super) fn run(&self, arguments: &[&str]) -> Finished {
        slitpose!().run(["run", "--device", &self.path, "--calibration", "none"].iter().chain(arguments))
    }

    /// Closes its standard input; gives what it said to standard error until its end. It must not
    /// have printed anything but the path, nor found the program at fault.
    pub(super) fn close(mut self) -> String {
        drop(self.stdin);
        let mut rest = String::new();
        self.stdout.read_to_string(&mut rest).expect("UTF-8");
        assert_eq!(rest, "", "more than the path on standard output");
        let finished = Finished::of(self.child);
        assert_eq!(finished.code, 0, "{}", finished.stderr);
        println!("{}", finished.stderr);
        let ratio = finished.stderr.lines().next().unwrap_or_default();
        assert!(ratio.contains("s of device time in") && ratio.contains("ratio"), "{ratio}");
        assert_eq!(finished.stderr.lines().count(), 1, "the program is at fault: {}", finished.stderr);
        finished.stderr
    }
}

//! What stands on a terminal, judged by a terminal emulator (the crate vt100) behind a pseudo-terminal:
//! nothing wrapped, nothing left over, at every size and after a change of it.

use std::fs::File;
use std::io::Read;
use std::num::NonZero;
use std::os::fd::OwnedFd;
use std::process::Child;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{Winsize, openpty};
use nix::sys::signal::Signal;
use slitpose_tests::process::{signal, text};
use slitpose_tests::slitpose;

/// A view that never comes is given up after this; it is no measure of speed.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(120);

/// A terminal's window, and a command that runs in it.
struct Window {
    child: Running,
    master: OwnedFd,
    shown: Arc<Mutex<Shown>>,
    reader: JoinHandle<()>,
}

/// A command that does not outlive its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // One that has ended is no longer there to be killed.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct Shown {
    screen: vt100::Parser,
    bytes: Vec<u8>,
}

impl Window {
    fn open(arguments: &[&str], rows: u16, columns: u16, environment: &[(&str, &str)]) -> Self {
        let size = Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        let pair = openpty(Some(&size), None).expect("pseudo-terminal");
        // Or the command would hold the other end of its own terminal.
        fcntl(&pair.master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).expect("closes");
        let slave = || pair.slave.try_clone().expect("terminal");
        let mut command = slitpose!().command(arguments);
        command.env("TERM", "xterm").env_remove("NO_COLOR").envs(environment.iter().copied());
        let child = command.stdin(slave()).stdout(slave()).stderr(slave()).spawn().expect("starts");
        let child = Running(child);
        drop(command);
        let shown = Shown { screen: vt100::Parser::new(count(rows), count(columns), 0), bytes: Vec::new() };
        let shown = Arc::new(Mutex::new(shown));
        let (mut output, seen) = (File::from(pair.master.try_clone().expect("terminal")), Arc::clone(&shown));
        let reader = std::thread::spawn(move || {
            let mut chunk = [0; 4096];
            // A terminal that nobody has open any more is an error to read from.
            while let Ok(count @ 1..) = output.read(&mut chunk) {
                let mut shown = seen.lock().expect("not poisoned");
                shown.screen.process(&chunk[..count]);
                shown.bytes.extend_from_slice(&chunk[..count]);
            }
        });
        Self { child, master: pair.master, shown, reader }
    }

    fn resize(&self, rows: u16, columns: u16) {
        let size = rustix::termios::Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        let mut shown = self.shown.lock().expect("not poisoned");
        rustix::termios::tcsetwinsize(&self.master, size).expect("resized");
        shown.screen.screen_mut().set_size(count(rows), count(columns));
    }

    /// Waits until the screen shows each of `names` at the beginning of one row, in this order, none
    /// of `others` more than once, and no row that the terminal has wrapped.
    fn expect(&self, names: &[&str], others: &[&str]) {
        let until = Instant::now() + GIVEN_UP_AFTER;
        loop {
            let (rows, wrapped) = self.rows();
            let beginning = |name: &&str| rows.iter().filter(|row| row.starts_with(*name)).count();
            let ordered: Vec<_> =
                rows.iter().filter_map(|row| names.iter().find(|name| row.starts_with(**name))).collect();
            if !wrapped
                && ordered.iter().eq(&names.iter().collect::<Vec<_>>())
                && others.iter().all(|name| beginning(name) <= 1)
            {
                return;
            }
            assert!(
                Instant::now() < until,
                "{names:?} are not each there once:\n{}\nwrapped: {wrapped}",
                rows.join("\n")
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn rows(&self) -> (Vec<String>, bool) {
        let shown = self.shown.lock().expect("not poisoned");
        let screen = shown.screen.screen();
        let (rows, columns) = (screen.size().0.get(), screen.size().1.get());
        (screen.rows(0, columns).collect(), (0..rows).any(|row| screen.row_wrapped(row)))
    }

    /// Interrupts the command, if it is to be, and gives all that it wrote to the terminal.
    fn end(mut self, by: Option<Signal>) -> String {
        if let Some(by) = by {
            signal(&self.child.0, by);
        }
        self.child.0.wait().expect("ends");
        self.reader.join().expect("reader");
        let shown = Arc::into_inner(self.shown).expect("of nobody else").into_inner().expect("not poisoned");
        String::from_utf8(shown.bytes).expect("UTF-8")
    }
}

fn count(characters: u16) -> NonZero<u16> {
    NonZero::new(characters).expect("a window")
}

/// Names of lines that must not stand twice.
const OTHERS: [&str; 6] = ["rate", "lost", "outcomes", "cells", "against", "MCU"];

#[test]
fn a_live_view_fits_every_window() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("c.mcap");
    let arguments = ["run", "--config", "none", "--device", "sim", "--record", text(&capture)];
    let window = Window::open(&arguments, 24, 80, &[]);
    let (wide, low) =
        (["board", "position", "rotation", "link", "rate", "recorder"], ["board", "position", "rotation", "recorder"]);
    window.expect(&wide, &OTHERS);
    for (rows, columns, names) in [(10, 40, &low[..]), (24, 80, &wide[..]), (40, 120, &wide[..]), (30, 30, &low[..])] {
        window.resize(rows, columns);
        window.expect(names, &OTHERS);
    }
    let printed = window.end(Some(Signal::SIGINT));
    assert!(printed.contains("MB in ") && printed.contains("slitpose: recorded "), "{printed}");
    let window = Window::open(&arguments[..5], 10, 40, &[]);
    window.expect(&["board", "position", "rotation"], &OTHERS);
    window.end(Some(Signal::SIGINT));
}

#[test]
fn messages_stand_above_the_view() {
    let arguments = ["run", "--config", "none", "--device", "sim", "--device", "/dev/no-such-board"];
    let window = Window::open(&arguments, 40, 200, &[]);
    window.expect(
        &[
            "slitpose: there is no /dev/no-such-board",
            "board       simulated",
            "position",
            "board       not known",
            "link        searching",
        ],
        &OTHERS,
    );
    let printed = window.end(Some(Signal::SIGINT));
    assert!(printed.contains("\u{1b}[33mlink        searching"), "what is wrong has no colour: {printed:?}");
}

#[test]
fn a_replay_shows_summary_and_progress() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("capture.mcap");
    slitpose!().run(["simulate", "--duration", "2s", "--output", text(&capture)]).done();
    for (rows, columns) in [(24, 80), (10, 40)] {
        let window = Window::open(&["replay", text(&capture), "--speed", "0.01"], rows, columns, &[]);
        window.expect(&["board", "position", "rotation", "progress"], &OTHERS);
        window.resize(20, 60);
        window.expect(&["board", "position", "rotation", "progress"], &OTHERS);
        window.end(Some(Signal::SIGINT));
    }
    // A terminal that cannot move its cursor gets the summary once.
    for terminal in ["dumb", ""] {
        let printed = Window::open(&["replay", text(&capture)], 24, 80, &[("TERM", terminal)]).end(None);
        assert!(!printed.contains('\u{1b}') && printed.matches("position").count() == 1, "{printed:?}");
        assert!(!printed.contains("progress"), "{printed}");
    }
    let printed = Window::open(&["replay", text(&capture)], 24, 80, &[("NO_COLOR", "1")]).end(None);
    assert!(
        printed.contains("progress") && !printed.contains("m\u{1b}") && !printed.contains("\u{1b}[0m"),
        "{printed:?}"
    );
}

#[test]
fn a_table_that_goes_to_a_file_shows_its_progress() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [poses, currents] = ["poses.csv", "currents.csv"].map(|name| folder.path().join(name));
    let rows = (0..4000).map(|id| format!("{id},0.1,0.2,0.3,0,0,0\n"));
    let header = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n";
    std::fs::write(&poses, header.to_owned() + &rows.collect::<String>()).expect("written");
    let model = ["model", "wide", "--poses", text(&poses)];
    let shown = |arguments: &[&str]| Window::open(arguments, 24, 80, &[]).end(None);
    assert!(!shown(&model).contains(" MB"), "the table goes to the terminal");
    let printed = shown(&[&model[..], &["--output", text(&currents)]].concat());
    assert!(printed.contains("model") && printed.contains(" MB"), "{printed:?}");
}

#[test]
fn errors_are_red_unless_nobody_wants_colours() {
    let error = |environment: &[(&str, &str)]| {
        Window::open(&["scene", "check", "no-such-scene"], 24, 80, environment).end(None)
    };
    assert!(error(&[]).starts_with("\u{1b}[1;31mslitpose:\u{1b}[0m cannot read scene"));
    for plain in [("NO_COLOR", "1"), ("TERM", "dumb")] {
        assert!(error(&[plain]).starts_with("slitpose: cannot read scene"), "{plain:?}");
    }
}

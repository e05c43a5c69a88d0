//! Boards that answer, and whose poses cannot be had: each is named with what to do, and no run waits for ever.

use std::net::TcpStream;
use std::process::Child;
use std::time::{Duration, Instant};

use slitpose_protocol::{BoardKind, Command, Hello, Message};
use slitpose_tests::process::{Finished, address_said, get};
use slitpose_tests::slitpose;
use slitpose_tests::terminal::{Board, Device, Log, Terminal, edited, greeting, packet, rewritten};

/// A busy machine may take its time.
const PATIENCE: Duration = Duration::from_secs(60);

/// A board under way, and the program that follows it.
struct Run {
    terminal: Terminal,
    child: Child,
}

impl Run {
    fn start(device: impl Device, arguments: &[&str]) -> Self {
        Self::on(Terminal::serve(device), arguments)
    }

    fn on(terminal: Terminal, arguments: &[&str]) -> Self {
        let arguments =
            ["run", "--config", "none", "--device", &terminal.path].into_iter().chain(arguments.iter().copied());
        let child = slitpose!().spawn(arguments);
        Self { terminal, child }
    }

    fn end(self) -> (Finished, Log) {
        let finished = Finished::of(self.child);
        (finished, self.terminal.closed())
    }
}

/// A board that sends no batches.
fn talkative(seed: u64) -> impl Device {
    edited(Board::wide(seed), |message| Some(message).filter(|message| !matches!(message, Message::Batch(_))))
}

/// A board whose batches are of another configuration than it says.
fn misconfigured(seed: u64) -> impl Device {
    edited(Board::wide(seed), |mut message| {
        if let Message::Batch(batch) = &mut message {
            batch.configuration += 1;
        }
        Some(message)
    })
}

/// A board whose batches do not fit its schedule.
fn unreadable(seed: u64) -> impl Device {
    edited(Board::wide(seed), |mut message| {
        if let Message::Batch(batch) = &mut message {
            batch.samples = &batch.samples[..batch.samples.len() - 1];
        }
        Some(message)
    })
}

#[test]
fn a_run_without_usable_scans_ends_and_says_why() {
    let unusable = "no usable scan for ";
    let foreign = "end any other program that speaks to the board";
    let another = "cannot be read; build firmware and program from the same source";
    // Side by side: each takes the seconds after which scans are missed. Where nothing but a status comes, half a
    // second may pass without a byte, which is an end, too.
    let runs = [
        (Run::start(talkative(81), &["--duration", "10s"]), ["from the board on", "reset the board"]),
        (Run::start(misconfigured(82), &["--duration", "10s"]), [unusable, foreign]),
        (Run::start(unreadable(83), &["--patience", "1s"]), [unusable, another]),
    ];
    for (run, words) in runs {
        let (finished, log) = run.end();
        finished.assert_refused(1, &words);
        let commands = log.commands();
        // Patience does not begin anew because the board has answered.
        assert_eq!(commands.iter().filter(|command| **command == Command::Start).count(), 1, "{commands:?}");
        assert_eq!(commands.last(), Some(&Command::Stop));
    }
}

#[test]
fn no_board_without_scans_is_healthy_at_any_time() {
    let mut run =
        Run::on(Terminal::serve_until_pulled(misconfigured(84)), &["--format", "none", "--status", "127.0.0.1:0"]);
    let address = address_said(&mut run.child, "status at ");
    let since = Instant::now();
    loop {
        let (code, text) = get(TcpStream::connect(&address).expect("listens"), "/health").expect("an answer");
        assert_eq!(code, 503, "{text}");
        if text.contains("that this program has not given") {
            break;
        }
        assert!(since.elapsed() < PATIENCE, "{text}");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(Finished::interrupted(run.child).code, 3, "batches were lost");
}

#[test]
fn what_only_a_person_can_mend_ends_the_program_at_once() {
    let of_four_cells = greeting(Board::wide(85), |hello| {
        hello.schedule.cells = 4;
        hello.schedule.slots.iter_mut().for_each(|lit| lit.0 &= 0b1111);
    });
    let without_scale = greeting(Board::wide(86), |hello| {
        hello.scaling.amperes_per_code = f64::NAN;
    });
    let runs = [
        (Run::start(of_four_cells, &[]), ["samples 4 cells", "6"]),
        (Run::start(without_scale, &[]), ["ADC scaling that cannot be used", "update its firmware"]),
    ];
    for (run, words) in runs {
        let (finished, log) = run.end();
        finished.assert_refused(1, &words);
        assert_eq!(finished.stderr.lines().count(), 1, "{}", finished.stderr);
        assert_ne!(log.commands().last(), Some(&Command::Start), "lit in the end");
    }
}

#[test]
fn two_ports_of_one_board_are_refused() {
    let terminals = [87, 88].map(|seed| Terminal::serve_until_pulled(Board::wide(seed)));
    let devices = terminals.map(|terminal| terminal.path);
    let finished = slitpose!().run(["run", "--config", "none", "--device", &devices.join(","), "--duration", "10s"]);
    finished.assert_said(1, &[&devices[0], &devices[1], "have one number", "two ports of one board"]);
}

#[test]
fn what_no_sound_board_does_is_said_once_and_poses_go_on() {
    let mut batches = 0;
    let jumping = edited(Board::wide(89), move |mut message| {
        if let Message::Batch(batch) = &mut message {
            batches += 1;
            // A third of a second by a clock of 170 MHz.
            batch.tick += if batches > 100 { 56_666_667 } else { 0 };
        }
        Some(message)
    });
    let truthful = greeting(Board::wide(90), |hello| {
        hello.kind = BoardKind::Physical;
    });
    // Says who it is once more after a hundred batches, by another name.
    let (mut renamed_hello, mut count) = (Vec::new(), 0);
    let renamed = rewritten(Board::wide(91), move |message, sent| {
        sent.extend(packet(&message));
        if let Message::Hello(hello) = &message {
            renamed_hello = packet(&Message::Hello(Hello { device_id: *b"another one\0", ..hello.clone() }));
        }
        count += u32::from(matches!(message, Message::Batch(_)));
        if count == 100 {
            sent.append(&mut renamed_hello);
        }
    });
    let runs = [
        (Run::start(jumping, &["--duration", "1s"]), "clock jumped by +0.33"),
        (Run::start(truthful, &["--duration", "1s"]), "sends true poses"),
        (Run::start(renamed, &["--duration", "1s"]), "in the midst of its stream"),
    ];
    for (run, words) in runs {
        let (finished, _) = run.end();
        assert_eq!(finished.code, 0, "{}", finished.stderr);
        assert_eq!(finished.stderr.matches(words).count(), 1, "{}", finished.stderr);
        let text = String::from_utf8(finished.stdout).expect("UTF-8");
        assert!(text.lines().count() > 2000, "{} lines", text.lines().count());
        assert!(text.contains("\"simulated\":true") == text.contains("\"truth\""), "a truth of what was measured");
    }
}

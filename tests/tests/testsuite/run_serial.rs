//! `slitpose run --device PATH`: a board on a terminal is followed without loss, also if nobody reads what is printed, stopped
//! in every case, and whatever else may be there is named.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{self, Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use slitpose::datagram::PoseDatagram;
use slitpose_head::scene_file::WIDE;
use slitpose_protocol::{
    BoardKind, Command, DELIMITER, Decoder, HardwareFault, MAX_REQUEST_BYTES, Message, Rejection, Request,
};
use slitpose_tests::capture::decode;
use slitpose_tests::consistency::Honesty;
use slitpose_tests::daemon::Follower;
use slitpose_tests::ndjson::{self, Line};
use slitpose_tests::process::{Finished, name_in, signal};
use slitpose_tests::slitpose;
use slitpose_tests::studies::scan_table;
use slitpose_tests::terminal::{Board, Device, FRAME_RATE_HZ, Log, Terminal, edited, greeting, packet, reply};

/// However busy the machine is. Nothing is judged by it but what would never come.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs the command against `device` and gives what both say.
fn run(device: impl Device, arguments: &[&str]) -> (Finished, Log, String) {
    let terminal = Terminal::serve(device);
    let path = terminal.path.clone();
    let finished = slitpose!().run(["run", "--device", &path].iter().chain(arguments));
    (finished, terminal.closed(), path)
}

fn spawn(terminal: &Terminal, arguments: &[&str]) -> Child {
    slitpose!().spawn(["run", "--device", &terminal.path].iter().chain(arguments))
}

/// Asserts that scans follow each other from the first on, each with a pose near the truth.
fn assert_followed(lines: &[Line]) {
    for (line, expected) in lines.iter().zip(lines[0].sequence..) {
        assert_eq!(line.sequence, expected);
    }
    let honesty = Honesty::of(lines.iter().filter_map(Line::beside_truth));
    // Of 48 000 normal numbers 0.03 lie beyond 5 σ.
    let is_followed = honesty.poses * 1000 >= lines.len() * 999 && honesty.beyond_five_sigma <= 2;
    assert!(is_followed, "of {} scans: {honesty:?}", lines.len());
}

fn is_ping(command: &Command) -> bool {
    matches!(command, Command::Ping { .. })
}

#[test]
fn two_seconds_through_a_terminal() {
    let (finished, log, _) = run(Board::wide(61), &["--duration", "2s"]);
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    let lines = ndjson::parse(&finished.done());
    assert_eq!(lines.len(), 8000);
    assert_followed(&lines);

    assert_eq!(log.received[0], 0, "half a packet is ended first");
    let wanted = slitpose_head::front_end::configuration(&WIDE.read().expect("shipped")).expect("schedule");
    let commands = log.commands();
    let [Command::Hello, Command::Configure(configuration), Command::Start, pings @ .., Command::Stop] = &commands[..]
    else {
        panic!("{commands:?}");
    };
    assert_eq!(*configuration, wanted);
    assert!(pings.len() >= 3 && pings.iter().all(is_ping), "{pings:?}");
}

#[test]
fn poses_are_printed_before_the_next_scans_come() {
    let (mut board, printed) = (Board::wide(59), Arc::new(AtomicU64::new(0)));
    let (seen, began, mut decoder) = (Arc::clone(&printed), Instant::now(), Decoder::<MAX_REQUEST_BYTES>::new());
    let (mut frames, mut started) = (0, None);
    // Frames pass only when the lines of those before have been read, but for two packets under way; until
    // then idle delimiters show that the link is alive.
    let device = move |received: &[u8], _: f64, sent: &mut Vec<u8>| {
        let mut bytes = received;
        while let Some(request) = decoder.next::<Request>(&mut bytes) {
            if request.is_ok_and(|request| request.command == Command::Start) {
                started = Some(frames);
            }
        }
        let is_ahead = started.is_some_and(|started| frames > started + seen.load(Ordering::Relaxed) + 8);
        frames += u64::from(!is_ahead || !received.is_empty());
        sent.push(DELIMITER);
        board.act(received, frames as f64 / FRAME_RATE_HZ, sent) && began.elapsed() < PATIENCE
    };
    let terminal = Terminal::serve(device);
    let mut child = spawn(&terminal, &["--duration", "50ms"]);
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    while stdout.read_line(&mut String::new()).expect("UTF-8") > 0 {
        printed.fetch_add(1, Ordering::Relaxed);
    }
    let finished = Finished::of(child);
    assert_eq!((finished.code, printed.load(Ordering::Relaxed)), (0, 200), "{}", finished.stderr);
    assert!(terminal.closed().commands().contains(&Command::Stop));
}

#[test]
fn an_interrupt_stops_the_board_and_prints_all_it_took() {
    let folder = tempfile::tempdir().expect("temporary folder");
    // Whoever closes a terminal hangs up twice: the kernel does, and the shell does.
    for signals in [&[Signal::SIGINT][..], &[Signal::SIGTERM], &[Signal::SIGHUP, Signal::SIGHUP]] {
        let first = signals[0];
        let terminal = Terminal::serve(Board::wide(63));
        let record = &*name_in(folder.path(), first.as_str());
        let mut child = spawn(&terminal, &["--record", record]);
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut text = String::new();
        for _ in 0..1000 {
            stdout.read_line(&mut text).expect("line");
        }
        signals.iter().for_each(|by| signal(&child, *by));
        stdout.read_to_string(&mut text).expect("UTF-8");
        let finished = Finished::of(child);
        assert_eq!(finished.code, 0, "{first}: {}", finished.stderr);
        let lines = ndjson::parse(&text);
        assert_followed(&lines);
        let (path, log) = (terminal.path.clone(), terminal.closed());
        assert_eq!(log.commands().last(), Some(&Command::Stop), "{first}");
        let sent = decode(&log.sent).scans.len();
        // A busy processor leaves scans that wait; they are counted, and in the capture.
        let waited = sent - lines.len();
        let said =
            format!("slitpose: {path}: {waited} of {sent} scans were not solved: they waited at the interrupt\n");
        assert_eq!(finished.stderr, if waited == 0 { "" } else { said.as_str() }, "{first}");
        let replayed = slitpose!().run(["replay", record]).done();
        assert!(replayed.starts_with(&text), "{first}: the capture has other poses");
        assert_eq!(replayed.lines().count(), sent, "{first}");
    }
}

#[test]
fn a_hang_up_that_is_ignored_ends_nothing() {
    let terminal = Terminal::serve(Board::wide(58));
    let mut command = process::Command::new("nohup");
    command.args([slitpose!().path(), "run", "--device", &terminal.path, "--duration", "1s"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("nohup starts");
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    let mut text = String::new();
    stdout.read_line(&mut text).expect("line");
    signal(&child, Signal::SIGHUP);
    stdout.read_to_string(&mut text).expect("UTF-8");
    assert_eq!(child.wait().expect("ends").code(), Some(0));
    assert_eq!(ndjson::parse(&text).len(), 4000);
}

#[test]
fn a_reader_that_goes_stops_the_board() {
    let terminal = Terminal::serve(Board::wide(64));
    let mut child = spawn(&terminal, &[]);
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    stdout.read_line(&mut String::new()).expect("line");
    drop(stdout);
    let finished = Finished::of(child);
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    assert_eq!(terminal.closed().commands().last(), Some(&Command::Stop));
}

#[test]
fn a_board_that_falls_silent_or_stops_by_itself_is_missed() {
    for (stops, what) in [(false, "no data for 0.45 s from the board on"), (true, "has stopped sampling")] {
        let (mut board, mut bytes) = (Board::wide(67), 0);
        let device = move |received: &[u8], now_s: f64, sent: &mut Vec<u8>| {
            // Some hundred scans.
            if bytes > 40_000 {
                board.command(Command::Stop);
            }
            if bytes > 40_000 && !stops {
                return true;
            }
            let before = sent.len();
            let plugged = board.act(received, now_s, sent);
            bytes += sent.len() - before;
            plugged
        };
        let (finished, log, path) = run(device, &["--duration", "10s"]);
        finished.assert_said(1, &[what, &path]);
        let lines = ndjson::parse(&String::from_utf8(finished.stdout).expect("UTF-8"));
        assert!(lines.len() > 100, "{} lines", lines.len());
        assert!(stops || log.commands().last() == Some(&Command::Stop), "told to stop in spite of it");
    }
}

#[test]
fn silence_and_garbage_are_no_boards() {
    for (count, parts) in [(0, &["not a byte"][..]), (1000, &["1000 bytes", "no hello"])] {
        let (started, mut left) = (Instant::now(), count);
        let garbage = move |_: &[u8], _: f64, sent: &mut Vec<u8>| {
            sent.extend(&[0x55, 0x00, 0xaa, 0x13, 0xff][..left.min(5)]);
            left -= left.min(5);
            true
        };
        let (finished, log, path) = run(garbage, &["--patience", "0s"]);
        finished.assert_refused(1, &[parts, &[&path]].concat());
        let commands = log.commands();
        assert!(commands.iter().all(|command| *command == Command::Hello), "{commands:?}");
        // Every 250 ms of 2 s.
        assert!(count > 0 || (commands.len() >= 6 && started.elapsed() >= Duration::from_secs(2)), "{commands:?}");
    }
}

/// The default board, except that it refuses one kind of command.
fn refusing(refused: fn(&Command) -> bool, rejection: Rejection) -> impl Device {
    let mut board = Board::wide(70);
    let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
    move |mut received: &[u8], now_s: f64, sent: &mut Vec<u8>| {
        while let Some(request) = decoder.next::<Request>(&mut received) {
            let Request { number, command } = request.expect("undamaged");
            if refused(&command) {
                sent.extend(packet(&reply(number, Err(rejection))));
            } else {
                board.act(&slitpose_tests::terminal::request(number, command), now_s, sent);
            }
        }
        board.act(&[], now_s, sent)
    }
}

#[test]
fn a_refused_command_is_named_with_its_reason() {
    let rejection = Rejection::TickRate { asked_hz: 170_000_000, board_hz: 144_000_000 };
    let device = refusing(|command| matches!(command, Command::Configure(_)), rejection);
    let (finished, log, path) = run(device, &[]);
    finished.assert_refused(1, &[&path, "Configure", "144000000 Hz", "front_end"]);
    assert!(!log.commands().contains(&Command::Start), "started in spite of it");

    let rejection = Rejection::Hardware(HardwareFault::Converters);
    let (finished, log, path) = run(refusing(|command| *command == Command::Start, rejection), &[]);
    finished.assert_refused(1, &[&path, "Start", "converters", "reset the board"]);
    assert_eq!(log.commands().last(), Some(&Command::Stop));
}

#[test]
fn a_board_with_another_full_scale_is_pointed_out() {
    let device = greeting(Board::wide(72), |hello| {
        hello.scaling.amperes_per_code *= 0.9;
    });
    let (finished, _, _) = run(device, &["--duration", "50ms"]);
    finished.assert_said(0, &["up to 9.000 uA", "up to 10.000 uA", "full_scale_a"]);
    let (finished, _, _) = run(Board::wide(73), &["--duration", "50ms"]);
    assert_eq!(finished.stderr, "");
}

#[test]
fn the_scene_of_the_board_is_looked_after() {
    let real = |hash| {
        edited(Board::wide(71), move |message| match message {
            Message::Hello(mut hello) => {
                hello.kind = BoardKind::Physical;
                hello.hashes.scene = hash;
                Some(Message::Hello(hello))
            }
            Message::Truth(_) => None,
            message => Some(message),
        })
    };
    // Without a scene of its own it is believed, and said so; what it measures is not simulated.
    let (finished, _, path) = run(real(None), &["--duration", "100ms"]);
    finished.assert_said(0, &[&path, "no scene stored"]);
    let (text, said) = (String::from_utf8(finished.stdout).expect("UTF-8"), finished.stderr);
    assert_eq!(text.lines().count(), 400);
    for line in text.lines() {
        assert!(line.contains(r#""simulated":false"#) && !line.contains("truth"), "{line}");
        // A real head without calibration is one of parts within usual tolerances.
        assert!(line.contains(r#""status":"degraded","reason":"uncalibrated""#), "{line}");
    }
    assert_eq!(said.matches("slitpose calibrate wide").count(), 1, "{said}");
    let own = WIDE.read().expect("shipped").hash;
    let (finished, _, _) = run(real(Some(own)), &["--duration", "100ms", "--calibration", "none"]);
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    assert!(!finished.done().contains("uncalibrated"));

    let (finished, log, _) = run(real(Some(!own)), &["--duration", "100ms"]);
    finished.assert_refused(1, &[&format!("{own:016x}"), &format!("{:016x}", !own), "--scene"]);
    assert!(log.commands().iter().all(|command| *command == Command::Hello), "configured in spite of it");
}

/// Scans of more than half a second are on their way to an output that is not read: the pipe and all
/// buffers are full by then.
const FULL: u64 = 4_000;

/// The datagram's flags, and its bit for scans that were passed over, as `slitpose_pose.h` has them.
const FLAGS_AT: usize = 8;
const BEHIND: u32 = 32;
const SEQUENCE_AT: usize = 48;

/// A daemon on a virtual board, with a client that follows; nobody reads what it prints.
struct Unread {
    child: Child,
    client: Follower,
    since: Instant,
}

impl Unread {
    fn start(terminal: &Terminal, folder: &Path, arguments: &[&str]) -> Self {
        let server = name_in(folder, "pose");
        let publish = format!("unix:{server}");
        let first = ["run", "--device", &terminal.path, "--format", "ndjson", "--publish", &publish];
        let child = slitpose!().spawn(first.iter().chain(arguments));
        Self { child, client: Follower::of(server.into()), since: Instant::now() }
    }

    /// The number and the flags of the next pose.
    fn next(&mut self) -> (u64, u32) {
        let mut datagram = [0; PoseDatagram::BYTES];
        while !self.client.receive(&mut datagram) {
            assert!(self.since.elapsed() < PATIENCE, "no pose comes");
        }
        let flags = u32::from_le_bytes(datagram[FLAGS_AT..][..4].try_into().expect("four bytes"));
        let sequence = u64::from_le_bytes(datagram[SEQUENCE_AT..][..8].try_into().expect("eight bytes"));
        (sequence, flags)
    }
}

#[test]
fn who_does_not_read_standard_output_keeps_no_control_loop_waiting() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let terminal = Terminal::serve(Board::wide(80));
    let mut unread = Unread::start(&terminal, folder.path(), &["--duration", "3s"]);
    let (mut last, mut behind) = (None, 0);
    // Nothing has been read when the last scans come; one of each read is given in this case.
    while last.is_none_or(|last| last < 11_900) {
        let (sequence, flags) = unread.next();
        assert!(last.is_none_or(|last| last < sequence), "scan {sequence} after {last:?}");
        behind += u64::from(flags & BEHIND != 0);
        last = Some(sequence);
    }
    assert!(behind > 0, "it does not say that scans were passed over");
    // Standard output never drops.
    let finished = Finished::of(unread.child);
    terminal.closed();
    let lines = ndjson::parse(&finished.done());
    assert_eq!(lines.len(), 12_000);
    lines.iter().zip(lines[0].sequence..).for_each(|(line, expected)| assert_eq!(line.sequence, expected));
}

#[test]
fn an_interrupt_ends_a_run_whose_output_nobody_reads() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "run.mcap");
    let terminal = Terminal::serve(Board::wide(81));
    let mut unread = Unread::start(&terminal, folder.path(), &["--record", &capture]);
    let mut last = 0;
    while last < 2 * FULL {
        last = unread.next().0;
    }
    signal(&unread.child, Signal::SIGINT);
    let since = Instant::now();
    // Nothing is read before it has ended.
    while unread.child.try_wait().expect("status").is_none() {
        assert!(since.elapsed() < PATIENCE, "the interrupt is not answered");
        std::thread::sleep(Duration::from_millis(10));
    }
    println!("ended {:?} after the interrupt", since.elapsed());
    let finished = Finished::of(unread.child);
    terminal.closed();
    finished.assert_said(1, &["nobody reads what is printed"]);
    // What was not solved is in the capture.
    let (boards, replayed) = scan_table::count(slitpose!(), &capture, &[]);
    assert_eq!(replayed.code, 0, "{}", replayed.stderr);
    let scans = boards.into_values().next().expect("a board");
    assert!(scans.jumps == 0 && scans.first + scans.count > last, "{scans:?}, {last} was sent");
    assert_eq!(scans.poses, scans.count);
}

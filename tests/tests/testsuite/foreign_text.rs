//! What boards, files and other programs say never reaches a terminal as it stands: no control
//! character, no override of the order of writing, no field of a hundred thousand characters.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;

use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{Event, Message, Severity};
use slitpose_tests::capture::{STREAM, capture, packets};
use slitpose_tests::process::{Finished, written};
use slitpose_tests::slitpose;
use slitpose_tests::terminal::{Board, Device, Terminal, greeting, packet};

/// Sets the window's title (xterm), clears the screen (ECMA-48), both also as C1; turns the order of
/// writing round (UAX #9); begins a line of its own.
const HOSTILE: &str =
    "evil\u{1b}]0;owned\u{7}\u{1b}[2J\u{9b}2J\u{9d}0;x\u{9c}\u{202e}txet\u{2066}\nslitpose: all is well\r";

/// More than any message of ours.
const MAX_BYTES: usize = 6000;

/// Every character that a terminal acts on, by the general category Cc and UAX #9.
fn assert_harmless(text: &str, what: &str) {
    let is_order =
        |c: char| matches!(c, '\u{61c}' | '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let acted_on = text.chars().find(|c| (c.is_control() && *c != '\n') || is_order(*c));
    assert_eq!(acted_on, None, "{what}: {text:?}");
    assert!(!text.lines().any(|line| line.starts_with("slitpose: all is well")), "{what}: a forged line: {text}");
}

fn check(finished: &Finished, what: &str) -> String {
    let text = String::from_utf8(finished.stdout.clone()).expect("UTF-8") + &finished.stderr;
    assert_harmless(&text, what);
    assert!(text.len() < MAX_BYTES, "{what}: {} bytes", text.len());
    text
}

/// A board of that name and firmware, which complains in the same words.
fn hostile() -> impl Device {
    greeting(Board::wide(83), |hello| {
        (hello.board, hello.firmware) = (HOSTILE, HOSTILE);
    })
}

#[test]
fn names_and_events_of_boards_and_captures() {
    for arguments in [
        &["device", "info"][..],
        &["doctor", "--duration", "100ms"],
        &["run", "--format", "summary", "--duration", "100ms"],
    ] {
        let terminal = Terminal::serve(hostile());
        let path = terminal.path.clone();
        let finished = slitpose!().run([arguments, &["--device", &path]].concat());
        drop(terminal);
        let text = check(&finished, &format!("{arguments:?}"));
        assert!(text.contains("evil\\u{1b}"), "{arguments:?}: {text}");
    }
    let terminal = Terminal::serve(hostile());
    let finished = slitpose!().run(["device", "list", "--search", &terminal.path]);
    assert!(check(&finished, "device list").contains("evil\\u{1b}"));

    let wide = WIDE.read().expect("shipped");
    let still = Trajectory::of_kind(TrajectoryKind::Still, 1, 1.0);
    let bytes = capture(&wide, still, STREAM, 1, 40);
    let mut changed = Vec::new();
    for (number, packet_of) in packets(&bytes).iter().enumerate() {
        changed.extend_from_slice(&bytes[packet_of.bytes.clone()]);
        if number == 2 {
            changed.extend(packet(&Message::Event(Event { tick: 1000, severity: Severity::Warning, text: HOSTILE })));
        }
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let name = written(folder.path(), "received\u{1b}[2J.raw", changed);
    let finished = slitpose!().run(["replay", &name, "--format", "summary"]);
    let text = check(&finished, "replay");
    assert!(text.contains("Warning") && text.contains("event "), "the event is shown: {text}");
    check(&slitpose!().run(["replay", &format!("{name}x")]), "a file name in an error");
}

#[test]
fn scenes_tables_and_configurations() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = |name: &str, text: &str| written(folder.path(), name, text);
    // TOML and CSV as far as they take such characters: as escapes, in quotes, or as they are.
    let escaped = "evil\\u001b[2J\\u009b2J\\u202e\\nslitpose: all is well\\r";
    let quoted = format!("\"{HOSTILE}\"");
    let long = "9x".repeat(50_000);
    let named = file("named.toml", &WIDE.text.replace("name = ", &format!("name = \"{escaped}\" # ")));
    let checked = slitpose!().run(["scene", "check", &named, "--samples", "10"]);
    assert_harmless(&checked.clone().done(), "a scene's name");
    assert_harmless(slitpose!().run(["scene", "plot", &named, "--output", "-"]).text(), "a picture");
    let poses = "tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad";
    let long_value = WIDE.text.replace("distance_mm = 5.0", &format!("distance_mm = \"{long}\""));
    let long_names = format!("scene = [\"{long}\", \"{escaped}\"]");
    for (name, text, arguments, remedy) in [
        ("key.toml", format!("\"{escaped}\" = 1"), &["scene", "check"][..], "known keys"),
        ("long-key.toml", format!("{long} = 1"), &["scene", "check"], "known keys"),
        ("value.toml", format!("name = 1 # {HOSTILE}"), &["scene", "check"], "correct this line"),
        ("long.toml", long_value, &["scene", "check"], "give"),
        ("field.csv", format!("id,{poses}\na,{quoted},0,0,0,0,0\n"), &["model", "wide", "--poses"], "give one like"),
        ("long-field.csv", format!("id,{poses}\na,{long},0,0,0,0,0\n"), &["model", "wide", "--poses"], "give one like"),
        ("header.csv", format!("id,{quoted},{long}\n1,2,3\n"), &["model", "wide", "--poses"], "add the column"),
        ("option.toml", format!("\"{escaped}\" = 1"), &["run", "--config"], "slitpose run --help"),
        ("long-option.toml", long_names, &["run", "--device", "sim", "--config"], "give"),
        ("long-value.toml", format!("duration = \"{long}\""), &["run", "--config"], "slitpose run --help"),
    ] {
        let path = file(name, &text);
        let finished = slitpose!().run([arguments, &[&path]].concat());
        assert_ne!(finished.code, 0, "{name}");
        let text = check(&finished, name);
        assert!(text.contains(remedy), "{name}: the next step is missing: {text}");
    }
}

#[test]
fn answers_of_other_programs() {
    for status in ["200 OK", "503 Service Unavailable"] {
        let server = TcpListener::bind("127.0.0.1:0").expect("port");
        let address = server.local_addr().expect("address").to_string();
        let answer = format!("HTTP/1.0 {status}\r\n\r\n{HOSTILE}");
        let thread = std::thread::spawn(move || {
            let (client, _) = server.accept().expect("a client");
            // All that it asks is read, or the connection is reset with the answer under way.
            let mut lines = BufReader::new(&client).lines();
            while lines.next().is_some_and(|line| !line.expect("text").is_empty()) {}
            (&client).write_all(answer.as_bytes()).expect("answered");
        });
        let finished = slitpose!().run(["status", "--address", &address]);
        thread.join().expect("server");
        let text = String::from_utf8(finished.stdout).expect("UTF-8") + &finished.stderr;
        // A page has lines of its own; what stands on them is the server's.
        assert!(
            text.contains("evil\\u{1b}") && !text.contains(['\u{1b}', '\u{9b}', '\u{202e}', '\r']),
            "{status}: {text:?}"
        );
    }
}

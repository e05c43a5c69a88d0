//! The live page of a daemon and of a replay, through the socket that the page uses.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Child;
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use slitpose_tests::process::{address_said, name_in, signal};
use slitpose_tests::slitpose;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// A busy machine may take its time.
const PATIENCE: Duration = Duration::from_secs(60);

/// A program that serves a page, and a client of it.
struct Page {
    /// `None` if it is another page's.
    program: Option<Child>,
    /// Host, port and a slash.
    url: String,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    heard: u64,
}

fn connect(url: &str) -> WebSocket<MaybeTlsStream<TcpStream>> {
    let (mut socket, _) = tungstenite::connect(format!("ws://{url}live")).expect("a page");
    if let MaybeTlsStream::Plain(stream) = socket.get_mut() {
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    }
    socket
}

impl Page {
    fn of<'a>(folder: &Path, arguments: impl IntoIterator<Item = &'a str>) -> Self {
        let arguments = arguments.into_iter().chain(["--format", "none", "--live", "127.0.0.1:0"]);
        let mut program = slitpose!().command(arguments).current_dir(folder).spawn().expect("slitpose starts");
        let url = address_said(&mut program, "live page at http://");
        let mut page = Self { program: Some(program), socket: connect(&url), url, heard: 0 };
        page.say(&json!({"kind": "hello"}));
        page
    }

    /// Another client of the program, for which it replays a recording.
    fn of_recording(&self, name: &str) -> Self {
        let mut page = Self { program: None, socket: connect(&self.url), url: self.url.clone(), heard: 0 };
        page.say(&json!({"kind": "hello", "recording": name}));
        page
    }

    /// What the program has at this address.
    fn fetched(&self, address: &str) -> Vec<u8> {
        let host = self.url.trim_end_matches('/');
        let mut stream = TcpStream::connect(host).expect("a page");
        write!(stream, "GET {address} HTTP/1.1\r\nHost: {host}\r\n\r\n").expect("a page");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("an answer");
        let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").expect("a header");
        assert!(answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer[..end]));
        answer.split_off(end + 4)
    }

    fn say(&mut self, request: &Value) {
        self.socket.send(Message::text(request.to_string())).expect("a page");
    }

    /// The next message for which `is_wanted`.
    fn until(&mut self, is_wanted: impl Fn(&Value) -> bool) -> Value {
        let since = Instant::now();
        while since.elapsed() < PATIENCE {
            let Message::Text(text) = self.socket.read().expect("a message") else { continue };
            self.heard += 1;
            let acknowledged = json!({"kind": "ack", "messages": self.heard});
            self.say(&acknowledged);
            let message = serde_json::from_str(&text).expect("JSON");
            if is_wanted(&message) {
                return message;
            }
        }
        panic!("nothing came that was wanted");
    }

    /// Waits for the recorder to be in this state; its file.
    fn recorder(&mut self, state: &str) -> String {
        file_of(&self.until(|message| message["report"]["recorder"]["state"] == state))
    }

    /// Begins a recording; its file. A daemon that has just sent its first frame may still be starting.
    fn begins_recording(&mut self) -> String {
        loop {
            self.say(&json!({"kind": "record", "on": true}));
            let answer = self
                .until(|message| message["kind"] == "refused" || message["report"]["recorder"]["state"] == "recording");
            if answer["kind"] != "refused" {
                return file_of(&answer);
            }
            assert!(answer["reason"].as_str().expect("a text").contains("still starting"), "{answer}");
        }
    }

    fn end(mut self) {
        let program = self.program.as_mut().expect("its own");
        signal(program, Signal::SIGINT);
        let ended = program.wait().expect("ends");
        // 3 if the machine was so busy that scans were left out.
        assert!(matches!(ended.code(), Some(0 | 3)), "{ended}");
    }
}

/// The file that a report's recorder writes.
fn file_of(report: &Value) -> String {
    report["report"]["recorder"]["file"].as_str().unwrap_or_default().to_owned()
}

#[test]
fn a_recording_is_noted_listed_renamed_fetched_and_replayed_while_the_board_is_followed() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut page = Page::of(folder.path(), ["run", "--config", "none", "--device", "sim"]);
    page.until(|message| message["kind"] == "frame");
    page.say(&json!({"kind": "note", "text": "too early", "ago_s": 0}));
    page.until(|message| message["kind"] == "refused");
    let file = page.begins_recording();
    page.say(&json!({"kind": "record", "on": true}));
    let refused = page.until(|message| message["kind"] == "refused");
    assert!(refused["reason"].as_str().expect("a text").contains("already"), "{refused}");
    let is_long =
        |message: &Value| message["report"]["recorder"]["bytes"].as_u64().is_some_and(|bytes| bytes > 300_000);
    page.until(is_long);
    page.say(&json!({"kind": "note", "text": "contact\n\u{3bc}", "ago_s": 0.2}));
    page.say(&json!({"kind": "record", "on": false}));
    page.recorder("off");
    page.say(&json!({"kind": "rename", "file": file, "to": "contact 1.mcap"}));
    let listed = page.until(|message| message["kind"] == "recordings");
    let of = &listed["files"][0];
    assert_eq!((&of["name"], &of["notes"]), (&json!("contact 1.mcap"), &json!(1)), "{listed}");
    let length_s = of["length_s"].as_f64().expect("an ended capture");
    page.say(&json!({"kind": "download", "file": "contact 1.mcap"}));
    let address = page.until(|message| message["kind"] == "download")["address"].as_str().expect("a text").to_owned();
    let path = folder.path().join("contact 1.mcap");
    assert_eq!(page.fetched(&address), std::fs::read(&path).expect("a capture"));

    let mut replay = page.of_recording("contact 1.mcap");
    assert_eq!(replay.until(|message| message["kind"] == "hello")["source"], "replay");
    replay.until(|message| message["kind"] == "frame");
    let played = replay.until(|message| message["kind"] == "player");
    assert!((played["duration_s"].as_f64().expect("a number") - length_s).abs() < 0.2, "{played} {length_s}");
    let note = &played["notes"][0];
    // The page asked when so much was recorded, some 0.2 s ago.
    assert!(
        (0.0..length_s).contains(&note["at_s"].as_f64().expect("a number")) && note["text"] == "contactμ",
        "{note}"
    );
    let mut other = page.of_recording("contact 1.mcap");
    other.say(&json!({"kind": "player", "playing": false}));
    replay.until(|message| message["kind"] == "player" && message["playing"] == false);
    // The board is followed meanwhile.
    page.until(|message| message["kind"] == "frame");
    let mut none = page.of_recording("../contact 1.mcap");
    let refused = none.until(|message| message["kind"] == "refused");
    assert!(refused["reason"].as_str().expect("a text").contains("is no name of a capture"), "{refused}");
    let threads = || {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", page.program.as_ref().expect("running").id()));
        let name =
            |task: std::io::Result<std::fs::DirEntry>| std::fs::read_to_string(task.ok()?.path().join("comm")).ok();
        tasks.expect("a process").filter_map(name).filter(|name| name.trim() == "play").count()
    };
    assert_eq!(threads(), 1, "both pages look at one player");
    drop((replay, other));
    let since = Instant::now();
    while threads() > 0 {
        assert!(since.elapsed() < PATIENCE, "the player goes on though nobody looks");
        thread::sleep(Duration::from_millis(20));
    }
    page.end();
    let said = slitpose!().run(["replay", path.to_str().expect("UTF-8"), "--format", "none"]);
    assert!(said.stderr.contains("s: contactμ"), "{}", said.stderr);
}

#[test]
fn a_replay_is_paused_moved_and_played_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let capture = &*name_in(folder.path(), "capture.mcap");
    slitpose!().run(["simulate", "--duration", "4s", "--output", capture]).done();
    let mut page = Page::of(folder.path(), ["replay", capture]);
    page.until(|message| message["kind"] == "frame");
    page.say(&json!({"kind": "player", "playing": false}));
    page.until(|message| message["kind"] == "player" && message["playing"] == false);
    page.say(&json!({"kind": "player", "playing": true, "speed": null, "seek_s": 3.0}));
    page.until(|message| message["kind"] == "cleared");
    let first = page.until(|message| message["kind"] == "frame" || message["kind"] == "history");
    let first = if first["kind"] == "history" { &first["frames"][0] } else { &first };
    let time_s = first["time_s"].as_f64().expect("a number");
    assert!((2.9..4.1).contains(&time_s), "it goes on at 3 s, not at {time_s} s");
    let ended = page.until(|message| message["kind"] == "player" && message["ended"] == true);
    assert!((ended["duration_s"].as_f64().expect("a number") - 4.0).abs() < 0.1, "{ended}");
    page.say(&json!({"kind": "player", "playing": true}));
    page.until(|message| message["kind"] == "player" && message["position_s"].as_f64() < Some(1.0));
    page.until(|message| message["kind"] == "frame" || message["kind"] == "history");
    page.end();
}

#[test]
fn the_token_of_a_live_page_is_not_printed() {
    // Standard error may be a journal.
    let arguments = ["scene", "view", "wide", "--live", "127.0.0.1:0", "--live-token", "correct-horse-battery"];
    let mut program = slitpose!().spawn(arguments);
    let said = address_said(&mut program, "live page at http://127.0.0.1:");
    program.kill().expect("running");
    program.wait().expect("ends");
    assert!(!said.contains("horse"), "{said}");
}

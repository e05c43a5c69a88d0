//! `slitpose doctor`: a good board is found good, a bad one is found bad in the right place, and the bundle holds
//! what it says.

use std::collections::BTreeMap;
use std::io::Write;
use std::process::Command;

use slitpose::device::SerialDevice;
use slitpose_head::scene_file::WIDE;
use slitpose_protocol::Message;
use slitpose_tests::process::{Finished, name_in};
use slitpose_tests::scenes::changed;
use slitpose_tests::slitpose;
use slitpose_tests::terminal::{Board, Device, Terminal, edited, greeting};

/// Runs the doctor and gives each check's verdict, too.
fn doctor(device: &str, arguments: &[&str]) -> (Finished, BTreeMap<String, String>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path().to_str().expect("UTF-8");
    let finished = slitpose!().run([&["doctor", "--device", device, "--folder", folder], arguments].concat());
    let text = String::from_utf8(finished.stdout.clone()).expect("UTF-8");
    // Verdict in 8 columns, name in 14.
    let checks = text.lines().filter(|line| !line.starts_with(' ')).map(|line| {
        let (verdict, name) = (&line[..8], &line[9..23]);
        (name.trim().to_owned(), verdict.trim().to_owned())
    });
    (finished, checks.collect())
}

fn at(served: impl Device) -> (Finished, BTreeMap<String, String>, String) {
    let terminal = Terminal::serve(served);
    let path = terminal.path.clone();
    let (finished, checks) = doctor(&path, &["--duration", "300ms"]);
    terminal.closed();
    (finished, checks, path)
}

#[test]
fn a_simulated_board_is_well_and_its_bundle_is_whole() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let bundle = &*name_in(folder.path(), "report.tar.gz");
    let (finished, checks) = doctor("sim", &["--duration", "200ms", "--bundle", bundle]);
    let good = ["hello", "version", "last start", "scene", "full scale", "board", "link", "poses", "health"];
    for name in good.into_iter().chain(["oscillator", "settings"]) {
        assert_eq!(checks.get(name).map(String::as_str), Some("ok"), "{name}: {checks:?}");
    }
    for name in ["rate", "date", "clock", "priority", "disk space", "disk rate"] {
        assert!(checks.contains_key(name), "{name}: {checks:?}");
    }
    assert_eq!(checks["port"], "skipped");
    assert_eq!(finished.code, 0, "{}", finished.stderr);

    let unpacked = Command::new("tar").args(["-xzf", bundle, "-C"]).arg(folder.path()).status().expect("tar");
    assert!(unpacked.success());
    let file = |name: &str| std::fs::read(folder.path().join("slitpose-doctor").join(name)).expect("in the bundle");
    assert_eq!(file("report.txt"), finished.stdout);
    assert_eq!(file("scene.toml"), WIDE.text.as_bytes());
    let stream = slitpose_tests::capture::decode(&file("stream.bin"));
    assert_eq!(stream.scans.len(), 800);
    for name in ["report.txt", "report.json", "hello.json", "scene.toml", "stream.bin", "system.txt"] {
        assert!(finished.stderr.contains(name) && !file(name).is_empty(), "{name}: {}", finished.stderr);
    }
    let folder = folder.path().to_str().expect("UTF-8");
    for name in ["report.txt", "report.json", "system.txt"] {
        assert!(!String::from_utf8_lossy(&file(name)).contains(folder), "where things are is private");
    }
}

#[test]
fn dark_current_is_nothing_to_complain_of() {
    let mut scene = tempfile::NamedTempFile::new().expect("temporary file");
    let text = changed(WIDE.text, &[("dark_current_a = 0.0", "dark_current_a = 200e-9")]);
    scene.write_all(text.as_bytes()).expect("written");
    let scene = scene.path().to_str().expect("UTF-8");
    // A second of health, and one to begin with.
    let (finished, checks) = doctor("sim", &["--duration", "2s", "--scene", scene]);
    for name in ["scene", "full scale", "board", "link", "poses", "health"] {
        assert_eq!(checks.get(name).map(String::as_str), Some("ok"), "{name}: {checks:?}");
    }
    assert_eq!(finished.code, 0, "{}", finished.stderr);
}

#[test]
fn a_board_on_a_port_is_well() {
    let (finished, checks, path) = at(Board::wide(91));
    for name in ["ports", "permission", "exclusive", "hello", "scene", "board", "link", "poses"] {
        assert_eq!(checks.get(name).map(String::as_str), Some("ok"), "{name}: {checks:?}");
    }
    assert!(String::from_utf8_lossy(&finished.stdout).contains(&path));
}

#[test]
fn losses_are_found_where_they_are() {
    let mut batches = 0;
    let lossy = edited(Board::wide(92), move |message| match message {
        Message::Batch(_) => {
            batches += 1;
            (batches % 20 != 0).then_some(message)
        }
        message => Some(message),
    });
    let (finished, checks, _) = at(lossy);
    assert_eq!((checks["link"].as_str(), checks["board"].as_str()), ("failed", "ok"), "{checks:?}");
    assert_eq!(finished.code, 1);
}

#[test]
fn what_is_no_board_gets_no_further() {
    let (finished, checks, _) = at(|_: &[u8], _: f64, _: &mut Vec<u8>| true);
    let verdicts = ["exclusive", "hello", "measurement"].map(|name| checks[name].as_str());
    assert_eq!((verdicts, finished.code), (["ok", "failed", "skipped"], 1));
    assert!(checks.contains_key("disk rate"), "the host is looked at all the same");

    let terminal = Terminal::serve(Board::wide(93));
    let held = SerialDevice::open(&terminal.path).expect("free");
    let (finished, checks) = doctor(&terminal.path, &[]);
    assert_eq!((checks["exclusive"].as_str(), finished.code), ("failed", 1));
    let text = String::from_utf8_lossy(&finished.stdout).into_owned();
    assert!(text.contains("in use"), "{text}");
    assert!(!cfg!(target_os = "linux") || text.contains(&format!("process {}", std::process::id())), "{text}");
    drop(held);
    terminal.closed();
}

#[test]
fn a_board_of_another_head_is_not_measured() {
    let other = greeting(Board::wide(94), |hello| {
        hello.hashes.scene = Some(7);
    });
    let (finished, checks, _) = at(other);
    assert_eq!((checks["scene"].as_str(), checks["measurement"].as_str()), ("failed", "skipped"));
    assert_eq!(finished.code, 1);
    assert!(String::from_utf8_lossy(&finished.stdout).contains("0000000000000007"));
}

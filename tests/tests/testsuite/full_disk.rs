//! A disk that is full stops the recording and nothing else: poses go on, the status says what happened, and
//! the capture holds what came before.
#![cfg(target_os = "linux")]

use std::io::Read;
use std::process::{Child, Command, Stdio};

use slitpose_tests::ndjson;
use slitpose_tests::process::{Finished, Slitpose, name_in, names};
use slitpose_tests::slitpose;
use slitpose_tests::studies::scan_table;

/// One board for four seconds, recorded at `capture`. No file may grow beyond `blocks` of 1 KiB.
fn run(slitpose: Slitpose, blocks: u32, capture: &str, status: &str) -> Child {
    // The limit of the shell is the one of what it becomes.
    let script = format!("ulimit -f {blocks}; exec \"$@\"");
    let run =
        ["run", "--device", "sim", "--tier", "paper", "--duration", "4s", "--record", capture, "--status", status];
    let mut command = Command::new("bash");
    command.args(["-c", &script, "bash", slitpose.path()]).args(run).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("bash starts")
}

#[test]
fn poses_go_on_when_the_disk_is_full() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [capture, socket] = ["full.mcap", "status"].map(|name| name_in(folder.path(), name));
    let address = format!("unix:{socket}");
    // A board sends some 400 KiB a second that cannot be made much shorter: it is full after two or three.
    let mut child = run(slitpose!(), 1000, &capture, &address);
    let mut stdout = child.stdout.take().expect("piped");
    let poses = std::thread::spawn(move || {
        let mut text = String::new();
        stdout.read_to_string(&mut text).expect("UTF-8");
        text
    });
    // The last answer before the end.
    let mut recorder = serde_json::Value::Null;
    while child.try_wait().expect("runs").is_none() {
        let answer = slitpose!().run(["status", "--address", &address, "--format", "json"]);
        if answer.code == 0 {
            let status: serde_json::Value = serde_json::from_slice(&answer.stdout).expect("JSON");
            recorder = status["recorder"].clone();
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let finished = Finished::of(child);
    assert_eq!(finished.code, 3, "{}", finished.stderr);
    assert!(finished.stderr.contains("the capture is not whole"), "{}", finished.stderr);
    assert_eq!(recorder["state"], "failed", "{recorder}");
    let reason = recorder["reason"].as_str().expect("a reason");
    assert!(reason.contains("File too large") && reason.contains(&capture), "{reason}");
    assert!(finished.stderr.contains(reason), "{}", finished.stderr);
    assert!(recorder["bytes_dropped"].as_u64() > Some(0), "{recorder}");

    let lines = ndjson::parse(&poses.join().expect("reader"));
    assert_eq!(lines.len(), 16_000);
    assert!(lines.iter().all(|line| line.estimate.is_some()), "a scan without a pose");

    let (boards, replayed) = scan_table::count(slitpose!(), &capture, &[]);
    assert_eq!(replayed.code, 3, "{}", replayed.stderr);
    assert!(replayed.stderr.contains("was not ended by its recorder"), "{}", replayed.stderr);
    let [scans] = boards.into_values().collect::<Vec<_>>()[..] else { panic!("one board") };
    // At the least what was flushed in the first second.
    assert!(scans.count >= 2000 && scans.count < 16_000 && scans.first == 0 && scans.jumps == 0, "{scans:?}");
    assert_eq!(scans.poses, scans.count);
}

#[test]
fn a_full_output_is_an_error_and_a_full_disk_before_the_run_is_told_at_its_end() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let record = name_in(folder.path(), "run.capture");
    let full = std::fs::File::options().write(true).open("/dev/full").expect("a full device");
    let run = ["run", "--device", "sim", "--speed", "max", "--duration", "1s", "--record"];
    let output = slitpose!().command(run.iter().chain(&[record.as_str()])).stdout(full).output().expect("runs");
    Finished::from(output).assert_said(1, &["standard output", "No space left"]);
    assert_eq!(names(folder.path()), ["run.capture"]);

    // The daemon goes on; what was to be recorded is missed at the end.
    let finished = slitpose!().run(run.iter().chain(&["/dev/full"]));
    finished.assert_said(3, &["/dev/full", "No space left", "the capture is not whole"]);
    assert_eq!(ndjson::parse(finished.text()).len(), 4000);
}

#[test]
fn a_run_without_a_board_replaces_no_capture() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("precious.mcap");
    std::fs::write(&path, "of last night").expect("written");
    let record = ["--duration", "1s", "--overwrite", "--record", path.to_str().expect("UTF-8")];
    let finished = slitpose!().run(["run", "--device", "/dev/slitpose-no-such-port"].iter().chain(&record));
    finished.assert_refused(1, &["there is no /dev/slitpose-no-such-port"]);
    assert_eq!(std::fs::read(&path).expect("still there"), b"of last night");
    assert_eq!(names(folder.path()), ["precious.mcap"], "something is left behind");
}

//! Results come into place whole or not at all, and never in the place of what was measured. A disk that is full stops a
//! recording and nothing else.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::Signal;
use nix::unistd::mkfifo;
use slitpose_tests::daemon::Usage;
use slitpose_tests::process::{Finished, name_in, names, text};
use slitpose_tests::studies::scan_table;
use slitpose_tests::{ndjson, slitpose};

/// A folder with a capture of 20 ms in it.
fn folder_with_capture() -> (tempfile::TempDir, PathBuf, Vec<u8>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("d.mcap");
    let simulated = slitpose!().run(["simulate", "--duration", "20ms", "--output", text(&capture)]);
    assert_eq!(simulated.code, 0, "{}", simulated.stderr);
    let bytes = fs::read(&capture).expect("capture");
    (folder, capture, bytes)
}

/// Neither a capture that is made nor one that is solved is in memory as a whole.
#[test]
fn memory_is_bounded_however_long_a_capture() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = name_in(folder.path(), "long.mcap");
    for command in [
        &["simulate", "--tier", "paper", "--duration", "30s", "--output", &capture][..],
        &["replay", &capture, "--tier", "paper", "--format", "none"],
        &["replay", &capture, "--tier", "exact", "--format", "none"],
    ] {
        let mut child = slitpose!().spawn(command);
        let mut most = Usage::default();
        while child.try_wait().expect("runs").is_none() {
            // An ended process that was not waited for has no memory any more.
            most = Usage::of(child.id()).unwrap_or(most);
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(Finished::of(child).code, 0, "{command:?}");
        assert!((1..64 << 20).contains(&most.peak_bytes), "{command:?}: {} MiB", most.peak_bytes >> 20);
    }
}

/// CSV and NDJSON have the same quantities.
#[test]
fn a_filtered_pose_and_its_velocity_are_in_csv_too() {
    let (_folder, capture, _) = folder_with_capture();
    let replay = |format| {
        let finished = slitpose!().run(["replay", text(&capture), "--format", format, "--filter", "5ms"]);
        assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
        finished
    };
    let (ndjson, csv) = (replay("ndjson"), replay("csv"));
    let objects = ndjson.text().lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"));
    let mut rows = csv::Reader::from_reader(csv.text().as_bytes());
    let names = rows.headers().expect("a header").clone();
    let mut withheld = 0;
    for (object, row) in objects.zip(rows.records()) {
        let row = row.expect("a row");
        let field = |name: &str| &row[names.iter().position(|known| known == name).expect(name)];
        let number = |name: &str| field(name).parse::<f64>().ok();
        let filtered = &object["filtered"];
        assert_eq!(number("filtered_lag_s"), filtered["lag_s"].as_f64());
        assert_eq!(number("filtered_tz_mm"), filtered["translation_m"][2].as_f64().map(|z| z * 1e3));
        assert_eq!(number("filtered_sigma_wx_rad_per_s"), filtered["twist"]["sigma"][3].as_f64());
        assert_eq!(number("vy_m_per_s"), object["twist"]["linear_m_per_s"][1].as_f64());
        assert_eq!(field("no_twist"), object["no_twist"].as_str().unwrap_or_default());
        assert_eq!(number("light_level"), object["light_level"].as_f64());
        let covariance = |i: usize, j: usize| object["covariance"][6 * i + j].as_f64().expect("a number");
        let correlation = covariance(1, 5) / (covariance(1, 1) * covariance(5, 5)).sqrt();
        assert_eq!(number("correlation_ty_rz"), Some(correlation));
        withheld += usize::from(field("no_twist") == "start");
    }
    assert!((1..20).contains(&withheld), "{withheld} poses without a velocity");
}

#[test]
fn no_capture_is_replaced_by_a_result() {
    let (folder, capture, bytes) = folder_with_capture();
    let d = text(&capture);
    let (other, truth) = (folder.path().join("other.mcap"), folder.path().join("truth.csv"));
    let short = ["simulate", "--duration", "1ms"];
    for (code, command) in [
        (2, &["export", d, "--format", "csv", "--output", d][..]),
        (1, &["simulate", "--duration", "1ms", "--output", text(&other), "--truth", d]),
        (2, &["simulate", "--duration", "1ms", "--output", text(&other), "--truth", text(&other)]),
        (2, &["simulate", "--duration", "1ms", "--overwrite", "--output", d, "--truth", d]),
        (1, &["simulate", "--duration", "1ms", "--output", d]),
        (1, &["simulate", "--duration", "1ms", "--output", d, "--raw"]),
    ] {
        slitpose!().run(command).assert_refused(code, &["give another name"]);
        assert!(fs::read(&capture).expect("capture") == bytes, "{command:?}");
    }
    assert_eq!(names(folder.path()), ["d.mcap"]);
    // Asked for, the new one comes into its place.
    let again = slitpose!().run([&short[..], &["--overwrite", "--output", d, "--truth", text(&truth)]].concat());
    assert_eq!((again.code, again.stderr.as_str()), (0, ""));
    assert!(fs::read(&capture).expect("capture").len() < bytes.len());
    assert_eq!(names(folder.path()), ["d.mcap", "truth.csv"]);
}

#[test]
fn the_name_of_an_export_says_how_it_is_written() {
    let (folder, capture, _) = folder_with_capture();
    let export = |output: &str, more: &[&str]| {
        slitpose!().run([&["export", text(&capture), "--output", output][..], more].concat())
    };
    for name in ["x.txt", "poses", "poses.CSVX"] {
        let path = folder.path().join(name);
        export(text(&path), &[]).assert_refused(2, &[text(&path), ".csv", ".ndjson", "--format"]);
    }
    assert_eq!(names(folder.path()), ["d.mcap"]);
    let written = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        assert_eq!(export(text(&path), more).code, 0);
        fs::read_to_string(&path).expect("poses")
    };
    let (csv, ndjson) = (written("a.csv", &[]), written("a.ndjson", &[]));
    assert_eq!((csv.lines().count(), ndjson.lines().count()), (81, 80));
    assert!(csv.starts_with("seq,") && ndjson.starts_with('{'));
    assert_eq!(written("x.txt", &["--format", "ndjson"]), ndjson);
    // What has no name of its own is written as before, and stays what it is.
    for output in ["-", "/dev/stdout"] {
        let exported = export(output, &[]);
        assert_eq!(String::from_utf8(exported.stdout).expect("UTF-8"), csv, "{output}: {}", exported.stderr);
    }
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).expect("pipe");
    let mut exporting = slitpose!().spawn(["export", text(&capture), "--output", text(&pipe)]);
    assert_eq!(fs::read_to_string(&pipe).expect("pipe"), csv);
    assert!(exporting.wait().expect("ends").success());
}

#[test]
fn an_export_of_a_damaged_capture_has_the_poses_of_its_replay_and_their_exit_code() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (capture, poses) = (folder.path().join("cut.capture"), folder.path().join("poses.csv"));
    slitpose!().run(["simulate", "--raw", "--output", text(&capture), "--duration", "50ms"]).done();
    let whole = fs::read(&capture).expect("a capture");
    // It ends within a packet.
    fs::write(&capture, &whole[..whole.len() - 70]).expect("a shorter capture");
    let replayed = slitpose!().run(["replay", text(&capture), "--format", "csv"]);
    let exported = slitpose!().run(["export", text(&capture), "--output", text(&poses)]);
    assert_eq!((replayed.code, exported.code), (3, 3));
    assert_eq!(fs::read(&poses).expect("poses"), replayed.stdout);
}

/// Waits until `child` takes notice of interrupts, and `is_ready`.
fn wait_until(child: &mut Child, is_ready: impl Fn() -> bool) {
    let status = format!("/proc/{}/status", child.id());
    let takes_notice = || {
        let caught = fs::read_to_string(&status).expect("status");
        let caught = caught.lines().find_map(|line| line.strip_prefix("SigCgt:")).expect("signals").trim().to_owned();
        u64::from_str_radix(&caught, 16).expect("a mask") & (1 << (Signal::SIGINT as u32 - 1)) != 0
    };
    while !(takes_notice() && is_ready()) {
        assert!(child.try_wait().expect("runs").is_none(), "it ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_table_or_text_that_is_interrupted_leaves_nothing() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let output = folder.path().join("result");
    fs::write(&output, "older").expect("written");
    let poses = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\nhome,0,0,0,0,0,0\n".to_owned();
    let names_of = |k: usize| format!(",i_x1_{k}_a,i_x2_{k}_a");
    let currents = format!("id{}\ndark{}\n", (0..6).map(names_of).collect::<String>(), ",0".repeat(12));
    for (command, rows) in [
        (&["model", "wide", "--poses", "-", "--output"][..], poses),
        (&["solve", "wide", "--currents", "-", "--output"], currents),
        (&["scene", "check", "wide", "--samples", "4000000000", "--output"], String::new()),
        (&["simulate", "--trajectory", "contact", "--duration", "100000y", "--overwrite", "--output"], String::new()),
    ] {
        let mut command = slitpose!().command(command.iter().chain(&[text(&output)]));
        let mut child = command.stdin(Stdio::piped()).spawn().expect("starts");
        // No other row ever follows.
        let mut input = child.stdin.take().expect("piped");
        input.write_all(rows.as_bytes()).expect("written");
        wait_until(&mut child, || names(folder.path()).iter().any(|name| name.ends_with(".part")));
        Finished::interrupted(child).assert_refused(1, &["interrupted", text(&output)]);
        assert_eq!(names(folder.path()), ["result"], "{command:?}");
        assert_eq!(fs::read_to_string(&output).expect("older"), "older");
    }
}

#[test]
fn a_pipe_that_nobody_reads_is_left_at_the_first_interrupt() {
    let (folder, capture, _) = folder_with_capture();
    let pipe = folder.path().join("pipe");
    mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).expect("pipe");
    for command in [
        &["export", text(&capture), "--output"][..],
        &["simulate", "--duration", "1ms", "--output"],
        &["run", "--config", "none", "--device", "sim", "--duration", "1ms", "--record"],
    ] {
        let mut child = slitpose!().command(command.iter().chain(&[text(&pipe)])).spawn().expect("starts");
        wait_until(&mut child, || true);
        Finished::interrupted(child).assert_refused(1, &["interrupted", text(&pipe)]);
    }
}

/// The program with `arguments`, none of whose files may grow beyond `blocks` of 1 KiB.
fn limited(blocks: u32, arguments: &[&str]) -> Command {
    // The limit of the shell is the one of what it becomes.
    let script = format!("ulimit -f {blocks}; exec \"$@\"");
    let mut command = Command::new("bash");
    command.args(["-c", &script, "bash", slitpose!().path()]).args(arguments).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

#[test]
fn a_file_that_may_not_grow_is_an_error_of_writing() {
    let (folder, capture, bytes) = folder_with_capture();
    let (new, poses) = (folder.path().join("new.mcap"), folder.path().join("poses.csv"));
    for command in [
        &["simulate", "--duration", "100ms", "--output", text(&new)][..],
        &["simulate", "--duration", "100ms", "--overwrite", "--output", text(&capture)],
        &["simulate", "--duration", "100ms", "--raw", "--output", text(&new)],
        &["export", text(&capture), "--output", text(&poses)],
    ] {
        let limited = limited(4, command).output().expect("bash runs");
        let target = command[command.len() - 1];
        Finished::from(limited).assert_refused(1, &["writing to", target, "File too large"]);
        assert!(fs::read(&capture).expect("capture") == bytes, "{command:?}");
        assert_eq!(names(folder.path()), ["d.mcap"], "{command:?}");
    }
}

#[test]
fn poses_go_on_when_the_disk_is_full() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [capture, socket] = ["full.mcap", "status"].map(|name| name_in(folder.path(), name));
    let address = format!("unix:{socket}");
    // A board sends some 400 KiB a second that cannot be made much shorter: it is full after two or three.
    let run =
        ["run", "--device", "sim", "--tier", "paper", "--duration", "4s", "--record", &capture, "--status", &address];
    let mut child = limited(1000, &run).spawn().expect("bash starts");
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
        std::thread::sleep(Duration::from_millis(50));
    }
    let finished = Finished::of(child);
    finished.assert_said(3, &["the capture is not whole"]);
    assert_eq!(recorder["state"], "failed", "{recorder}");
    let reason = recorder["reason"].as_str().expect("a reason");
    assert!(reason.contains("File too large") && reason.contains(&capture), "{reason}");
    assert!(finished.stderr.contains(reason), "{}", finished.stderr);
    assert!(recorder["bytes_dropped"].as_u64() > Some(0), "{recorder}");

    let lines = ndjson::parse(&poses.join().expect("reader"));
    assert_eq!(lines.len(), 16_000);
    assert!(lines.iter().all(|line| line.estimate.is_some()), "a scan without a pose");

    let (boards, replayed) = scan_table::count(slitpose!(), &capture, &[]);
    replayed.assert_said(3, &["was not ended by its recorder"]);
    let [scans] = boards.into_values().collect::<Vec<_>>()[..] else { panic!("one board") };
    // At the least what was flushed in the first second.
    assert!(scans.count >= 2000 && scans.count < 16_000 && scans.first == 0 && scans.jumps == 0, "{scans:?}");
    assert_eq!(scans.poses, scans.count);
}

#[test]
fn a_full_output_is_an_error_and_a_full_disk_before_the_run_is_told_at_its_end() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let record = name_in(folder.path(), "run.capture");
    let full = fs::File::options().write(true).open("/dev/full").expect("a full device");
    let run = ["run", "--device", "sim", "--speed", "max", "--duration", "1s", "--record"];
    let output = slitpose!().command(run.iter().chain(&[record.as_str()])).stdout(full).output().expect("runs");
    Finished::from(output).assert_said(1, &["standard output", "No space left"]);
    assert_eq!(names(folder.path()), ["run.capture"]);

    // The daemon goes on; what was to be recorded is missed at the end.
    let finished = slitpose!().run(run.iter().chain(&["/dev/full"]));
    finished.assert_said(3, &["/dev/full", "No space left", "the capture is not whole"]);
    assert_eq!(ndjson::parse(finished.text()).len(), 4000);
}

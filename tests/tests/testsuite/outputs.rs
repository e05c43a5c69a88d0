//! Results come into place whole or not at all, and never in the place of what was measured.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::Signal;
use nix::unistd::mkfifo;
use slitpose_tests::process::{Finished, name_in, names, text};
use slitpose_tests::slitpose;

/// A folder with a capture of 20 ms in it.
fn folder_with_capture() -> (tempfile::TempDir, PathBuf, Vec<u8>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("d.mcap");
    let simulated = slitpose!().run(["simulate", "--duration", "20ms", "--output", text(&capture)]);
    assert_eq!(simulated.code, 0, "{}", simulated.stderr);
    let bytes = fs::read(&capture).expect("capture");
    (folder, capture, bytes)
}

#[test]
fn a_filtered_pose_that_csv_has_no_room_for_is_missed_aloud() {
    let (_folder, capture, _) = folder_with_capture();
    let replay = |format, filter| slitpose!().run(["replay", text(&capture), "--format", format, "--filter", filter]);
    let says_so = |finished: Finished| finished.stderr.contains("CSV has no columns for the filtered pose");
    assert!(says_so(replay("csv", "5ms")));
    assert!(!says_so(replay("csv", "off")) && !says_so(replay("ndjson", "5ms")));
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
    for (name, advice) in
        [("p.parquet", "--features parquet"), ("x.txt", "--format"), ("poses", "--format"), ("poses.CSVX", "--format")]
    {
        let path = folder.path().join(name);
        export(text(&path), &[]).assert_refused(2, &[text(&path), ".csv", ".ndjson", advice]);
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
fn an_interrupted_simulation_leaves_nothing() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (capture, truth) = (folder.path().join("long.mcap"), folder.path().join("long.csv"));
    let long = ["simulate", "--trajectory", "contact", "--duration", "100000y"];
    let mut child = slitpose!()
        .command(long.iter().chain(&["--output", text(&capture), "--truth", text(&truth)]))
        .spawn()
        .expect("starts");
    // Two parts, of which one grows.
    let grows = || {
        let parts = fs::read_dir(folder.path()).expect("folder").filter_map(|entry| entry.ok()?.metadata().ok());
        parts.map(|part| part.len()).max() > Some(100_000)
    };
    wait_until(&mut child, grows);
    Finished::interrupted(child).assert_refused(1, &["interrupted", text(&capture)]);
    assert!(names(folder.path()).is_empty(), "{:?}", names(folder.path()));
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
        // The limit of the shell, in KiB, is the one of what it becomes.
        let mut limited = Command::new("bash");
        limited.args(["-c", "ulimit -f 4; exec \"$@\"", "bash", slitpose!().path()]).args(command);
        let limited = limited.stdin(Stdio::null()).output().expect("bash runs");
        let target = command[command.len() - 1];
        Finished::from(limited).assert_refused(1, &["writing to", target, "File too large"]);
        assert!(fs::read(&capture).expect("capture") == bytes, "{command:?}");
        assert_eq!(names(folder.path()), ["d.mcap"], "{command:?}");
    }
}

/// Poses are compared scan by scan; a table in another order would leave most of them out.
#[test]
fn a_reference_of_another_order_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| name_in(folder.path(), name);
    let (capture, truth, reversed) = (path("a.mcap"), path("truth.csv"), path("reversed.csv"));
    let simulate = ["simulate", "--duration", "50ms", "--tier", "paper", "--output", &capture, "--truth", &truth];
    assert_eq!(slitpose!().run(simulate).code, 0);
    let compare = |table: &str| slitpose!().run(["replay", &capture, "--format", "none", "--compare", table]);
    let compared = compare(&truth);
    assert!(compared.code == 0 && compared.stderr.contains("200 poses compared"), "{}", compared.stderr);
    let text = fs::read_to_string(&truth).expect("a table");
    let (header, rows) = text.split_once('\n').expect("rows");
    let rows: Vec<&str> = rows.lines().rev().collect();
    fs::write(&reversed, format!("{header}\n{}\n", rows.join("\n"))).expect("a file");
    compare(&reversed).assert_refused(1, &["row 2", "column `seq`", "ascend"]);
}

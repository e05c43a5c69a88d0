//! A capture solved again gives what was printed when it was taken, byte for byte; and work on several cores gives what one
//! gives.

use std::fs;
use std::path::Path;

use slitpose_protocol::Command;
use slitpose_tests::process::text;
use slitpose_tests::scenes::wide_with;
use slitpose_tests::terminal::{Board, Terminal};
use slitpose_tests::{poses, slitpose};

fn run(arguments: &[&str]) -> Vec<u8> {
    slitpose!().run(["run", "--device", "sim", "--speed", "max"].iter().chain(arguments)).silently_done()
}

fn replay(capture: &Path, arguments: &[&str]) -> Vec<u8> {
    slitpose!().run(["replay", text(capture)].iter().chain(arguments)).silently_done()
}

#[test]
fn a_recording_replays_as_it_ran() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("run.capture");
    for motion in ["smooth", "contact"] {
        for tier in ["paper", "exact"] {
            for format in ["ndjson", "csv"] {
                let common = ["--format", format, "--tier", tier];
                let live = ["--duration", "500ms", "--trajectory", motion, "--overwrite", "--record", text(&capture)];
                let ran = run(&[&live[..], &common[..]].concat());
                assert_eq!(ran.iter().filter(|byte| **byte == b'\n').count(), 2000 + usize::from(format == "csv"));
                assert!(replay(&capture, &common) == ran, "{motion}, {tier}, {format}: replay differs from run");
            }
        }
    }
}

/// With the instants of arrivals, pings and their answers, which no second run has again.
#[test]
fn what_came_over_a_terminal_in_real_time_replays_as_it_ran() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("live.mcap");
    for (format, filter) in [("ndjson", &[][..]), ("ndjson", &["--filter", "5ms"]), ("csv", &["--filter", "5ms"])] {
        let terminal = Terminal::serve(Board::wide(23));
        let live = ["--device", &terminal.path, "--duration", "1500ms", "--overwrite", "--record", text(&capture)];
        let finished = slitpose!().run(["run", "--format", format].iter().chain(&live).chain(filter));
        assert_eq!((finished.code, finished.stderr.as_str()), (0, ""), "{format}");
        let commands = terminal.closed().commands();
        assert!(commands.iter().any(|command| matches!(command, Command::Ping { .. })), "{commands:?}");
        let printed = String::from_utf8(finished.stdout.clone()).expect("UTF-8");
        // The board's clock is known after its first answers.
        assert!(format == "csv" || printed.contains("host_utc_ns"), "no instant by the host's clock");
        assert!(format == "csv" || printed.contains("filtered") != filter.is_empty());
        // The filter is the one of the recording.
        assert!(replay(&capture, &["--format", format]) == finished.stdout, "{format}, {filter:?}: replay differs");
    }
}

#[test]
fn simulating_and_replaying_is_running() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (simulated, recorded) = (folder.path().join("simulated"), folder.path().join("recorded"));
    let common = ["--duration", "300ms", "--trajectory", "fast", "--seed", "21"];
    let output = ["simulate", "--output", text(&simulated)];
    let finished = slitpose!().run(output.iter().chain(&common));
    assert_eq!((finished.code, finished.stdout.as_slice(), finished.stderr.as_str()), (0, &b""[..], ""));
    let ran = run(&[&common[..], &["--record", text(&recorded)]].concat());
    assert!(replay(&simulated, &[]) == ran, "replay of simulate differs from run");
    assert!(replay(&recorded, &[]) == ran, "replay of a recording differs from run");

    // Standard output takes a capture, too, and the bytes alone are one.
    let read = |path| fs::read(path).expect("capture");
    let finished = slitpose!().run(["simulate", "--output", "-"].iter().chain(&common));
    assert!(finished.code == 0 && finished.stdout == read(&simulated), "standard output got another capture");
    let bytes = folder.path().join("bytes");
    let finished = slitpose!().run(["simulate", "--raw", "--output", text(&bytes)].iter().chain(&common));
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    assert!(replay(&bytes, &[]) == ran, "replay of the bytes alone differs from run");
}

#[test]
fn duration_ends_a_replay_without_complaint() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("run.capture");
    let all = run(&["--duration", "300ms", "--record", text(&capture)]);
    let lines: Vec<&[u8]> = all.split_inclusive(|byte| *byte == b'\n').collect();
    for (duration, scans) in [("100ms", 400), ("1ms", 4), ("250us", 1), ("299ms", 1196), ("10s", 1200)] {
        let part = replay(&capture, &["--duration", duration]);
        assert!(part == lines[..scans].concat(), "{duration} of replay are not the first {scans} lines");
    }
}

#[test]
fn the_scene_of_a_capture_is_looked_after() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (capture, scene) = (folder.path().join("capture"), folder.path().join("thick.toml"));
    let thick = wide_with(&[("length_mm = 10.0  ", "thickness_mm = 0.15\nlength_mm = 10.0  ")]);
    fs::write(&scene, thick).expect("scene");
    let ran = run(&["--duration", "20ms", "--scene", text(&scene), "--record", text(&capture)]);
    assert!(replay(&capture, &[]) == ran, "a capture holds its scene");

    // Bytes alone do not. The hash names no shipped scene: the default one must not be taken for it.
    let bytes = folder.path().join("bytes");
    let simulate = ["simulate", "--raw", "--duration", "20ms", "--scene", text(&scene), "--output", text(&bytes)];
    assert_eq!(slitpose!().run(simulate).code, 0);
    let refused = slitpose!().run(["replay", text(&bytes)]);
    let wide = slitpose_head::scene_file::WIDE.read().expect("shipped").hash;
    let own = slitpose_tests::scenes::parse(&fs::read_to_string(&scene).expect("scene")).hash;
    refused.assert_refused(1, &[&format!("{wide:016x}"), &format!("{own:016x}"), "--scene"]);

    assert!(replay(&bytes, &["--scene", text(&scene)]) == ran, "replay with the scene given differs from run");

    // Asked for by name another scene is used, and said so.
    let other = slitpose!().run(["replay", text(&capture), "--scene", "wide"]);
    assert_eq!(other.code, 0);
    assert!(other.stdout != ran, "the scene asked for was not used");
    assert!(other.stderr.contains(&format!("{own:016x}")), "{}", other.stderr);

    // A shipped scene is found by its hash.
    let ran = run(&["--duration", "20ms", "--overwrite", "--record", text(&capture), "--scene", "wide"]);
    assert!(replay(&capture, &[]) == ran);
}

#[test]
fn results_do_not_depend_on_the_number_of_jobs() {
    let rows = poses::in_box(&mut poses::generator(5), 4.0, 15.0, 1_500);
    let table = poses::table("p", &rows);
    let with_jobs = |arguments: &[&str], input: &str| {
        let [one, three] = ["1", "3"]
            .map(|jobs| slitpose!().run_with_input(arguments.iter().copied().chain(["--jobs", jobs]), input).done());
        assert_eq!(one, three, "{arguments:?}");
        one
    };
    let currents = with_jobs(&["model", "wide", "--poses", "-"], &table);
    with_jobs(&["solve", "wide", "--currents", "-"], &currents);
    with_jobs(&["scene", "check", "wide", "--samples", "3000", "--format", "json"], "");
    with_jobs(&["scene", "map", "wide", "--samples", "300"], "");
    with_jobs(&["compare", "wide", "base", "--samples", "300"], "");
    let free = ["--free", "slit_width", "--seed", "3"];
    with_jobs(&[&["scene", "optimise", "wide"][..], &free].concat(), "");
}

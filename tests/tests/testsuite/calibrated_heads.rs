//! Heads by a calibration, and by the tolerances of their parts, through the command.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use slitpose_head::scene_file::{WIDE, fnv1a_64};
use slitpose_protocol::{Command, Hashes};
use slitpose_tests::poses;
use slitpose_tests::process::text;
use slitpose_tests::slitpose;
use slitpose_tests::table::{POSE, SIGMA, Table};
use slitpose_tests::terminal::{Board, Terminal};
use tempfile::TempDir;

use super::calibrate::data;

/// What the calibration below leaves open of each translation, metres.
const OPEN_M: f64 = 10e-6;

/// A calibration of the shipped scene: cell 0 shifted by 0.2 mm along its x, and dimmer by a tenth.
fn calibration(folder: &TempDir, name: &str, scene_hash: u64) -> PathBuf {
    let mut text = format!(
        "format = 1\nid = \"test\"\nweak = []\n[scene]\nname = \"wide\"\n\
         hash = \"{scene_hash:016x}\"\ntext = \"\"\n[statistics]\nrows = 1\nreadings = 6\nreadings_rejected = 0\n\
         poses_rejected = 0\nchi2 = 1.0\nredundancy = 1.0\n"
    );
    for cell in 0..6 {
        let entries = if cell == 0 {
            r#"["slit_x", 2e-4, 1e-6, 0e0, 6e-5, "m"], ["log_intensity", -1e-1, 1e-4, 0e0, 3e-1, "1"]"#
        } else {
            ""
        };
        // Writing to a String cannot fail.
        let _ = write!(text, "[[cell]]\nmodel_error_relative = 0.0\nmodel_error_m = 0.0\nparameters = [{entries}]\n");
    }
    text +=
        "[converter]\nfull_scale_a = 1e-5\nparameters = []\n[pose_error]\nlength_scale_m = 1e-2\ncoefficients = [\n";
    for row in 0..42 {
        // The first three belong to translations that are off by the same everywhere.
        let values: Vec<f64> = (0..=row).map(|k| if k == row && k < 3 { OPEN_M * OPEN_M } else { 0.0 }).collect();
        let _ = writeln!(text, "{values:?},");
    }
    text += "]\n[correlation]\nrows = [[], [0.0]]\n";
    let path = folder.path().join(name);
    let hashed = format!("hash = \"{:016x}\"\n{text}", fnv1a_64(text.as_bytes()));
    fs::write(&path, hashed).expect("written");
    path
}

#[test]
fn the_mean_of_sixteen_frames_has_a_quarter_of_the_noise() {
    let truths = poses::in_box(&mut poses::generator(5), 4.0, 15.0, 20);
    let currents = slitpose!().run_with_input(["model", "wide", "--poses", "-"], &poses::table("p", &truths)).done();
    let (header, rows) = currents.split_once('\n').expect("rows");
    let solve = |frames: [&str; 2]| {
        let twice: String = rows.lines().flat_map(|row| frames.map(|frames| format!("{row},{frames}\n"))).collect();
        slitpose!().run_with_input(["solve", "wide", "--currents", "-"], &format!("{header},frames\n{twice}"))
    };
    let solved = Table::parse(&solve(["1", "16"]).done());
    assert_eq!(solved.rows().len(), 40);
    for (one, sixteen) in solved.rows().step_by(2).zip(solved.rows().skip(1).step_by(2)) {
        for column in SIGMA {
            let ratio = one.number(column) / sixteen.number(column);
            // Integrals are good to 1e-6, which no mean improves: a hundredth of the noise.
            assert!((ratio - 4.0).abs() < 0.01, "{column}: {ratio}");
        }
    }
    let none = solve(["0.5", "1"]);
    let named = ["row 1", "`frames`", "0.5", "1 or more"].iter().all(|part| none.stderr.contains(part));
    assert!(none.code == 1 && named, "{}", none.stderr);
}

#[test]
fn a_calibrated_head_is_solved_with_what_its_calibration_leaves_open() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = calibration(&folder, "head.toml", WIDE.read().expect("shipped").hash);
    let of_head = ["--calibration", text(&path)];
    let truths = poses::in_box(&mut poses::generator(6), 3.0, 10.0, 20);
    let model = ["model", "wide", "--poses", "-"];
    let currents = slitpose!().run_with_input(model.iter().chain(&of_head), &poses::table("p", &truths)).done();
    let solve = |arguments: &[&str]| {
        let solve = ["solve", "wide", "--currents", "-"];
        Table::parse(&slitpose!().run_with_input(solve.iter().chain(arguments), &currents).done())
    };
    let (calibrated, drawn) = (solve(&of_head), solve(&[]));
    for ((row, drawn), truth) in calibrated.rows().zip(drawn.rows()).zip(&truths) {
        assert_eq!(row.text("status"), "converged");
        let (pose, sigma) = (row.numbers(POSE), row.numbers(SIGMA));
        for axis in 0..6 {
            // Noise-free currents to 1e-10, solved with integrals to 1e-6: 0.015 σ, as in `solve_process`.
            assert!((pose[axis] - truth[axis]).abs() < 0.015 * sigma[axis], "{}", row.text("id"));
            // Noise has 0.5 to 2 µm.
            let open = sigma[axis] * 1e-3 / OPEN_M;
            assert!(axis >= 3 || (1.0..1.1).contains(&open), "{open}");
        }
        assert_ne!(drawn.text("status"), "converged", "{}", row.text("id"));
    }
    let check = slitpose!().run(["scene", "check", "wide", "--samples", "100"].iter().chain(&of_head)).done();
    assert!(check != slitpose!().run(["scene", "check", "wide", "--samples", "100"]).done());
}

#[test]
fn a_calibration_of_another_scene_is_refused_with_both_hashes() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = calibration(&folder, "head.toml", 0x1234_5678_9abc_def0);
    let hash = format!("{:016x}", WIDE.read().expect("shipped").hash);
    let (table, output) = (data("head_1_test.csv"), folder.path().join("output"));
    let output = text(&output);
    for verb in [
        &["solve", "wide", "--currents", &table][..],
        &["model", "wide", "--poses", &table],
        &["simulate", "--output", output],
        &["run", "--device", "sim", "--duration", "1ms"],
        &["scene", "check", "wide"],
        &["scene", "plot", "wide", "--output", output],
    ] {
        let finished = slitpose!().run(verb.iter().chain(&["--calibration", text(&path)]));
        finished.assert_refused(1, &["123456789abcdef0", &hash, "calibrate this one"]);
    }
    let two = slitpose!().run(["run", "--device", "sim,sim", "--calibration", text(&path)]);
    two.assert_refused(2, &["1 calibrations for 2 boards"]);
}

#[test]
fn captures_replay_with_the_calibration_they_were_made_with() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = calibration(&folder, "head.toml", WIDE.read().expect("shipped").hash);
    let [recorded, simulated] = ["recorded.mcap", "simulated.mcap"].map(|name| folder.path().join(name));
    let common = ["--duration", "300ms", "--seed", "3", "--calibration", text(&path)];
    let run = ["run", "--device", "sim", "--speed", "max", "--format", "ndjson", "--record", text(&recorded)];
    let ran = slitpose!().run(run.iter().chain(&common)).silently_done();
    slitpose!().run(["simulate", "--output", text(&simulated)].iter().chain(&common)).silently_done();
    fs::remove_file(&path).expect("removed");
    for capture in [&recorded, &simulated] {
        let replayed = slitpose!().run(["replay", text(capture), "--format", "ndjson"]);
        assert!(!replayed.text().contains("degraded"));
        assert!(replayed.silently_done() == ran, "replay differs from run");
        let drawn = slitpose!().run(["replay", text(capture), "--format", "ndjson", "--calibration", "none"]);
        assert!(drawn.silently_done() != ran);
    }
}

#[test]
fn an_uncalibrated_run_says_so_and_replays_as_it_ran() {
    let folder = tempfile::tempdir().expect("a folder");
    let [scene, capture] = ["head.toml", "run.mcap"].map(|name| folder.path().join(name));
    fs::write(&scene, format!("{}\n[tolerance]\n", WIDE.text)).expect("written");
    let run = ["run", "--device", "sim", "--speed", "max", "--format", "ndjson", "--scene", text(&scene)];
    let ran =
        slitpose!().run(run.iter().chain(&["--duration", "200ms", "--filter", "5ms", "--record", text(&capture)]));
    assert!(ran.code == 0 && ran.stderr.contains("slitpose calibrate"), "{}", ran.stderr);
    let printed = ran.stdout.clone();
    for line in ran.done().lines().filter(|line| line.contains("\"seq\"")) {
        assert!(line.contains(r#""status":"degraded","reason":"uncalibrated""#), "{line}");
    }
    let replayed = slitpose!().run(["replay", text(&capture), "--format", "ndjson"]);
    assert!(replayed.silently_done() == printed, "replay differs from run");
}

#[test]
fn a_board_keeps_the_hash_of_its_calibration_and_refuses_another() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = WIDE.read().expect("shipped").hash;
    let path = calibration(&folder, "head.toml", scene);
    let first = fs::read_to_string(&path).expect("written");
    let hash = first.lines().next().and_then(|line| line.strip_prefix("hash = \"")).expect("a hash")[..16].to_owned();
    let number = u64::from_str_radix(&hash, 16).expect("a hash");

    let terminal = Terminal::serve(Board::wide(91));
    let set = ["device", "set", "--device", &terminal.path, "--scene", "wide", "--calibration", text(&path)];
    assert!(slitpose!().run(set).done().contains(&format!("the calibration with hash {hash}")));
    let stored = Hashes { scene: Some(scene), calibration: Some(number) };
    assert!(terminal.closed().commands().contains(&Command::Store(stored)));

    let run = |calibration: u64, arguments: &[&str]| {
        let mut board = Board::wide(92);
        board.command(Command::Store(Hashes { scene: Some(scene), calibration: Some(calibration) }));
        let terminal = Terminal::serve(board);
        let run = ["run", "--device", &terminal.path, "--duration", "50ms", "--format", "ndjson"];
        slitpose!().run(run.iter().chain(arguments))
    };
    run(number, &["--calibration", text(&path)]).silently_done();
    let other = run(!number, &["--calibration", text(&path)]);
    other.assert_refused(1, &[&hash, &format!("{:016x}", !number), "--calibration", "device set"]);
}

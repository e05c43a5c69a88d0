//! Tables in other units, frames and clocks than they are said to be in: refused, or told with the next step.

use std::fs;

use slitpose_tests::process::{Finished, name_in};
use slitpose_tests::slitpose;

const POSES: [&str; 6] = ["tx_mm", "ty_mm", "tz_mm", "rx_rad", "ry_rad", "rz_rad"];

/// The column of that name in the header of `table`.
fn place(table: &str, name: &str) -> usize {
    table.lines().next().and_then(|header| header.split(',').position(|column| column == name)).expect(name)
}

/// `table` with the numbers of `names` changed.
fn changed(table: &str, names: &[&str], change: impl Fn(f64) -> f64) -> String {
    let places: Vec<usize> = names.iter().map(|name| place(table, name)).collect();
    let mut lines = table.lines().map(str::to_owned);
    let header = lines.next().expect("a header");
    let rows = lines.map(|line| {
        let fields = line.split(',').enumerate().map(|(at, field)| match places.contains(&at) {
            true => change(field.parse().expect("a number")).to_string(),
            false => field.to_owned(),
        });
        fields.collect::<Vec<_>>().join(",")
    });
    [header].into_iter().chain(rows).collect::<Vec<_>>().join("\n") + "\n"
}

/// Ended with `code`, and said all `parts`, or nothing.
fn assert_said(finished: &Finished, code: i32, parts: &[&str], what: &str) {
    assert_eq!(finished.code, code, "{what}: {}", finished.stderr);
    parts.iter().for_each(|part| assert!(finished.stderr.contains(part), "{what}: `{part}`: {}", finished.stderr));
}

/// Doubts of a table are a line of their own on standard error.
fn assert_no_doubt(finished: &Finished, what: &str) {
    assert_eq!((finished.code, finished.stderr.contains("are these")), (0, false), "{what}: {}", finished.stderr);
    assert!(!finished.stderr.contains("seems"), "{what}: {}", finished.stderr);
}

/// Poses within the workspace of `wide`, 4 mm and 0.26 rad.
fn poses() -> String {
    let row = |row: u32| {
        let part = |axis: u32, size: f64| size * (f64::from((row * (2 * axis + 3) + 5 * axis) % 11) - 5.0) / 5.0;
        let numbers: Vec<String> =
            (0..6).map(|axis| part(axis, if axis < 3 { 3.0 } else { 0.2 }).to_string()).collect();
        format!("{row},{}\n", numbers.join(","))
    };
    format!("id,{}\n{}", POSES.join(","), (0..6).map(row).collect::<String>())
}

#[test]
fn poses_of_other_units_are_told() {
    let table = poses();
    let (t, r) = POSES.split_at(3);
    let model = |table: &str| slitpose!().run_with_input(["model", "wide", "--poses", "-"], table);
    assert_no_doubt(&model(&table), "as it is");
    let degrees = changed(&table, r, |rad| 100.0 * rad);
    let parts = ["row 1 (line 2), column `r", "radians", "are these degrees?"];
    assert_said(&model(&degrees), 1, &parts, "degrees");
    let few_degrees = changed(&table, r, |rad| 20.0 * rad);
    assert_said(&model(&few_degrees), 0, &["column `r", "more than half a turn", "are these degrees?"], "few degrees");
    let micrometres = changed(&table, t, |mm| mm * 1e3);
    assert_said(&model(&micrometres), 0, &["column `t", "leads 750 times", "are these micrometres?"], "micrometres");
    let metres = changed(&table, t, |mm| mm * 1e-3);
    assert_said(&model(&metres), 0, &["column `t", "0.003 is the largest", "are these metres?"], "metres");
    assert_no_doubt(&model(&changed(&table, t, |_| 0.0)), "turns alone");
}

/// `poses` with the currents of the shipped scene `scene` beside them.
fn measured(scene: &str, poses: &str) -> String {
    let currents = slitpose!().run_with_input(["model", scene, "--tier", "paper", "--poses", "-"], poses).done();
    let joined: Vec<String> = poses.lines().zip(currents.lines()).map(|(pose, of)| format!("{pose},{of}")).collect();
    joined.join("\n").replacen(",id,", ",again,", 1) + "\n"
}

#[test]
fn profiles_are_not_identified_from_poses_of_other_units() {
    // At most of these the light stays at the middle of the detector, whatever the axes.
    let turns: String = (-6..7).map(|row| format!("{row},{},0,0,0,{},0\n", row / 4, 0.1 * f64::from(row))).collect();
    let bench = measured("bench", &format!("id,{}\n{turns}", POSES.join(",")));
    assert_no_doubt(&slitpose!().run_with_input(["identify", "bench", "--currents", "-"], &bench), "bench");
    let table = measured("wide", &poses());
    let identify = |table: &str| slitpose!().run_with_input(["identify", "wide", "--currents", "-"], table);
    assert_no_doubt(&identify(&table), "as it is");
    let currents: Vec<&str> =
        table.lines().next().expect("a header").split(',').filter(|name| name.starts_with("i_x")).collect();
    let microamperes = identify(&changed(&table, &currents, |a| a * 1e6));
    assert_said(&microamperes, 0, &["check that currents are in amperes", "times the emitter's"], "microamperes");
    for (names, change, parts) in [
        (&POSES[..3], 1e-3, &["tx_mm, ty_mm and tz_mm are millimetres", "metres?"][..]),
        (&POSES[3..], 57.29577951308232, &["column `r", "are these degrees?"]),
        (&POSES[..3], -1.0, &["axes of the poses look exchanged or reversed"]),
    ] {
        let finished = identify(&changed(&table, names, |number| change * number));
        assert_said(&finished, 1, parts, &format!("{names:?} times {change}"));
    }
}

#[test]
fn references_of_other_clocks_and_units_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| name_in(folder.path(), name);
    let (capture, truth, other) = (path("a.mcap"), path("truth.csv"), path("other.csv"));
    let simulate = ["simulate", "--duration", "300ms", "--tier", "paper", "--output", &capture, "--truth", &truth];
    assert_eq!(slitpose!().run(simulate).code, 0);
    let by_scan = fs::read_to_string(&truth).expect("a table");
    let by_time = by_scan.replacen("device_time_s", "time_s", 1).replacen("seq", "row", 1);
    let compare = |table: &str| {
        fs::write(&other, table).expect("a file");
        slitpose!().run(["replay", &capture, "--format", "none", "--compare", &other])
    };
    assert_no_doubt(&compare(&by_scan), "by scan");
    assert_no_doubt(&compare(&by_time), "by time");
    let time = |change: fn(f64) -> f64| changed(&by_time, &["time_s"], change);
    let degrees = changed(&by_time, &POSES[3..], f64::to_degrees);
    for (what, table, code, parts) in [
        (
            "epoch",
            time(|s| s + 1.79e9),
            1,
            &["time_s runs from 1790000000.0", "that of the poses from 5.69", "epoch"][..],
        ),
        ("epoch", time(|s| s + 1.79e9), 1, &["1790000000.0", "s late"]),
        ("milliseconds", time(|s| s * 1e3), 0, &["are these milliseconds?"]),
        ("rows", changed(&by_time, &["time_s"], |s| (s * 4000.0).floor()), 0, &["are these numbers of rows?"]),
        ("late", time(|s| s + 0.0205), 0, &["the reference seems 0.020", "s late", "subtract"]),
        ("early", time(|s| s - 1.55e-4), 0, &["the reference seems 0.00015", "s early", "add"]),
        ("metres", changed(&by_scan, &POSES[..3], |mm| mm * 1e-3), 0, &["are these metres?", "times as well"]),
        ("metres by time", changed(&by_time, &POSES[..3], |mm| mm * 1e-3), 0, &["are these metres?"]),
        (
            "mirrored",
            changed(&by_scan, &["ty_mm", "rx_rad", "rz_rad"], |number| -number),
            0,
            &["(tx_mm, −ty_mm, tz_mm)"],
        ),
        ("other axes", changed(&by_scan, &["tx_mm"], |mm| mm + 50.0), 0, &["hardly better than a tool at rest"]),
        (
            "scans",
            changed(&by_scan, &["seq"], |n| n + 5e3),
            1,
            &["seq runs from 5000.0 to 6199.0", "from 0.0 to 1199.0"],
        ),
        ("degrees", degrees, 1, &["column `r", "are these degrees?"]),
    ] {
        assert_said(&compare(&table), code, parts, what);
    }
}

#[test]
fn paths_by_another_clock_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| name_in(folder.path(), name);
    let (table, capture) = (path("path.csv"), path("a.mcap"));
    for (times, code, parts) in [
        ([0.0, 0.01, 0.02], 0, &[][..]),
        ([-0.01, 0.0, 1.0], 0, &[]),
        (
            [1.79e9, 1.79e9 + 0.1, 1.79e9 + 0.2],
            1,
            &["time_s runs from 1790000000.0 to 1790000000.2", "the simulation", "0.02"],
        ),
        ([-3.0, -2.0, -1.0], 1, &["time_s runs from -3.0 to -1.0", "begins at zero"]),
        ([0.0, 100.0, 200.0], 0, &["takes 200 s, and the simulation 0.02 s", "milliseconds"]),
    ] {
        let rows: String = times.iter().enumerate().map(|(x, time)| format!("{time},{x},0,0,0,0,0\n")).collect();
        fs::write(&table, format!("time_s,{}\n{rows}", POSES.join(","))).expect("a file");
        let simulate = ["simulate", "--duration", "20ms", "--trajectory", &table, "--overwrite", "--output", &capture];
        let finished = slitpose!().run(simulate);
        assert_said(&finished, code, parts, &format!("{times:?}"));
        assert!(code == 1 || !parts.is_empty() || finished.stderr.is_empty(), "{times:?}: {}", finished.stderr);
    }
}

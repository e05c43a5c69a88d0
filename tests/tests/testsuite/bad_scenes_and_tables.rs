//! Scene files and tables that are wrong: refused with a message that says where, what
//! stands there and what to do, with nothing on standard output. Of a table a field refuses its row only. Tables in other
//! units, frames and clocks than they are said to be in are refused, or told with the next step.

use std::fs;

use slitpose_head::scene_file::BENCH;
use slitpose_tests::process::{Finished, name_in};
use slitpose_tests::scenes::wide_with;
use slitpose_tests::slitpose;
use slitpose_tests::table::{POSE, with_changed};

const POSES: &str = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n";

/// Which mistakes are found, and in which words, are tests of the crate `slitpose-head`.
#[test]
fn every_verb_refuses_a_wrong_scene_and_says_where_it_is_wrong() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = name_in(folder.path(), "head.toml");
    let poses = format!("{POSES}a,0,0,0,0,0,0\n");
    let old = "distance_mm = 5.0";
    for (new, fault) in [
        ("distanse_mm = 5.0", "did you mean `distance_mm`?"),
        ("distance_mm 5.0", "not valid TOML"),
        ("distance_mm = -5.0", "slit.distance_mm = -5.0"),
    ] {
        let scene = wide_with(&[(old, new)]);
        fs::write(&path, &scene).expect("scene");
        let before = &scene[..scene.find(new).expect("stands there")];
        let line = before.matches('\n').count() + 1;
        let parts = [format!("{path}:{line}:"), fault.to_owned()];
        let parts = parts.each_ref().map(String::as_str);
        slitpose!().run_with_input(["model", &path, "--poses", "-"], &poses).assert_refused(1, &parts);
        slitpose!().run_with_input(["solve", &path, "--currents", "-"], "id\n1\n").assert_refused(1, &parts);
        slitpose!().run(["run", "--device", "sim", "--scene", &path, "--duration", "1ms"]).assert_refused(1, &parts);
        slitpose!().run(["simulate", "--output", "-", "--scene", &path]).assert_refused(1, &parts);
        slitpose!().run(["scene", "check", &path]).assert_refused(1, &parts);
    }
    for (old, new, parts) in [
        ("emitter_axis = [1.0, 0.0, 0.0]", "emitter_axis = [0.0, 0.0, 0.0]", ["emitter_axis", "length 0"]),
        ("slots = [[0, 2, 4], [1, 3, 5], []]", "slots = [[0, 2, 4], [1, 3], []]", ["emitter 5", "no slot"]),
    ] {
        fs::write(&path, wide_with(&[(old, new)])).expect("scene");
        slitpose!().run(["scene", "check", &path]).assert_refused(1, &parts);
    }
}

#[test]
fn tables_that_are_none() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let name = &*name_in(folder.path(), "poses.csv");
    let missing_column = POSES.replace("tz_mm", "tz") + "a,0,0,0,0,0,0\n";
    for (text, parts) in [
        ("", &["is empty", "header row"][..]),
        (POSES, &["no row", "add at least one"]),
        (
            &missing_column,
            &["line 1", "`tz_mm` is missing", "id, tx_mm, ty_mm, tz, rx_rad", "add the column, or rename tz if"],
        ),
        ("id,id,tx_mm\na,b,0\n", &["line 1", "`id`", "twice", "rename"]),
    ] {
        fs::write(name, text).expect("table");
        slitpose!().run(["model", "wide", "--poses", name]).assert_refused(1, &[parts, &[name]].concat());
        slitpose!().run_with_input(["model", "wide", "--poses", "-"], text).assert_refused(1, parts);
    }
    let currents = "id,i_x1_0_a,i_x2_0_a\n1,1e-6,1e-6\n";
    let refused = slitpose!().run_with_input(["solve", "wide", "--currents", "-"], currents);
    refused.assert_refused(1, &["standard input, line 1", "`i_x1_1_a` is missing", "add the column"]);
}

#[test]
fn fields_that_are_no_numbers() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (path, output) = (folder.path().join("poses.csv"), folder.path().join("out.csv"));
    let (name, output_name) = (path.to_str().expect("UTF-8 path"), output.to_str().expect("UTF-8 path"));
    // A row fails alone.
    let poses = ["0,0,0.5 mm,0,0,0", "0,0,,0,0,0", "0,0,0,NaN,0,0", "0,0,0,0,inf,0"];
    let faults = ["`tz_mm`: `0.5 mm`", "`tz_mm`: ``", "`rx_rad`: `NaN`", "`ry_rad`: `inf`"];
    let rows: String = poses.iter().map(|pose| format!("a,0,0,0,0,0,0\nb,{pose}\n")).collect();
    let run = slitpose!().run_with_input(["model", "wide", "--poses", "-"], &format!("{POSES}{rows}"));
    assert_eq!(run.code, 3, "{}", run.stderr);
    let table = String::from_utf8(run.stdout).expect("text");
    let (sound, damaged): (Vec<&str>, Vec<&str>) = table.lines().skip(1).partition(|row| row.starts_with("a,lit,"));
    assert_eq!(
        (sound.len(), damaged.as_slice()),
        (4, &[format!("b{}", ",unreadable,,,,,,".repeat(6)).as_str(); 4][..])
    );
    for (number, fault) in faults.iter().enumerate() {
        let place = format!("row {} (line {}), column {fault}", 2 * number + 2, 2 * number + 3);
        assert!(run.stderr.contains(&place), "{place}: {}", run.stderr);
    }
    let home = slitpose!().run_with_input(["model", "wide", "--poses", "-"], &format!("{POSES}a,0,0,0,0,0,0\n")).done();
    let [header, currents] = home.lines().collect::<Vec<_>>()[..] else { panic!("{home}") };
    let column = header.split(',').position(|name| name == "i_x2_3_a").expect("column");
    for field in ["NaN", "-inf", "none"] {
        let mut fields: Vec<&str> = currents.split(',').collect();
        fields[column] = field;
        let table = format!("{header}\n{currents}\n{}\n{currents}\n", fields.join(","));
        let run = slitpose!().run_with_input(["solve", "wide", "--currents", "-"], &table);
        assert_eq!(run.code, 3, "{}", run.stderr);
        assert!(run.stderr.contains(&format!("row 2 (line 3), column `i_x2_3_a`: `{field}`")), "{}", run.stderr);
        let solved = String::from_utf8(run.stdout).expect("text");
        let starts = ["a,converged,", "a,unreadable,,,,,,,,,,,,", "a,converged,"];
        assert!(solved.lines().skip(1).zip(starts).all(|(row, start)| row.starts_with(start)), "{solved}");
        assert_eq!(solved.lines().count(), 4);
    }
    for (row, parts) in [
        ("b,0,0,0", &["4 fields", "header has 7", "correct this row"]),
        ("b,0,0,0,0,0,0,0", &["8 fields", "header has 7", "correct this row"]),
        ("b,1e12,0,0,0,0,0", &["column `tx_mm`: 1000000000000", "out of range", "at most 1e9"]),
    ] {
        fs::write(&path, format!("{POSES}a,0,0,0,0,0,0\n{row}\nc,0,0,0,0,0,0\n")).expect("table");
        // To a file: what was written to standard output cannot be taken back.
        let finished = slitpose!().run(["model", "wide", "--poses", name, "--output", output_name]);
        finished.assert_refused(1, &[&parts[..], &[name, "row 2 (line 3)"]].concat());
        assert!(!output.exists(), "{row}: a table in spite of the error");
    }
    // Not UTF-8.
    fs::write(&path, [POSES.as_bytes(), b"\xff,0,0,0,0,0,0\n"].concat()).expect("table");
    slitpose!().run(["model", "wide", "--poses", name]).assert_refused(1, &[name, "row 1 (line 2)", "UTF-8"]);
}

#[test]
fn paths_that_do_not_advance() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = name_in(folder.path(), "path.csv");
    let name = path.as_str();
    let run = ["run", "--device", "sim", "--speed", "max", "--duration", "1ms", "--trajectory", name];
    slitpose!()
        .run(run)
        .assert_refused(1, &[name, "the motions are still, hand, smooth, fast, contact", "cannot read"]);
    fs::write(&path, "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0,0\n0,1,0,0,0,0,0\n").expect("table");
    slitpose!().run(run).assert_refused(1, &[name, "time 0 s follows 0 s", "sort"]);
    fs::write(&path, "tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0\n").expect("table");
    slitpose!().run(run).assert_refused(1, &[name, "`time_s` is missing"]);
}

/// The workspace of `wide` reaches to 3.3 mm and 15°, 0.2618 rad.
#[test]
fn paths_far_beyond_the_workspace_are_told() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [path, capture] = ["path.csv", "path.mcap"].map(|name| folder.path().join(name).display().to_string());
    for (row, told) in [
        ("1,6,0,0.5,0", None),
        ("0,7,0,1,0", Some("row 2, column `ry_rad`: 1 leads 4 times")),
        ("0,20,0,1,0", Some("row 2, column `ty_mm`: 20 leads 6 times")),
    ] {
        fs::write(&path, format!("time_s,tx_mm,ty_mm,rx_rad,ry_rad,rz_rad,tz_mm\n0,0,0,0,0,0,0\n1,{row},0\n"))
            .expect("table");
        let simulate = ["simulate", "--duration", "1ms", "--trajectory", &path, "--overwrite", "--output", &capture];
        let run = slitpose!().run(simulate);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert_eq!(run.stderr.contains("leads"), told.is_some(), "{row}: {}", run.stderr);
        assert!(run.stderr.contains(told.unwrap_or_default()), "{row}: {}", run.stderr);
    }
}

#[test]
fn integrals_that_meet_the_limit_of_work_are_told() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = name_in(folder.path(), "scene.toml");
    let path = path.as_str();
    let text = BENCH.text.replace("distance_mm = 7.5", "distance_mm = 1.0").replace("width_mm = 0.4", "width_mm = 4.0");
    let text = text.replace("width_mm = 1.0", "width_mm = 5.0");
    let text = text.replace("[0.0, 0.0, -15.0]", "[0.0, 0.0, -2.262242254704235]");
    // Light and dark in turns of 3° over a spot of 130°; a needle of a quarter of a degree that passes the spot by.
    let saw: String = (0..29).map(|i| format!("[{}.0, {}.0], ", 3 * i, (i + 1) % 2)).collect();
    let aside = "emitter_axis = [-0.008644273012421485, -0.7924553743397872, -0.6098686384985497]";
    for (profile, axis, said) in [
        (format!("profile = [{saw}]"), "emitter_axis = [0.0, 0.0, -1.0]", "1 rows are good to "),
        ("profile_exponent = 62729.50675134393".to_owned(), aside, "1 rows are not good to the tolerance"),
    ] {
        let text = text.replace("emitter_axis = [0.0, 0.0, -1.0]", axis);
        fs::write(path, text.replace("half_angle_deg = 55.0", &profile)).expect("written");
        let model = |tier| {
            let poses = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\nhome,0,0,0,0,0,0\n";
            slitpose!().run_with_input(["model", path, "--poses", "-", "--tier", tier], poses)
        };
        let run = model("exact");
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(run.stderr.contains(said) && run.stderr.contains("51200 values"), "{profile}: {}", run.stderr);
        let paper = model("paper");
        assert_eq!((paper.code, paper.stderr.as_str()), (0, ""));
    }
}

#[test]
fn help_is_data_and_has_an_example() {
    fn check(command: &clap::Command, words: &[&str]) {
        let verbs: Vec<_> = command.get_subcommands().filter(|verb| verb.get_name() != "help").collect();
        // A verb of verbs leaves examples to them.
        if verbs.is_empty() || words.is_empty() {
            let help = slitpose!().run(words.iter().chain(&["--help"])).done();
            let example = help.split_once("Example").map_or("", |(_, example)| example);
            assert!(example.contains(&format!("slitpose {}", words.join(" "))), "{words:?}: {help}");
        }
        for verb in verbs {
            check(verb, &[words, &[verb.get_name()]].concat());
        }
    }
    check(&slitpose::commands::command(), &[]);
}

/// `table` with the numbers of `names` changed.
fn changed(table: &str, names: &[&str], change: impl Fn(f64) -> f64) -> String {
    with_changed(table, |name| names.contains(&name), change)
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
    format!("id,{}\n{}", POSE.join(","), (0..6).map(row).collect::<String>())
}

#[test]
fn poses_of_other_units_are_told() {
    let table = poses();
    let (t, r) = POSE.split_at(3);
    let model = |table: &str| slitpose!().run_with_input(["model", "wide", "--poses", "-"], table);
    assert_no_doubt(&model(&table), "as it is");
    let degrees = changed(&table, r, |rad| 100.0 * rad);
    let parts = ["row 1 (line 2), column `r", "radians", "are these degrees?"];
    model(&degrees).assert_said(1, &parts);
    let few_degrees = changed(&table, r, |rad| 20.0 * rad);
    model(&few_degrees).assert_said(0, &["column `r", "more than half a turn", "are these degrees?"]);
    let micrometres = changed(&table, t, |mm| mm * 1e3);
    model(&micrometres).assert_said(0, &["column `t", "leads 909 times", "are these micrometres?"]);
    let metres = changed(&table, t, |mm| mm * 1e-3);
    model(&metres).assert_said(0, &["column `t", "0.003 is the largest", "are these metres?"]);
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
    let bench = measured("bench", &format!("id,{}\n{turns}", POSE.join(",")));
    assert_no_doubt(&slitpose!().run_with_input(["identify", "bench", "--currents", "-"], &bench), "bench");
    let table = measured("wide", &poses());
    let identify = |table: &str| slitpose!().run_with_input(["identify", "wide", "--currents", "-"], table);
    assert_no_doubt(&identify(&table), "as it is");
    let currents: Vec<&str> =
        table.lines().next().expect("a header").split(',').filter(|name| name.starts_with("i_x")).collect();
    let microamperes = identify(&changed(&table, &currents, |a| a * 1e6));
    microamperes.assert_said(0, &["check that currents are in amperes", "times the emitter's"]);
    for (names, change, parts) in [
        (&POSE[..3], 1e-3, &["tx_mm, ty_mm and tz_mm are millimetres", "metres?"][..]),
        (&POSE[3..], 57.29577951308232, &["column `r", "are these degrees?"]),
        (&POSE[..3], -1.0, &["axes of the poses look exchanged or reversed"]),
    ] {
        println!("{names:?} times {change}");
        identify(&changed(&table, names, |number| change * number)).assert_said(1, parts);
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
    let degrees = changed(&by_time, &POSE[3..], f64::to_degrees);
    let mirrored = changed(&by_scan, &["ty_mm", "rx_rad", "rz_rad"], |number| -number);
    let (epoch, later) = (time(|s| s + 1.79e9), changed(&by_scan, &["seq"], |n| n + 5e3));
    let (header, rows) = by_scan.split_once('\n').expect("rows");
    let reversed = format!("{header}\n{}\n", rows.lines().rev().collect::<Vec<_>>().join("\n"));
    for (what, table, code, parts) in [
        ("epoch", epoch, 1, &["time_s runs from 1790000000.0", "that of the poses from 6.08", "epoch", "s late"][..]),
        ("milliseconds", time(|s| s * 1e3), 0, &["are these milliseconds?"]),
        ("rows", changed(&by_time, &["time_s"], |s| (s * 4000.0).floor()), 0, &["are these numbers of rows?"]),
        ("late", time(|s| s + 0.0205), 0, &["the reference seems 0.020", "s late", "subtract"]),
        ("early", time(|s| s - 1.55e-4), 0, &["the reference seems 0.00015", "s early", "add"]),
        ("metres", changed(&by_scan, &POSE[..3], |mm| mm * 1e-3), 0, &["are these metres?", "times as well"]),
        ("metres by time", changed(&by_time, &POSE[..3], |mm| mm * 1e-3), 0, &["are these metres?"]),
        ("mirrored", mirrored, 0, &["(tx_mm, −ty_mm, tz_mm)"]),
        ("other axes", changed(&by_scan, &["tx_mm"], |mm| mm + 50.0), 0, &["hardly better than a tool at rest"]),
        ("scans", later, 1, &["seq runs from 5000.0 to 6199.0", "from 0.0 to 1199.0"]),
        ("degrees", degrees, 1, &["column `r", "are these degrees?"]),
        ("reversed", reversed, 1, &["row 2", "column `seq`", "ascend"]),
    ] {
        println!("{what}");
        compare(&table).assert_said(code, parts);
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
        fs::write(&table, format!("time_s,{}\n{rows}", POSE.join(","))).expect("a file");
        let simulate = ["simulate", "--duration", "20ms", "--trajectory", &table, "--overwrite", "--output", &capture];
        let finished = slitpose!().run(simulate);
        println!("{times:?}");
        finished.assert_said(code, parts);
        assert!(code == 1 || !parts.is_empty() || finished.stderr.is_empty(), "{times:?}: {}", finished.stderr);
    }
}

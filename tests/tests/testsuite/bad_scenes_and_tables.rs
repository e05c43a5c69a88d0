//! Scene files, tables and command lines that are wrong: refused with a message that says where, what
//! stands there and what to do, with nothing on standard output. Of a table a field refuses its row only.

use slitpose_head::scene_file::BENCH;
use slitpose_tests::process::name_in;
use slitpose_tests::scenes::wide_with;
use slitpose_tests::slitpose;

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
        std::fs::write(&path, &scene).expect("scene");
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
        ("slots = [[0, 3], [1, 4], [2, 5], []]", "slots = [[0, 3], [1, 4], [2], []]", ["emitter 5", "no slot"]),
    ] {
        std::fs::write(&path, wide_with(&[(old, new)])).expect("scene");
        slitpose!().run(["scene", "check", &path]).assert_refused(1, &parts);
    }
}

#[test]
fn a_scene_that_is_not_there() {
    slitpose!()
        .run(["model", "no/such.toml", "--poses", "-"])
        .assert_refused(1, &["no/such.toml", "wide, fine, redundant, spacemouse, maglev, base, bench"]);
    for (typed, meant) in [("wied", "wide"), ("bas", "base"), ("bnech", "bench")] {
        slitpose!().run(["scene", "check", typed]).assert_refused(1, &[typed, &format!("did you mean `{meant}`?")]);
    }
    let refused = slitpose!().run(["run", "--device", "sim", "--scene", "bench", "--duration", "1ms"]);
    refused.assert_refused(1, &["bench", "[front_end]", "add one"]);
}

#[test]
fn tables_that_are_none() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("poses.csv");
    let name = path.to_str().expect("UTF-8 path");
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
        std::fs::write(&path, text).expect("table");
        slitpose!().run(["model", "wide", "--poses", name]).assert_refused(1, &[parts, &[name]].concat());
        slitpose!().run_with_input(["model", "wide", "--poses", "-"], text).assert_refused(1, parts);
    }
    let refused = slitpose!().run(["model", "wide", "--poses", "no/such.csv"]);
    refused.assert_refused(1, &["cannot read no/such.csv", "give a CSV file"]);
    let refused = slitpose!().run(["model", "wide", "--poses", "/dev/zero"]);
    refused.assert_refused(1, &["cannot read /dev/zero", "a device"]);
    slitpose!().run(["scene", "check", "/dev/zero"]).assert_refused(1, &["`/dev/zero`", "a device", "regular file"]);
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
        std::fs::write(&path, format!("{POSES}a,0,0,0,0,0,0\n{row}\nc,0,0,0,0,0,0\n")).expect("table");
        // To a file: what was written to standard output cannot be taken back.
        let finished = slitpose!().run(["model", "wide", "--poses", name, "--output", output_name]);
        finished.assert_refused(1, &[&parts[..], &[name, "row 2 (line 3)"]].concat());
        assert!(!output.exists(), "{row}: a table in spite of the error");
    }
    // Not UTF-8.
    std::fs::write(&path, [POSES.as_bytes(), b"\xff,0,0,0,0,0,0\n"].concat()).expect("table");
    slitpose!().run(["model", "wide", "--poses", name]).assert_refused(1, &[name, "row 1 (line 2)", "UTF-8"]);
}

#[test]
fn paths_that_do_not_advance() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = name_in(folder.path(), "path.csv");
    let name = path.as_str();
    let run = ["run", "--device", "sim", "--speed", "max", "--duration", "1ms", "--trajectory", name];
    slitpose!().run(run).assert_refused(1, &[name, "the motions are still, smooth, fast, contact", "cannot read"]);
    let misspelt = ["simulate", "--output", "-", "--trajectory", "contct"];
    slitpose!().run(misspelt).assert_refused(1, &["no motion is called contct (did you mean `contact`?)"]);
    std::fs::write(&path, "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0,0\n0,1,0,0,0,0,0\n")
        .expect("table");
    slitpose!().run(run).assert_refused(1, &[name, "time 0 s follows 0 s", "sort"]);
    std::fs::write(&path, "tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0\n").expect("table");
    slitpose!().run(run).assert_refused(1, &[name, "`time_s` is missing"]);
}

/// The workspace of `wide` reaches to 4 mm and 15°, 0.2618 rad.
#[test]
fn paths_far_beyond_the_workspace_are_told() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [path, capture] = ["path.csv", "path.mcap"].map(|name| folder.path().join(name).display().to_string());
    for (row, told) in [
        ("1,7,0,0.5,0", None),
        ("0,7,0,1,0", Some("row 2, column `ry_rad`: 1 leads 4 times")),
        ("0,20,0,1,0", Some("row 2, column `ty_mm`: 20 leads 5 times")),
    ] {
        std::fs::write(&path, format!("time_s,tx_mm,ty_mm,rx_rad,ry_rad,rz_rad,tz_mm\n0,0,0,0,0,0,0\n1,{row},0\n"))
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
        std::fs::write(path, text.replace("half_angle_deg = 55.0", &profile)).expect("written");
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
fn wrong_usage_ends_with_two() {
    for (arguments, part) in [
        (&[][..], "Usage"),
        (&["frobnicate"], "frobnicate"),
        (&["run", "--device", "sim", "--scene", "wide,base,wide"], "3 scenes for 1 boards"),
        (&["run", "--device", "sim", "--duration", "soon"], "such as 10s"),
        (&["run", "--device", "sim", "--duration", "0s"], "such as 10s"),
        (&["run", "--device", "sim", "--speed", "0"], "such as 1 or 0.5"),
        (&["run", "--device", "sim", "--format", "xml"], "ndjson"),
        (&["run", "--device", "sim", "--seed", "one"], "--seed"),
        (&["model", "wide"], "--poses"),
        (&["model", "wide", "--poses", "-", "--tier", "best"], "paper, exact"),
        (&["model", "wide", "--poses", "-", "--tolerance", "0"], "between 0 and 1"),
        (&["solve", "wide"], "--currents"),
        (&["replay"], "<FILE>"),
        (&["simulate"], "--output"),
    ] {
        slitpose!().run(arguments).assert_refused(2, &[part]);
    }
    slitpose!()
        .run(["run", "--patience", "0s", "--device", "/dev/no-such-board"])
        .assert_refused(1, &["/dev/no-such-board", "--device sim"]);
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

//! Work on several cores at once: `replay --jobs` of several captures, and `--jobs` of other commands, whose results do not
//! depend on it.

use std::fs;

use slitpose_tests::poses;
use slitpose_tests::process::text;
use slitpose_tests::slitpose;
use slitpose_tests::table::Table;

#[test]
fn captures_side_by_side_have_the_poses_of_their_own_replays() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let captures = ["a", "b", "c"].map(|name| folder.path().join(format!("{name}.capture")));
    for (seed, capture) in captures.iter().enumerate() {
        let seed = seed.to_string();
        let simulated = ["simulate", "--raw", "--output", text(capture), "--duration", "50ms", "--seed", &seed];
        slitpose!().run(simulated).done();
    }
    // One of them ends within a packet.
    let whole = fs::read(&captures[1]).expect("a capture");
    fs::write(&captures[1], &whole[..whole.len() - 70]).expect("a shorter capture");
    let own = captures.each_ref().map(|capture| slitpose!().run(["replay", text(capture), "--format", "csv"]));
    assert_eq!(own.each_ref().map(|own| own.code), [0, 3, 0]);

    for jobs in ["1", "2", "5"] {
        let poses = folder.path().join(jobs);
        let options = ["--jobs", jobs, "--output", text(&poses), "--format", "csv"];
        let all = slitpose!().run(["replay"].into_iter().chain(captures.iter().map(|path| text(path))).chain(options));
        assert_eq!(all.code, 3, "{}", all.stderr);
        assert!(all.stderr.contains("b.capture: "), "which one is damaged? {}", all.stderr);
        let table = Table::parse(std::str::from_utf8(&all.stdout).expect("UTF-8"));
        assert_eq!(table.rows().len(), captures.len());
        for (((row, capture), own), ended) in table.rows().zip(&captures).zip(&own).zip(["whole", "data_lost", "whole"])
        {
            assert_eq!([row.text("capture"), row.text("ended")], [text(capture), ended]);
            let name = capture.file_stem().expect("a name").to_str().expect("UTF-8");
            let written = fs::read(poses.join(format!("{name}.csv"))).expect("a file of poses");
            assert!(written == own.stdout, "{name}: other poses than those of its own replay, {jobs} at a time");
            let poses = written.iter().filter(|byte| **byte == b'\n').count() - 1;
            assert_eq!([row.number("scans"), row.number("converged")], [poses as f64; 2], "{name}");
        }
        assert_eq!(fs::read_dir(&poses).expect("a folder").count(), captures.len());
    }

    // Without a folder the table is all; what cannot be replayed does not keep the others from it.
    let missing = folder.path().join("d.capture");
    let some = slitpose!().run(["replay", text(&captures[0]), text(&missing), text(&captures[2]), "--jobs", "2"]);
    assert_eq!(some.code, 1, "{}", some.stderr);
    assert!(some.stderr.contains("d.capture: ") && some.stderr.contains("cannot read"), "{}", some.stderr);
    let table = Table::parse(std::str::from_utf8(&some.stdout).expect("UTF-8"));
    let ended: Vec<_> = table.rows().map(|row| row.text("ended").to_owned()).collect();
    assert_eq!(ended, ["whole", "failed", "whole"]);
}

#[test]
fn captures_side_by_side_are_refused_where_their_poses_would_be_mixed_or_lost() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("a.capture");
    slitpose!().run(["simulate", "--raw", "--output", text(&capture), "--duration", "5ms"]).done();
    let output = text(folder.path());
    for (arguments, parts) in [
        (&["--jobs", "2", "--format", "csv"][..], &["--output DIR", "--format"][..]),
        (&["--jobs", "2", "--output", output, "--format", "summary"], &["--output DIR", "--format"]),
        (&["--jobs", "0"], &["--jobs", "0"]),
        (&["--output", output], &["--jobs"]),
        (&["--jobs", "2", "--speed", "1"], &["--speed", "--jobs"]),
    ] {
        slitpose!().run(["replay", text(&capture)].iter().chain(arguments)).assert_refused(2, parts);
    }
    let twice = ["replay", text(&capture), text(&capture), "--jobs", "2", "--output", output];
    slitpose!().run(twice).assert_refused(2, &["a.ndjson", "twice"]);
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);
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

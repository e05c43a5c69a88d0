//! `--fault` in every command that has it. That each kind is noticed, costs no scan silently, and gives no wrong pose
//! unflagged, is shown by the study of the same name.

use std::fs;

use slitpose_head::faults::{KINDS, Kind};
use slitpose_tests::process::name_in;
use slitpose_tests::reference::data;
use slitpose_tests::slitpose;
use slitpose_tests::studies::faults::{Spans, needs_daemon};

#[test]
fn a_fault_without_patience_ends_the_run_as_the_table_says() {
    for kind in KINDS.iter().filter(|kind| needs_daemon(kind)) {
        let spec = format!("{}:from=100ms", kind.name);
        let run =
            ["run", "--device", "sim", "--speed", "max", "--duration", "3s", "--format", "none", "--fault", &spec];
        let finished = slitpose!().run(run);
        assert_eq!(finished.code, 1, "{spec}: {}", finished.stderr);
        assert!(kind.sees.contains("needs --patience, else the run fails"), "{}", kind.name);
    }
}

#[test]
fn the_exit_code_is_that_of_the_table() {
    for kind in KINDS.iter().filter(|kind| !needs_daemon(kind)) {
        let spec = Spans { from_s: 0.1, for_s: 0.3, every_s: 0.7, count: 1 }.spec(kind);
        let run = ["run", "--device", "sim", "--speed", "max", "--duration", "600ms", "--tier", "paper"];
        let finished = slitpose!().run(run.iter().chain(&["--format", "none", "--fault", &spec]));
        assert_eq!(finished.code, i32::from(kind.exit), "{spec}: {}", finished.stderr);
        assert!(finished.stderr.contains(&format!("faults are injected: {spec}")), "{}", finished.stderr);
    }
}

#[test]
fn a_faulty_capture_is_that_of_a_sound_one_with_the_fault_and_says_so() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [sound, faulty] = ["sound", "faulty"].map(|name| name_in(folder.path(), name));
    let common = ["simulate", "--duration", "300ms", "--tier", "paper", "--output"];
    let fault = ["--fault", "flip:rate=1e-4,from=50ms", "--fault", "occlude:cell=2,from=100ms"];
    assert_eq!(slitpose!().run(common.iter().chain(&[&*sound])).code, 0);
    assert_eq!(slitpose!().run(common.iter().chain(&[&*faulty]).chain(&fault)).code, 0);
    let replay = |arguments: &[&str]| {
        let finished = slitpose!().run(["replay", "--format", "ndjson"].iter().chain(arguments));
        assert_eq!(finished.code, 3, "{}", finished.stderr);
        String::from_utf8(finished.stdout).expect("UTF-8")
    };
    let [live, again] = [replay(&[&faulty]), replay(&[&[&*sound][..], &fault[..]].concat())];
    assert!(live == again, "{} and {} lines", live.lines().count(), again.lines().count());
    for text in ["flip:rate=1e-4,from=50ms", "occlude:cell=2,from=100ms"] {
        let told = live
            .lines()
            .filter(|line| line.contains(&format!("\"kind\":\"injected_fault\",\"fault\":\"{text}\"")))
            .count();
        assert_eq!(told, 1, "{text}");
    }
    assert!(fs::read(&sound).expect("written") != fs::read(&faulty).expect("written"));
}

/// Device time passes once, however often and in whichever order its scans come, and what is missing at its end is told.
#[test]
fn a_run_has_all_scans_of_its_duration_or_says_how_many_are_missing() {
    let run = |duration: &str, faults: &[&str]| {
        let mut arguments = vec!["run", "--device", "sim", "--speed", "max", "--duration", duration, "--tier", "paper"];
        arguments.extend(["--format", "csv", "--patience", "20s"]);
        arguments.extend(faults.iter().flat_map(|fault| ["--fault", fault]));
        let finished = slitpose!().run(arguments);
        (finished.stdout.iter().filter(|byte| **byte == b'\n').count() - 1, finished.code, finished.stderr)
    };
    for (fault, expected) in [("duplicate:rate=0.5", 3), ("stall:from=100ms,for=100ms", 0)] {
        let (found, code, said) = run("300ms", &[fault]);
        assert_eq!((found, code), (1200, expected), "{fault}: {said}");
    }
    let (found, code, said) = run("300ms", &["overrun:scans=8,from=299ms"]);
    assert!(code == 3 && found < 1200 && said.contains(&format!("{} scans missing", 1200 - found)), "{found}: {said}");
    // What is held back when the board stops is delivered when that time is over.
    let (found, code, said) = run("2s", &["stop:from=150ms", "stall:from=100ms,for=100ms"]);
    assert!(code == 3 && found > 600 && said.contains("the board on sim runs"), "{code}, {found}: {said}");
}

#[test]
fn what_cannot_be_injected_is_refused_as_wrong_usage() {
    for (arguments, parts) in [
        (&["run", "--device", "sim", "--fault", "oclude:cell=1"][..], &["`oclude`", "`occlude` is"][..]),
        (&["run", "--device", "sim", "--duration", "1s", "--fault", "occlude:cell=6"], &["occlude:cell=6", "0 to 5"]),
        (&["run", "--device", "/dev/null", "--fault", "flip"], &["--fault", "--device sim"]),
        (&["simulate", "--output", "/dev/null", "--fault", "hangup"], &["hangup", "--patience"]),
        (&["replay", "/dev/null", "--fault", "dead:emitter=1"], &["dead:emitter=1", "`simulate`"]),
    ] {
        slitpose!().run(arguments).assert_refused(2, parts);
    }
}

#[test]
fn the_list_has_all_of_them_and_one_is_explained() {
    let list = slitpose!().run(["faults"]).done();
    assert!(KINDS.iter().all(|kind| list.contains(kind.example) && list.contains(kind.what)));
    let one = slitpose!().run(["faults", "warm"]).done();
    for part in ["by       a difference up to 200K", "over     a time", "default 1s", "not in replay: "] {
        assert!(one.contains(part), "{one}");
    }
}

#[test]
fn the_table_of_the_guide_is_that_of_the_program() {
    let page = fs::read_to_string(data("../../host/guide/faults.md")).expect("the chapter");
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `") && !line.starts_with("| `--")).collect();
    let row = |kind: &Kind| format!("| `{}` | {} | {} | {} |", kind.example, kind.what, kind.sees, kind.exit);
    assert_eq!(rows, KINDS.iter().map(row).collect::<Vec<_>>());
}

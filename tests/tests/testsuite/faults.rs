//! Injected faults: each kind is noticed, costs no scan silently, and gives no wrong pose unflagged; and `--fault` does
//! the same in every command that has it.

use std::fs;

use slitpose_head::faults::{KINDS, Kind, Lasts};
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::TrajectoryKind;
use slitpose_model::Tier;
use slitpose_tests::faults::memory::Conditions;
use slitpose_tests::faults::{Report, Spans, kinds_in_memory, memory, needs_daemon, process, table};
use slitpose_tests::reference::data;
use slitpose_tests::slitpose;

const SEED: u64 = 20_180_718;

/// Faults whose errors may be so small that the redundancy of six cells does not reveal each of them, with the most
/// poses that were wrong and unflagged. What such a pose says of itself covers its error all the same.
const SUBTLE: [(&str, usize); 5] =
    [("noisy", 200), ("swap-electrodes", 5), ("swap-cells", 5), ("move", 100), ("warm", 5)];

fn conditions(spans: Spans) -> Conditions {
    let mut file = Box::new(WIDE.read().expect("shipped"));
    // Half of the shipped rate: packets, and so faults of the wire, are half as many.
    file.front_end.as_mut().expect("has one").frame_rate_hz = 2000.0;
    Conditions { file, tier: Tier::Paper, motion: TrajectoryKind::Smooth, seed: SEED, spans }
}

#[test]
fn where_there_is_no_fault_nothing_is_noticed() {
    let spans = Spans::of(1);
    let report = Report::of("none", &spans, false, &memory::run(&conditions(spans), ""));
    assert!(report.by.is_empty(), "seed {SEED}: {report:?}");
    assert_eq!((report.silently_lost, report.unflagged, report.flagged, report.out_of_order), (0, 0, 0, 0));
}

#[test]
fn each_fault_is_noticed_and_costs_nothing_silently() {
    let spans = Spans::of(1);
    let conditions = conditions(spans);
    let study = |kind: &Kind| {
        let trace = memory::run(&conditions, &spans.spec(kind));
        Report::of(kind.name, &spans, kind.lasts == Lasts::Instant, &trace)
    };
    let reports: Vec<_> = kinds_in_memory().map(study).collect();
    print!("seed {SEED}\n{}", table(&reports));
    for report in &reports {
        assert_eq!(report.detected, report.injected, "{report:?}");
        assert_eq!((report.silently_lost, report.out_of_order, report.beyond), (0, 0, 0), "{report:?}");
        let most = SUBTLE.iter().find(|(name, _)| report.fault == *name).map_or(0, |(_, most)| *most);
        assert!(report.unflagged <= most, "{report:?}");
        assert!(report.recovery().1.is_finite(), "{report:?}");
    }
}

#[test]
fn a_board_that_is_lost_is_found_again_and_what_it_took_meanwhile_is_counted() {
    let spans = Spans::of(1);
    for kind in KINDS.iter().filter(|kind| needs_daemon(kind)) {
        let (trace, code) = process::run(slitpose!(), kind, &spans, SEED);
        let report = Report::of(kind.name, &spans, kind.lasts == Lasts::Instant, &trace);
        assert_eq!((report.detected, report.injected), (1, 1), "{report:?}");
        assert_eq!((report.silently_lost, report.unflagged), (0, 0), "{report:?}");
        assert_eq!(code, i32::from(kind.exit), "{}", kind.name);
    }
}

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
    for kind in kinds_in_memory() {
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
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (sound, faulty) = (path("sound"), path("faulty"));
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

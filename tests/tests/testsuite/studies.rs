//! The studies in small: the example `study` runs them in full size. Times are not judged, since the machine may be as busy
//! as it likes. And `--fault` in every command that has it.
#![cfg(target_os = "linux")]

use std::fs;
use std::process::Stdio;

use nix::sys::signal::Signal;
use slitpose_head::faults::{KINDS, Kind};
use slitpose_tests::daemon::{Daemon, WallClock, scans};
use slitpose_tests::process::name_in;
use slitpose_tests::slitpose;
use slitpose_tests::studies::assert_kept;
use slitpose_tests::studies::faults::{Spans, needs_daemon};
use slitpose_tests::table::data;

macro_rules! kept {
    ($($name:ident: $words:literal;)*) => {
        $(#[test]
        fn $name() {
            assert_kept(slitpose!(), $words);
        })*
    };
}

kept! {
    cold_starts_find_the_pose_and_far_out_it_is_right_or_absent:
        "monte_carlo --seed 20180719 --only cold --count 600";
    errors_are_those_of_the_bound: "monte_carlo --seed 20180719 --only efficiency --count 1200";
    other_openings_give_poses_as_slits_do: "monte_carlo --seed 20180719 --only openings";
    each_fault_is_noticed_and_costs_nothing_silently: "faults --spans 1 --tier paper --rate-hz 2000";
    poses_reach_a_client_in_c: "latency --warm-up 0 --seconds 2 --untimed";
    // Seconds say little about growth: queues still fill for the first time.
    two_boards_lose_nothing: "storm --calm --boards 2 --duration 8s --pages 0 --most-growth-kib 16384";
    faulty_boards_and_a_daemon_that_is_struck_lose_nothing_silently:
        "storm --boards 2 --duration 4s --least-blows 3 --seed 3 --pause-s 0.5 --pages 0";
    // Twice in each manner.
    a_board_is_back_however_it_went: "replug --cycles 12 --seed 7 --within 15s --most-growth-kib 16384";
}

#[test]
fn a_wall_clock_that_is_set_is_told_with_what_follows() {
    let clock = WallClock::make();
    let folder = tempfile::tempdir().expect("temporary folder");
    let arguments = ["--config", "none", "--device", "sim", "--format", "none"];
    let daemon = Daemon::start(Some(&clock), slitpose!(), folder, arguments, Stdio::null());
    // Two seconds of the board's time, in which the daemon looks at its clock every 20 ms.
    let goes_on = || {
        let taken = |status: &serde_json::Value| scans(status).first().copied().unwrap_or(0);
        let before = taken(&daemon.status_when(|status| taken(status) > 0));
        daemon.status_when(|status| taken(status) > before + 8000);
    };
    goes_on();
    clock.set_ahead(-90_000_000_000);
    goes_on();
    clock.set_ahead(30_000_000_000);
    goes_on();
    let said = daemon.end_by(Signal::SIGINT).stderr;
    let back = "this computer's clock was set back by 90.0 s: `host_utc_ns` runs at half speed for 180.0 s";
    let ahead = "this computer's clock was set ahead by 120.0 s, or it was suspended: `host_utc_ns` jumps";
    for told in [back, ahead] {
        assert_eq!(said.matches(told).count(), 1, "{told}: {said}");
    }
}

#[test]
fn the_exit_code_is_that_of_the_table() {
    for kind in &KINDS {
        let spec = Spans { from_s: 0.1, for_s: 0.3, every_s: 10.0, count: 1 }.spec(kind);
        let duration = if needs_daemon(kind) { "3s" } else { "600ms" };
        let run = ["run", "--device", "sim", "--speed", "max", "--duration", duration, "--tier", "paper"];
        if needs_daemon(kind) {
            let without_patience = slitpose!().run(run.iter().chain(&["--format", "none", "--fault", &spec]));
            assert_eq!(without_patience.code, 1, "{spec}: {}", without_patience.stderr);
            assert!(kind.sees.contains("needs --patience, else the run fails"), "{}", kind.name);
        }
        // A busy machine may find a board that was lost late.
        let options = ["--format", "csv", "--patience", "60s", "--fault", &spec];
        let finished = slitpose!().run(run.iter().chain(&options));
        assert_eq!(finished.code, i32::from(kind.exit), "{spec}: {}", finished.stderr);
        let poses = finished.text().lines().count() - 1;
        // A quarter of what it would be without the fault, which acts for half of the time.
        assert!(poses > 600, "{spec}: {poses} poses: {}", finished.stderr);
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

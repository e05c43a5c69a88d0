//! The studies in small: the example `study` runs them in full size. Times are not judged, since the machine may be as busy
//! as it likes.
#![cfg(target_os = "linux")]

use std::process::Stdio;

use nix::sys::signal::Signal;
use slitpose_tests::daemon::{Daemon, WallClock, scans};
use slitpose_tests::slitpose;
use slitpose_tests::studies::assert_kept;

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
    a_moving_tool_is_no_worse_than_its_covariance: "monte_carlo --seed 20180719 --only moving --runs 6 --count 250";
    outliers_do_not_pass_for_poses: "monte_carlo --seed 20180719 --only outliers --count 1000";
    too_few_cells_are_not_made_up_for: "monte_carlo --seed 20180719 --only subsets --count 300";
    no_scan_costs_more_than_its_budget: "lit_cells --runs 2 --scans 250 --passes 1 --seed 20180720 --untimed";
    each_fault_is_noticed_and_costs_nothing_silently: "faults --spans 1 --tier paper --rate-hz 2000";
    poses_reach_a_client_in_c: "latency --warm-up 0 --seconds 2 --untimed";
    // Seconds say little about growth: queues still fill for the first time.
    two_boards_lose_nothing: "soak --boards 2 --duration 4s --every 200ms --most-growth-kib 16384";
    faulty_boards_and_a_daemon_that_is_struck_lose_nothing_silently:
        "storm --boards 2 --duration 4s --least-blows 3 --seed 3 --pause-s 0.5 --pages 0";
    // Twice in each manner.
    a_board_is_back_however_it_went: "replug --cycles 12 --seed 7 --within 15s --most-growth-kib 16384";
    what_a_killed_daemon_has_recorded_is_there: "kill --times 6 --seed 4 --boards 1 --at-once 2 --slack 1h";
    memory_is_bounded: "hour --duration 30s --untimed --by env";
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

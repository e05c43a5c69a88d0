//! Two faulty boards for some seconds: the storm in small; and a wall clock that is set.
#![cfg(target_os = "linux")]

use std::process::Stdio;
use std::time::Duration;

use nix::sys::signal::Signal;
use slitpose_tests::acceptance::daemon::{Daemon, scans};
use slitpose_tests::acceptance::storm::{Conditions, study};
use slitpose_tests::acceptance::wall_clock::WallClock;
use slitpose_tests::slitpose;
use slitpose_tests::verdicts::Verdicts;

#[test]
fn faulty_boards_and_a_daemon_that_is_struck_lose_nothing_silently() {
    let conditions = Conditions {
        boards: 2,
        duration: Duration::from_secs(4),
        least_blows: 3,
        seed: 3,
        pause_s: 0.5..1.5,
        live: None,
        disk: None,
        most_bytes: 160 << 20,
    };
    let report = study(slitpose!(), &conditions);
    println!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.assert_kept();
}

#[test]
fn a_wall_clock_that_is_set_is_told_with_what_follows() {
    let clock = WallClock::make();
    let folder = tempfile::tempdir().expect("temporary folder");
    let arguments = ["--config", "none", "--device", "sim", "--format", "none"];
    let daemon = Daemon::start_by(Some(&clock), slitpose!(), folder, arguments, Stdio::null());
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

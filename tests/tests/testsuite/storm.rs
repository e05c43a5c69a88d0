//! Two faulty boards for some seconds: the storm in small.
#![cfg(target_os = "linux")]

use std::time::Duration;

use slitpose_tests::acceptance::storm::{Conditions, study};
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

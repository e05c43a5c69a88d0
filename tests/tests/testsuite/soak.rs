//! Two boards for some seconds: the soak in small.
#![cfg(target_os = "linux")]

use std::time::Duration;

use slitpose_tests::acceptance::soak::{Conditions, study};
use slitpose_tests::slitpose;
use slitpose_tests::verdicts::Verdicts;

#[test]
fn two_boards_lose_nothing() {
    let conditions = Conditions {
        boards: 2,
        duration: Duration::from_secs(4),
        every: Duration::from_millis(200),
        // Seconds say little about growth: queues still fill for the first time.
        most_growth_bytes: f64::from(16 << 20),
    };
    let report = study(slitpose!(), &conditions);
    println!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.assert_kept();
    assert!(report.datagrams > 0, "the client was sent nothing");
}

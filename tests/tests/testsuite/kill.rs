//! Some daemons killed while they record: the long study in small.
#![cfg(target_os = "linux")]

use slitpose_tests::acceptance::kill::{Conditions, study};
use slitpose_tests::slitpose;
use slitpose_tests::verdicts::Verdicts;

#[test]
fn what_a_killed_daemon_has_recorded_is_there() {
    let conditions = Conditions { times: 6, seed: 4, boards: 1, at_once: 2 };
    let report = study(slitpose!(), &conditions);
    println!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.assert_kept();
    assert!(report.owing() > 0, "no daemon lived long enough: take another seed");
}

//! A board that goes in all manners and comes back, twice each: the long study in small.
#![cfg(target_os = "linux")]

use std::time::Duration;

use slitpose_tests::acceptance::replug::{Conditions, study};
use slitpose_tests::slitpose;
use slitpose_tests::verdicts::Verdicts;

#[test]
fn a_board_is_back_however_it_went() {
    let conditions = Conditions {
        cycles: 12,
        seed: 7,
        // A busy machine may take its time.
        within: Duration::from_secs(15),
        // So few cycles say little about memory.
        most_growth_bytes: f64::from(16 << 20),
    };
    let report = study(slitpose!(), &conditions);
    println!("{report}");
    let mut verdicts = Verdicts::default();
    report.check(&mut verdicts);
    verdicts.assert_kept();
}

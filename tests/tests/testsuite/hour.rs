//! Half a minute of device time, made and replayed: the long study in small, without a verdict on speed,
//! which other programs on this machine would share in.
#![cfg(target_os = "linux")]

use std::time::Duration;

use slitpose_tests::acceptance::hour::{Conditions, study};
use slitpose_tests::slitpose;
use slitpose_tests::verdicts::Verdicts;

#[test]
fn memory_is_bounded() {
    let conditions = Conditions { duration: Duration::from_secs(30), most_bytes: 64 << 20, wrapper: Vec::new() };
    let report = study(slitpose!(), &conditions);
    println!("{report}");
    let mut verdicts = Verdicts::default();
    report.check_memory(&mut verdicts);
    verdicts.assert_kept();
}

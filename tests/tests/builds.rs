//! A build gives the same poses each time. That debug and release builds give the same ones shows the
//! example `builds`, which needs both.

use slitpose_tests::acceptance::builds::Build;
use slitpose_tests::slitpose;

#[test]
fn a_build_gives_the_same_each_time() {
    let (first, second) = (Build::of(slitpose!()), Build::of(slitpose!()));
    println!("{first}");
    assert!(first.equals(&second), "{first} and {second}");
}

//! Poses of a board reach a control loop in C, with times. How soon is measured by the example of the
//! same name; here the machine may be as busy as it likes.

use slitpose_tests::latency::{Distribution, Plan, measure};
use slitpose_tests::slitpose;

#[test]
fn poses_reach_a_client_in_c() {
    let plan = Plan { warm_up: 0, poses: 8000, recorded: true, options: Vec::new() };
    let measurement = measure(slitpose!(), &plan);
    let (daemon, ways) = (&measurement.daemon, &measurement.ways);
    assert_eq!((daemon.code, daemon.stderr.lines().count()), (0, 1), "{}", daemon.stderr);
    assert!(daemon.stderr.starts_with("slitpose: poses at unix:"), "{}", daemon.stderr);
    assert_eq!(ways.len(), 8000);
    assert!(measurement.capture_bytes > 8000 * 30, "{} bytes recorded", measurement.capture_bytes);

    let in_order = ways.windows(2).all(|pair| pair[0].received.sequence < pair[1].received.sequence);
    assert!(in_order, "scans out of order");
    // A client that does not run for a hundredth of a second misses what its queue does not hold.
    let scans = ways[ways.len() - 1].received.sequence + 1 - ways[0].received.sequence;
    println!("{} poses of {scans} scans", ways.len());
    assert!(scans < 10_000, "{} poses of {scans} scans", ways.len());

    // The second ping goes out half a second after the first. A board that has to wait for a busy
    // host is no clock for a while.
    let timed = ways.iter().filter(|way| way.received.has_host_time).count();
    println!("{timed} with the host's time");
    assert!(timed > ways.len() / 2, "{timed} poses with the host's time");

    for way in ways {
        let received = way.received;
        let is_forward = way.written_ns <= received.arrival_ns
            && received.arrival_ns <= received.published_ns
            && received.published_ns <= received.received_ns;
        assert!(is_forward, "{way:?}");
    }
    let total = Distribution::of(ways.iter().map(|way| way.received.received_ns - way.written_ns));
    println!("{}\n{total}", Distribution::HEADING);
    assert!(total.quantile_us(0.5) < 1e6, "{total}");
}

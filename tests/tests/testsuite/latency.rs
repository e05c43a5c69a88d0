//! Poses of a board reach a control loop in C, with times. How soon is measured by the example of the
//! same name; here the machine may be as busy as it likes.

use slitpose_tests::latency::{Distribution, Plan, measure};
use slitpose_tests::slitpose;

#[test]
fn poses_reach_a_client_in_c() {
    let plan = Plan { warm_up: 0, poses: 8000, recorded: true, options: Vec::new() };
    let measurement = measure(slitpose!(), &plan);
    let (daemon, ways) = (&measurement.daemon, &measurement.ways);
    // 3 if it did not run for a while and left scans out.
    assert_eq!(daemon.code, if daemon.stderr.contains("were not solved") { 3 } else { 0 }, "{}", daemon.stderr);
    assert!(daemon.stderr.starts_with("slitpose: poses at unix:"), "{}", daemon.stderr);
    assert_eq!(ways.len(), 8000);
    assert!(measurement.capture_bytes > 8000 * 30, "{} bytes recorded", measurement.capture_bytes);

    let in_order = ways.windows(2).all(|pair| pair[0].received.sequence < pair[1].received.sequence);
    assert!(in_order, "scans out of order");
    // What a client misses that does not run for a while is in the datagrams that it did not take.
    let (first, last) = (ways[0].received, ways[ways.len() - 1].received);
    let scans = last.sequence + 1 - first.sequence;
    // A daemon that does not run for a while passes scans over, and says so.
    let is_whole = ways
        .windows(2)
        .map(|pair| (pair[0].received, pair[1].received))
        .all(|(before, after)| after.is_behind || after.sequence - before.sequence == after.datagram - before.datagram);
    assert!(is_whole, "a scan without a datagram: {}", daemon.stderr);

    // A machine so busy that the board cannot keep its pace makes a clock of it that is none; but the first
    // ping is answered in any case.
    let timed = ways.iter().filter(|way| way.received.taken_ns.is_some()).count();
    println!("{} poses of {scans} scans, {timed} with the host's time", ways.len());
    assert!(timed > 0, "no pose with the host's time");

    for way in ways {
        let received = way.received;
        let is_forward = received.taken_ns.is_none_or(|taken_ns| taken_ns < received.arrival_ns)
            && way.written_ns <= received.arrival_ns
            && received.arrival_ns <= received.published_ns
            && received.published_ns <= received.received_ns;
        assert!(is_forward, "{way:?}");
    }
    let total = Distribution::of(ways.iter().map(|way| way.received.received_ns - way.written_ns));
    println!("{}\n{total}", Distribution::HEADING);
}

//! Poses of a board reach a control loop in C, with times. How soon is measured by the example of the
//! same name; here the machine may be as busy as it likes.

use slitpose_tests::latency::{Distribution, Plan, measure};
use slitpose_tests::slitpose;
use slitpose_tests::terminal::FRAME_RATE_HZ;

#[test]
fn poses_reach_a_client_in_c() {
    let plan = Plan { warm_up: 0, poses: 8000, recorded: true, options: Vec::new() };
    let measurement = measure(slitpose!(), &plan);
    let (daemon, ways) = (&measurement.daemon, &measurement.ways);
    assert_eq!(daemon.code, 0, "{}", daemon.stderr);
    assert!(daemon.stderr.starts_with("slitpose: poses at unix:"), "{}", daemon.stderr);
    assert_eq!(ways.len(), 8000);
    assert!(measurement.capture_bytes > 8000 * 30, "{} bytes recorded", measurement.capture_bytes);

    let in_order = ways.windows(2).all(|pair| pair[0].received.sequence < pair[1].received.sequence);
    assert!(in_order, "scans out of order");
    // What a client misses that does not run for a while is in the datagrams that it did not take.
    let (first, last) = (ways[0].received, ways[ways.len() - 1].received);
    let scans = last.sequence + 1 - first.sequence;
    let is_whole =
        ways.iter().all(|way| way.received.sequence - first.sequence == way.received.datagram - first.datagram);
    assert!(is_whole, "a scan without a datagram: {}", daemon.stderr);

    // The second ping goes out half a second after the first. A board that cannot keep up, because the
    // machine is busy, is no clock.
    let pace = scans as f64 / FRAME_RATE_HZ / ((last.received_ns - first.received_ns) as f64 * 1e-9);
    let timed = ways.iter().filter(|way| way.received.has_host_time).count();
    println!("{} poses of {scans} scans at {pace:.3} of their pace, {timed} with the host's time", ways.len());
    assert!(timed > ways.len() / 2 || pace < 0.99, "{timed} poses with the host's time");

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

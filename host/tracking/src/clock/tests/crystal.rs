//! Boards that report a crystal: the gain in uncertainty, and boards whose rate contradicts the report.

use super::*;

/// A crystal whose rate and wander are near their bounds: 190 ppm at most, and 0.24 ppm a second.
const AT_ITS_BOUNDS: Link = Link { rate: 170e-6, wander: 20e-6, wander_period_s: 523.6, ..USB };

#[test]
fn a_crystal_makes_every_link_better_known_and_truth_stays_within_the_uncertainty() {
    let links = [
        ("USB", USB),
        ("USB, +100 ppm", Link { rate: 100e-6, ..USB }),
        ("USB, -100 ppm", Link { rate: -100e-6, ..USB }),
        ("USB, crystal at its bounds", AT_ITS_BOUNDS),
        ("USB, a third of the pings lost", Link { pings_lost: 0.33, ..USB }),
        ("USB, 2 ms more to the host", Link { up_ns: 2e6, ..USB }),
        ("USB, 2 ms more to the board", Link { down_ns: 2e6, ..USB }),
        ("USB, busy host", Link { jitter_ns: 3e6, stalls: 0.02, ..USB }),
        ("UART", UART),
        ("quick", Link { up_ns: 2e3, down_ns: 2e3, jitter_ns: 1e3, frame_ns: 0.0, stalls: 0.0, ..AT_ITS_BOUNDS }),
    ];
    println!("{HEAD}");
    for (seed, (name, link)) in (1..).zip(links) {
        let [oscillator_ns, crystal_ns] = [ClockSource::Internal, ClockSource::Crystal].map(|source| {
            let trial = Trial::with_source(Some(source), &link, seed, 60.0);
            println!("{}", trial.row(&format!("{name}; {source}")));
            assert!(!trial.contradicts_crystal, "seed {seed}, {name}");
            assert!(trial.unknown_s.iter().all(|&truth_s| truth_s < 1.5), "seed {seed}, {name}");
            trial.uncertainties.value_at_quantile(0.5) as f64
        });
        // No fit can know better than half the least round trip.
        let least_ns = 0.5 * (link.up_ns + link.down_ns);
        assert!(crystal_ns >= least_ns && crystal_ns < 0.98 * oscillator_ns, "seed {seed}, {name}");
    }
}

#[test]
fn a_crystal_that_is_off_by_a_per_cent_is_noticed_and_no_time_is_wrong() {
    for (seed, rate) in (20..).zip([0.01, -0.01]) {
        for (name, link) in [("USB", USB), ("UART", UART), ("quick", QUICK)] {
            // The trial fails at the first time with an error above its uncertainty.
            let trial = Trial::with_source(Some(ClockSource::Crystal), &Link { rate, ..link }, seed, 20.0);
            println!("{HEAD}\n{}", trial.row(&format!("{name}, {rate}")));
            assert!(trial.contradicts_crystal, "seed {seed}, {name}, {rate}");
            // After the contradiction no time is known until two pongs agree within an oscillator's bounds.
            let (without, last_s) = (trial.unknown_s.len(), trial.unknown_s.iter().copied().fold(0.0, f64::max));
            assert!(without > 1000 && last_s < 2.0, "seed {seed}, {name}, {rate}: {without} until {last_s} s");
        }
    }
}

#[test]
fn ntp_that_corrects_the_host_faster_than_a_crystal_explains_is_noticed_within_3_s() {
    const SINCE_S: f64 = 20.0;
    for (seed, (name, link)) in (30..).zip([("USB", USB), ("UART", UART), ("quick", QUICK)]) {
        let link = Link { slew: Some((SINCE_S * 1e9, 500e-6)), ..link };
        let mut fit = ClockFit::new(TICK_HZ);
        let (mut scans, mut last_wrong_s, mut most_ns) = (0, 0.0_f64, 0.0_f64);
        link.run(seed, 60.0, |seen, restarted| match seen {
            Seen::Pong { asked, tick, at } => {
                fit.answered(asked, tick, at);
                fit.set_source(ClockSource::Crystal);
            }
            Seen::Batch { tick, last, at } => {
                fit.arrived(last, at);
                for scan in Link::scans(tick) {
                    let truth_ns = link.truth_of_tick_ns(scan, REFERENCE_TICKS, restarted);
                    let Some(time) = fit.time_of(scan, REFERENCE_TICKS) else { continue };
                    scans += usize::from(truth_ns > SINCE_S * 1e9);
                    let error_ns = (time.monotonic_ns as f64 - link.monotonic_ns(truth_ns)).abs();
                    let beyond_ns = error_ns - time.uncertainty_ns as f64;
                    // Clocks are read in whole nanoseconds, and truth is known to one at 5e12.
                    if beyond_ns > 2.0 {
                        (last_wrong_s, most_ns) = (truth_ns / 1e9, most_ns.max(beyond_ns));
                    }
                }
            }
        });
        println!("{name}: wrong by up to {:.0} us beyond the uncertainty, until {last_wrong_s:.1} s", most_ns / 1e3);
        assert!(fit.contradicts_crystal(), "seed {seed}, {name}");
        assert!(last_wrong_s < SINCE_S + 3.0, "seed {seed}, {name}: {last_wrong_s} s");
        assert!(scans > 150_000, "seed {seed}, {name}: {scans} scans with a time");
    }
}

#[test]
fn only_a_crystal_narrows_the_bounds() {
    let times = |source: Option<ClockSource>| {
        let mut fit = ClockFit::new(TICK_HZ);
        let mut times = Vec::new();
        USB.run(40, 10.0, |seen, _| match seen {
            Seen::Pong { asked, tick, at } => {
                fit.answered(asked, tick, at);
                source.into_iter().for_each(|source| fit.set_source(source));
            }
            Seen::Batch { tick, last, at } => {
                fit.arrived(last, at);
                times.extend(Link::scans(tick).map(|scan| fit.time_of(scan, REFERENCE_TICKS)));
            }
        });
        times
    };
    let unknown = times(None);
    for source in [ClockSource::Internal, ClockSource::CrystalFailed] {
        assert_eq!(times(Some(source)), unknown, "{source:?}");
    }
    assert_ne!(times(Some(ClockSource::Crystal)), unknown);
}

#[test]
fn a_board_that_restarts_has_the_widest_bounds_until_it_reports_a_crystal() {
    const SECOND_NS: u64 = 1_000_000_000;
    let mut fit = ClockFit::new(TICK_HZ);
    fit.set_source(ClockSource::Crystal);
    assert_eq!(follow(&mut fit, (SECOND_NS, 9_000_000), 1.0, 10), 1000);
    // It restarts without its crystal, and sends scans before its first status.
    assert_eq!(follow(&mut fit, (12 * SECOND_NS, 0), 0.99, 5), 1000);
    assert!(!fit.contradicts_crystal());
    // The first report since a restart keeps the points; a report of another source shows another restart.
    fit.set_source(ClockSource::CrystalFailed);
    let tick = (5.0 * 0.99 * f64::from(TICK_HZ)) as u64;
    assert!(fit.time_of(tick, 0.0).is_some());
    fit.set_source(ClockSource::Crystal);
    assert_eq!(fit.time_of(tick, 0.0), None);
    assert_eq!(follow(&mut fit, (17 * SECOND_NS, tick), 1.0, 5), 1000);
    assert!(!fit.contradicts_crystal());
}

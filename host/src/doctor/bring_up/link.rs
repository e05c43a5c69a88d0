//! Link and start; supply and temperature.

use slitpose_protocol::{Level, Status};

use super::bench::{Bench, BenchError, sample};
use super::sampling;
use crate::doctor::{link, measurement};
use slitpose_head::finding::Finding;
use slitpose_tracking::link::start_findings;

/// Duration of the measurement, seconds.
const DURATION_S: f64 = 2.0;

/// What was counted in `DURATION_S`.
#[derive(Clone, Copy, Debug)]
struct Counted {
    scans: usize,
    missing: u64,
    elapsed_s: f64,
    scheduled_hz: f64,
    lost_on_board: u64,
    overruns: u32,
}

pub(super) fn link(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let (mut board, info) = bench.connect()?;
    let (mut findings, _) = link::judge(&info);
    let configuration = sampling::at(bench.schedule()?, Level(0));
    let scheduled_hz = configuration.schedule.frame_rate_hz();
    let before = board.status()?;
    let sampling = sample(&mut board, configuration, (DURATION_S * scheduled_hz) as usize)?;
    let after = board.status()?;
    findings.extend(start_findings(after.clock, after.settings));
    let lost = |status: &Status| status.scans_dropped + status.scans_lost;
    findings.extend(judge(&Counted {
        scans: sampling.scans.len(),
        missing: sampling.missing,
        elapsed_s: sampling.elapsed_s,
        scheduled_hz,
        lost_on_board: lost(&after).saturating_sub(lost(&before)),
        overruns: after.adc_overruns.saturating_sub(before.adc_overruns),
    }));
    Ok(findings)
}

fn judge(counted: &Counted) -> [Finding; 2] {
    let &Counted { scans, missing, elapsed_s, scheduled_hz, lost_on_board, overruns } = counted;
    let rate_hz = scans as f64 / elapsed_s;
    let text = format!("{rate_hz:.0} frames/s by the host's clock, {scheduled_hz:.0} by the schedule; 5 % allowed");
    let rate = if (rate_hz / scheduled_hz - 1.0).abs() <= measurement::RATE_SLACK {
        Finding::ok("frame rate", text)
    } else {
        // An emulated board, or a busy host, and no fault of the board's clock that keeps poses from coming.
        let next_step = "lower the load of this host; if it stays so, look at the board's clock (crystal, its load)";
        Finding::warning("frame rate", text, next_step)
    };
    let text =
        format!("{scans} frames, {missing} missing; the board counts {lost_on_board} lost and {overruns} overruns");
    let losses = if missing == 0 && overruns == 0 {
        Finding::ok("frames", text)
    } else if lost_on_board + u64::from(overruns) > 0 {
        Finding::failed(
            "frames",
            text,
            "the host did not read in time, its USB port suspends, or the MCU is overloaded: lower the load of both",
        )
    } else {
        Finding::failed("frames", text, "change cable or hub; data lines of USB as short as possible, side by side")
    };
    [rate, losses]
}

pub(super) fn supply(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let status = bench.connect()?.0.status()?;
    Ok(judge_supply(&status).into())
}

fn judge_supply(status: &Status) -> [Finding; 2] {
    let volts = status.supply_v;
    let range = measurement::SUPPLY_V;
    let text = format!("V_DDA {volts:.3} V, expected {:.3} to {:.3} V", range.start(), range.end());
    // NaN is in no range.
    let supply = if range.contains(&volts) {
        Finding::ok("supply", text)
    } else {
        let next_step = "measure 3.3 V and V_DDA: regulator, cable, a short or a load that does not \
                         belong there; currents scale with V_DDA";
        Finding::failed("supply", text, next_step)
    };
    let celsius = status.temperature_k - 273.15;
    let text = format!("MCU at {celsius:.1} C, expected -40 to 85 C");
    let temperature = if measurement::TEMPERATURE_K.contains(&status.temperature_k) {
        Finding::ok("temperature", text)
    } else {
        Finding::failed(
            "temperature",
            text,
            "if the MCU is hot, switch the supply off at once: one of its pins drives against another output",
        )
    };
    [supply, temperature]
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade::{self, Failed, Ok, Warning};

    #[test]
    fn rates_and_losses_are_judged_apart() {
        let good =
            Counted { scans: 8_000, missing: 0, elapsed_s: 2.0, scheduled_hz: 4_000.0, lost_on_board: 0, overruns: 0 };
        let grades = |counted| judge(&counted).map(|finding| finding.grade);
        assert_eq!(grades(good), [Ok, Ok]);
        assert_eq!(grades(Counted { elapsed_s: 2.2, ..good }), [Warning, Ok]);
        assert_eq!(grades(Counted { missing: 1, ..good }), [Ok, Failed]);
        assert_eq!(grades(Counted { overruns: 1, ..good }), [Ok, Failed]);
        let lossy = judge(&Counted { missing: 4, lost_on_board: 4, ..good });
        assert!(lossy[1].next_step.as_ref().is_some_and(|step| step.contains("host")), "{lossy:?}");
    }

    #[test]
    fn a_supply_of_three_volts_is_too_low() {
        let good = super::super::safety::tests::status();
        let status = |supply_v, temperature_k| Status { supply_v, temperature_k, ..good };
        let grades = |supply_v, temperature_k| -> [Grade; 2] {
            judge_supply(&status(supply_v, temperature_k)).map(|finding| finding.grade)
        };
        assert_eq!(grades(3.3, 300.0), [Ok, Ok]);
        assert_eq!(grades(3.0, 300.0), [Failed, Ok]);
        assert_eq!(grades(f32::NAN, f32::NAN), [Failed, Failed]);
        assert_eq!(grades(3.3, 400.0), [Ok, Failed]);
    }
}

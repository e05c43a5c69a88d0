//! Settling: each cell is sampled ever earlier after its emitter was switched on, and a first-order rise is fitted.
//!
//! A front end of first order with the time constant τ behind a drive that is late by d gives, x after switching on,
//!
//! ```text
//! I(x) = I·(1 − exp(−(x − d)/τ)),   ln(1 − I(x)/I) = (d − x)/τ,
//! ```
//!
//! a straight line in x. I is the light long after.

use slitpose_model::Pair;
use slitpose_protocol::{Level, Schedule};

use super::bench::{Bench, BenchError, least_settling_ticks, sample};
use super::lighting;
use slitpose_head::finding::Finding;

/// Scans of each instant.
const SCANS: usize = 150;

/// Instants, from the least that the board allows to that of the scene, in equal ratios; and the settling time of the
/// light long after, in that of the scene.
const INSTANTS: i32 = 10;
const LONG_AFTER: u32 = 3;

/// Least instant that is of use, as a share of the scene's settling time, for boards that allow any.
const EARLIEST: u32 = 24;

/// Shares of the light still to come that are fitted: before, drive and stages of second order bend the line; after, noise
/// does (150 words know the light to 6e-5).
const TO_COME: std::ops::RangeInclusive<f64> = 3e-3..=0.7;

/// What is left of a full-scale step after settling, codes: the scene's 13 µs leave that much of 4 031 codes
/// (`firmware/README.md`, bandwidth and settling).
const LEFT_CODES: f64 = 0.3;

/// Largest relative difference of the time constant from the scene's: the spread of C_f with its layout, and of the
/// detector.
const TAU_TOLERANCE: f64 = 0.3;

/// Settling times in those of the scene: enough, and somewhat too long.
const ENOUGH: f64 = 1.1;
const LONG: f64 = 1.3;

/// Least share of the scene's light of a cell that is to be judged.
const LIT: f64 = 0.15;

/// Light of a cell at an instant after its emitter was switched on.
#[derive(Clone, Copy, Debug)]
struct Instant {
    after_s: f64,
    light_a: f64,
}

/// A first-order rise.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rise {
    time_constant_s: f64,
    delay_s: f64,
}

pub(super) fn take(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let base = Schedule { oversampling: 1, ..bench.schedule()? };
    let settling_s = f64::from(base.settling_ticks) / f64::from(base.tick_hz);
    let longest = Schedule { settling_ticks: LONG_AFTER * base.settling_ticks, ..base.clone() };
    let mut configuration = lighting::at(lighting::alone(&longest), Level::NOMINAL);
    let least = least_settling_ticks(&mut board, &configuration)?.max(base.settling_ticks / EARLIEST);
    let settled: Vec<f64> =
        sample(&mut board, configuration.clone(), SCANS)?.all_light().iter().map(Pair::total_a).collect();
    let mut instants = vec![Vec::new(); settled.len()];
    for k in 0..INSTANTS {
        let share = f64::from(k) / f64::from(INSTANTS - 1);
        let ratio = f64::from(base.settling_ticks) / f64::from(least);
        configuration.schedule.settling_ticks = (f64::from(least) * ratio.powf(share)).round() as u32;
        let sampling = sample(&mut board, configuration.clone(), SCANS)?;
        for (cell, instants) in instants.iter_mut().enumerate() {
            let ticks = sampling.schedule.settling_ticks + cell as u32 * sampling.schedule.conversion_ticks;
            let after_s = f64::from(ticks) / f64::from(sampling.schedule.tick_hz);
            instants.push(Instant { after_s, light_a: sampling.light(cell).total_a() });
        }
    }
    let scene_tau_s = bench.scene.front_end.map_or(0.0, |front_end| front_end.time_constant_s);
    let full_scale_codes = sampled_codes(bench);
    let asked = Asked { settling_s, time_constant_s: scene_tau_s, full_scale_codes };
    let is_lit = |cell: usize| settled[cell] >= LIT * expected.own[cell].total_a();
    Ok((0..settled.len())
        .map(|cell| judge(cell, is_lit(cell).then(|| fit(&instants[cell], settled[cell])), &asked))
        .collect())
}

/// Codes from no light to full scale, by the scene.
fn sampled_codes(bench: &Bench<'_>) -> f64 {
    bench.scene.front_end.map_or(0.0, |front_end| f64::from(1_u32 << front_end.adc_bits))
}

/// What the scene says of its front end.
#[derive(Clone, Copy, Debug)]
struct Asked {
    settling_s: f64,
    time_constant_s: f64,
    full_scale_codes: f64,
}

/// The line through ln(1 − I(x)/I) with weights (1 − I(x)/I)², as the noise of the light is the same at all instants;
/// `None` if fewer than two instants show light still to come.
fn fit(instants: &[Instant], settled_a: f64) -> Option<Rise> {
    let points: Vec<(f64, f64, f64)> = instants
        .iter()
        .map(|instant| (instant.after_s, 1.0 - instant.light_a / settled_a))
        .filter(|(_, to_come)| TO_COME.contains(to_come))
        .map(|(after_s, to_come)| (after_s, to_come.ln(), to_come * to_come))
        .collect();
    let sum = |term: fn(&(f64, f64, f64)) -> f64| points.iter().map(term).sum::<f64>();
    let weight = sum(|&(_, _, w)| w);
    let (x, y) = (sum(|&(x, _, w)| w * x) / weight, sum(|&(_, y, w)| w * y) / weight);
    let slope = points.iter().map(|(px, py, w)| w * (px - x) * (py - y)).sum::<f64>()
        / points.iter().map(|(px, _, w)| w * (px - x) * (px - x)).sum::<f64>();
    let rise = Rise { time_constant_s: -slope.recip(), delay_s: x - y / slope };
    (points.len() >= 2 && slope < 0.0 && slope.is_finite()).then_some(rise)
}

/// `rise`: `None` for a dark cell, `Some(None)` for one that has settled before the first instant.
fn judge(cell: usize, rise: Option<Option<Rise>>, asked: &Asked) -> Finding {
    let micro = |seconds: f64| seconds * 1e6;
    let Some(rise) = rise else {
        let text = format!("cell {cell}: no light: see step emitters");
        return Finding::failed("settling", text, "take step emitters first");
    };
    let Some(Rise { time_constant_s, delay_s }) = rise else {
        let text =
            format!("cell {cell}: settled, or without a rise that a line fits, at every instant the board allows");
        return Finding::warning(
            "settling",
            text,
            "look at the amplifier's output with an oscilloscope: is C_f fitted?",
        );
    };
    let suffices_s = delay_s + time_constant_s * (asked.full_scale_codes / LEFT_CODES).ln();
    let text = format!(
        "cell {cell}: time constant {:.2} us, {:.2} us by the scene; delay {:.2} us; {:.1} us would suffice, {:.1} us are set",
        micro(time_constant_s),
        micro(asked.time_constant_s),
        micro(delay_s),
        micro(suffices_s),
        micro(asked.settling_s)
    );
    let off = time_constant_s / asked.time_constant_s - 1.0;
    let share = suffices_s / asked.settling_s;
    if share > LONG || off > TAU_TOLERANCE {
        let next_step = format!(
            "settle longer (front_end.settling_s = {:.1}e-6), or look for a larger R_f or C_f; then correct \
             front_end.time_constant_s",
            micro(suffices_s)
        );
        Finding::failed("settling", format!("{text}: the front end is slow"), next_step)
    } else if share > ENOUGH {
        Finding::warning("settling", text, format!("set front_end.settling_s = {:.1}e-6", micro(suffices_s)))
    } else if off < -TAU_TOLERANCE {
        let next_step = "is C_f fitted? look for ringing; noise grows with the bandwidth";
        Finding::warning("settling", format!("{text}: the front end is faster than the scene says"), next_step)
    } else {
        Finding::ok("settling", text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    const ASKED: Asked = Asked { settling_s: 13e-6, time_constant_s: 1.36e-6, full_scale_codes: 4096.0 };

    /// A first-order rise, sampled from `first_s` on.
    fn instants(time_constant_s: f64, delay_s: f64, first_s: f64) -> Vec<Instant> {
        let light_a = |after_s: f64| 6.8e-6 * (1.0 - (-((after_s - delay_s) / time_constant_s).max(0.0)).exp());
        (0..10)
            .map(|k| first_s + 0.7e-6 * f64::from(k * k) / 5.0)
            .map(|after_s| Instant { after_s, light_a: light_a(after_s) })
            .collect()
    }

    #[test]
    fn time_constant_and_delay_are_found_for_early_and_late_cells() {
        for (time_constant_s, delay_s, first_s) in
            [(1.36e-6, 0.0, 0.7e-6), (1.36e-6, 0.2e-6, 0.7e-6), (3.4e-6, 0.1e-6, 5e-6), (1.0e-6, 0.0, 4.5e-6)]
        {
            let rise = fit(&instants(time_constant_s, delay_s, first_s), 6.8e-6).unwrap();
            assert!((rise.time_constant_s / time_constant_s - 1.0).abs() < 1e-9, "{rise:?}");
            assert!((rise.delay_s - delay_s).abs() < 1e-12, "{rise:?}");
        }
        assert_eq!(fit(&instants(0.05e-6, 0.0, 0.7e-6), 6.8e-6), None);
    }

    #[test]
    fn slow_and_fast_front_ends_are_named_with_the_time_that_would_do() {
        let judged = |time_constant_s| judge(2, Some(Some(Rise { time_constant_s, delay_s: 0.0 })), &ASKED);
        assert_eq!(judged(1.36e-6).grade, Grade::Ok);
        assert_eq!(judged(1.6e-6).grade, Grade::Warning);
        assert_eq!(judged(0.7e-6).grade, Grade::Warning);
        let slow = judged(3.4e-6);
        assert!(slow.grade == Grade::Failed && slow.text.contains("32.4 us would suffice"), "{slow}");
        assert!(slow.to_string().contains("settling_s = 32.4e-6"), "{slow}");
        assert_eq!(judge(0, None, &ASKED).grade, Grade::Failed);
        assert_eq!(judge(0, Some(None), &ASKED).grade, Grade::Warning);
    }
}

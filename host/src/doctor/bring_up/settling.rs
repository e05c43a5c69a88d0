//! Settling: each cell is sampled ever later after its emitter was switched on, until next to nothing is still to come.
//!
//! What is still to come of a step through several poles falls ever more like exp(−t/τ) of the slowest one: its
//! logarithm becomes a straight line. The line is fitted to the last decades that noise leaves, and read where 0.3
//! codes of full scale are left. With one pole that is exact; with those of `firmware/README.md` and a detector of 1.0 µs
//! it is 0.2 µs late of 13.4 µs.

use anyhow::Result;
use slitpose_model::Pair;
use slitpose_protocol::{Level, Schedule};

use super::bench::{Bench, least_settling_ticks, sample};
use super::sampling::{self, LIT};
use crate::doctor::named;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::Warning;

/// Scans of each instant, and of the light long after: its error is in the remainder at all instants.
const SCANS: usize = 300;
const SETTLED_SCANS: usize = 1_200;

/// Instants in equal ratios, from the least that the board allows to the last; the last and that of the light long after,
/// in the scene's settling time.
const INSTANTS: i32 = 18;
const LAST: u32 = 2;
const LONG_AFTER: u32 = 3;

/// Least instant that is of use, as a share of the scene's settling time, for boards that allow any.
const EARLIEST: u32 = 24;

/// Shares of the light still to come that are fitted: before, faster poles bend the line; after, noise does (300 words
/// know the light to 5e-5).
const TO_COME: std::ops::RangeInclusive<f64> = 5e-4..=0.03;

/// Noise of a share still to come; and the part of the share that faster poles make, which keeps the first instants of
/// the line from deciding alone.
const SHARE_NOISE: f64 = 5e-5;
const BEND: f64 = 0.05;

/// What is left of a full-scale step after settling, codes: the scene's 13 µs leave that much of 4 031 codes
/// (`firmware/README.md`, bandwidth and settling).
const LEFT_CODES: f64 = 0.3;

/// Largest relative difference from the scene's time constant: the spread of C_f with its layout, and of the detector.
const TAU_TOLERANCE: f64 = 0.3;

/// Settling times in those of the scene: enough, and somewhat too long.
const ENOUGH: f64 = 1.1;
const LONG: f64 = 1.3;

/// Light of a cell at an instant after its emitter was switched on.
#[derive(Clone, Copy, Debug)]
struct Instant {
    after_s: f64,
    light_a: f64,
}

pub(super) fn take(bench: &mut Bench) -> Result<Vec<Finding>> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let base = Schedule { oversampling: 1, ..bench.schedule()? };
    let settling_s = f64::from(base.settling_ticks) / f64::from(base.tick_hz);
    let longest = Schedule { settling_ticks: LONG_AFTER * base.settling_ticks, ..base.clone() };
    let mut configuration = sampling::at(sampling::alone(&longest), Level::NOMINAL);
    let least = least_settling_ticks(&mut board, &configuration)?.max(base.settling_ticks / EARLIEST);
    let settled: Vec<f64> =
        sample(&mut board, configuration.clone(), SETTLED_SCANS)?.all_light().iter().map(Pair::total_a).collect();
    let mut instants = vec![Vec::new(); settled.len()];
    for k in 0..INSTANTS {
        let share = f64::from(k) / f64::from(INSTANTS - 1);
        let ratio = f64::from(LAST * base.settling_ticks) / f64::from(least);
        configuration.schedule.settling_ticks = (f64::from(least) * ratio.powf(share)).round() as u32;
        let sampling = sample(&mut board, configuration.clone(), SCANS)?;
        for (cell, instants) in instants.iter_mut().enumerate() {
            let ticks = sampling.schedule.settling_ticks + cell as u32 * sampling.schedule.conversion_ticks;
            let after_s = f64::from(ticks) / f64::from(sampling.schedule.tick_hz);
            instants.push(Instant { after_s, light_a: sampling.light(cell).total_a() });
        }
    }
    let front_end = bench.scene.front_end;
    let asked = Asked {
        settling_s,
        time_constant_s: front_end.map_or(0.0, |front_end| front_end.time_constant_s),
        full_scale_codes: front_end.map_or(0.0, |front_end| f64::from(1_u32 << front_end.adc_bits)),
    };
    let is_lit = |cell: usize| settled[cell] >= LIT * expected.own[cell].total_a();
    let left = LEFT_CODES / asked.full_scale_codes;
    Ok((0..settled.len())
        .map(|cell| judge(cell, is_lit(cell).then(|| settled_after(&instants[cell], settled[cell], left)), &asked))
        .collect())
}

/// What the scene says of its front end.
#[derive(Clone, Copy, Debug)]
struct Asked {
    settling_s: f64,
    time_constant_s: f64,
    /// Codes from no light to full scale.
    full_scale_codes: f64,
}

/// The instant at which the share `left` of the light is still to come, seconds, by the line through ln(1 − I(x)/I);
/// `None` if fewer than two instants show light still to come.
fn settled_after(instants: &[Instant], settled_a: f64, left: f64) -> Option<f64> {
    let points: Vec<(f64, f64, f64)> = instants
        .iter()
        .map(|instant| (instant.after_s, 1.0 - instant.light_a / settled_a))
        .filter(|(_, to_come)| TO_COME.contains(to_come))
        .map(|(after_s, to_come)| (after_s, to_come.ln(), 1.0 / ((SHARE_NOISE / to_come).powi(2) + BEND * BEND)))
        .collect();
    let sum = |term: fn(&(f64, f64, f64)) -> f64| points.iter().map(term).sum::<f64>();
    let weight = sum(|&(_, _, w)| w);
    let (x, y) = (sum(|&(x, _, w)| w * x) / weight, sum(|&(_, y, w)| w * y) / weight);
    let slope = points.iter().map(|(px, py, w)| w * (px - x) * (py - y)).sum::<f64>()
        / points.iter().map(|(px, _, w)| w * (px - x) * (px - x)).sum::<f64>();
    (points.len() >= 2 && slope < 0.0 && slope.is_finite()).then(|| x + (left.ln() - y) / slope)
}

/// `settled`: `None` for a dark cell, `Some(None)` for one that has settled before the first instant.
fn judge(cell: usize, settled: Option<Option<f64>>, asked: &Asked) -> Finding {
    let micro = |seconds: f64| seconds * 1e6;
    let Some(settled) = settled else {
        let text = format!("cell {cell}: no light: see step emitters");
        return Finding::failed("settling", text, "take step emitters first");
    };
    let Some(settled_s) = settled else {
        return Finding::warning(
            "settling",
            format!(
                "cell {cell}: no instant that the board allows shows light settling: it settles too fast, or rings"
            ),
            "look at the amplifier's output with an oscilloscope: is C_f fitted?",
        );
    };
    let time_constant_s = settled_s / (asked.full_scale_codes / LEFT_CODES).ln();
    let text = format!(
        "cell {cell}: {LEFT_CODES} codes of full scale are left after {:.1} us, {:.1} us are set; one time constant of \
         {:.2} us would take as long, {:.2} us by the scene",
        micro(settled_s),
        micro(asked.settling_s),
        micro(time_constant_s),
        micro(asked.time_constant_s),
    );
    let off = time_constant_s / asked.time_constant_s - 1.0;
    let share = settled_s / asked.settling_s;
    let is_slow = share > LONG || off > TAU_TOLERANCE;
    let set = format!("set front_end.settling_s = {:.1}e-6", micro(settled_s));
    let set_both = format!("{set} and front_end.time_constant_s = {:.2}e-6", micro(time_constant_s));
    if is_slow {
        let next_step = format!("look for a larger R_f or C_f; or {set_both}");
        Finding::failed("settling", format!("{text}: the front end is slow"), next_step)
    } else if share > ENOUGH {
        Finding::warning("settling", text, set)
    } else {
        let next_step = "is C_f fitted? look for ringing; noise grows with the bandwidth";
        let is_fast = off < -TAU_TOLERANCE;
        named("settling", text, &[(is_fast, Warning, "the front end is faster than the scene says", next_step)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    const ASKED: Asked = Asked { settling_s: 13e-6, time_constant_s: 1.36e-6, full_scale_codes: 4096.0 };

    /// When 0.3 codes are left of a step through first-order poles, by the fit to instants from `first_us` to 30 µs.
    fn fitted_us(poles_us: &[f64], first_us: f64) -> Option<f64> {
        let weight = |own: f64| -> f64 {
            poles_us.iter().filter(|&&other| other != own).map(|other| own / (own - other)).product()
        };
        let to_come =
            |after_us: f64| -> f64 { poles_us.iter().map(|&own| weight(own) * (-after_us / own).exp()).sum() };
        let instants: Vec<_> = (0..INSTANTS)
            .map(|k| first_us * (30.0 / first_us).powf(f64::from(k) / 17.0))
            .map(|after_us| Instant { after_s: 1e-6 * after_us, light_a: 6.8e-6 * (1.0 - to_come(after_us)) })
            .collect();
        settled_after(&instants, 6.8e-6, 0.3 / 4096.0).map(|after_s| 1e6 * after_s)
    }

    /// Expected instants: `firmware/analogue`, `left`, for the same poles and 4 096 codes.
    #[test]
    fn the_instant_of_settling_is_found_for_one_pole_and_for_several() {
        let cases: [(&[f64], f64, f64); 7] = [
            (&[1.36], 12.95, 0.01),
            (&[3.4], 32.38, 0.01),
            (&[0.7], 6.67, 0.01),
            (&[1.07, 0.36, 0.41, 0.13, 0.10], 11.39, 0.03),
            (&[1.07, 0.36, 0.6, 0.13, 0.10], 11.75, 0.1),
            (&[1.07, 0.36, 1.0, 0.13, 0.10], 13.21, 0.2),
            (&[1.07, 0.36, 1.36, 0.13, 0.10], 15.65, 0.15),
        ];
        for (poles_us, expected_us, within_us) in cases {
            for first_us in [0.7, 4.0] {
                let us = fitted_us(poles_us, first_us).expect("light still to come");
                println!("{poles_us:?} from {first_us} us on: {us:.2} us, {expected_us} us expected");
                assert!((us - expected_us).abs() < within_us, "{poles_us:?}, {first_us} us: {us}, not {expected_us}");
            }
        }
        assert_eq!(fitted_us(&[0.05], 0.7), None);
    }

    #[test]
    fn slow_and_fast_front_ends_are_named_with_the_time_that_would_do() {
        let judged = |settled_us: f64| judge(2, Some(Some(1e-6 * settled_us)), &ASKED);
        for (settled_us, grade) in [
            (11.9, Grade::Ok),
            (13.5, Grade::Ok),
            (14.5, Warning),
            (16.0, Warning),
            (9.0, Warning),
            (17.0, Grade::Failed),
        ] {
            assert_eq!(judged(settled_us).grade, grade, "{settled_us}");
        }
        let slow = judged(32.4).to_string();
        assert!(slow.contains("left after 32.4 us") && slow.contains("settling_s = 32.4e-6"), "{slow}");
        assert_eq!(judge(0, None, &ASKED).grade, Grade::Failed);
        assert_eq!(judge(0, Some(None), &ASKED).grade, Warning);
    }
}

//! Current against level: each emitter alone, at levels from an eighth to nominal; and the codes of the converters on the
//! way: none missing, none repeated.
//!
//! For the codes the level of all emitters falls from nominal in steps of about two codes. The noise of one conversion
//! spreads each step over its neighbours, so all codes on the way should come about equally often. A converter that is
//! disturbed by another one, or lacks a bit, leaves out codes or repeats them, mostly every 8 or every 64.

use std::collections::BTreeMap;

use anyhow::Result;
use slitpose_model::Pair;
use slitpose_protocol::{Level, Schedule};

use super::bench::{Bench, ELECTRODES, Wiring, sample};
use super::sampling::{self, LIT};
use crate::device::Conversation;
use crate::doctor::{faulty_or, judged};
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::Failed;

const SCANS: usize = 200;

/// Levels, rising to nominal; none above, where pulses are limited. The lowest is 0.206 V: below 0.2 V the buffer of the
/// DAC is not specified (DS12288, table 74), and relatives stay at 25 to 69 mV.
const LEVELS: [Level; 5] = [Level(0x1000), Level(0x2000), Level(0x4000), Level(0x6000), Level::NOMINAL];

/// Largest difference from proportionality, as a share of the light at nominal level: a driver with 3.3 Ω within 1 %
/// and an amplifier's offset of 150 µV has 0.1 % of 329 mV; the rest is heating of the emitter.
const TOLERANCE: f64 = 0.02;

pub(super) fn take(bench: &mut Bench) -> Result<Vec<Finding>> {
    let expected = bench.expected()?;
    let (mut board, _) = bench.connect()?;
    let base = bench.schedule()?;
    let schedule = sampling::alone(&base);
    let mut light = Vec::new();
    for level in LEVELS {
        light.push(sample(&mut board, sampling::at(schedule.clone(), level), SCANS)?.all_light());
    }
    let mut findings = judge(&light, &expected.own, bench.wiring);
    findings.extend(take_codes(&mut board, &base, bench.wiring)?);
    Ok(findings)
}

/// Light of an emitter at each of [`LEVELS`], relative to that at nominal level.
type Shares = [f64; LEVELS.len()];

/// How the light of an emitter follows its level.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Following {
    /// In proportion; the largest difference.
    Proportional(f64),
    Not,
    /// Up to about this level, and not beyond.
    UpTo(f64),
    /// Otherwise; the largest difference.
    Otherwise(f64),
}

fn following(shares: Shares) -> Following {
    let off = |k: usize| shares[k] - LEVELS[k].relative();
    let worst = (0..LEVELS.len()).fold(0.0_f64, |worst, k| worst.max(off(k).abs()));
    if worst <= TOLERANCE {
        return Following::Proportional(worst);
    }
    if shares.iter().all(|share| (share - 1.0).abs() <= TOLERANCE) {
        return Following::Not;
    }
    // Proportional below, the same above.
    let knee = (1..LEVELS.len() - 1).find(|&k| {
        let slope = shares[1] / LEVELS[1].relative();
        (0..=k).all(|k| (shares[k] - slope * LEVELS[k].relative()).abs() <= TOLERANCE)
            && (k + 1..LEVELS.len()).all(|k| (shares[k] - 1.0).abs() <= TOLERANCE)
    });
    match knee {
        Some(_) if shares[1] > 0.0 => Following::UpTo(LEVELS[1].relative() / shares[1]),
        _ => Following::Otherwise(worst),
    }
}

/// `light`: of each cell, at each of [`LEVELS`].
fn judge(light: &[Vec<Pair<f64>>], expected: &[Pair<f64>], wiring: Wiring) -> Vec<Finding> {
    let shares_of = |emitter: usize| -> Option<Shares> {
        let nominal_a = light.last()?.get(emitter)?.total_a();
        let is_lit = nominal_a >= LIT * expected[emitter].total_a();
        is_lit.then(|| std::array::from_fn(|k| light[k][emitter].total_a() / nominal_a))
    };
    let shares: Vec<_> = (0..expected.len()).map(shares_of).collect();
    // A line is at fault if all its emitters are off, and by the same.
    let wrong_line = |emitter: usize| {
        let (name, emitters) = wiring.level_line(emitter)?;
        let lit: Vec<Shares> = emitters.filter_map(|emitter| *shares.get(emitter)?).collect();
        let is_same = |other: &Shares| other.iter().zip(&lit[0]).all(|(a, b)| (a - b).abs() <= TOLERANCE);
        let is_wrong = |shares: &Shares| !matches!(following(*shares), Following::Proportional(_)) && is_same(shares);
        (lit.len() > 1 && lit.iter().all(is_wrong)).then_some(name)
    };
    (0..shares.len()).map(|emitter| of_emitter(emitter, shares[emitter], wrong_line(emitter))).collect()
}

/// `wrong_line`: the level line, if all emitters on it are off by the same.
fn of_emitter(emitter: usize, shares: Option<Shares>, wrong_line: Option<String>) -> Finding {
    let Some(shares) = shares else {
        let text = format!("emitter {emitter}: no light at nominal level: see step emitters");
        return Finding::failed("levels", text, "take step emitters first");
    };
    let [of, levels] = [shares, LEVELS.map(Level::relative)]
        .map(|row| row.map(|share| format!("{:.3}", if share.abs() < 5e-4 { 0.0 } else { share })).join(" "));
    let text = format!("emitter {emitter}: {of} of its nominal light at levels {levels}");
    let (of_line, of_driver, next_step) = match following(shares) {
        Following::Proportional(worst) => {
            return Finding::ok("levels", format!("{text}; off by {:.2} % at most, 2 % allowed", 1e2 * worst));
        }
        Following::Not => (
            "stays at nominal".to_owned(),
            "the driver does not follow its level line".to_owned(),
            "look at the switch and the divider in front of the driver's amplifier",
        ),
        Following::UpTo(level) => (
            format!("does not rise above level {level:.2}"),
            format!("no more light above level {level:.2}; the driver or the cell saturates"),
            "measure the 3.3 ohm (329 mV at nominal) and the 5 V of the emitters under load; is the cell saturated?",
        ),
        Following::Otherwise(worst) => (
            format!("is off by {:.1} % of nominal, 2 % allowed", 1e2 * worst),
            format!("off by {:.1} %, 2 % allowed", 1e2 * worst),
            "measure the 3.3 ohm at each level: 329 mV in proportion; if it is, the emitter heats up or the tool moves",
        ),
    };
    match wrong_line {
        Some(line) => Finding::failed("levels", format!("{text}: {line} {of_line}"), LINE),
        None => Finding::failed("levels", format!("{text}: {of_driver}"), next_step),
    }
}

const LINE: &str =
    "measure the level line at the DAC's pin and behind its 100 ohm: 0.21 V at level 0.125, 1.65 V at nominal";

// Codes under light.

/// Levels, their distance (three codes of the level's converter, nominal being 2 048 of them), and scans of each. On the
/// shipped head they cover 80 codes with some 50 words of each.
const CODE_LEVELS: u16 = 40;
const LEVEL_STEP: u16 = 3 * (Level::NOMINAL.0 / 2048);
const CODE_SCANS: usize = 100;

/// One in so many words is left out at each end, where noise makes words fewer.
const ENDS: usize = 20;

/// Least number of codes, and of words of each on average, that are judged.
const MIN_CODES: u16 = 16;
const MIN_WORDS: f64 = 30.0;

/// A code that comes less often than this share of the average is missing, one that comes more often is repeated: a
/// converter may be off by a step in its differential linearity, and 30 words vary by 18 %.
const MISSING: f64 = 0.1;
const REPEATED: f64 = 3.0;

/// Words of single conversions of each cell's electrodes, over all levels.
type Words = Vec<[Vec<u16>; 2]>;

fn take_codes(board: &mut Conversation, base: &Schedule, wiring: Wiring) -> Result<Vec<Finding>> {
    let schedule = sampling::alone(&Schedule { oversampling: 1, ..base.clone() });
    let mut words: Words = vec![[Vec::new(), Vec::new()]; usize::from(base.cells)];
    for step in 0..CODE_LEVELS {
        let level = Level(Level::NOMINAL.0 - step * LEVEL_STEP);
        let sampling = sample(board, sampling::at(schedule.clone(), level), CODE_SCANS)?;
        for scan in &sampling.scans {
            for (words, lit) in words.iter_mut().zip(scan.lit()) {
                (0..2).for_each(|electrode| words[electrode].push(lit[electrode]));
            }
        }
    }
    Ok(judge_codes(&words, wiring))
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Histogram {
    first: u16,
    last: u16,
    missing: Vec<u16>,
    repeated: Vec<u16>,
}

/// `None` if the words cover too few codes, as without light.
fn histogram(words: &[u16]) -> Option<Histogram> {
    let mut sorted = words.to_vec();
    sorted.sort_unstable();
    let end = sorted.len() / ENDS;
    let (first, last) = (*sorted.get(end)?, *sorted.get(sorted.len().checked_sub(end + 1)?)?);
    if last < first + MIN_CODES {
        return None;
    }
    let mut counts: BTreeMap<u16, u32> = (first..=last).map(|code| (code, 0)).collect();
    words.iter().for_each(|word| {
        if let Some(count) = counts.get_mut(word) {
            *count += 1;
        }
    });
    let average = f64::from(counts.values().sum::<u32>()) / counts.len() as f64;
    let with = |is_so: &dyn Fn(f64) -> bool| -> Vec<u16> {
        counts.iter().filter(|(_, count)| is_so(f64::from(**count) / average)).map(|(code, _)| *code).collect()
    };
    let (missing, repeated) = (with(&|share| share < MISSING), with(&|share| share > REPEATED));
    (average >= MIN_WORDS).then_some(Histogram { first, last, missing, repeated })
}

fn judge_codes(words: &Words, wiring: Wiring) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (cell, pair) in words.iter().enumerate() {
        for (side, words) in ELECTRODES.into_iter().zip(pair) {
            let Some(Histogram { first, last, missing, repeated }) = histogram(words) else { continue };
            let text = format!(
                "{}: of {} codes from {first} on, {} are missing and {} come too often{}",
                wiring.electrode(cell, side),
                last - first + 1,
                missing.len(),
                repeated.len(),
                period(if repeated.is_empty() { &missing } else { &repeated })
            );
            let is_faulty = !missing.is_empty() || !repeated.is_empty();
            let next_step = "decoupling and ground of V_REF+ and V_DDA; ES0430 on converters that run at once";
            findings.push(judged("codes", text, [(is_faulty, Failed, next_step)]));
        }
    }
    match findings.len() {
        0 => vec![Finding::skipped("codes", "no cell has light that follows the level")],
        judged => faulty_or(findings, "codes", || {
            format!("{judged} channels: no code missing or too frequent as the level falls")
        }),
    }
}

/// The distance of codes that are not as they should be, if it is the same for all.
fn period(codes: &[u16]) -> String {
    let mut distances = codes.windows(2).map(|pair| pair[1] - pair[0]);
    match distances.next() {
        Some(first) if distances.all(|distance| distance == first) => format!(", every {first} codes"),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    /// Words of a finding that failed, of emitters that give these shares of the scene's light at each level.
    #[test]
    fn lines_and_drivers_that_do_not_follow_their_level_are_told_apart() {
        type Shares = fn(usize, f64) -> f64;
        let cases: [(Shares, usize, &str); 9] = [
            (|_, level| 0.7 * level, 0, ""),
            (|_, level| level + 0.05 * level * (1.0 - level), 0, ""),
            // The buffer of the DAC ends at 0.2 V of 1.65 V.
            (|_, level| level.max(0.2 / 1.65), 0, ""),
            (|emitter, level| if emitter < 3 { level.max(0.3) } else { level }, 3, "(PA4, CN7-32) is off by 17.5 %"),
            (|emitter, level| if emitter < 2 { 1.0 } else { level }, 2, "emitter 0: 1.000"),
            (|emitter, level| if emitter == 4 { 1.0 } else { level }, 1, "the driver does not follow"),
            (|emitter, level| if emitter == 1 { level.min(0.6) } else { level }, 1, "no more light above level 0.60"),
            (|emitter, level| if emitter == 1 { level * level } else { level }, 1, "off by 25.0 %"),
            (|emitter, level| if emitter == 1 { 0.0 } else { level }, 1, "no light at nominal"),
        ];
        for (shares, count, words) in cases {
            let pair = |share: f64| Pair { i_x1_a: share * 3.4e-6, i_x2_a: share * 3.4e-6 };
            let light: Vec<Vec<_>> = LEVELS
                .iter()
                .map(|level| (0..6).map(|emitter| pair(shares(emitter, level.relative()))).collect())
                .collect();
            let mut findings = judge(&light, &[pair(1.0); 6], Wiring::Nucleo);
            findings.retain(|finding| finding.grade == Failed);
            assert!(findings.len() == count, "{words}: {findings:?}");
            assert!(findings.first().is_none_or(|finding| finding.text.contains(words)), "{words}: {findings:?}");
        }
    }

    /// 50 words of each of 80 codes, as `bend` changes them.
    fn words_of(bend: impl Fn(u16) -> u16) -> Vec<u16> {
        (0..4_000).map(|k| bend(2_660 + k % 80)).collect()
    }

    fn judged_codes(words: Vec<u16>) -> Vec<Finding> {
        let mut all: Words = vec![[words_of(|code| code), words_of(|code| code)]; 6];
        all[3][1] = words;
        judge_codes(&all, Wiring::Nucleo)
    }

    #[test]
    fn codes_left_out_every_eight_are_named_with_their_channel_and_period() {
        let good = judged_codes(words_of(|code| code));
        assert!(good.len() == 1 && good[0].grade == Grade::Ok && good[0].text.starts_with("12 channels"), "{good:?}");
        let dark = judge_codes(&vec![[vec![4_031; 4_000], vec![4_030; 4_000]]; 6], Wiring::Nucleo);
        assert_eq!(dark[0].grade, Grade::Skipped);
        let found = judged_codes(words_of(|code| if code % 8 == 7 { code - 1 } else { code }));
        assert!(found.len() == 1 && found[0].grade == Failed, "{found:?}");
        assert!(found[0].text.contains("I_X2 of cell 3 (PB2") && found[0].text.contains("every 8 codes"), "{found:?}");
        let coarse = judged_codes(words_of(|code| code / 8 * 8));
        assert!(coarse[0].text.contains("come too often, every 8 codes"), "{coarse:?}");
    }
}

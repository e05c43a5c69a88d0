//! Codes of the converters under light: none missing, none repeated.
//!
//! The level of all emitters falls from nominal in steps of about two codes. The noise of one conversion spreads each
//! step over its neighbours, so all codes on the way should come about equally often. A converter that is disturbed by
//! another one, or lacks a bit, leaves out codes or repeats them, mostly every 8 or every 64.

use std::collections::BTreeMap;

use slitpose_protocol::{Level, Schedule};

use super::bench::{BenchError, sample};
use super::pins::{ELECTRODES, Wiring};
use super::sampling;
use crate::device::Conversation;
use slitpose_head::finding::Finding;

/// Levels, their distance (three codes of the level's converter, nominal being 2 048 of them), and scans of each. On the
/// shipped head they cover 80 codes with some 50 words of each.
const LEVELS: u16 = 40;
const LEVEL_STEP: u16 = 3 * (Level::NOMINAL.0 / 2048);
const SCANS: usize = 100;

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

pub(super) fn take(board: &mut Conversation, base: &Schedule, wiring: Wiring) -> Result<Vec<Finding>, BenchError> {
    let schedule = sampling::alone(&Schedule { oversampling: 1, ..base.clone() });
    let mut words: Words = vec![[Vec::new(), Vec::new()]; usize::from(base.cells)];
    for step in 0..LEVELS {
        let level = Level(Level::NOMINAL.0 - step * LEVEL_STEP);
        let sampling = sample(board, sampling::at(schedule.clone(), level), SCANS)?;
        for scan in &sampling.scans {
            for (words, lit) in words.iter_mut().zip(scan.lit()) {
                (0..2).for_each(|electrode| words[electrode].push(lit[electrode]));
            }
        }
    }
    Ok(judge(&words, wiring))
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

fn judge(words: &Words, wiring: Wiring) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut judged = 0;
    for (cell, pair) in words.iter().enumerate() {
        for (side, words) in ELECTRODES.into_iter().zip(pair) {
            let Some(histogram) = histogram(words) else { continue };
            judged += 1;
            let Histogram { first, last, missing, repeated } = &histogram;
            if missing.is_empty() && repeated.is_empty() {
                continue;
            }
            let count = last - first + 1;
            let text = format!(
                "{}: of {count} codes from {first} on, {} are missing and {} come too often{}",
                wiring.electrode(cell, side),
                missing.len(),
                repeated.len(),
                period(if repeated.is_empty() { missing } else { repeated })
            );
            let next_step = "decoupling and ground of V_REF+ and V_DDA; ES0430 on converters that run at once";
            findings.push(Finding::failed("codes", text, next_step));
        }
    }
    match (findings.is_empty(), judged) {
        (true, 0) => findings.push(Finding::skipped("codes", "no cell has light that follows the level")),
        (true, _) => {
            findings.push(Finding::ok(
                "codes",
                format!("{judged} channels: no code missing or too frequent as the level falls"),
            ));
        }
        _ => {}
    }
    findings
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

    /// 50 words of each of 80 codes, as `bend` changes them.
    fn words(bend: impl Fn(u16) -> u16) -> Vec<u16> {
        (0..4_000).map(|k| bend(2_660 + k % 80)).collect()
    }

    fn judged(words: Vec<u16>) -> Vec<Finding> {
        let mut all: Words = vec![[self::words(|code| code), self::words(|code| code)]; 6];
        all[3][1] = words;
        judge(&all, Wiring::Nucleo)
    }

    #[test]
    fn all_codes_equally_often_are_good() {
        let good = judged(words(|code| code));
        assert!(good.len() == 1 && good[0].grade == Grade::Ok && good[0].text.starts_with("12 channels"), "{good:?}");
        let dark = judge(&vec![[vec![4_031; 4_000], vec![4_030; 4_000]]; 6], Wiring::Nucleo);
        assert_eq!(dark[0].grade, Grade::Skipped);
    }

    #[test]
    fn codes_left_out_every_eight_are_named_with_their_channel_and_period() {
        let found = judged(words(|code| if code % 8 == 7 { code - 1 } else { code }));
        assert!(found.len() == 1 && found[0].grade == Grade::Failed, "{found:?}");
        assert!(found[0].text.contains("I_X2 of cell 3 (PB2") && found[0].text.contains("every 8 codes"), "{found:?}");
        let coarse = judged(words(|code| code / 8 * 8));
        assert!(coarse[0].text.contains("come too often, every 8 codes"), "{coarse:?}");
    }
}

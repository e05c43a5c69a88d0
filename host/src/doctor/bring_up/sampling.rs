//! Words of some frames, and what follows from them for one word: mean, noise, and the steps of its codes.

use std::cmp::Ordering;

use slitpose_model::{CompiledScene, Pair, Pose};
use slitpose_protocol::{AdcScaling, Configuration, Edge, EmitterSet, Exposure, Level, MAX_CELLS, RawScan, Schedule};

#[derive(Clone, Debug)]
pub(super) struct Sampling {
    pub(super) schedule: Schedule,
    pub(super) scaling: AdcScaling,
    pub(super) scans: Vec<RawScan>,
    /// All edges of the trigger input meanwhile.
    pub(super) edges: Vec<Edge>,
}

/// Statistics of one word, in codes of one conversion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Codes {
    pub(super) mean: f64,
    pub(super) rms: f64,
    pub(super) distinct: usize,
    /// Greatest common divisor of all differences between words: 1 unless codes are missing regularly. 0 for a word
    /// that never changes.
    pub(super) step: u16,
}

impl Codes {
    fn of(words: impl Iterator<Item = u16> + Clone, oversampling: u16) -> Self {
        let conversions = f64::from(oversampling);
        let codes = words.clone().map(|word| f64::from(word) / conversions);
        let count = codes.clone().count().max(1) as f64;
        let mean = codes.clone().sum::<f64>() / count;
        let variance = codes.map(|code| (code - mean) * (code - mean)).sum::<f64>() / (count - 1.0).max(1.0);
        let first = words.clone().next().unwrap_or(0);
        let step = words.clone().fold(0, |step, word| gcd(step, word.abs_diff(first)));
        let values: std::collections::BTreeSet<_> = words.collect();
        Self { mean, rms: variance.sqrt(), distinct: values.len(), step }
    }
}

fn gcd(a: u16, b: u16) -> u16 {
    if b == 0 { a } else { gcd(b, a % b) }
}

impl Sampling {
    pub(super) fn cells(&self) -> usize {
        usize::from(self.schedule.cells)
    }

    /// The words of `electrode` (0 or 1) of `cell` in its emitter's slot.
    pub(super) fn lit(&self, cell: usize, electrode: usize) -> Codes {
        Codes::of(self.scans.iter().map(|scan| scan.lit()[cell][electrode]), self.schedule.oversampling)
    }

    /// The words of `electrode` of `cell` in the dark slot.
    pub(super) fn dark(&self, cell: usize, electrode: usize) -> Codes {
        let words = self.scans.iter().filter_map(|scan| scan.dark()).map(|dark| dark[cell][electrode]);
        Codes::of(words, self.schedule.oversampling)
    }

    /// Mean photocurrents of `cell`, lit minus dark, as they were sampled.
    pub(super) fn light(&self, cell: usize) -> Pair<f64> {
        let [i_x1_a, i_x2_a] = [0, 1].map(|electrode| {
            (self.lit(cell, electrode).mean - self.dark(cell, electrode).mean) * self.scaling.amperes_per_code
        });
        Pair { i_x1_a, i_x2_a }
    }

    pub(super) fn all_light(&self) -> Vec<Pair<f64>> {
        (0..self.cells()).map(|cell| self.light(cell)).collect()
    }
}

// The dark slot comes first, after the idle rest of the frame: so dark words hold no light that has not settled.

/// The schedule of `base` with a dark slot, then one slot for each of `groups`, whose emitters are lit together. The
/// frame is at least as long as that of `base`, with a rest of two settling times.
pub(super) fn grouped(base: &Schedule, groups: &[Vec<usize>]) -> Schedule {
    let conversions = u32::from(base.cells) * u32::from(base.oversampling);
    let slot_ticks = base.slot_ticks.max(base.settling_ticks + conversions * base.conversion_ticks);
    let frame_ticks = (groups.len() as u32 + 1) * slot_ticks + 2 * base.settling_ticks;
    Schedule {
        frame_ticks: frame_ticks.max(base.frame_ticks),
        slots: std::iter::once(EmitterSet::DARK).chain(groups.iter().map(|group| EmitterSet::of(group))).collect(),
        slot_ticks,
        ..base.clone()
    }
}

pub(super) fn alone(base: &Schedule) -> Schedule {
    let singles: Vec<_> = (0..usize::from(base.cells)).map(|emitter| vec![emitter]).collect();
    grouped(base, &singles)
}

pub(super) fn at(schedule: Schedule, level: Level) -> Configuration {
    let cells = usize::from(schedule.cells);
    let levels = [level; MAX_CELLS].into_iter().take(cells).collect();
    Configuration { schedule, levels, exposure: Exposure::Fixed }
}

/// Rounds in which each of `count` emitters is lit along with each other one once: the circle method for tournaments.
/// Where the number is odd, one emitter of each round is lit alone.
pub(super) fn rounds(count: usize) -> Vec<Vec<Vec<usize>>> {
    let turning = (count + count % 2).saturating_sub(1);
    let group = |round: usize, first: usize| {
        let second = (round + turning - first) % turning;
        match first.cmp(&second) {
            Ordering::Less => Some(vec![first, second]),
            Ordering::Equal => Some([first, turning].into_iter().filter(|&emitter| emitter < count).collect()),
            Ordering::Greater => None,
        }
    };
    (0..turning).map(|round| (0..turning).filter_map(|first| group(round, first)).collect()).collect()
}

/// Least share of the scene's light at which an electrode, or a cell, counts as lit.
pub(super) const LIT: f64 = 0.15;

#[derive(Clone, Debug)]
pub(super) struct Expected {
    pub(super) own: Vec<Pair<f64>>,
    /// `stray[cell][emitter]`: light of the other emitters, both electrodes together, as a share of the cell's own.
    pub(super) stray: Vec<Vec<f64>>,
}

impl Expected {
    /// By the optics `plan`, and `coarse` ones for light of other emitters.
    pub(super) fn of(plan: &CompiledScene<f64>, coarse: &CompiledScene<f64>) -> Self {
        let cells = 0..plan.cell_count();
        let own: Vec<_> = cells.clone().map(|cell| plan.crosstalk(cell, cell, &Pose::HOME)).collect();
        let share = |cell: usize, emitter: usize| {
            let light = if cell == emitter { own[cell] } else { coarse.crosstalk(cell, emitter, &Pose::HOME) };
            light.total_a() / own[cell].total_a()
        };
        let stray = cells.clone().map(|cell| cells.clone().map(|emitter| share(cell, emitter)).collect()).collect();
        Self { own, stray }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_words_are_in_codes_of_one_conversion() {
        let words = [16_000_u16, 16_008, 16_016, 16_008];
        let codes = Codes::of(words.into_iter(), 4);
        assert_eq!((codes.mean, codes.distinct, codes.step), (4_002.0, 3, 8));
        assert!((codes.rms - (8.0_f64 / 3.0).sqrt()).abs() < 1e-12, "{codes:?}");
        let same = Codes::of([7; 5].into_iter(), 1);
        assert_eq!((same.mean, same.rms, same.distinct, same.step), (7.0, 0.0, 1, 0));
        assert_eq!(Codes::of([10, 13, 14].into_iter(), 1).step, 1);
    }

    #[test]
    fn each_pair_of_emitters_meets_once_and_none_is_left_out_of_a_round() {
        for count in 1..=7 {
            let rounds = rounds(count);
            let mut met = std::collections::BTreeSet::new();
            for round in &rounds {
                let mut lit: Vec<_> = round.concat();
                lit.sort_unstable();
                assert_eq!(lit, (0..count).collect::<Vec<_>>(), "{round:?}");
                met.extend(round.iter().filter(|group| group.len() == 2).cloned());
            }
            assert_eq!(met.len(), count * (count - 1) / 2, "{rounds:?}");
        }
    }
}

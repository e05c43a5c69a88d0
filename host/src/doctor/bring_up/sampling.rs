//! Words of some frames, and what follows from them for one word: mean, noise, and the steps of its codes.

use slitpose_model::Pair;
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

/// The scans of one configuration.
#[derive(Clone, Debug)]
pub(super) struct Sampling {
    /// The schedule they were taken by.
    pub(super) schedule: Schedule,
    /// Scaling of their codes.
    pub(super) scaling: AdcScaling,
    /// The scans, without the first ones.
    pub(super) scans: Vec<RawScan>,
    /// Scans missing in their numbers.
    pub(super) missing: u64,
    /// Time between the first scan and the last by the host's clock, seconds.
    pub(super) elapsed_s: f64,
}

/// Statistics of one word, in codes of one conversion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Codes {
    /// Mean.
    pub(super) mean: f64,
    /// Standard deviation.
    pub(super) rms: f64,
    /// Number of different values.
    pub(super) distinct: usize,
    /// Greatest common divisor of all differences between words: 1 unless codes are missing regularly. 0 for a word
    /// that never changes.
    pub(super) step: u16,
}

impl Codes {
    /// Of words of `oversampling` conversions.
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
    /// Number of cells.
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

    /// Mean photocurrents of all cells.
    pub(super) fn all_light(&self) -> Vec<Pair<f64>> {
        (0..self.cells()).map(|cell| self.light(cell)).collect()
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
}

//! Sums over the last second of device time.

use slitpose_model::MAX_CELLS;
use slitpose_protocol::WordPair;

/// Full buckets of a window; one more is being filled.
const FULL: usize = 4;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CellSums {
    pub(super) saturated: u32,
    pub(super) faint: u32,
    pub(super) missing: u32,
    pub(super) excluded: u32,
    /// Scans with the words of the scan before.
    pub(super) still: u32,
    /// Scans with a photocurrent, and the sum of these, I_O above dark.
    pub(super) measured: u32,
    pub(super) light_a: f64,
    /// Comparisons of the cell with the model; of these: spot clipped, light expected, light missed.
    pub(super) looks: u32,
    pub(super) clipped: u32,
    pub(super) expected: u32,
    pub(super) missed: u32,
    /// Measured and expected photocurrents where light was expected.
    pub(super) compared_a: f64,
    pub(super) expected_a: f64,
    pub(super) dark: DarkSums,
}

/// Sums of the dark words of a cell.
///
/// Their noise is estimated from the differences of successive scans (von Neumann 1941): slow changes cancel, as they
/// do when dark words are subtracted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DarkSums {
    count: u64,
    /// Sum of the words of both electrodes.
    words: u64,
    differences: u64,
    squares: u64,
}

impl DarkSums {
    /// Adds the dark words of a scan; `before` are those of the scan before.
    pub(super) fn add_words(&mut self, words: WordPair, before: Option<WordPair>) {
        self.count += 1;
        self.words += u64::from(words[0]) + u64::from(words[1]);
        if let Some(before) = before {
            self.differences += 1;
            let square = |electrode: usize| u64::from(words[electrode].abs_diff(before[electrode])).pow(2);
            self.squares += square(0) + square(1);
        }
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.words += other.words;
        self.differences += other.differences;
        self.squares += other.squares;
    }

    pub(super) fn count(&self) -> f64 {
        self.count as f64
    }

    /// Mean of both electrodes' words added up; `None` without any.
    pub(super) fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.words as f64 / self.count())
    }

    /// Variance of a word, mean of both electrodes: half that of a difference.
    pub(super) fn variance(&self) -> Option<f64> {
        (self.differences > 0).then(|| self.squares as f64 / (4.0 * self.differences as f64))
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Bucket {
    pub(super) scans: u32,
    /// Scans that the scene does not explain.
    pub(super) troubled: u32,
    pub(super) cells: [CellSums; MAX_CELLS],
}

impl Bucket {
    fn add(&mut self, other: &Self) {
        self.scans += other.scans;
        self.troubled += other.troubled;
        for (sums, more) in self.cells.iter_mut().zip(&other.cells) {
            sums.saturated += more.saturated;
            sums.faint += more.faint;
            sums.missing += more.missing;
            sums.excluded += more.excluded;
            sums.still += more.still;
            sums.measured += more.measured;
            sums.light_a += more.light_a;
            sums.looks += more.looks;
            sums.clipped += more.clipped;
            sums.expected += more.expected;
            sums.missed += more.missed;
            sums.compared_a += more.compared_a;
            sums.expected_a += more.expected_a;
            sums.dark.add(&more.dark);
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    buckets: [Bucket; FULL + 1],
    /// Number of the current bucket, counted by the board's clock; `None` before the first scan.
    number: Option<u64>,
    full: usize,
}

impl Window {
    /// Advances to bucket `number`; whether that is one of the next. Else it is the same one, or the buckets were too old or
    /// the clock has restarted, and all begin anew.
    pub(super) fn turn(&mut self, number: u64) -> bool {
        let ahead = self.number.and_then(|before| number.checked_sub(before));
        self.number = Some(number);
        match ahead {
            Some(0) => false,
            Some(ahead) if ahead <= FULL as u64 => {
                self.full = FULL.min(self.full + ahead as usize);
                // Buckets in between stay empty.
                for skipped in 0..ahead {
                    self.buckets[index_of(number - skipped)] = Bucket::default();
                }
                true
            }
            _ => {
                self.buckets.fill(Bucket::default());
                self.full = 0;
                false
            }
        }
    }

    pub(super) fn current(&mut self) -> &mut Bucket {
        &mut self.buckets[index_of(self.number.unwrap_or(0))]
    }

    /// Whether the window covers a whole second.
    pub(super) fn is_full(&self) -> bool {
        self.full == FULL
    }

    pub(super) fn sum(&self) -> Bucket {
        let mut sum = Bucket::default();
        self.buckets.iter().for_each(|bucket| sum.add(bucket));
        sum
    }
}

fn index_of(number: u64) -> usize {
    (number % (FULL as u64 + 1)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_forgets_what_is_older() {
        let mut window = Window::default();
        let mut take = |number| {
            let turn = window.turn(number);
            window.current().scans += 1;
            (turn, window.sum().scans, window.is_full())
        };
        assert_eq!(take(70), (false, 1, false));
        assert_eq!(take(70), (false, 2, false));
        assert_eq!(take(71), (true, 3, false));
        assert_eq!(take(74), (true, 4, true));
        assert_eq!(take(75), (true, 3, true), "70 is gone");
        assert_eq!(take(77), (true, 3, true), "71 is gone, though 76 was skipped");
        assert_eq!(take(82), (false, 1, false), "nothing came for a second");
        assert_eq!(take(3), (false, 1, false), "the board was restarted");
    }

    #[test]
    fn drift_is_no_noise() {
        let mut sums = DarkSums::default();
        let mut before = None;
        for i in 0..8000_u16 {
            // One electrode: 0 and 1 in turn. The other: a slow rise by a thousand.
            let words = [64_000 + i % 2, 1000 + i / 8];
            sums.add_words(words, before.replace(words));
        }
        // Differences of ±1 and, one in eight, of 1.
        assert!((sums.variance().unwrap() - (1.0 + 0.125) / 4.0).abs() < 1e-3, "{sums:?}");
        assert_eq!(sums.mean(), Some(64_000.5 + 1499.5));
        assert_eq!((DarkSums::default().mean(), DarkSums::default().variance()), (None, None));
    }
}

//! Faults of a head on the words of its scans.
//!
//! Words are sums of conversions, and codes may fall as the current rises ([`AdcScaling`]). The noise of a word that is
//! dimmed is dimmed with it, and what is missing comes from the dark word of the scan before.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_protocol::{AdcScaling, RawScan, WordPair};

use super::Faults;
use super::kinds::Layer;
use super::text::{Fault, FaultClock};

/// The faults of a head on the words of one board.
#[derive(Clone, Debug)]
pub struct WordFaults {
    faults: Vec<WordFault>,
    clock: FaultClock,
    dark_before: Option<RawScan>,
}

#[derive(Clone, Debug)]
struct WordFault {
    fault: Fault,
    random: ChaCha8Rng,
    /// The words that a stuck cell keeps.
    kept: Option<(WordPair, Option<WordPair>)>,
}

/// What words of one configuration are worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WordScale {
    pub(crate) scaling: AdcScaling,
    pub(crate) oversampling: u16,
    pub(crate) tick_hz: u32,
}

impl WordScale {
    fn top(&self) -> f64 {
        f64::from(u32::from(self.oversampling) * ((1_u32 << self.scaling.bits.min(16)) - 1)).min(f64::from(u16::MAX))
    }

    fn word(&self, value: f64) -> u16 {
        value.round().clamp(0.0, self.top()) as u16
    }

    fn steps(&self, current_a: f64) -> f64 {
        f64::from(self.oversampling) * current_a / self.scaling.amperes_per_code
    }

    fn zero(&self) -> f64 {
        f64::from(self.oversampling) * self.scaling.zero_code
    }
}

impl WordFaults {
    /// Those of `faults` that act on words; `None` if none does.
    pub fn of(faults: &Faults) -> Option<Self> {
        let faults: Vec<_> = faults
            .of(Layer::Words)
            .into_iter()
            .map(|(fault, random)| WordFault { fault, random, kept: None })
            .collect();
        (!faults.is_empty()).then(|| Self { faults, clock: FaultClock::default(), dark_before: None })
    }

    /// Changes the words of the next `scan`.
    pub(crate) fn apply(&mut self, scan: &mut RawScan, scale: &WordScale) {
        let time_s = self.clock.take(scan.tick, scale.tick_hz);
        let before = self.dark_before.replace(*scan).filter(|before| before.cells() == scan.cells());
        for fault in &mut self.faults {
            if fault.fault.window.is_open(time_s) {
                fault.apply(scan, before.as_ref(), scale);
            } else {
                fault.kept = None;
            }
        }
    }
}

impl WordFault {
    fn apply(&mut self, scan: &mut RawScan, before: Option<&RawScan>, scale: &WordScale) {
        // A board that has fewer cells than its head is refused elsewhere.
        if self.fault.cells().any(|cell| cell >= scan.cells()) {
            return;
        }
        let [cell, amount] = self.fault.values;
        let cell = cell as usize;
        match self.fault.kind.name {
            name @ ("occlude" | "dim") => {
                let to = if name == "dim" { amount } else { 0.0 };
                let zero = [scale.word(scale.zero()); 2];
                let dark = before.unwrap_or(scan).dark().map_or(zero, |dark| dark[cell]);
                for (lit, dark) in scan.lit_mut()[cell].iter_mut().zip(dark) {
                    *lit = scale.word(to * f64::from(*lit) + (1.0 - to) * f64::from(dark));
                }
            }
            "saturate" => {
                scan.lit_mut()[cell] =
                    [if scale.scaling.amperes_per_code < 0.0 { 0 } else { scale.word(scale.top()) }; 2];
            }
            "glint" => {
                let word = &mut scan.lit_mut()[cell][0];
                *word = scale.word(f64::from(*word) + scale.steps(amount));
            }
            "stray" => {
                change(scan, cell, |word| scale.word(f64::from(word) + scale.steps(amount)));
            }
            "noisy" => {
                let rms = scale.steps(amount).abs();
                let mut draw = || <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut self.random);
                change(scan, cell, |word| scale.word(f64::from(word) + rms * draw()));
            }
            "stuck" => {
                let now = || (scan.lit()[cell], scan.dark().map(|dark| dark[cell]));
                let (lit, dark) = *self.kept.get_or_insert_with(now);
                scan.lit_mut()[cell] = lit;
                if let (Some(words), Some(dark)) = (scan.dark_mut(), dark) {
                    words[cell] = dark;
                }
            }
            "swap-electrodes" => {
                scan.lit_mut()[cell].swap(0, 1);
                if let Some(dark) = scan.dark_mut() {
                    dark[cell].swap(0, 1);
                }
            }
            "swap-cells" => {
                let with = amount as usize;
                scan.lit_mut().swap(cell, with);
                if let Some(dark) = scan.dark_mut() {
                    dark.swap(cell, with);
                }
            }
            // Of other layers.
            _ => {}
        }
    }
}

fn change(scan: &mut RawScan, cell: usize, mut change: impl FnMut(u16) -> u16) {
    scan.lit_mut()[cell] = scan.lit()[cell].map(&mut change);
    if let Some(dark) = scan.dark_mut() {
        dark[cell] = dark[cell].map(&mut change);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALE: WordScale = WordScale {
        scaling: AdcScaling { zero_code: 4000.0, amperes_per_code: -1e-9, bits: 12, saturation_code: 16 },
        oversampling: 4,
        tick_hz: 1000,
    };

    fn scan(tick: u64) -> RawScan {
        let mut scan = RawScan::new(3, true);
        (scan.sequence, scan.tick) = (tick, tick);
        for cell in 0..3 {
            scan.lit_mut()[cell] = [8000 + cell as u16 + tick as u16, 9000 + cell as u16];
            scan.dark_mut().unwrap()[cell] = [16_000 + tick as u16, 15_990];
        }
        scan
    }

    fn faulty(texts: &[&str], ticks: u64) -> Vec<RawScan> {
        let faults = Faults::new(texts.iter().map(|text| text.parse().unwrap()).collect(), 3).unwrap();
        let mut words = WordFaults::of(&faults).unwrap();
        let apply = |tick| {
            let mut scan = scan(tick);
            words.apply(&mut scan, &SCALE);
            scan
        };
        (0..ticks).map(apply).collect()
    }

    #[test]
    fn a_fault_acts_within_its_span_on_its_cell() {
        let scans = faulty(&["occlude:cell=1,from=2ms,for=2ms"], 6);
        for (tick, faulty) in (0..).zip(&scans) {
            let sound = scan(tick);
            // No light: as dark as the scan before.
            let expected = if (2..4).contains(&tick) { scan(tick - 1).dark().unwrap()[1] } else { sound.lit()[1] };
            assert_eq!(faulty.lit()[1], expected, "{tick}");
            assert_eq!(
                (faulty.lit()[0], faulty.lit()[2], faulty.dark()),
                (sound.lit()[0], sound.lit()[2], sound.dark())
            );
        }
    }

    #[test]
    fn each_fault_does_to_words_what_it_says() {
        let last = |text: &str| faulty(&[text], 3)[2];
        let sound = scan(2);
        // Half of the way to the dark word of the scan before, 16 001.
        assert_eq!(last("dim:cell=0,to=0.5").lit()[0][0], (16_001 + 8002_u16).div_ceil(2));
        assert_eq!(last("saturate:cell=0").lit()[0], [0, 0]);
        // 100 nA are 100 codes, and 400 steps down.
        assert_eq!(last("glint:cell=0,current=100nA").lit()[0], [8002 - 400, 9000]);
        assert_eq!(last("glint:cell=0,current=100nA").dark(), sound.dark());
        let stray = last("stray:cell=0,current=100nA");
        assert_eq!(
            (stray.lit()[0], stray.dark().unwrap()[0]),
            ([8002 - 400, 9000 - 400], [16_002 - 400, 15_990 - 400])
        );
        let stuck = last("stuck:cell=0,from=1ms");
        assert_eq!((stuck.lit()[0], stuck.dark().unwrap()[0]), (scan(1).lit()[0], scan(1).dark().unwrap()[0]));
        assert_eq!(last("swap-electrodes:cell=2").lit()[2], [9002, 8004]);
        let swapped = last("swap-cells:cell=0,with=2");
        assert_eq!((swapped.lit()[0], swapped.lit()[2]), (sound.lit()[2], sound.lit()[0]));
    }

    #[test]
    fn noise_is_as_large_as_asked_for_and_depends_on_the_seed() {
        let noisy = |text: &str| -> Vec<f64> {
            let lit =
                |(tick, faulty): (u64, RawScan)| f64::from(faulty.lit()[0][1]) - f64::from(scan(tick).lit()[0][1]);
            (0..).zip(faulty(&[text], 2000)).map(lit).collect()
        };
        let first = noisy("noisy:cell=0,rms=20nA");
        let rms = (first.iter().map(|step| step * step).sum::<f64>() / 2000.0).sqrt();
        // 80 steps, to six standard deviations of an estimate from 2000.
        assert!((rms - 80.0).abs() < 80.0 * 6.0 / 4000.0_f64.sqrt(), "seed 1: {rms}");
        assert_eq!(first, noisy("noisy:cell=0,rms=20nA,seed=1"));
        assert_ne!(first, noisy("noisy:cell=0,rms=20nA,seed=2"));
    }
}

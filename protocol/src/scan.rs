//! One scan: the converters' codes of one frame, before conversion to currents.

use core::num::NonZeroU32;

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::schedule::MAX_CELLS;

/// Drive level of an emitter: its radiant intensity as a fraction of nominal, in
/// units of 1/32 768. `Level(0x8000)` is nominal, `Level(0)` off, `Level(0xFFFF)` just
/// under twice nominal.
///
/// ```
/// use slitpose_protocol::Level;
/// assert_eq!(Level::NOMINAL.relative(), 1.0);
/// assert_eq!(Level(0x1000).relative(), 0.125);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Level(pub u16);

impl Level {
    /// Nominal radiant intensity.
    pub const NOMINAL: Self = Self(0x8000);

    /// Intensity relative to nominal, 0 to just under 2.
    pub fn relative(self) -> f64 {
        f64::from(self.0) / f64::from(Self::NOMINAL.0)
    }
}

/// Levels of the emitters of all cells, index = cell.
pub type Levels = Vec<Level, MAX_CELLS>;

/// Two words of one cell: the sums of its I_X1 and of its I_X2 conversions, in ADC
/// codes. [`AdcScaling`] converts them to amperes.
pub type WordPair = [u16; 2];

/// The words of one frame, with its sequence number and tick.
///
/// All arrays have room for [`MAX_CELLS`] cells: 184 bytes, no heap. To fill one, start
/// from [`RawScan::new`] and write through the `_mut` accessors, which return exactly the
/// existing cells.
///
/// ```
/// use slitpose_protocol::{Level, RawScan};
/// let mut scan = RawScan::new(6, true);
/// scan.levels_mut().fill(Level::NOMINAL);
/// scan.lit_mut()[2] = [9_000, 12_000];
/// assert_eq!((scan.cells(), scan.lit()[2], scan.dark().map(<[_]>::len)), (6, [9_000, 12_000], Some(6)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawScan {
    /// Number of this scan among all scans that the board has taken since its reset, sent
    /// or not; the first is 0.
    pub sequence: u64,
    /// Device tick at which the frame started.
    pub tick: u64,
    levels: [Level; MAX_CELLS],
    lit: [WordPair; MAX_CELLS],
    dark: [WordPair; MAX_CELLS],
    cells: u8,
    has_dark: bool,
}

const _: () = assert!(size_of::<RawScan>() == 184);

impl RawScan {
    /// A scan of zeros for `cells` cells, [`MAX_CELLS`] at most, with or without dark
    /// words.
    pub fn new(cells: usize, has_dark: bool) -> Self {
        Self {
            sequence: 0,
            tick: 0,
            levels: [Level(0); MAX_CELLS],
            lit: [[0; 2]; MAX_CELLS],
            dark: [[0; 2]; MAX_CELLS],
            cells: cells.min(MAX_CELLS) as u8,
            has_dark,
        }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        usize::from(self.cells)
    }

    /// Drive level of each emitter.
    pub fn levels(&self) -> &[Level] {
        &self.levels[..self.cells()]
    }

    /// Levels to be filled in.
    pub fn levels_mut(&mut self) -> &mut [Level] {
        let cells = self.cells();
        &mut self.levels[..cells]
    }

    /// Words of each cell while its own emitter was lit.
    pub fn lit(&self) -> &[WordPair] {
        &self.lit[..self.cells()]
    }

    /// Lit words to be filled in.
    pub fn lit_mut(&mut self) -> &mut [WordPair] {
        let cells = self.cells();
        &mut self.lit[..cells]
    }

    /// Words of each cell in the dark slot; `None` if the schedule has none.
    pub fn dark(&self) -> Option<&[WordPair]> {
        self.has_dark.then(|| &self.dark[..self.cells()])
    }

    /// Dark words to be filled in; `None` if the schedule has none.
    pub fn dark_mut(&mut self) -> Option<&mut [WordPair]> {
        let cells = self.cells();
        self.has_dark.then(|| &mut self.dark[..cells])
    }

    /// Whether the scan has dark words.
    pub fn has_dark(&self) -> bool {
        self.has_dark
    }
}

/// Conversion of words to currents: a word w of `oversampling` conversions is the current
/// (w / oversampling − `zero_code`) · `amperes_per_code`.
///
/// The scale is signed because a detector's anodes source current, for which a
/// single-supply stage swings down from a code near the top.
///
/// ```
/// use slitpose_protocol::AdcScaling;
/// // The code falls from 4031 as the current rises, 2.5 nA a code.
/// let scaling = AdcScaling { zero_code: 4031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };
/// assert!(scaling.validate(4).is_ok());
/// assert!(scaling.is_saturated(4 * 20, 4) && !scaling.is_saturated(4 * 2000, 4));
/// assert!((scaling.full_scale_a() - 10e-6).abs() < 0.1e-6);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AdcScaling {
    /// Code of one conversion at zero current; it need not be an integer.
    pub zero_code: f64,
    /// Amperes per code of one conversion; negative if the code falls as the current
    /// rises.
    pub amperes_per_code: f64,
    /// Bits of one conversion.
    pub bits: u8,
    /// The code at which, in the direction of rising current, the stage or the converter
    /// begins to saturate.
    pub saturation_code: u16,
}

impl AdcScaling {
    /// Whether a word of 16 bits holds the sum of `oversampling` conversions of `bits` bits each.
    pub fn fits_a_word(bits: u32, oversampling: u32) -> bool {
        (1..=u16::BITS).contains(&bits) && ((1_u32 << bits) - 1).saturating_mul(oversampling) <= u32::from(u16::MAX)
    }

    /// Checks that words, each the sum of `oversampling` conversions, can be converted to currents.
    ///
    /// # Errors
    /// The first contradiction found, with its numbers.
    pub fn validate(&self, oversampling: u16) -> Result<(), ScalingError> {
        if !Self::fits_a_word(self.bits.into(), oversampling.into()) {
            return Err(ScalingError::Bits { bits: self.bits, oversampling });
        }
        let top_code = u16::MAX >> (u16::BITS - u32::from(self.bits));
        if self.saturation_code > top_code {
            return Err(ScalingError::SaturationCode { saturation_code: self.saturation_code, top_code });
        }
        if !self.zero_code.is_finite() {
            return Err(ScalingError::ZeroCode(self.zero_code));
        }
        if self.amperes_per_code == 0.0 || !self.amperes_per_code.is_finite() {
            return Err(ScalingError::AmperesPerCode(self.amperes_per_code));
        }
        Ok(())
    }

    /// The current at the end of the converter's range, in amperes: the greatest that could
    /// be measured if the stage in front of it reached that far.
    pub fn full_scale_a(&self) -> f64 {
        (f64::from(self.end_code()) - self.zero_code) * self.amperes_per_code
    }

    /// The same with `full_scale_pa` picoamperes at the end of the converter's range.
    #[must_use]
    pub fn with_full_scale(self, full_scale_pa: NonZeroU32) -> Self {
        // In `f32`, which a board has: right to 1e-7.
        let range = self.end_code() as f32 - self.zero_code as f32;
        Self { amperes_per_code: f64::from(full_scale_pa.get() as f32 * 1e-12 / range), ..self }
    }

    /// The end of the converter's range that currents go to.
    fn end_code(&self) -> u32 {
        if self.amperes_per_code.is_sign_negative() { 0 } else { (1 << self.bits.min(16)) - 1 }
    }

    /// Whether a word of `oversampling` conversions reaches the saturation code on
    /// average, so that it no longer measures the current.
    pub fn is_saturated(&self, word: u16, oversampling: u16) -> bool {
        let limit = u32::from(self.saturation_code) * u32::from(oversampling);
        // By the sign bit: a comparison of `f64` takes a board forty cycles.
        if self.amperes_per_code.is_sign_negative() { u32::from(word) <= limit } else { u32::from(word) >= limit }
    }
}

/// Why an [`AdcScaling`] cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum ScalingError {
    #[error("a word of 16 bits does not hold sums of {oversampling} conversions of {bits} bits")]
    Bits { bits: u8, oversampling: u16 },
    #[error("saturation code {saturation_code} lies above the top code {top_code}")]
    SaturationCode { saturation_code: u16, top_code: u16 },
    #[error("the code at zero current is {0}: give a finite number")]
    ZeroCode(f64),
    #[error("one code is {0} A: give a finite number other than zero")]
    AmperesPerCode(f64),
}

#[cfg(test)]
mod tests {
    use super::*;

    const FALLING: AdcScaling =
        AdcScaling { zero_code: 3900.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 64 };

    #[test]
    fn saturation_follows_the_sign_of_the_scale() {
        assert!(FALLING.is_saturated(4 * 64, 4));
        assert!(!FALLING.is_saturated(4 * 64 + 1, 4));
        let rising = AdcScaling { amperes_per_code: 2.5e-9, saturation_code: 4000, ..FALLING };
        assert!(rising.is_saturated(4 * 4000, 4));
        assert!(!rising.is_saturated(4 * 4000 - 1, 4));
    }

    #[test]
    fn full_scale_lies_at_the_far_end_of_the_range() {
        assert_eq!(FALLING.full_scale_a(), 3900.0 * 2.5e-9);
        let rising = AdcScaling { amperes_per_code: 2.5e-9, zero_code: 95.0, ..FALLING };
        assert_eq!(rising.full_scale_a(), 4000.0 * 2.5e-9);
        for scaling in [FALLING, rising] {
            for pa in [1, 9_100_000, u32::MAX] {
                let other = scaling.with_full_scale(NonZeroU32::new(pa).unwrap());
                assert!((other.full_scale_a() / (f64::from(pa) * 1e-12) - 1.0).abs() < 3e-7, "{other:?}");
                assert_eq!(other.amperes_per_code.is_sign_negative(), scaling.amperes_per_code.is_sign_negative());
            }
        }
    }

    #[test]
    fn scalings_that_mean_nothing_are_refused() {
        // 16 · 4095 and 1 · 65 535 are the largest sums that fit 16 bits.
        let whole = [(1, 16, 1), (12, 16, 0), (12, 16, 4095), (14, 4, 0), (16, 1, 65_535)];
        for (bits, oversampling, saturation_code) in whole {
            assert_eq!(AdcScaling { bits, saturation_code, ..FALLING }.validate(oversampling), Ok(()));
        }
        for (bits, oversampling) in [(0, 1), (13, 16), (15, 4), (16, 2), (17, 1), (255, 1)] {
            let scaling = AdcScaling { bits, ..FALLING };
            assert_eq!(scaling.validate(oversampling), Err(ScalingError::Bits { bits, oversampling }));
        }
        let scaling = AdcScaling { saturation_code: 4096, ..FALLING };
        let error = ScalingError::SaturationCode { saturation_code: 4096, top_code: 4095 };
        assert_eq!(scaling.validate(16), Err(error));
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let scaling = AdcScaling { zero_code: wrong, ..FALLING };
            assert!(matches!(scaling.validate(16), Err(ScalingError::ZeroCode(_))), "{wrong}");
            let scaling = AdcScaling { amperes_per_code: wrong, ..FALLING };
            assert!(matches!(scaling.validate(16), Err(ScalingError::AmperesPerCode(_))), "{wrong}");
        }
        let scaling = AdcScaling { amperes_per_code: 0.0, ..FALLING };
        assert_eq!(scaling.validate(16), Err(ScalingError::AmperesPerCode(0.0)));
    }
}

//! `[front_end]`: the electronics between detector and counts.

use super::document::Document;
use super::error::{KeyPath, SceneFileError};

/// The widest result the converters give: 12 bits, 16 with oversampling (STM32G4).
const WIDEST_BITS: i64 = 16;

/// The most conversions the converters' hardware adds up to one result (STM32G4).
const MOST_OVERSAMPLING: i64 = 256;

/// Gain, noise and timing of the electronics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontEnd {
    /// Electrode current at the converter's top code, amperes.
    pub full_scale_a: f64,
    /// Resolution of one conversion, bits.
    pub adc_bits: u32,
    /// Standard deviation of one conversion, in steps of the converter.
    pub raw_noise_lsb: f64,
    /// Conversions summed to one result.
    pub oversampling: u32,
    /// Of detector and transimpedance stage together, first order, seconds.
    pub time_constant_s: f64,
    /// From switching the emitters to the first conversion, seconds.
    pub settling_s: f64,
    /// Duration of one conversion, seconds.
    pub conversion_s: f64,
    /// Frames per second; a frame is one pass through all lighting slots.
    pub frame_rate_hz: f64,
}

impl FrontEnd {
    /// Duration of one lighting slot: settling, then the conversions of all cells one after the
    /// other. Both currents of a cell are converted at the same time, by two converters.
    pub fn slot_duration_s(&self, cells: usize) -> f64 {
        self.settling_s + cells as f64 * f64::from(self.oversampling) * self.conversion_s
    }

    /// Duration of one frame.
    pub fn frame_period_s(&self) -> f64 {
        1.0 / self.frame_rate_hz
    }
}

/// The front end, if the file has one. Scale, resolution and rate must be given; a noise, a
/// delay or a repetition that is not given is not there.
pub(super) fn read(document: &Document<'_>) -> Result<Option<FrontEnd>, SceneFileError> {
    if !document.has_section("front_end") {
        return Ok(None);
    }
    Ok(Some(FrontEnd {
        full_scale_a: positive(document, "full_scale_a")?,
        adc_bits: count(document, "adc_bits", WIDEST_BITS, "a whole number from 1 to 16")?
            .ok_or_else(|| document.missing(path("adc_bits")))?,
        raw_noise_lsb: not_negative(document, "raw_noise_lsb")?,
        oversampling: count(document, "oversampling", MOST_OVERSAMPLING, "a whole number from 1 to 256")?.unwrap_or(1),
        time_constant_s: not_negative(document, "time_constant_s")?,
        settling_s: not_negative(document, "settling_s")?,
        conversion_s: not_negative(document, "conversion_s")?,
        frame_rate_hz: positive(document, "frame_rate_hz")?,
    }))
}

const fn path(key: &'static str) -> KeyPath {
    KeyPath::section("front_end", key)
}

fn positive(document: &Document<'_>, key: &'static str) -> Result<f64, SceneFileError> {
    let value = document.required(path(key))?;
    match document.find(path(key)) {
        Some(entry) if value <= 0.0 => Err(document.out_of_range(path(key), entry, "a number above zero")),
        _ => Ok(value),
    }
}

fn not_negative(document: &Document<'_>, key: &'static str) -> Result<f64, SceneFileError> {
    let value = document.number(path(key))?.unwrap_or(0.0);
    match document.find(path(key)) {
        Some(entry) if value < 0.0 => Err(document.out_of_range(path(key), entry, "zero or more")),
        _ => Ok(value),
    }
}

fn count(
    document: &Document<'_>,
    key: &'static str,
    most: i64,
    allowed: &'static str,
) -> Result<Option<u32>, SceneFileError> {
    let Some(entry) = document.find(path(key)) else {
        return Ok(None);
    };
    let value = document.as_integer(path(key), entry)?;
    match u32::try_from(value) {
        Ok(count) if (1..=most).contains(&value) => Ok(Some(count)),
        _ => Err(document.out_of_range(path(key), entry, allowed)),
    }
}

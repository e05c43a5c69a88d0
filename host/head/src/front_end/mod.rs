//! Conversion between ADC codes and currents, the interface of board and optics.
//!
//! [`configuration`] derives a board's schedule from a scene's lighting and electronics; [`Settling`] is the response
//! of a first-order front end to switched light; [`Stage`] converts scans, and has the noise of lit-minus-dark
//! currents.

mod stage;

use slitpose_protocol::{
    AdcScaling, Configuration, EmitterSet, Exposure, Level, MAX_CELLS, MAX_OVERSAMPLING, Schedule, ScheduleError,
};
pub use stage::{ROOM_TEMPERATURE_K, Settling, Stage, dark_word_noise_a};
use thiserror::Error;

use crate::scene_file::{FrontEnd, SceneFile, SceneFileError};

/// Largest relative difference of the full scales of one front end, above the tolerance of resistors.
const FULL_SCALE_SLACK: f64 = 0.01;

/// Whether a board with the full scale `board_a` may have the front end of a scene with `scene_a`, amperes.
pub fn is_full_scale_of(board_a: f64, scene_a: f64) -> bool {
    (board_a / scene_a - 1.0).abs() <= FULL_SCALE_SLACK
}

/// Device ticks per second of schedules from scenes. A board whose timers count at another rate rejects
/// them, and names both rates.
const TICK_HZ: u32 = 170_000_000;

/// Why a board cannot run a scene.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum TimingError {
    #[error("scene `{0}` has no [front_end], so no board can sample it; add one, or use the shipped scene `wide`")]
    NoFrontEnd(String),
    #[error("scene `{0}`{1}")]
    FrontEnd(String, String),
    #[error(transparent)]
    Slots(#[from] SceneFileError),
    #[error("scene `{0}`: the schedule cannot be run; change [lighting] or [front_end]")]
    Schedule(String, #[source] ScheduleError),
}

impl FrontEnd {
    /// With the conversions of `schedule`, which may be another than the scene's.
    #[must_use]
    pub fn as_scheduled(&self, schedule: &Schedule) -> Self {
        let conversion_s = f64::from(schedule.conversion_ticks) / f64::from(schedule.tick_hz);
        Self { oversampling: schedule.oversampling.into(), conversion_s, ..*self }
    }
}

/// `file` at another rate of frames, with as many conversions as then fit, the scene's at most.
///
/// # Errors
/// Those of [`configuration`] with a single conversion.
pub fn at_rate(file: &SceneFile, frame_rate_hz: f64) -> Result<SceneFile, TimingError> {
    let mut file = file.clone();
    let Some(front_end) = &mut file.front_end else { return Err(TimingError::NoFrontEnd(file.name)) };
    front_end.frame_rate_hz = frame_rate_hz;
    loop {
        match (configuration(&file), &mut file.front_end) {
            (Err(_), Some(front_end)) if front_end.oversampling > 1 => front_end.oversampling /= 2,
            (outcome, _) => return outcome.map(|_| file),
        }
    }
}

/// As [`configuration`], for a board that is to send what it converts.
///
/// # Errors
/// Those of [`configuration`], and if a word on the wire does not hold the sum of its conversions.
pub fn board_configuration(file: &SceneFile) -> Result<Configuration, TimingError> {
    let configuration = configuration(file)?;
    match file.front_end {
        Some(FrontEnd { adc_bits: bits, oversampling, .. }) if !AdcScaling::fits_a_word(bits, oversampling) => {
            let text = format!(
                " sums {oversampling} conversions of {bits} bits, more than the 16 bits of a word on the wire; lower \
                 front_end.oversampling or front_end.adc_bits"
            );
            Err(TimingError::FrontEnd(file.name.clone(), text))
        }
        _ => Ok(configuration),
    }
}

/// The configuration of a board for `file`: its lighting slots, each just long enough for settling and
/// conversions, at nominal emitter levels.
///
/// # Errors
/// If the scene has no front end, or one whose schedule does not fit its frame period.
pub fn configuration(file: &SceneFile) -> Result<Configuration, TimingError> {
    let scene = || file.name.clone();
    let front_end = file.front_end.ok_or_else(|| TimingError::NoFrontEnd(scene()))?;
    let oversampling = u16::try_from(front_end.oversampling)
        .ok()
        .filter(|&oversampling| oversampling <= MAX_OVERSAMPLING)
        .ok_or_else(|| {
            let text = format!(
                " sums {} conversions, a word on the wire holds {MAX_OVERSAMPLING}; lower front_end.oversampling",
                front_end.oversampling
            );
            TimingError::FrontEnd(scene(), text)
        })?;
    let ticks = |key: &str, value: f64, seconds: f64| {
        let ticks = (seconds * f64::from(TICK_HZ)).round();
        if ticks <= f64::from(u32::MAX) {
            Ok(ticks as u32)
        } else {
            let text = format!(": front_end.{key} = {value} is not a duration a timer of {TICK_HZ} Hz can count");
            Err(TimingError::FrontEnd(scene(), text))
        }
    };
    file.require_slots_fit()?;
    let settling_ticks = ticks("settling_s", front_end.settling_s, front_end.settling_s)?;
    let conversion_ticks = ticks("conversion_s", front_end.conversion_s, front_end.conversion_s)?.max(1);
    let frame_ticks = ticks("frame_rate_hz", front_end.frame_rate_hz, front_end.frame_period_s())?;
    let cells = file.scene.cells.len();
    let conversions = cells as u32 * u32::from(oversampling);
    let slot_ticks = conversions.saturating_mul(conversion_ticks).saturating_add(settling_ticks);
    let schedule = Schedule {
        tick_hz: TICK_HZ,
        frame_ticks,
        slots: file.lighting.slots.iter().map(|slot| EmitterSet::of(slot)).collect(),
        slot_ticks,
        settling_ticks,
        conversion_ticks,
        oversampling,
        cells: cells as u8,
    };
    schedule.validate().map_err(|source| TimingError::Schedule(scene(), source))?;
    let levels = [Level::NOMINAL; MAX_CELLS].into_iter().take(cells).collect();
    Ok(Configuration { schedule, levels, exposure: Exposure::Fixed })
}

#[cfg(test)]
mod tests;

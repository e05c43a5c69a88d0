//! The schedule of a board, from a scene's lighting and electronics.

use slitpose_protocol::{
    AdcScaling, Configuration, EmitterSet, Exposure, Level, MAX_CELLS, MAX_OVERSAMPLING, Schedule, ScheduleError,
};
use thiserror::Error;

use crate::scene_file::{FrontEnd, SceneFile, SceneFileError};

/// Device ticks per second of schedules from scenes. A board whose timers count at another rate rejects
/// them, and names both rates.
const TICK_HZ: u32 = 170_000_000;

/// Why a board cannot run a scene.
#[derive(Debug, Error)]
pub enum TimingError {
    /// A scene that has no front end.
    #[error("scene `{0}` has no [front_end], so no board can sample it; add one, or use the shipped scene `wide`")]
    NoFrontEnd(String),
    /// A scene whose front end no board can have: why, and what to change.
    #[error("scene `{0}`{1}")]
    FrontEnd(String, String),
    /// Slots that take longer than a frame.
    #[error(transparent)]
    Slots(#[from] SceneFileError),
    /// A scene with a schedule that no board can run.
    #[error("scene `{0}`: the schedule cannot be run; change [lighting] or [front_end]")]
    Schedule(String, #[source] ScheduleError),
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
mod tests {
    use super::*;
    use crate::scene_file::Shipped;

    fn wide() -> SceneFile {
        Shipped::named("wide").expect("shipped").read().expect("valid")
    }

    #[test]
    fn the_default_scene_runs_at_4_khz_with_a_third_of_the_frame_idle() {
        let Configuration { schedule, levels, .. } = configuration(&wide()).unwrap();
        assert_eq!(schedule.frame_rate_hz(), 4000.0);
        assert_eq!((schedule.slots.len(), levels.len(), schedule.words_per_scan()), (4, 6, 24));
        let busy = 4.0 * f64::from(schedule.slot_ticks) / f64::from(schedule.frame_ticks);
        assert!((0.5..0.67).contains(&busy), "{busy}");
    }

    #[test]
    fn a_board_whose_words_are_too_narrow_is_refused_but_not_its_noise() {
        let mut file = wide();
        // 4 · 16 383 = 65 532 fits 16 bits, 4 · 32 767 does not; one conversion of 16 bits does.
        for (bits, oversampling, fits) in [(12, 16, true), (14, 4, true), (15, 4, false), (16, 1, true), (16, 2, false)]
        {
            let front_end = file.front_end.as_mut().unwrap();
            (front_end.adc_bits, front_end.oversampling, front_end.frame_rate_hz) = (bits, oversampling, 1000.0);
            assert!(configuration(&file).is_ok());
            match board_configuration(&file) {
                Ok(_) => assert!(fits, "{bits}, {oversampling}"),
                Err(error) => assert!(!fits && error.to_string().contains(&format!("{bits} bits")), "{error}"),
            }
        }
    }

    #[test]
    fn a_schedule_that_does_not_fit_is_refused() {
        let mut file = wide();
        file.front_end.as_mut().unwrap().frame_rate_hz = 8000.0;
        let refused = configuration(&file).unwrap_err().to_string();
        assert!(refused.contains("4 slots of ") && refused.contains("the frame period is 125.0 µs"), "{refused}");
        file.front_end.as_mut().unwrap().oversampling = 32;
        assert!(configuration(&file).unwrap_err().to_string().contains("32"));
        file.front_end = None;
        assert!(configuration(&file).unwrap_err().to_string().contains("[front_end]"));
    }
}

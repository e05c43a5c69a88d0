//! The wiring of cells, emitters and level lines, as far as it limits a configuration.

use slitpose_protocol::{Configuration, HardwareFault, Level, MAX_CELLS, Schedule};

/// Cells the board has converters and emitter drivers for.
pub const CHANNELS: u8 = 6;

/// Level lines: each sets the current of three emitters together.
pub const LEVEL_LINES: usize = 2;

/// The level line of an emitter: 0 to 2 are on the first, 3 to 5 on the second, so that
/// opposite emitters of a head, which are lit in pairs, have a line each.
pub const fn level_line(emitter: usize) -> usize {
    if emitter < CHANNELS as usize / LEVEL_LINES { 0 } else { 1 }
}

/// The highest level that a level line reaches: the output buffer of its DAC ends 0.2 V
/// below the supply, at code 3847 of 4095; this level is code 3840.
const HIGHEST: Level = Level(0xf000);

/// Longest pulse for which the emitters may carry more than their continuous current,
/// seconds: the pulse of data sheets' surge and peak ratings.
const PULSE_S: f32 = 100e-6;

/// Largest share of time an emitter may be lit at more than its continuous current.
const DUTY: f32 = 0.25;

/// The highest level an emitter may be driven at by `schedule`: 1.875 times nominal in short
/// pulses with long pauses, on average less than half the continuous current; otherwise
/// nominal, the emitters' continuous rating.
pub fn highest_level(schedule: &Schedule) -> Level {
    let (lit, frame) = (schedule.slot_ticks as f32, schedule.frame_ticks as f32);
    let is_pulse = lit <= PULSE_S * schedule.tick_hz as f32 && lit <= DUTY * frame;
    if is_pulse { HIGHEST } else { Level::NOMINAL }
}

/// Checks that the emitters can be driven as `configuration` says.
///
/// # Errors
/// If a level is too high for the schedule's pulses, or two emitters that are lit together
/// share a level line and ask for different levels.
pub fn check_levels(configuration: &Configuration) -> Result<(), HardwareFault> {
    let Configuration { schedule, levels, .. } = configuration;
    let highest = highest_level(schedule);
    if levels.iter().any(|&level| level > highest) {
        return Err(HardwareFault::Emitters);
    }
    for slot in &schedule.slots {
        let mut first_on_line = [None; LEVEL_LINES];
        for emitter in slot.emitters() {
            let first = *first_on_line[level_line(emitter)].get_or_insert(emitter);
            if levels.get(first) != levels.get(emitter) {
                return Err(HardwareFault::SharedLevel { first: first as u8, second: emitter as u8 });
            }
        }
    }
    Ok(())
}

/// Lowers `levels` to the highest that `schedule` allows, and to the lowest of the emitters
/// that are lit together on a level line.
pub fn limit_levels(schedule: &Schedule, levels: &mut [Level]) {
    let highest = highest_level(schedule);
    levels.iter_mut().for_each(|level| *level = (*level).min(highest));
    agree(schedule, levels);
}

/// Lowers levels until emitters that are lit together on a level line agree.
fn agree(schedule: &Schedule, levels: &mut [Level]) {
    for slot in &schedule.slots {
        let mut lowest = [Level(u16::MAX); LEVEL_LINES];
        for (emitter, level) in levels.iter().enumerate().filter(|&(emitter, _)| slot.contains(emitter)) {
            let line = &mut lowest[level_line(emitter)];
            *line = (*line).min(*level);
        }
        for (emitter, level) in levels.iter_mut().enumerate().filter(|&(emitter, _)| slot.contains(emitter)) {
            *level = lowest[level_line(emitter)];
        }
    }
}

const _: () = assert!(CHANNELS as usize <= MAX_CELLS);

#[cfg(test)]
mod tests {
    use slitpose_protocol::EmitterSet;

    use super::*;
    use crate::pcb::default_configuration;

    #[test]
    fn short_rare_pulses_are_allowed_levels_above_nominal_and_others_are_not() {
        let mut configuration = default_configuration();
        configuration.levels[4] = HIGHEST;
        assert_eq!(check_levels(&configuration), Ok(()));
        configuration.levels[4] = Level(HIGHEST.0 + 1);
        assert_eq!(check_levels(&configuration), Err(HardwareFault::Emitters));
        configuration.levels[4] = HIGHEST;
        // Half of the time: no more than nominal.
        configuration.schedule.frame_ticks = 2 * configuration.schedule.slot_ticks;
        assert_eq!(check_levels(&configuration), Err(HardwareFault::Emitters));
        configuration.levels[4] = Level::NOMINAL;
        assert_eq!(check_levels(&configuration), Ok(()));
        // Rare, but 101 µs long.
        configuration.schedule.slot_ticks = 17_170;
        configuration.schedule.frame_ticks = u32::MAX;
        assert_eq!(highest_level(&configuration.schedule), Level::NOMINAL);
    }

    #[test]
    fn emitters_lit_together_on_a_line_are_refused_different_levels() {
        let mut configuration = default_configuration();
        configuration.levels[1] = Level(7);
        assert_eq!(check_levels(&configuration), Ok(()), "pairs have a line each");
        configuration.schedule.slots.clear();
        let all = EmitterSet::of(&[0, 1, 2, 3, 4, 5]);
        configuration.schedule.slots.push(all).unwrap();
        let shared = HardwareFault::SharedLevel { first: 0, second: 1 };
        assert_eq!(check_levels(&configuration), Err(shared));
        agree(&configuration.schedule, &mut configuration.levels);
        assert_eq!(check_levels(&configuration), Ok(()));
        assert_eq!(configuration.levels[..3], [Level(7); 3]);
        assert_eq!(configuration.levels[3..], [Level::NOMINAL; 3]);
    }
}

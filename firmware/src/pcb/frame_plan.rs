//! From a configuration to the settings of timers, converters and DMA.
//!
//! ```text
//! timer    0────────────────────────────────────────period   one period a slot
//! emitters on (update)                                        the last slot's period is
//! trigger        ▲ compare                                    longer by the frame's idle
//! sampling time  └─24.5─┤hold                                 rest; emitters go off at
//! conversions           │ 0 │ 1 │ … │ ranks · oversampling    slot_ticks
//! ```
//! A word belongs to the instant at which its samples are held, the end of the sampling
//! time. The trigger is therefore early by the sampling time and the converters' latency.
//!
//! A conversion that comes late after another may be wrong (ES0430, "Wrong ADC result if conversion done late
//! after calibration or previous conversion": by more than 1 ms). Where a schedule has such a pause, each slot
//! converts its first cell once more, ahead of all others, and that word is not handed out.
//!
//! Times are in ticks of the timer, which runs at the processor's clock.

use heapless::Vec;
use slitpose_protocol::{Configuration, HardwareFault, Level, Schedule};

use super::TICK_HZ;
use super::wiring::{CHANNELS, LEVEL_LINES, check_levels, level_line};

/// Ticks of one period of the converters' clock: 170 MHz / 4 = 42.5 MHz, under the limit
/// for several converters at once (STM32G474 data sheet, ADC characteristics).
pub const ADC_CLOCK_TICKS: u32 = 4;

/// Ticks from the trigger's edge to the start of the first sampling time: two periods of
/// the converters' clock (RM0440, ADC timing: t_LATR).
pub const TRIGGER_LATENCY_TICKS: u32 = 2 * ADC_CLOCK_TICKS;

/// Sampling times of the converters, in half periods of their clock, in the order of their
/// codes (RM0440, ADC_SMPR1).
const SAMPLING_HALF_CLOCKS: [u32; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];

/// The first code whose sampling time is long enough for the circuit at the pins. The sampling capacitor of 5 pF
/// (DS12288, C_ADC) still has the voltage of the cell before, up to 4 096 codes away. It takes 5/(470 + 5) of that
/// difference from the capacitor at the pin, 43 codes, which come back through 220 Ω: with 0.104 µs to half a code
/// within 0.104 µs · ln(43/0.5) = 0.47 µs. Code 3 has 24.5 periods, 0.58 µs; code 2 would leave 2.6 codes.
const MIN_SAMPLING_CODE: usize = 3;

/// Ticks without a conversion after which the next one may be wrong: the 1 ms of ES0430, less a tenth for a clock
/// that runs late.
pub const STALE_TICKS: u32 = TICK_HZ / 1_000 / 10 * 9;

/// Half periods from the hold to the end of a conversion of twelve bits.
const CONVERSION_HALF_CLOCKS: u32 = 25;

/// Slots of any schedule that lights each of the board's emitters once.
pub const BOARD_SLOTS: usize = CHANNELS as usize + 1;

/// Ticks after the end of the last conversion until the DMA has surely written its word.
const DMA_TICKS: u32 = 170;

/// Ticks of the shortest frame: above 20 kHz frames cannot be read and sent fast enough.
pub const MIN_FRAME_TICKS: u32 = TICK_HZ / 20_000;

/// Ticks of the longest frame: 12.6 seconds, half the range of the counter.
pub const MAX_FRAME_TICKS: u32 = i32::MAX as u32;

/// Ticks by which the emitters of a last slot with an idle rest go off before its end. The
/// compare event comes in every slot, so it must stay clear of the next slot's start. The
/// event must also come after the last hold, one conversion before the slot's end: 60
/// ticks at least.
const OFF_LEAD_TICKS: u32 = 32;

/// Ticks by which the guard is at least later than the trigger that it waits for, and earlier than the next frame's
/// light: what DMA may take on a busy bus.
const GUARD_TICKS: u32 = 512;

/// Code of the DACs at nominal level: the middle of their range.
const NOMINAL_CODE: u32 = 2048;

/// One frame, ready to be written to registers and DMA tables.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FramePlan {
    /// Code of the sampling time.
    pub sampling_code: u8,
    /// Binary logarithm of the conversions summed by the converters.
    pub oversampling_log2: u8,
    /// Words of each converter a slot: one a cell, and one ahead of them if [`Self::has_leading_word`].
    pub ranks: u8,
    /// Whether the first word of each slot is not handed out, because its conversion may come too late after the
    /// one before.
    pub has_leading_word: bool,
    /// Ticks from the start of a slot to the trigger.
    pub trigger_ticks: u32,
    /// Ticks from the start of a slot to the end of its last conversion, at the latest.
    pub converted_ticks: u32,
    /// Ticks from one slot to the next, for each slot.
    pub periods: Vec<u32, BOARD_SLOTS>,
    /// Emitters lit in each slot, bit k for emitter k.
    pub emitters: Vec<u8, BOARD_SLOTS>,
    /// Ticks from the start of the last slot until its emitters go off, if the slot is lit
    /// and an idle rest follows: 0.2 µs before the slot's end.
    pub off_ticks: Option<u32>,
    /// Ticks without a trigger after which all emitters go off.
    pub guard_ticks: u32,
    /// Whether that happens in the idle rest of every frame, once or more.
    pub guard_fires_in_rest: bool,
    /// Code of each level line in each slot.
    pub level_codes: [Vec<u16, BOARD_SLOTS>; LEVEL_LINES],
    /// Ticks of a frame.
    pub frame_ticks: u32,
    /// Ticks from the start of a frame until its last word is in memory.
    pub done_ticks: u32,
    /// For each cell, the index of its lit word among the words of a frame.
    pub lit_at: Vec<u8, { CHANNELS as usize }>,
    /// For each cell, the index of its dark word; empty without a dark slot.
    pub dark_at: Vec<u8, { CHANNELS as usize }>,
}

impl FramePlan {
    /// The plan of a valid configuration.
    ///
    /// # Errors
    /// What the board cannot do.
    pub fn new(configuration: &Configuration) -> Result<Self, HardwareFault> {
        let Configuration { schedule, levels, .. } = configuration;
        if schedule.cells > CHANNELS {
            return Err(HardwareFault::Channels { cells: schedule.cells, channels: CHANNELS });
        }
        if !schedule.oversampling.is_power_of_two() {
            return Err(HardwareFault::Oversampling { oversampling: schedule.oversampling });
        }
        if !(MIN_FRAME_TICKS..=MAX_FRAME_TICKS).contains(&schedule.frame_ticks) {
            return Err(HardwareFault::Timing);
        }
        check_levels(configuration)?;
        let sampling_code = sampling_code(schedule.conversion_ticks)?;
        let slots = schedule.slots.len();
        let idle = schedule.frame_ticks - slots as u32 * schedule.slot_ticks;
        // From the last conversion of a frame to the first of the next.
        let longest_pause = idle + schedule.slot_ticks - conversions_ticks(schedule);
        let has_leading_word = longest_pause > STALE_TICKS;
        let trigger_ticks = trigger_ticks(schedule, sampling_code, has_leading_word)?;
        let ranks = schedule.cells + u8::from(has_leading_word);
        // At most as many slots as emitters, and a dark slot.
        let mut periods: Vec<u32, BOARD_SLOTS> = (0..slots.min(BOARD_SLOTS)).map(|_| schedule.slot_ticks).collect();
        match periods.last_mut() {
            Some(last) if slots <= BOARD_SLOTS => *last += idle,
            _ => return Err(HardwareFault::Timing),
        }
        let (guard_ticks, guard_fires_in_rest) = guard(schedule.slot_ticks, trigger_ticks, idle);
        let last_is_lit = schedule.slots.last().is_some_and(|set| !set.is_dark());
        let first = u8::from(has_leading_word);
        let word = |slot: Option<usize>, cell: u8| slot.map(|slot| slot as u8 * ranks + first + cell);
        let cells = 0..schedule.cells;
        Ok(Self {
            sampling_code: sampling_code as u8,
            oversampling_log2: schedule.oversampling.trailing_zeros() as u8,
            ranks,
            has_leading_word,
            trigger_ticks,
            converted_ticks: converted_ticks(schedule),
            periods,
            emitters: schedule.slots.iter().map(|set| set.0 as u8).collect(),
            off_ticks: (last_is_lit && idle > 0).then(|| schedule.slot_ticks.saturating_sub(OFF_LEAD_TICKS)),
            guard_ticks,
            guard_fires_in_rest,
            level_codes: core::array::from_fn(|line| line_codes(schedule, levels, line)),
            frame_ticks: schedule.frame_ticks,
            done_ticks: done_ticks(schedule),
            lit_at: cells.clone().filter_map(|cell| word(schedule.lit_slot(cell.into()), cell)).collect(),
            dark_at: cells.filter_map(|cell| word(schedule.dark_slot(), cell)).collect(),
        })
    }

    /// Words each converter makes in a frame.
    pub fn words(&self) -> usize {
        self.periods.len() * usize::from(self.ranks)
    }

    /// Whether the level of a line is the same in all slots, so that it can be set once.
    pub fn is_level_constant(&self, line: usize) -> bool {
        self.level_codes[line].windows(2).all(|pair| pair[0] == pair[1])
    }
}

fn sampling_ticks(code: usize) -> u32 {
    SAMPLING_HALF_CLOCKS[code] * ADC_CLOCK_TICKS / 2
}

fn conversion_ticks(code: usize) -> u32 {
    sampling_ticks(code) + CONVERSION_HALF_CLOCKS * ADC_CLOCK_TICKS / 2
}

fn sampling_code(asked_ticks: u32) -> Result<usize, HardwareFault> {
    let distance = |code: &usize| conversion_ticks(*code).abs_diff(asked_ticks);
    let nearest = (MIN_SAMPLING_CODE..SAMPLING_HALF_CLOCKS.len()).min_by_key(distance).unwrap_or(MIN_SAMPLING_CODE);
    let nearest_ticks = conversion_ticks(nearest);
    if nearest_ticks == asked_ticks {
        Ok(nearest)
    } else {
        Err(HardwareFault::Conversion { asked_ticks, nearest_ticks })
    }
}

/// Ticks of the conversions of all cells in a slot.
fn conversions_ticks(schedule: &Schedule) -> u32 {
    u32::from(schedule.cells) * u32::from(schedule.oversampling) * schedule.conversion_ticks
}

fn trigger_ticks(schedule: &Schedule, sampling_code: usize, has_leading_word: bool) -> Result<u32, HardwareFault> {
    let leading = if has_leading_word { u32::from(schedule.oversampling) * schedule.conversion_ticks } else { 0 };
    let lead = TRIGGER_LATENCY_TICKS + sampling_ticks(sampling_code) + leading;
    // A trigger at the very start of a period would coincide with the update.
    let least_ticks = lead + 1;
    let asked_ticks = schedule.settling_ticks;
    if asked_ticks >= least_ticks {
        Ok(asked_ticks - lead)
    } else {
        Err(HardwareFault::Settling { asked_ticks, least_ticks })
    }
}

/// Ticks without a trigger after which the guard switches the emitters off, again and again, and whether it does so in
/// every idle rest. A short rest it outlasts. In a long one it comes every one to two slots, and for the last time just
/// before the next frame, whose light it leaves alone until that frame's first trigger.
fn guard(slot_ticks: u32, trigger_ticks: u32, idle_ticks: u32) -> (u32, bool) {
    let least = slot_ticks.saturating_add(GUARD_TICKS);
    // The guard counts in steps of up to 2⁻¹⁶ of its time.
    let lead = trigger_ticks + GUARD_TICKS + (idle_ticks >> 14);
    match (slot_ticks.saturating_add(idle_ticks)).checked_sub(lead) {
        Some(reach) if reach >= least => (reach / (reach / least), true),
        _ => (least.saturating_add(idle_ticks), false),
    }
}

fn converted_ticks(schedule: &Schedule) -> u32 {
    // Counted from the hold of the first conversion. The hold of the last conversion is one
    // conversion earlier than this sum, which therefore covers its end.
    schedule.settling_ticks + conversions_ticks(schedule)
}

fn done_ticks(schedule: &Schedule) -> u32 {
    let last_slot = (schedule.slots.len() as u32 - 1) * schedule.slot_ticks;
    last_slot + converted_ticks(schedule) + DMA_TICKS
}

/// Codes of a level line, slot by slot. A slot that lights no emitter of the line keeps the
/// code of the slot before.
fn line_codes(schedule: &Schedule, levels: &[Level], line: usize) -> Vec<u16, BOARD_SLOTS> {
    let of_slot = |slot: usize| {
        let emitter = schedule.slots[slot].emitters().find(|&emitter| level_line(emitter) == line)?;
        levels.get(emitter).map(|&level| level_code(level))
    };
    let slots = schedule.slots.len().min(BOARD_SLOTS);
    let mut last = (0..slots).rev().find_map(of_slot).unwrap_or(0);
    let codes = (0..slots).map(|slot| {
        last = of_slot(slot).unwrap_or(last);
        last
    });
    codes.collect()
}

fn level_code(level: Level) -> u16 {
    let nominal = u32::from(Level::NOMINAL.0);
    ((u32::from(level.0) * NOMINAL_CODE + nominal / 2) / nominal) as u16
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::EmitterSet;

    use super::*;
    use crate::pcb::default_configuration;

    fn refused(change: impl FnOnce(&mut Configuration)) -> HardwareFault {
        let mut configuration = default_configuration();
        change(&mut configuration);
        FramePlan::new(&configuration).unwrap_err()
    }

    #[test]
    fn the_guard_waits_for_no_trigger_in_vain_but_in_a_rest() {
        // Slots of 5 800 ticks with the trigger at 2 104: the last chance before the next frame's light is 512 before it.
        assert_eq!(guard(5_800, 2_104, 2_104 + 1_024), (5_800 + 512, true));
        assert_eq!(guard(5_800, 2_104, 2_104 + 1_023), (5_800 + 2_104 + 1_023 + 512, false));
        assert_eq!(guard(5_800, 2_104, 0), (6_312, false));
        for idle in [4_000, 19_300, 100_000, 10_000_000, MAX_FRAME_TICKS - 4 * 5_800] {
            let (ticks, fires_in_rest) = guard(5_800, 2_104, idle);
            assert!(fires_in_rest && (6_312..2 * 6_312).contains(&ticks), "{ticks}");
            // From the last trigger of a frame to the next frame's light and first trigger.
            let (light, trigger) = (5_800 - 2_104 + idle, 5_800 + idle);
            let last = trigger / ticks * ticks;
            assert!(last <= light - 512, "{idle}: {last} of {light}");
        }
        let plan = FramePlan::new(&default_configuration()).unwrap();
        assert_eq!((plan.guard_ticks, plan.guard_fires_in_rest), (7_494, true));
    }

    #[test]
    fn a_configuration_beyond_the_parts_is_refused_with_the_numbers_that_disagree() {
        let nearest = |c: u32| HardwareFault::Conversion { asked_ticks: c, nearest_ticks: 148 };
        assert_eq!(refused(|c| c.schedule.conversion_ticks = 150), nearest(150));
        assert_eq!(refused(|c| c.schedule.oversampling = 3), HardwareFault::Oversampling { oversampling: 3 });
        let short = HardwareFault::Settling { asked_ticks: 106, least_ticks: 107 };
        assert_eq!(refused(|c| c.schedule.settling_ticks = 106), short);
        assert_eq!(refused(|c| c.schedule.cells = 7), HardwareFault::Channels { cells: 7, channels: 6 });
        let mut configuration = default_configuration();
        configuration.schedule.settling_ticks = 107;
        assert_eq!(FramePlan::new(&configuration).unwrap().trigger_ticks, 1);
    }

    #[test]
    fn frames_too_short_to_read_or_too_long_to_count_are_refused() {
        let frame = |ticks| {
            let mut configuration = default_configuration();
            let schedule = &mut configuration.schedule;
            schedule.slots.truncate(1);
            schedule.slots[0] = EmitterSet::of(&[0]);
            (schedule.cells, schedule.slot_ticks, schedule.frame_ticks) = (1, ticks, ticks);
            schedule.settling_ticks = ticks - 4 * 148;
            configuration.levels.truncate(1);
            assert_eq!(configuration.schedule.validate(), Ok(()));
            FramePlan::new(&configuration)
        };
        assert_eq!(frame(MIN_FRAME_TICKS - 1), Err(HardwareFault::Timing));
        assert_eq!(frame(u32::MAX), Err(HardwareFault::Timing));
        assert!(frame(MIN_FRAME_TICKS).is_ok());
        assert!(frame(MAX_FRAME_TICKS).is_ok_and(|plan| plan.done_ticks > MAX_FRAME_TICKS));
    }

    #[test]
    fn words_and_the_end_of_a_frame_are_where_the_schedule_has_them() {
        let configuration = default_configuration();
        let plan = FramePlan::new(&configuration).unwrap();
        assert_eq!(plan.lit_at, [0, 7, 14, 3, 10, 17]);
        assert_eq!(plan.dark_at, [18, 19, 20, 21, 22, 23]);
        let Schedule { conversion_ticks, .. } = configuration.schedule;
        let sampled = configuration.schedule.last_sample_ticks() as u32 + conversion_ticks;
        assert_eq!(plan.done_ticks, sampled + DMA_TICKS);
    }

    #[test]
    fn a_line_has_its_level_before_its_first_emitter_is_lit() {
        let mut configuration = default_configuration();
        configuration.schedule.slots.rotate_right(1);
        let plan = FramePlan::new(&configuration).unwrap();
        assert!(plan.level_codes.iter().all(|codes| codes[..] == [2_048; 4]), "{:?}", plan.level_codes);
    }
}

//! A configuration for unit tests of the core.

use slitpose_protocol::{Configuration, EmitterSet, Exposure, Level, MAX_CELLS, Schedule};

/// Ticks per millisecond of [`configuration`].
pub(crate) const TICKS_PER_MS: u64 = 170_000;

/// Six cells in three slots of two emitters and a dark slot, 4 000 frames a second, four
/// conversions a word, nominal levels.
pub(crate) fn configuration() -> Configuration {
    let slots = [EmitterSet::of(&[0, 3]), EmitterSet::of(&[1, 4]), EmitterSet::of(&[2, 5]), EmitterSet::DARK];
    Configuration {
        schedule: Schedule {
            tick_hz: 170_000_000,
            frame_ticks: 42_500,
            slots: slots.into_iter().collect(),
            slot_ticks: 6_000,
            settling_ticks: 2_000,
            conversion_ticks: 150,
            oversampling: 4,
            cells: 6,
        },
        levels: [Level::NOMINAL; MAX_CELLS].into_iter().take(6).collect(),
        exposure: Exposure::Fixed,
    }
}

//! The time model: when each emitter is lit, and when each word is sampled.
//!
//! A frame starts at a device tick and is divided into equal slots. In each slot a set
//! of emitters is lit (or none: the dark slot), the front end settles, and then the
//! ADC pair samples every cell in rank order, `oversampling` conversions for each.
//! Cell k has rank k and emitter k; I_X1 is converted by ADC1 and I_X2 by ADC2 at
//! the same instant. Conversion j of rank r in slot s is therefore sampled at
//!
//! ```text
//! frame tick + s·slot_ticks + settling_ticks + (r·oversampling + j)·conversion_ticks
//! ```
//!
//! A word is the sum of its conversions; its instant is their mean, with
//! j = (oversampling − 1)/2.
//!
//! Board, simulator and solver all compute their instants by this module. Ticks are
//! periods of the board's timer clock, `tick_hz` of them per second.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Largest number of cells (and so of emitters) a schedule may have.
pub const MAX_CELLS: usize = 16;

/// Largest number of slots: each emitter alone, and one dark slot.
pub const MAX_SLOTS: usize = MAX_CELLS + 1;

/// Largest number of conversions accumulated in one word: 16 · 4095 = 65 520 still
/// fits 16 bits, 17 · 4095 = 69 615 does not.
pub const MAX_OVERSAMPLING: u16 = 16;

/// A set of emitters lit together: bit k stands for emitter k.
///
/// ```
/// use slitpose_protocol::EmitterSet;
/// let opposite = EmitterSet::of(&[0, 3]);
/// assert!(opposite.contains(3) && !opposite.is_dark());
/// assert_eq!(opposite.emitters().collect::<Vec<_>>(), [0, 3]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct EmitterSet(pub u16);

impl EmitterSet {
    /// No emitter: the dark slot.
    pub const DARK: Self = Self(0);

    /// The set of the emitters listed.
    ///
    /// # Panics
    /// If an index is not below [`MAX_CELLS`].
    pub const fn of(emitters: &[usize]) -> Self {
        let mut mask = 0;
        let mut i = 0;
        while i < emitters.len() {
            assert!(emitters[i] < MAX_CELLS, "emitter index out of range");
            mask |= 1 << emitters[i];
            i += 1;
        }
        Self(mask)
    }

    /// Whether the set is empty.
    pub const fn is_dark(self) -> bool {
        self.0 == 0
    }

    /// Whether emitter `emitter` is in the set.
    pub const fn contains(self, emitter: usize) -> bool {
        emitter < MAX_CELLS && self.0 & (1 << emitter) != 0
    }

    /// The emitters of the set in rising order.
    pub fn emitters(self) -> impl Iterator<Item = usize> {
        (0..MAX_CELLS).filter(move |&k| self.contains(k))
    }
}

/// One frame of lighting and sampling, repeated without pause.
///
/// A schedule received over the wire may be invalid until [`validate`](Self::validate)
/// has accepted it. The other methods never panic, but their results are meaningless for
/// an invalid schedule.
///
/// ```
/// use slitpose_protocol::{EmitterSet, Schedule};
/// let slots = [EmitterSet::of(&[0, 2, 4]), EmitterSet::of(&[1, 3, 5]), EmitterSet::DARK];
/// let schedule = Schedule {
///     tick_hz: 170_000_000, frame_ticks: 42_500, slots: slots.into_iter().collect(), slot_ticks: 5_800,
///     settling_ticks: 2_210, conversion_ticks: 148, oversampling: 4, cells: 6,
/// };
/// assert_eq!(schedule.validate(), Ok(()));
/// assert_eq!((schedule.frame_rate_hz(), schedule.lit_slot(3), schedule.dark_slot()), (4_000.0, Some(1), Some(2)));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Schedule {
    /// Device ticks per second.
    pub tick_hz: u32,
    /// Ticks from one frame start to the next.
    pub frame_ticks: u32,
    /// Emitters lit in each slot, in the order of the slots.
    pub slots: Vec<EmitterSet, MAX_SLOTS>,
    /// Ticks from one slot start to the next.
    pub slot_ticks: u32,
    /// Ticks from the start of a slot to its first conversion.
    pub settling_ticks: u32,
    /// Ticks from one conversion to the next.
    pub conversion_ticks: u32,
    /// Conversions summed into one word, 1 to [`MAX_OVERSAMPLING`].
    pub oversampling: u16,
    /// Number of cells, 1 to [`MAX_CELLS`].
    pub cells: u8,
}

impl Schedule {
    /// Checks that the schedule can be run and lights the emitter of every cell.
    ///
    /// # Errors
    /// The first contradiction found, with its numbers.
    pub fn validate(&self) -> Result<(), ScheduleError> {
        self.check_numbers()?;
        self.check_lighting()?;
        self.check_fit()
    }

    fn check_numbers(&self) -> Result<(), ScheduleError> {
        if self.cells == 0 || usize::from(self.cells) > MAX_CELLS {
            return Err(ScheduleError::CellCount { cells: self.cells });
        }
        if self.oversampling == 0 || self.oversampling > MAX_OVERSAMPLING {
            return Err(ScheduleError::Oversampling { oversampling: self.oversampling });
        }
        for (value, quantity) in [
            (self.tick_hz, Quantity::TickRate),
            (self.frame_ticks, Quantity::Frame),
            (self.slot_ticks, Quantity::Slot),
            (self.conversion_ticks, Quantity::Conversion),
        ] {
            if value == 0 {
                return Err(ScheduleError::Zero(quantity));
            }
        }
        Ok(())
    }

    fn check_lighting(&self) -> Result<(), ScheduleError> {
        let mut lit_in = [None; MAX_CELLS];
        let mut dark_in = None;
        // At most MAX_SLOTS entries, so the index fits the u8 the errors carry.
        for (slot, set) in (0_u8..).zip(&self.slots) {
            if set.is_dark()
                && let Some(first_slot) = dark_in.replace(slot)
            {
                return Err(ScheduleError::DarkTwice { first_slot, second_slot: slot });
            }
            for (emitter, lit) in (0_u8..).zip(&mut lit_in) {
                if !set.contains(usize::from(emitter)) {
                    continue;
                }
                if emitter >= self.cells {
                    return Err(ScheduleError::UnknownEmitter { emitter, slot, cells: self.cells });
                }
                if let Some(first_slot) = lit.replace(slot) {
                    return Err(ScheduleError::LitTwice { emitter, first_slot, second_slot: slot });
                }
            }
        }
        for (emitter, lit) in (0..self.cells).zip(&lit_in) {
            if lit.is_none() {
                return Err(ScheduleError::NeverLit { emitter });
            }
        }
        Ok(())
    }

    fn check_fit(&self) -> Result<(), ScheduleError> {
        let conversions = u64::from(self.cells) * u64::from(self.oversampling);
        let needed_ticks = u64::from(self.settling_ticks) + conversions * u64::from(self.conversion_ticks);
        if needed_ticks > u64::from(self.slot_ticks) {
            return Err(ScheduleError::SlotTooShort { needed_ticks, slot_ticks: self.slot_ticks });
        }
        let needed_ticks = self.slots.len() as u64 * u64::from(self.slot_ticks);
        if needed_ticks > u64::from(self.frame_ticks) {
            return Err(ScheduleError::FrameTooShort { needed_ticks, frame_ticks: self.frame_ticks });
        }
        Ok(())
    }

    /// The slot in which the emitter of `cell` is lit; `None` if there is none.
    pub fn lit_slot(&self, cell: usize) -> Option<usize> {
        self.slots.iter().position(|set| set.contains(cell))
    }

    /// The slot in which no emitter is lit; `None` if the schedule has none.
    pub fn dark_slot(&self) -> Option<usize> {
        self.slots.iter().position(|set| set.is_dark())
    }

    /// Ticks from the frame start to the first conversion of `cell` in `slot`;
    /// `None` if the schedule lacks the slot or the cell.
    pub fn first_sample_ticks(&self, slot: usize, cell: usize) -> Option<u64> {
        if slot >= self.slots.len() || cell >= usize::from(self.cells) {
            return None;
        }
        let rank = cell as u64 * u64::from(self.oversampling);
        Some(
            slot as u64 * u64::from(self.slot_ticks)
                + u64::from(self.settling_ticks)
                + rank * u64::from(self.conversion_ticks),
        )
    }

    /// Ticks from the frame start to the mean instant of the lit word of `cell`;
    /// `None` if its emitter is never lit. A multiple of ½, and exact.
    pub fn lit_sample_ticks(&self, cell: usize) -> Option<f64> {
        let first = self.first_sample_ticks(self.lit_slot(cell)?, cell)?;
        let spread = u64::from(self.oversampling.saturating_sub(1)) * u64::from(self.conversion_ticks);
        Some(first as f64 + spread as f64 / 2.0)
    }

    /// Ticks from the frame start to the reference instant of a scan: the mean of the
    /// lit instants of all cells. It is the instant of the pose solved from the scan, and
    /// of its [`Truth`](crate::Truth). A constant velocity disturbs the pose least at
    /// this centre of the exposures.
    ///
    /// 0 for a schedule that lights nothing.
    pub fn reference_ticks(&self) -> f64 {
        let (sum, lit) = (0..usize::from(self.cells))
            .filter_map(|cell| self.lit_sample_ticks(cell))
            .fold((0.0, 0_u32), |(sum, lit), ticks| (sum + ticks, lit + 1));
        if lit == 0 { 0.0 } else { sum / f64::from(lit) }
    }

    /// Ticks from the frame start to the last conversion of a scan, its earliest possible
    /// arrival. 0 for a schedule that lights nothing.
    pub fn last_sample_ticks(&self) -> u64 {
        let spread = u64::from(self.oversampling.saturating_sub(1)) * u64::from(self.conversion_ticks);
        (0..usize::from(self.cells))
            .flat_map(|cell| [self.lit_slot(cell), self.dark_slot()].map(|slot| self.first_sample_ticks(slot?, cell)))
            .flatten()
            .max()
            .map_or(0, |first| first + spread)
    }

    /// Words of one scan on the wire: two lit words per cell, and two dark ones if there
    /// is a dark slot.
    pub fn words_per_scan(&self) -> usize {
        let lit = 2 * usize::from(self.cells);
        if self.dark_slot().is_some() { 2 * lit } else { lit }
    }

    /// Frames per second.
    pub fn frame_rate_hz(&self) -> f64 {
        f64::from(self.tick_hz) / f64::from(self.frame_ticks)
    }
}

/// A duration or rate of a [`Schedule`] that must not be zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quantity {
    /// `tick_hz`
    TickRate,
    /// `frame_ticks`
    Frame,
    /// `slot_ticks`
    Slot,
    /// `conversion_ticks`
    Conversion,
}

/// Why a [`Schedule`] cannot be run. It crosses the wire in a
/// [`Rejection`](crate::Rejection), variants numbered from 0 in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum ScheduleError {
    #[error("{cells} cells: give 1 to 16")]
    CellCount { cells: u8 },
    #[error("oversampling {oversampling}: give 1 to 16, the sum must fit a 16-bit word")]
    Oversampling { oversampling: u16 },
    #[error("{0:?} is zero ticks or hertz: give at least 1")]
    Zero(Quantity),
    #[error("slots {first_slot} and {second_slot} are both dark: keep one")]
    DarkTwice { first_slot: u8, second_slot: u8 },
    #[error("slot {slot} lights emitter {emitter}, but there are only {cells} cells")]
    UnknownEmitter { emitter: u8, slot: u8, cells: u8 },
    #[error("emitter {emitter} is lit in slots {first_slot} and {second_slot}: keep one")]
    LitTwice { emitter: u8, first_slot: u8, second_slot: u8 },
    #[error("emitter {emitter} is lit in no slot: add it to one")]
    NeverLit { emitter: u8 },
    #[error("settling and conversions take {needed_ticks} ticks, a slot has {slot_ticks}")]
    SlotTooShort { needed_ticks: u64, slot_ticks: u32 },
    #[error("the slots take {needed_ticks} ticks, a frame has {frame_ticks}")]
    FrameTooShort { needed_ticks: u64, frame_ticks: u32 },
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Opposite pairs and a dark slot at 4 kHz; slots of 34 µs.
    fn pairs() -> Schedule {
        Schedule {
            tick_hz: 170_000_000,
            frame_ticks: 42_500,
            slots: Vec::from_array([
                EmitterSet::of(&[0, 3]),
                EmitterSet::of(&[1, 4]),
                EmitterSet::of(&[2, 5]),
                EmitterSet::DARK,
            ]),
            slot_ticks: 5_800,
            settling_ticks: 2_210,
            conversion_ticks: 148,
            oversampling: 4,
            cells: 6,
        }
    }

    fn refused(change: impl FnOnce(&mut Schedule)) -> ScheduleError {
        let mut schedule = pairs();
        change(&mut schedule);
        schedule.validate().unwrap_err()
    }

    #[test]
    fn instants_follow_slot_rank_and_conversion() {
        let schedule = pairs();
        assert_eq!(schedule.validate(), Ok(()));
        assert_eq!(schedule.frame_rate_hz(), 4_000.0);
        assert_eq!(schedule.words_per_scan(), 24);
        assert_eq!(schedule.lit_slot(4), Some(1));
        assert_eq!(schedule.dark_slot(), Some(3));
        let first = 5_800 + 2_210 + 4 * 4 * 148;
        assert_eq!(schedule.first_sample_ticks(1, 4), Some(first));
        assert_eq!(schedule.lit_sample_ticks(4), Some(first as f64 + 222.0));
        // Cells 0 to 5 lie in slots 0, 1, 2, 0, 1, 2: on average slot 1, rank 2½.
        assert_eq!(schedule.reference_ticks(), 5_800.0 + 2_210.0 + 2.5 * 592.0 + 222.0);
        // The 24th conversion of the dark slot.
        assert_eq!(schedule.last_sample_ticks(), 3 * 5_800 + 2_210 + 23 * 148);
    }

    #[test]
    fn half_ticks_are_exact() {
        let schedule = Schedule { oversampling: 2, conversion_ticks: 149, ..pairs() };
        assert_eq!(schedule.lit_sample_ticks(0), Some(2_284.5));
    }

    #[test]
    fn what_is_not_there_has_no_instant() {
        let mut schedule = pairs();
        assert_eq!(schedule.first_sample_ticks(4, 0), None);
        assert_eq!(schedule.first_sample_ticks(0, 6), None);
        assert_eq!(schedule.lit_sample_ticks(usize::MAX), None);
        schedule.slots.pop();
        assert_eq!(schedule.validate(), Ok(()));
        assert_eq!(schedule.words_per_scan(), 12);
        // Without it the last is that of cell 5, in slot 2.
        assert_eq!(schedule.last_sample_ticks(), 2 * 5_800 + 2_210 + 23 * 148);
        schedule.slots.clear();
        assert_eq!(schedule.reference_ticks(), 0.0);
        assert_eq!(schedule.last_sample_ticks(), 0);
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        for cells in [0, 17, 255] {
            let error = ScheduleError::CellCount { cells };
            assert_eq!(refused(|s| s.cells = cells), error);
        }
        for oversampling in [0, 17] {
            let error = ScheduleError::Oversampling { oversampling };
            assert_eq!(refused(|s| s.oversampling = oversampling), error);
        }
        let zero = ScheduleError::Zero;
        assert_eq!(refused(|s| s.tick_hz = 0), zero(Quantity::TickRate));
        assert_eq!(refused(|s| s.frame_ticks = 0), zero(Quantity::Frame));
        assert_eq!(refused(|s| s.slot_ticks = 0), zero(Quantity::Slot));
        assert_eq!(refused(|s| s.conversion_ticks = 0), zero(Quantity::Conversion));
    }

    #[test]
    fn every_emitter_is_lit_once() {
        assert_eq!(refused(|s| s.slots[1] = EmitterSet::of(&[4])), ScheduleError::NeverLit { emitter: 1 });
        assert_eq!(
            refused(|s| s.slots[2] = EmitterSet::of(&[2, 3, 5])),
            ScheduleError::LitTwice { emitter: 3, first_slot: 0, second_slot: 2 }
        );
        assert_eq!(
            refused(|s| s.slots[3] = EmitterSet::of(&[6])),
            ScheduleError::UnknownEmitter { emitter: 6, slot: 3, cells: 6 }
        );
        assert_eq!(
            refused(|s| s.slots.push(EmitterSet::DARK).unwrap()),
            ScheduleError::DarkTwice { first_slot: 3, second_slot: 4 }
        );
    }

    #[test]
    fn time_must_suffice_to_the_tick() {
        let needed_ticks = 2_210 + 24 * 148;
        let mut schedule = pairs();
        schedule.slot_ticks = needed_ticks as u32;
        schedule.frame_ticks = 4 * schedule.slot_ticks;
        assert_eq!(schedule.validate(), Ok(()));
        assert_eq!(
            refused(|s| s.slot_ticks = needed_ticks as u32 - 1),
            ScheduleError::SlotTooShort { needed_ticks, slot_ticks: 5_761 }
        );
        assert_eq!(
            refused(|s| s.frame_ticks = 23_199),
            ScheduleError::FrameTooShort { needed_ticks: 23_200, frame_ticks: 23_199 }
        );
    }
}

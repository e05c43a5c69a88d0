//! Errors of a schedule, as a board reports them to its host.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A duration or rate of a [`Schedule`](crate::Schedule) that must not be zero.
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

/// Why a [`Schedule`](crate::Schedule) cannot be run. It crosses the wire in a
/// [`Rejection`](crate::Rejection), variants numbered from 0 in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum ScheduleError {
    /// The number of cells is not in 1 to [`MAX_CELLS`](crate::MAX_CELLS).
    #[error("{cells} cells: give 1 to 16")]
    CellCount {
        /// Requested number of cells.
        cells: u8,
    },
    /// The number of conversions in a word is not in 1 to [`MAX_OVERSAMPLING`](crate::MAX_OVERSAMPLING).
    #[error("oversampling {oversampling}: give 1 to 16, the sum must fit a 16-bit word")]
    Oversampling {
        /// Requested number of conversions.
        oversampling: u16,
    },
    /// A quantity that divides or advances time is zero.
    #[error("{0:?} is zero ticks or hertz: give at least 1")]
    Zero(Quantity),
    /// Two slots are dark.
    #[error("slots {first_slot} and {second_slot} are both dark: keep one")]
    DarkTwice {
        /// Index of the first dark slot.
        first_slot: u8,
        /// Index of the second dark slot.
        second_slot: u8,
    },
    /// A slot lights an emitter that belongs to no cell.
    #[error("slot {slot} lights emitter {emitter}, but there are only {cells} cells")]
    UnknownEmitter {
        /// Index of the emitter.
        emitter: u8,
        /// Index of the slot.
        slot: u8,
        /// Number of cells.
        cells: u8,
    },
    /// An emitter is lit in two slots.
    #[error("emitter {emitter} is lit in slots {first_slot} and {second_slot}: keep one")]
    LitTwice {
        /// Index of the emitter.
        emitter: u8,
        /// Index of the first slot that lights it.
        first_slot: u8,
        /// Index of the second slot that lights it.
        second_slot: u8,
    },
    /// An emitter is lit in no slot.
    #[error("emitter {emitter} is lit in no slot: add it to one")]
    NeverLit {
        /// Index of the emitter.
        emitter: u8,
    },
    /// Settling and conversions do not fit a slot.
    #[error("settling and conversions take {needed_ticks} ticks, a slot has {slot_ticks}")]
    SlotTooShort {
        /// Ticks of settling and conversions together.
        needed_ticks: u64,
        /// Ticks of a slot.
        slot_ticks: u32,
    },
    /// The slots do not fit a frame.
    #[error("the slots take {needed_ticks} ticks, a frame has {frame_ticks}")]
    FrameTooShort {
        /// Ticks of all slots together.
        needed_ticks: u64,
        /// Ticks of a frame.
        frame_ticks: u32,
    },
}

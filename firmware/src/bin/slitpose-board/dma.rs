//! DMA of tables: each request moves one item, round and round or once.

use core::sync::atomic::{AtomicU16, AtomicU32};

use embassy_stm32::pac::bdma::Dma;
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::{DMA1, DMA2, DMAMUX1};

/// Channels of DMA1, which come first in the multiplexer.
const FIRST_CHANNELS: usize = 8;

/// A table that the DMA reads or writes while the firmware runs. Its items are atomic, so
/// that both may access them at any time.
#[derive(Debug, Clone, Copy)]
pub struct Table {
    address: u32,
    items: u16,
    size: Size,
}

impl Table {
    pub fn of_halves(items: &'static [AtomicU16]) -> Self {
        Self { address: items.as_ptr() as u32, items: items.len() as u16, size: Size::BITS16 }
    }

    pub fn of_words(items: &'static [AtomicU32]) -> Self {
        Self { address: items.as_ptr() as u32, items: items.len() as u16, size: Size::BITS32 }
    }

    /// A table of the bytes of words, the lowest of each first.
    #[cfg(feature = "pose")]
    pub fn of_bytes(words: &'static [AtomicU32]) -> Self {
        Self { address: words.as_ptr() as u32, items: 4 * words.len() as u16, size: Size::BITS8 }
    }
}

/// A channel of DMA1 or, with `SECOND`, of DMA2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel<const SECOND: bool = false> {
    index: usize,
    /// Number of its request line (RM0440, DMAMUX requests).
    request: u8,
}

impl<const SECOND: bool> Channel<SECOND> {
    const DMA: Dma = if SECOND { DMA2 } else { DMA1 };

    /// Channel `index` (from 0), driven by the request line `request`.
    pub const fn new(index: usize, request: u8) -> Self {
        Self { index, request }
    }

    /// Starts the channel: each request moves the next item of `table` to `register`.
    pub fn feed(self, register: *mut (), table: Table) {
        self.start(register, table, Dir::FROM_MEMORY);
    }

    /// Starts the channel: each request moves the content of `register` to the next item of
    /// `table`.
    pub fn collect(self, register: *mut (), table: Table) {
        self.start(register, table, Dir::FROM_PERIPHERAL);
    }

    #[inline(never)]
    fn start(self, register: *mut (), table: Table, direction: Dir) {
        self.set_up(register, table, direction, true);
        Self::DMA.ch(self.index).ndtr().write(|w| w.set_ndt(table.items));
        self.enable();
    }

    /// Prepares the channel for [`run_once`](Self::run_once): each request is to move the next item of `table` to
    /// `register`. It waits for all channels of [`feed`](Self::feed) and [`collect`](Self::collect).
    #[cfg(feature = "pose")]
    pub fn prepare_once(self, register: *mut (), table: Table) {
        self.set_up(register, table, Dir::FROM_MEMORY, false);
    }

    /// Moves the first `items` of the table of [`prepare_once`](Self::prepare_once), from the first on.
    #[cfg(feature = "pose")]
    pub fn run_once(self, items: u16) {
        self.stop();
        Self::DMA.ch(self.index).ndtr().write(|w| w.set_ndt(items));
        self.enable();
    }

    fn set_up(self, register: *mut (), table: Table, direction: Dir, is_circular: bool) {
        let channel = Self::DMA.ch(self.index);
        self.stop();
        let place = if SECOND { FIRST_CHANNELS + self.index } else { self.index };
        DMAMUX1.ccr(place).write(|w| w.set_dmareq_id(self.request));
        channel.par().write_value(register as u32);
        channel.mar().write_value(table.address);
        channel.cr().write(|w| {
            w.set_dir(direction);
            w.set_circ(is_circular);
            w.set_minc(true);
            w.set_psize(table.size);
            w.set_msize(table.size);
            w.set_pl(if is_circular { Pl::VERY_HIGH } else { Pl::LOW });
        });
    }

    fn enable(self) {
        Self::DMA.ch(self.index).cr().modify(|w| w.set_en(true));
    }

    /// Stops the channel and clears its flags, each by its own bit: a write to the global one may hide an error that
    /// comes at the same time (ES0548 of the STM32G0, "DMA disable failure and error flag omission upon simultaneous
    /// transfer error and global flag clear"; ES0430 has not been read for it).
    #[inline(never)]
    pub fn stop(self) {
        Self::DMA.ch(self.index).cr().modify(|w| w.set_en(false));
        Self::DMA.ifcr().write(|w| {
            w.set_tcif(self.index, true);
            w.set_htif(self.index, true);
            w.set_teif(self.index, true);
        });
    }

    /// Items left until the end of the table.
    pub fn remaining(self) -> u16 {
        Self::DMA.ch(self.index).ndtr().read().ndt()
    }

    /// Whether the channel has stopped at an address that does not answer.
    pub fn has_failed(self) -> bool {
        Self::DMA.isr().read().teif(self.index)
    }
}

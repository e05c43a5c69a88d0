//! DMA in circular mode: each request moves one item of a table.

use core::sync::atomic::{AtomicU16, AtomicU32};

use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::{DMA1, DMAMUX1};

/// A table that the DMA reads or writes while the firmware runs. Its items are atomic, so
/// that both may access them at any time.
#[derive(Debug, Clone, Copy)]
pub struct Table {
    address: u32,
    items: u16,
    size: Size,
}

impl Table {
    /// A table of half words.
    pub fn of_halves(items: &'static [AtomicU16]) -> Self {
        Self { address: items.as_ptr() as u32, items: items.len() as u16, size: Size::BITS16 }
    }

    /// A table of words.
    pub fn of_words(items: &'static [AtomicU32]) -> Self {
        Self { address: items.as_ptr() as u32, items: items.len() as u16, size: Size::BITS32 }
    }
}

/// A channel of DMA1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Channel {
    index: usize,
    /// Number of its request line (RM0440, DMAMUX requests).
    request: u8,
}

impl Channel {
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
        let channel = DMA1.ch(self.index);
        self.stop();
        DMAMUX1.ccr(self.index).write(|w| w.set_dmareq_id(self.request));
        channel.par().write_value(register as u32);
        channel.mar().write_value(table.address);
        channel.ndtr().write(|w| w.set_ndt(table.items));
        channel.cr().write(|w| {
            w.set_dir(direction);
            w.set_circ(true);
            w.set_minc(true);
            w.set_psize(table.size);
            w.set_msize(table.size);
            w.set_pl(Pl::VERY_HIGH);
        });
        channel.cr().modify(|w| w.set_en(true));
    }

    /// Stops the channel and clears its flags, each by its own bit: a write to the global one may hide an error that
    /// comes at the same time (ES0548 of the STM32G0, "DMA disable failure and error flag omission upon simultaneous
    /// transfer error and global flag clear"; ES0430 has not been read for it).
    #[inline(never)]
    pub fn stop(self) {
        DMA1.ch(self.index).cr().modify(|w| w.set_en(false));
        DMA1.ifcr().write(|w| {
            w.set_tcif(self.index, true);
            w.set_htif(self.index, true);
            w.set_teif(self.index, true);
        });
    }

    /// Items left until the end of the table.
    pub fn remaining(self) -> u16 {
        DMA1.ch(self.index).ndtr().read().ndt()
    }

    /// Whether the channel has stopped at an address that does not answer.
    pub fn has_failed(self) -> bool {
        DMA1.isr().read().teif(self.index)
    }
}

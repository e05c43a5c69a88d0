//! What faulty silicon does to the wires between the peripherals: late transfers, disturbed converters, a slow supply
//! detector, a crystal that fails, a troublesome USB host. Other faults are in the peripherals that have them.

use std::ops::RangeInclusive;

use super::Board;
use crate::faults::{DAC_REST_V, Fault, Faults};
use crate::memory::{Bits, CCM_BYTES, RAM_BASE, RAM_BYTES};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::usb_host::Order;

/// Fault dma-latency: ticks of a transfer.
const DMA_LATENCY_TICKS: RangeInclusive<u64> = 5..=60;
/// Fault usb-host: ticks for which the bus is suspended, 5 ms, and between two times, 0.2 to 0.6 s.
const USB_SUSPENDED_TICKS: Ticks = TICKS_PER_SECOND / 200;
const USB_PAUSE_TICKS: RangeInclusive<u64> = TICKS_PER_SECOND / 5..=TICKS_PER_SECOND / 5 * 3;
/// Fault pvd-slow: the detector's delay, 100 µs.
const PVD_TICKS: Ticks = TICKS_PER_SECOND / 10_000;

/// Fault sram-first-write: where the blocks of SRAM begin: three of SRAM1, SRAM2, CCM SRAM.
const BLOCKS: [usize; 5] = [0, 0x8000, 0x1_0000, 0x1_4000, RAM_BYTES - CCM_BYTES];

/// Fault sram-first-write: what has become of a block since the reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Block {
    Untouched,
    /// A write to this offset was lost.
    Lost(usize),
    Sound,
}

#[derive(Debug)]
pub(super) struct UnderWay {
    /// Fault dma-latency: transfers of DMA1 and DMA2.
    transfers: [Option<Transfer>; 2],
    /// Fault pvd-slow: when the detector's output follows the supply.
    pvd_due: Ticks,
    /// Fault usb-host: when the host next suspends or resets the bus, or lets it go on.
    usb_due: Ticks,
    blocks: [Block; BLOCKS.len()],
}

/// A DMA transfer that takes its time.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    channel: usize,
    request: u32,
    done: Ticks,
}

impl Default for UnderWay {
    fn default() -> Self {
        Self { transfers: [None; 2], pvd_due: Ticks::MAX, usb_due: Ticks::MAX, blocks: [Block::Sound; BLOCKS.len()] }
    }
}

impl UnderWay {
    /// When [`Board::handle_faults`] is to be called.
    #[inline]
    pub(super) fn next_event(&self) -> Ticks {
        let transfers = self.transfers.iter().flatten().map(|transfer| transfer.done);
        transfers.fold(self.pvd_due.min(self.usb_due), Ticks::min)
    }

    /// Reset: transfers under way are not made.
    pub(super) fn reset(&mut self) {
        self.transfers = [None; 2];
    }
}

impl Board {
    /// Gives the silicon its faults; before the board runs.
    pub fn set_faults(&mut self, faults: Faults, seed: u64) {
        self.effects.faults = faults;
        self.effects.chance = Bits::seeded(seed);
        self.effects.clock_phase = self.effects.chance.within(0..=3);
        if faults.has(Fault::DacRest) {
            self.dacs.iter_mut().for_each(|dac| dac.set_rest_v(DAC_REST_V));
        }
        self.forget_accesses();
        if faults.has(Fault::UsbHost) {
            self.under_way.usb_due = *USB_PAUSE_TICKS.start();
        }
        self.find_next_event();
    }

    /// A reset: no block of SRAM counts as touched, if the silicon has fault sram-first-write.
    pub(super) fn forget_accesses(&mut self) {
        self.loses_writes = self.effects.faults.has(Fault::SramFirstWrite);
        self.under_way.blocks.fill(if self.loses_writes { Block::Untouched } else { Block::Sound });
    }

    /// An access to RAM; whether it is a write that is lost. One that is not repeated at once breaks a rule.
    #[cold]
    pub(super) fn loses_access(&mut self, offset: usize, written: Option<u32>) -> bool {
        let index = BLOCKS.iter().rposition(|&start| start <= offset).unwrap_or(0);
        let before = self.under_way.blocks[index];
        let is_lost = before == Block::Untouched && written.is_some();
        self.under_way.blocks[index] = if is_lost { Block::Lost(offset) } else { Block::Sound };
        if matches!(before, Block::Lost(at) if at != offset || written.is_none()) {
            self.effects.address = RAM_BASE + offset as u32;
            let rule = "a first access to SRAM that is a write is lost: it is repeated before any other";
            self.effects.violation(written.unwrap_or(0), rule);
        }
        self.loses_writes = self.under_way.blocks.iter().any(|&block| block != Block::Sound);
        is_lost
    }

    /// Fault injection: the crystal stops, for good.
    pub fn stop_crystal(&mut self) {
        self.effects.faults = self.effects.faults.with(Fault::HseDead);
        self.rcc.lose_crystal(&mut self.effects);
    }

    pub(super) fn handle_faults(&mut self, now: Ticks) {
        for controller in 0..2 {
            if let Some(transfer) = self.under_way.transfers[controller].take_if(|transfer| transfer.done == now)
                // A channel that was stopped meanwhile lets go.
                && self.dma.is_enabled(transfer.channel)
            {
                self.carry_out(transfer.channel, transfer.request);
            }
        }
        if self.under_way.usb_due == now {
            self.under_way.usb_due = now + self.trouble_usb(now);
        }
        if self.under_way.pvd_due == now {
            self.under_way.pvd_due = Ticks::MAX;
            self.follow_pvd();
        }
    }

    /// Fault dma-latency: each controller that is free begins its next transfer. Gives whether one has.
    pub(super) fn begin_transfers(&mut self, ready: u128) -> bool {
        let mut has_begun = false;
        for (controller, transfer) in self.under_way.transfers.iter_mut().enumerate().filter(|(_, is)| is.is_none()) {
            let channels = 8 * controller..8 * (controller + 1);
            if let Some((channel, request)) = self.dma.select(ready, channels) {
                let done = self.effects.now + self.effects.chance.within(DMA_LATENCY_TICKS);
                *transfer = Some(Transfer { channel, request, done });
                has_begun = true;
            }
        }
        has_begun
    }

    #[inline]
    pub(super) fn disturb_neighbours(&mut self) {
        if self.effects.faults.has(Fault::AdcNeighbour) && self.adc12.is_converting() && self.adc345.is_converting() {
            self.adc12.disturb(&mut self.effects);
        }
    }

    /// Lets the detector see the supply: at once, or late with fault pvd-slow.
    pub(super) fn update_pvd(&mut self) {
        if self.effects.faults.has(Fault::PvdSlow) {
            self.under_way.pvd_due = self.effects.now + PVD_TICKS;
        } else {
            self.follow_pvd();
        }
    }

    /// Fault usb-host; gives the ticks until the next time.
    fn trouble_usb(&mut self, now: Ticks) -> Ticks {
        if self.usb_host.is_suspended() {
            self.usb_host.order(Order::Resume, now);
        } else if self.usb_host.dtr() && self.effects.chance.within(0..=2) == 0 {
            self.usb_host.order(Order::Reset, now);
        } else if self.usb_host.dtr() {
            self.usb_host.order(Order::Suspend, now);
            return USB_SUSPENDED_TICKS;
        }
        self.effects.chance.within(USB_PAUSE_TICKS)
    }
}

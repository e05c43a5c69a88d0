//! What faulty silicon does to the wires between the peripherals: late transfers, disturbed converters, a slow supply
//! detector, a crystal that fails, a troublesome USB host. Other faults are in the peripherals that have them.

use std::ops::RangeInclusive;

use super::Board;
use crate::memory::Bits;
use crate::peripherals::{Request, TICKS_PER_SECOND, Ticks};
use crate::silicon::{Fault, Silicon};
use crate::world::World;

/// Fault dma-latency: ticks of a transfer.
const DMA_LATENCY_TICKS: RangeInclusive<u64> = 5..=60;
/// Fault usb-host: ticks for which the bus is suspended, 5 ms, and between two times, 0.2 to 0.6 s.
const USB_SUSPENDED_TICKS: Ticks = TICKS_PER_SECOND / 200;
const USB_PAUSE_TICKS: RangeInclusive<u64> = TICKS_PER_SECOND / 5..=TICKS_PER_SECOND / 5 * 3;
/// Fault pvd-slow: the detector's delay, 100 µs.
const PVD_TICKS: Ticks = TICKS_PER_SECOND / 10_000;

/// What faults have under way.
#[derive(Debug)]
pub(super) struct Faults {
    /// Fault dma-latency: transfers of DMA1 and DMA2.
    transfers: [Option<Transfer>; 2],
    /// Fault pvd-slow: when the detector's output follows the supply.
    pvd_due: Ticks,
    /// Fault usb-host: when the host next suspends or resets the bus, or lets it go on.
    usb_due: Ticks,
}

/// A DMA transfer that takes its time.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    channel: usize,
    request: Request,
    done: Ticks,
}

impl Default for Faults {
    fn default() -> Self {
        Self { transfers: [None; 2], pvd_due: Ticks::MAX, usb_due: Ticks::MAX }
    }
}

impl Faults {
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

impl<W: World> Board<W> {
    /// Gives the silicon its faults; before the board runs.
    pub fn set_silicon(&mut self, silicon: Silicon, seed: u64) {
        self.effects.silicon = silicon;
        self.effects.chance = Bits::seeded(seed);
        self.effects.clock_phase = self.effects.chance.within(0..=3);
        if silicon.has(Fault::UsbHost) {
            self.faults.usb_due = *USB_PAUSE_TICKS.start();
        }
        self.find_next_event();
    }

    /// Fault injection: the crystal stops, for good.
    pub fn stop_crystal(&mut self) {
        self.effects.silicon = self.effects.silicon.with(Fault::HseDead);
        self.rcc.lose_crystal(&mut self.effects);
    }

    /// Does what is due now.
    pub(super) fn handle_faults(&mut self, now: Ticks) {
        for controller in 0..2 {
            if let Some(transfer) = self.faults.transfers[controller].take_if(|transfer| transfer.done == now)
                // A channel that was stopped meanwhile lets go.
                && self.dma.is_enabled(transfer.channel)
            {
                self.carry_out(transfer.channel, transfer.request);
            }
        }
        if self.faults.usb_due == now {
            self.faults.usb_due = now + self.trouble_usb(now);
        }
        if self.faults.pvd_due == now {
            self.faults.pvd_due = Ticks::MAX;
            self.follow_pvd();
        }
    }

    /// Fault dma-latency: each controller that is free begins its next transfer. Gives whether one has.
    pub(super) fn begin_transfers(&mut self, ready: u128) -> bool {
        let mut has_begun = false;
        for (controller, transfer) in self.faults.transfers.iter_mut().enumerate().filter(|(_, is)| is.is_none()) {
            let channels = 8 * controller..8 * (controller + 1);
            if let Some((channel, request)) = self.dma.select(ready, channels) {
                let done = self.effects.now() + self.effects.chance.within(DMA_LATENCY_TICKS);
                *transfer = Some(Transfer { channel, request, done });
                has_begun = true;
            }
        }
        has_begun
    }

    /// Fault adc-neighbour.
    #[inline]
    pub(super) fn disturb_neighbours(&mut self) {
        if self.effects.silicon.has(Fault::AdcNeighbour) && self.adc12.is_converting() && self.adc345.is_converting() {
            self.adc12.disturb(&mut self.effects);
        }
    }

    /// Lets the detector see the supply: at once, or late with fault pvd-slow.
    pub(super) fn update_pvd(&mut self) {
        if self.effects.silicon.has(Fault::PvdSlow) {
            self.faults.pvd_due = self.effects.now() + PVD_TICKS;
        } else {
            self.follow_pvd();
        }
    }

    /// Fault usb-host; gives the ticks until the next time.
    fn trouble_usb(&mut self, now: Ticks) -> Ticks {
        if self.usb_host.is_suspended() {
            self.usb_host.resume(now);
        } else if self.usb_host.dtr() && self.effects.chance.within(0..=2) == 0 {
            self.usb_host.reset_bus(now);
        } else if self.usb_host.dtr() {
            self.usb_host.suspend(now);
            return USB_SUSPENDED_TICKS;
        }
        self.effects.chance.within(USB_PAUSE_TICKS)
    }
}

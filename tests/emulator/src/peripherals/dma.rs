//! DMA1 and DMA2 with the request multiplexer before them (RM0440, "Direct memory access
//! controller" and "DMA request multiplexer").
//!
//! A request is served in the tick in which it arises; where several wait, by priority level,
//! then DMA1 before DMA2, then by channel number. The hardware takes about five bus cycles for
//! each transfer, and more on a busy bus: [`crate::faults::Fault::DmaLatency`]. Memory-to-memory transfers, synchronisation and request generators are not
//! modelled. The data move through the board, which owns the bus.

use super::{Effects, field};
use crate::st::DMA::{
    CCR_CIRC as CIRC, CCR_DIR as DIR, CCR_EN as EN, CCR_HTIE as HTIE, CCR_MEM2MEM as MEM2MEM, CCR_MINC as MINC,
    CCR_MSIZE_0, CCR_MSIZE_1, CCR_PINC as PINC, CCR_PL, CCR_PSIZE_0, CCR_PSIZE_1, CCR_TCIE as TCIE, CCR_TEIE as TEIE,
    Channel_CCR as CCR, Channel_CMAR as CMAR, Channel_CNDTR as CNDTR, Channel_CPAR as CPAR, IFCR, ISR, ISR_GIF1 as GIF,
    ISR_HTIF1 as HTIF, ISR_TCIF1 as TCIF, ISR_TEIF1 as TEIF,
};
use crate::st::DMAMUX::CxCR_EGE as MUX_EVENTS;
use crate::st::{DMA1, DMA2};

/// Channels of both controllers: DMA1 has 0 to 7, DMA2 has 8 to 15. DMAMUX counts the same way.
pub const CHANNELS: usize = 16;

const FIRST_CHANNEL: u32 = DMA1::Channel1_BASE - DMA1::BASE;
const CHANNEL_SPAN: u32 = DMA1::Channel2_BASE - DMA1::Channel1_BASE;

const MUX_LAST_CHANNEL: u32 = 0x3C;
const MUX_REQUEST: u32 = 0x7F;

/// Width of one side of a transfer, in bytes: 1, 2 or 4.
pub type Width = u32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    pub source: u32,
    pub source_width: Width,
    pub destination: u32,
    /// How wide it is written: the value is cut or extended with zeros.
    pub destination_width: Width,
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    ccr: u32,
    cndtr: u32,
    cpar: u32,
    cmar: u32,
    /// Flags GIF, TCIF, HTIF, TEIF.
    flags: u32,
    /// CNDTR as it was when the channel was enabled.
    total: u32,
    /// Items moved since the channel was enabled or has wrapped.
    moved: u32,
    /// DMAMUX_CxCR.
    mux: u32,
    fail_next: bool,
}

impl Channel {
    fn get(&self, register: u32) -> u32 {
        match register {
            CCR => self.ccr,
            CNDTR => self.cndtr,
            CPAR => self.cpar,
            _ => self.cmar,
        }
    }

    fn enabled(&self) -> bool {
        self.ccr & EN != 0
    }

    /// The request that this channel would serve now; 0: none.
    fn listens_to(&self) -> u32 {
        if self.enabled() && self.cndtr != 0 { self.mux & MUX_REQUEST } else { 0 }
    }

    fn priority(&self) -> u32 {
        field(self.ccr, CCR_PL)
    }

    fn interrupt(&self) -> bool {
        self.flags & self.ccr & (TCIE | HTIE | TEIE) != 0
    }

    fn transfer(&self) -> Transfer {
        let peripheral_width = 1 << field(self.ccr, CCR_PSIZE_0 | CCR_PSIZE_1).min(2);
        let memory_width = 1 << field(self.ccr, CCR_MSIZE_0 | CCR_MSIZE_1).min(2);
        let step = |increment: u32, width: Width| if self.ccr & increment != 0 { self.moved * width } else { 0 };
        let peripheral = (self.cpar.wrapping_add(step(PINC, peripheral_width)), peripheral_width);
        let memory = (self.cmar.wrapping_add(step(MINC, memory_width)), memory_width);
        let (from, to) = if self.ccr & DIR != 0 { (memory, peripheral) } else { (peripheral, memory) };
        Transfer { source: from.0, source_width: from.1, destination: to.0, destination_width: to.1 }
    }
}

#[derive(Debug, Default)]
pub struct Dma {
    channels: [Channel; CHANNELS],
    /// Requests that an enabled channel waits for, bit n for request n.
    wanted: u128,
}

impl Dma {
    pub fn new() -> Self {
        Self::default()
    }

    /// Resets controller 0 (DMA1) or 1 (DMA2); the multiplexer has a reset of its own.
    pub fn reset_controller(&mut self, controller: usize, effects: &mut Effects) {
        for index in 8 * controller..8 * controller + 8 {
            self.channels[index] = Channel { mux: self.channels[index].mux, ..Channel::default() };
            self.update_line(index, effects);
        }
        self.find_wanted();
    }

    pub fn reset_multiplexer(&mut self) {
        for channel in &mut self.channels {
            channel.mux = 0;
        }
        self.find_wanted();
    }

    /// Value of a register of controller 0 or 1.
    pub fn read(&mut self, controller: usize, offset: u32, effects: &mut Effects) -> u32 {
        let first = 8 * controller;
        match offset {
            ISR => (0..8).map(|index| self.channels[first + index].flags << (4 * index)).sum(),
            _ => match channel_register(offset) {
                Some((index, register)) => self.channels[first + index].get(register),
                None => {
                    effects.unmodelled();
                    0
                }
            },
        }
    }

    /// Writes a register of controller 0 or 1.
    pub fn write(&mut self, controller: usize, offset: u32, value: u32, effects: &mut Effects) {
        let first = 8 * controller;
        match offset {
            IFCR => {
                for index in 0..8 {
                    self.clear_flags(first + index, value >> (4 * index) & 0xF, effects);
                }
            }
            _ => match channel_register(offset) {
                Some((index, register)) => self.write_channel(first + index, register, value, effects),
                None => effects.unmodelled(),
            },
        }
    }

    pub fn read_multiplexer(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            0..=MUX_LAST_CHANNEL => self.channels[(offset / 4) as usize].mux,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    pub fn write_multiplexer(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            0..=MUX_LAST_CHANNEL => {
                let channel = &mut self.channels[(offset / 4) as usize];
                if channel.enabled() && channel.mux != value {
                    effects.violation(value, "DMAMUX_CxCR is written only while its DMA channel is disabled");
                }
                if value & !(MUX_REQUEST | MUX_EVENTS) != 0 {
                    effects.unmodelled();
                }
                channel.mux = value & (MUX_REQUEST | MUX_EVENTS);
                self.find_wanted();
                self.watch_sharing(value, effects);
            }
            _ => effects.unmodelled(),
        }
    }

    /// Requests that some channel waits for, bit n for request n.
    #[inline]
    pub fn wanted(&self) -> u128 {
        self.wanted
    }

    /// The channel of `channels` to serve next among the waiting requests `ready` (all of them wanted).
    pub fn select(&self, ready: u128, channels: std::ops::Range<usize>) -> Option<(usize, u32)> {
        let serves = |channel: &Channel| {
            let request = channel.listens_to();
            request != 0 && ready >> request & 1 != 0
        };
        let candidates =
            self.channels.iter().enumerate().filter(|(index, channel)| channels.contains(index) && serves(channel));
        let best = candidates.min_by_key(|(index, channel)| (3 - channel.priority(), *index));
        best.map(|(index, channel)| (index, channel.listens_to()))
    }

    pub fn is_enabled(&self, channel: usize) -> bool {
        self.channels[channel].enabled()
    }

    /// What `channel` moves next; an error if a fault was injected.
    pub fn transfer(&mut self, channel: usize) -> Option<Transfer> {
        let channel = &mut self.channels[channel];
        if std::mem::take(&mut channel.fail_next) { None } else { Some(channel.transfer()) }
    }

    /// Accounts for a transfer that was made (`true`) or refused by the bus (`false`).
    pub fn finish(&mut self, index: usize, moved: bool, effects: &mut Effects) {
        let channel = &mut self.channels[index];
        if !moved {
            // RM0440, "DMA error management": the channel is disabled by hardware.
            channel.flags |= TEIF | GIF;
            channel.ccr &= !EN;
            self.find_wanted();
            self.update_line(index, effects);
            return;
        }
        channel.moved += 1;
        channel.cndtr -= 1;
        if channel.cndtr == channel.total / 2 {
            channel.flags |= HTIF | GIF;
        }
        if channel.cndtr == 0 {
            channel.flags |= TCIF | GIF;
            if channel.ccr & CIRC != 0 {
                channel.cndtr = channel.total;
                channel.moved = 0;
            } else {
                self.find_wanted();
            }
        }
        self.update_line(index, effects);
    }

    /// Fault injection: the next transfer of `channel` (0 to 15) meets a bus error.
    pub fn fail_next(&mut self, channel: usize) {
        self.channels[channel].fail_next = true;
    }

    fn write_channel(&mut self, index: usize, register: u32, value: u32, effects: &mut Effects) {
        let channel = &mut self.channels[index];
        if channel.enabled() && value != channel.get(register) && !(register == CCR && value & EN == 0) {
            effects.violation(value, "registers of a DMA channel are written only while EN = 0");
        }
        match register {
            CCR => self.write_ccr(index, value, effects),
            CNDTR => channel.cndtr = value & 0xFFFF,
            CPAR => channel.cpar = value,
            _ => channel.cmar = value,
        }
        self.find_wanted();
        self.update_line(index, effects);
    }

    fn write_ccr(&mut self, index: usize, value: u32, effects: &mut Effects) {
        let channel = &mut self.channels[index];
        if value & EN != 0 && !channel.enabled() {
            if value & MEM2MEM != 0 {
                effects.unmodelled();
            }
            if channel.flags & TEIF != 0 {
                effects.violation(value, "a DMA channel is enabled again only after TEIF is cleared");
            }
            channel.total = channel.cndtr;
            channel.moved = 0;
        }
        channel.ccr = value & 0x7FFF;
        self.find_wanted();
        self.watch_sharing(value, effects);
    }

    fn clear_flags(&mut self, index: usize, clear: u32, effects: &mut Effects) {
        if clear == 0 {
            return;
        }
        let flags = &mut self.channels[index].flags;
        *flags &= if clear & GIF != 0 { 0 } else { !clear };
        if *flags & (TCIF | HTIF | TEIF) == 0 {
            *flags = 0;
        }
        self.update_line(index, effects);
    }

    fn find_wanted(&mut self) {
        self.wanted = self.channels.iter().fold(0, |wanted, channel| wanted | 1 << channel.listens_to()) & !1;
    }

    /// RM0440, "DMAMUX channels": a request may be selected by one channel only.
    fn watch_sharing(&self, value: u32, effects: &mut Effects) {
        let listening = self.channels.iter().filter(|channel| channel.listens_to() != 0).count();
        if listening != self.wanted.count_ones() as usize {
            effects.violation(value, "a DMA request is selected by one channel only");
        }
    }

    fn update_line(&self, index: usize, effects: &mut Effects) {
        let line = match index {
            0..=6 => DMA1::Channel1_IRQn + index as u32,
            7 => DMA1::Channel8_IRQn,
            8..=12 => DMA2::Channel1_IRQn + (index - 8) as u32,
            _ => DMA2::Channel6_IRQn + (index - 13) as u32,
        };
        effects.set_line(line, self.channels[index].interrupt());
    }
}

/// (channel 0 to 7, register) at `offset`.
fn channel_register(offset: u32) -> Option<(usize, u32)> {
    let from_first = offset.checked_sub(FIRST_CHANNEL)?;
    let (index, register) = (from_first / CHANNEL_SPAN, from_first % CHANNEL_SPAN);
    (index < 8 && register <= CMAR).then_some((index as usize, register))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CH3: u32 = FIRST_CHANNEL + 2 * CHANNEL_SPAN;

    /// DMA1 channel 3 on request 5: 4 halfwords from 0x5000_0040 to 0x2000_0000.
    fn ring(flags: u32) -> (Dma, Effects) {
        let (mut dma, mut effects) = (Dma::new(), Effects::default());
        dma.write_multiplexer(8, 5, &mut effects);
        dma.write(0, CH3 + CNDTR, 4, &mut effects);
        dma.write(0, CH3 + CPAR, 0x5000_0040, &mut effects);
        dma.write(0, CH3 + CMAR, 0x2000_0000, &mut effects);
        dma.write(0, CH3 + CCR, 1 << 8 | 1 << 10 | MINC | EN | flags, &mut effects);
        (dma, effects)
    }

    #[test]
    fn write_rules_are_watched() {
        let (mut dma, mut effects) = ring(CIRC);
        dma.write(0, CH3 + CMAR, 0x2000_0000, &mut effects);
        assert_eq!(effects.violation_count, 0, "nothing was changed");
        dma.write(0, CH3 + CMAR, 0x2000_0010, &mut effects);
        dma.write_multiplexer(8, 36, &mut effects);
        assert_eq!(effects.violation_count, 2);
        dma.write_multiplexer(0, 36, &mut effects);
        dma.write(0, FIRST_CHANNEL + CNDTR, 1, &mut effects);
        dma.write(0, FIRST_CHANNEL + CCR, EN, &mut effects);
        assert_eq!(effects.violation_count, 3, "two channels share a request");
    }

    #[test]
    fn widths_and_priority_are_fields_of_their_own() {
        let wide = Channel { ccr: CCR_PSIZE_1 | CCR_MSIZE_0 | CCR_PL, ..Channel::default() };
        let Transfer { source_width, destination_width, .. } = wide.transfer();
        assert_eq!((source_width, destination_width, wide.priority()), (4, 2, 3));
    }
}

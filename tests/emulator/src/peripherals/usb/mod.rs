//! The full-speed USB device block (RM0440, "Universal serial bus full-speed device interface").
//!
//! The program's side is registers and packet memory; the host's side is [`UsbPort`]. Endpoints are
//! control, bulk or interrupt with one buffer for each direction; isochronous and double-buffered
//! endpoints, link power management and charger detection are not modelled.

mod endpoint;

use super::{Effects, Ticks};
use crate::st::USB::{
    BCDR, BCDR_DPPU, BTABLE, CNTR, CNTR_FRES, CNTR_FSUSP, CNTR_LPMODE, CNTR_PDWN, DADDR, DADDR_EF, FNR,
    FNR_FN as FNR_FRAME, FNR_LCK, FNR_LSOF, FNR_RXDP, ISTR, ISTR_CTR, ISTR_DIR, ISTR_ESOF, ISTR_RESET, ISTR_SOF,
    ISTR_SUSP, ISTR_WKUP,
};
use crate::usb_wire::FRAME_TICKS;
use endpoint::{Endpoint, PacketMemory};

pub use endpoint::UsbPort;

/// Endpoint registers, and so the largest number of endpoints.
const ENDPOINTS: usize = 8;

const EPNR_END: u32 = 0x20;

// USB_CNTR; bits 8 to 15 enable the interrupts of the same bits in USB_ISTR.
const CNTR_MODELLED: u32 = 0xff00 | CNTR_FRES | CNTR_PDWN | CNTR_LPMODE | CNTR_FSUSP;

const INTERRUPTS: u32 = 0xff00;
const FNR_LSOF_ONE: u32 = 0x800;

/// A start of frame is missed when it is later than this.
const MISSED_FRAME_TICKS: Ticks = FRAME_TICKS + FRAME_TICKS / 100;

/// Missed frames that mean suspension: 3 ms.
const SUSPEND_FRAMES: u32 = 3;

#[derive(Debug, Default)]
pub struct Usb {
    endpoints: [Endpoint; ENDPOINTS],
    /// It has its own addresses and does not repeat narrow accesses over a word.
    pub memory: PacketMemory,
    control: u32,
    /// USB_ISTR without what follows from the endpoints.
    status: u32,
    frame: u32,
    /// Starts of frame since reset or resume, up to two: then the frame timer is locked.
    frames_seen: u32,
    address: u32,
    buffer_table: u32,
    battery: u32,
    /// 48 MHz arrive.
    clock: bool,
    /// The host holds the lines; time does not count as silence.
    line_held: bool,
    /// When the next missing start of frame is noticed.
    silence_at: Ticks,
    missed_frames: u32,
}

impl Usb {
    pub fn new() -> Self {
        Self { control: CNTR_FRES | CNTR_PDWN, silence_at: Ticks::MAX, ..Self::default() }
    }

    /// RCC reset bit or system reset. Packet memory and what the host does are not touched.
    pub fn reset(&mut self, effects: &mut Effects) {
        let memory = std::mem::take(&mut self.memory);
        *self = Self { memory, clock: self.clock, line_held: self.line_held, ..Self::new() };
        self.update_interrupt(effects);
    }

    /// Whether the 48 MHz clock arrives (CCIPR.CLK48SEL, and its source running). To be told at
    /// every change; when the whole device is reset, after [`Self::reset`].
    pub fn set_clock(&mut self, running: bool, effects: &mut Effects) {
        self.clock = running;
        if !running && !self.is_held() {
            effects.violation(self.control, "USB: the 48 MHz clock is stopped while the block runs");
        }
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            0..EPNR_END => self.endpoints[(offset / 4) as usize].register(),
            CNTR => self.control,
            ISTR => self.interrupt_status(),
            FNR => self.frame | if self.battery & BCDR_DPPU != 0 && !self.line_held { FNR_RXDP } else { 0 },
            DADDR => self.address,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            0..EPNR_END => self.write_endpoint((offset / 4) as usize, value, effects),
            CNTR => self.write_control(value, effects),
            // Flags are cleared by zeros; ones do nothing.
            ISTR => self.status &= value,
            DADDR => self.address = value & 0xff,
            BTABLE => self.buffer_table = value & 0xfff8,
            BCDR if value & !BCDR_DPPU == 0 => self.battery = value,
            _ => effects.unmodelled(),
        }
        self.update_interrupt(effects);
    }

    /// When the block will notice a missing start of frame.
    pub fn next_event(&self) -> Ticks {
        self.silence_at
    }

    /// Notices that a start of frame is missing.
    pub fn advance(&mut self, effects: &mut Effects) {
        if self.frames_seen == 2 {
            self.status |= ISTR_ESOF;
            let lost = (self.frame & FNR_LSOF) + FNR_LSOF_ONE;
            self.frame = self.frame & !FNR_LSOF | lost.min(FNR_LSOF);
        }
        self.missed_frames += 1;
        self.silence_at = effects.now + FRAME_TICKS;
        if self.missed_frames == SUSPEND_FRAMES {
            self.status |= ISTR_SUSP;
            self.frames_seen = 0;
            self.missed_frames = 0;
            self.frame &= !FNR_LCK;
        }
        self.update_interrupt(effects);
    }

    pub fn port<'a>(&'a mut self, effects: &'a mut Effects) -> UsbPort<'a> {
        UsbPort { usb: self, effects }
    }

    /// Held in reset by the program.
    fn is_held(&self) -> bool {
        self.control & (CNTR_FRES | CNTR_PDWN) != 0
    }

    /// Where the buffer table describes endpoint register `index`.
    fn entry(&self, index: usize) -> usize {
        self.buffer_table as usize + 8 * index
    }

    fn interrupt_status(&self) -> u32 {
        // A lower number goes first.
        match self.endpoints.iter().position(Endpoint::has_completed) {
            Some(index) => {
                let direction = if self.endpoints[index].has_received() { ISTR_DIR } else { 0 };
                self.status | ISTR_CTR | direction | index as u32
            }
            None => self.status,
        }
    }

    fn update_interrupt(&self, effects: &mut Effects) {
        effects.set_line(crate::st::USB::LP_IRQn, self.interrupt_status() & self.control & INTERRUPTS != 0);
    }

    fn write_control(&mut self, value: u32, effects: &mut Effects) {
        let (before, now) = (self.control, effects.now);
        if value & !CNTR_MODELLED != 0 {
            effects.unmodelled();
        }
        self.control = value & CNTR_MODELLED;
        if before & (CNTR_FRES | CNTR_PDWN) != 0 && !self.is_held() && !self.clock {
            effects.violation(value, "USB: FRES cleared without the 48 MHz clock");
        }
        if value & CNTR_FRES != 0 && value & CNTR_PDWN == 0 {
            self.reset_protocol();
        } else if value & CNTR_PDWN != 0 {
            self.endpoints.iter_mut().for_each(Endpoint::reset);
        }
        if (before ^ self.control) & (CNTR_FRES | CNTR_PDWN | CNTR_FSUSP) != 0 {
            self.listen(now);
        }
    }

    fn write_endpoint(&mut self, index: usize, value: u32, effects: &mut Effects) {
        self.endpoints[index].write(value);
        if !self.endpoints[index].is_modelled() {
            effects.unmodelled();
        }
    }

    /// What a reset from the bus and one by FRES have in common.
    fn reset_protocol(&mut self) {
        self.endpoints.iter_mut().for_each(Endpoint::reset);
        self.address = 0;
        self.frames_seen = 0;
        self.status |= ISTR_RESET;
    }

    /// The bus was active: silence begins anew.
    fn listen(&mut self, now: Ticks) {
        self.missed_frames = 0;
        let deaf = self.is_held() || self.line_held || self.control & CNTR_FSUSP != 0;
        self.silence_at = if deaf { Ticks::MAX } else { now + MISSED_FRAME_TICKS };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::usb_wire::{Answer, BusSignal, OutPacket};

    const CONTROL: u32 = 0b01 << 9;
    const RUNNING: u32 = 0xbf00;

    /// Powered, clocked and out of reset as the manual asks for, after a bus reset, at address 0.
    fn running() -> (Usb, Effects) {
        let (mut usb, mut effects) = (Usb::new(), Effects::default());
        usb.set_clock(true, &mut effects);
        usb.write(CNTR, CNTR_FRES, &mut effects);
        usb.write(CNTR, RUNNING, &mut effects);
        usb.write(BCDR, BCDR_DPPU, &mut effects);
        usb.port(&mut effects).signal(BusSignal::ResetBegins);
        usb.port(&mut effects).signal(BusSignal::ResetEnds);
        usb.write(ISTR, 0, &mut effects);
        usb.write(DADDR, DADDR_EF, &mut effects);
        // Endpoint 0: 8 bytes out at 64 + 0, 64 bytes in at 128.
        usb.memory.write(0..2, 128);
        usb.memory.write(4..6, 64);
        usb.memory.write(6..8, 1 << 15 | 1 << 10);
        assert_eq!(effects.violation_count, 0);
        (usb, effects)
    }

    fn packet(bytes: &[u8], setup: bool, toggle: bool) -> OutPacket<'_> {
        OutPacket { address: 0, endpoint: 0, setup, toggle, bytes }
    }

    #[test]
    fn a_repeated_packet_is_acknowledged_and_ignored() {
        let (mut usb, mut effects) = running();
        usb.write(0, CONTROL | 0b11 << 12, &mut effects);
        assert_eq!(usb.port(&mut effects).packet_out(packet(b"first", false, false)), Answer::Ack);
        usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
        assert_eq!(usb.port(&mut effects).packet_out(packet(b"again", false, false)), Answer::Ack);
        assert_eq!(usb.read(ISTR, &mut effects) & ISTR_CTR, 0);
        assert_eq!(usb.port(&mut effects).packet_out(packet(b"after", false, true)), Answer::Ack);
        assert_eq!(usb.memory.read(64..65), u32::from(b'a'));
        // More than the buffer holds is not acknowledged.
        usb.write(0, CONTROL | 1 << 7 | 0b01 << 12, &mut effects);
        assert_eq!(usb.port(&mut effects).packet_out(packet(&[0; 65], false, false)), Answer::Silence);
    }

    #[test]
    fn the_clock_is_watched() {
        let (mut usb, mut effects) = (Usb::new(), Effects::default());
        usb.write(CNTR, CNTR_FRES, &mut effects);
        usb.write(CNTR, 0, &mut effects);
        assert_eq!(effects.violation_count, 1);
        usb.set_clock(true, &mut effects);
        usb.set_clock(false, &mut effects);
        assert_eq!(effects.violation_count, 2);
    }
}

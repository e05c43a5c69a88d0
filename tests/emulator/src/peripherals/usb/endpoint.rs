//! An endpoint register, USB_EPnR, with the rules by which program and block write it; the packet memory: buffers, and the
//! table that says where they are (RM0440, "Buffer descriptor table"); and the block as the host sees it: signals and packets,
//! and what they do to registers and memory.
//!
//! An entry of the table has four halfwords: address and count of the transmission buffer, address and count of the reception
//! buffer. The upper bits of the latter hold the buffer's size.

use super::{BCDR_DPPU, CNTR_FSUSP, CNTR_LPMODE, CNTR_PDWN, DADDR_EF, FNR_FRAME, FNR_LCK, ISTR_SOF, ISTR_WKUP, Usb};
use crate::peripherals::Effects;
use crate::st::USB::{
    EP_BULK as TYPE_BULK, EP_CONTROL as TYPE_CONTROL, EP_CTR_RX as CTR_RX, EP_CTR_TX as CTR_TX, EP_DTOG_RX as DTOG_RX,
    EP_DTOG_TX as DTOG_TX, EP_INTERRUPT as TYPE_INTERRUPT, EP_KIND, EP_SETUP as SETUP, EP_T_FIELD as EP_TYPE,
    EPADDR_FIELD as EA, EPRX_STAT as STAT_RX, EPTX_STAT as STAT_TX,
};
use crate::usb_wire::{Answer, BusSignal, OutPacket};
use std::ops::Range;

/// Bits that a one inverts and a zero leaves.
const TOGGLED: u32 = DTOG_RX | STAT_RX | DTOG_TX | STAT_TX;

/// Bits that a zero clears and a one leaves.
const CLEARED: u32 = CTR_RX | CTR_TX;

/// How one direction of an endpoint answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stat {
    Disabled,
    /// With STALL.
    Stall,
    /// With NAK.
    Nak,
    Valid,
}

impl Stat {
    fn of(bits: u32) -> Self {
        [Self::Disabled, Self::Stall, Self::Nak, Self::Valid][bits as usize & 3]
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Endpoint(u32);

impl Endpoint {
    pub fn register(&self) -> u32 {
        self.0
    }

    /// A write by the program. SETUP is read-only.
    pub fn write(&mut self, value: u32) {
        let kept = self.0 & SETUP;
        self.0 = kept | (self.0 & value & CLEARED) | ((self.0 ^ value) & TOGGLED) | value & (EP_TYPE | EP_KIND | EA);
    }

    /// A reset of the bus leaves what the program has not seen yet.
    pub fn reset(&mut self) {
        self.0 &= CLEARED;
    }

    pub fn number(&self) -> u8 {
        (self.0 & EA) as u8
    }

    pub fn rx(&self) -> Stat {
        Stat::of(self.0 >> 12)
    }

    pub fn tx(&self) -> Stat {
        Stat::of(self.0 >> 4)
    }

    pub fn is_control(&self) -> bool {
        self.0 & EP_TYPE == TYPE_CONTROL
    }

    /// Isochronous and double-buffered endpoints are not.
    pub fn is_modelled(&self) -> bool {
        match self.0 & EP_TYPE {
            TYPE_BULK => self.0 & EP_KIND == 0,
            TYPE_CONTROL | TYPE_INTERRUPT => true,
            _ => false,
        }
    }

    pub fn has_received(&self) -> bool {
        self.0 & CTR_RX != 0
    }

    pub fn has_completed(&self) -> bool {
        self.0 & CLEARED != 0
    }

    pub fn complete_tx(&mut self) {
        self.0 = (self.0 ^ DTOG_TX) & !STAT_TX | NAK_TX | CTR_TX;
    }

    pub fn complete_rx(&mut self) {
        self.0 = (self.0 ^ DTOG_RX) & !(STAT_RX | SETUP) | NAK_RX | CTR_RX;
    }

    /// A SETUP was received, as DATA0: both directions go on with DATA1, when the program has
    /// understood the request.
    pub fn complete_setup(&mut self) {
        self.0 = self.0 & !(STAT_RX | STAT_TX) | NAK_RX | NAK_TX | DTOG_RX | DTOG_TX | SETUP | CTR_RX;
    }
}

const NAK_RX: u32 = 0b10 << 12;
const NAK_TX: u32 = 0b10 << 4;

pub const BYTES: usize = 1024;

const COUNT: usize = 0x3ff;

/// Blocks of 32 bytes rather than 2.
const BLOCK_SIZE: usize = 1 << 15;

/// 1 KB of memory beside the bus.
#[derive(Clone, Debug)]
pub struct PacketMemory([u8; BYTES]);

impl Default for PacketMemory {
    fn default() -> Self {
        Self([0; BYTES])
    }
}

impl PacketMemory {
    /// A little-endian number of up to four bytes. Beyond the memory there is nothing.
    pub fn read(&self, range: Range<usize>) -> u32 {
        self.bytes(range).iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte))
    }

    pub fn write(&mut self, range: Range<usize>, value: u32) {
        if let Some(bytes) = self.0.get_mut(range) {
            let len = bytes.len();
            bytes.copy_from_slice(&value.to_le_bytes()[..len]);
        }
    }

    /// The part of `range` that exists.
    pub fn bytes(&self, range: Range<usize>) -> &[u8] {
        let end = range.end.min(BYTES);
        &self.0[range.start.min(end)..end]
    }

    /// What the entry at `entry` says is to be sent.
    pub fn tx_buffer(&self, entry: usize) -> Range<usize> {
        let start = self.half(entry) & !1;
        start..start + (self.half(entry + 2) & COUNT)
    }

    /// Where the entry at `entry` has room for a packet.
    pub fn rx_buffer(&self, entry: usize) -> Range<usize> {
        let start = self.half(entry + 4) & !1;
        let size = self.half(entry + 6);
        let blocks = size >> 10 & 0x1f;
        start..start + if size & BLOCK_SIZE != 0 { 32 * (blocks + 1) } else { 2 * blocks }
    }

    /// Puts a packet into the reception buffer of the entry at `entry`, and its length into the
    /// entry.
    pub fn receive(&mut self, entry: usize, packet: &[u8]) {
        let start = self.rx_buffer(entry).start;
        if let Some(buffer) = self.0.get_mut(start..start + packet.len()) {
            buffer.copy_from_slice(packet);
        }
        let count = self.half(entry + 6) & !COUNT | packet.len();
        self.write(entry + 6..entry + 8, count as u32);
    }

    fn half(&self, offset: usize) -> usize {
        self.read(offset..offset + 2) as usize
    }
}

/// What a host finds at the other end of the cable.
#[derive(Debug)]
pub struct UsbPort<'a> {
    pub(super) usb: &'a mut Usb,
    pub(super) effects: &'a mut Effects,
}

impl UsbPort<'_> {
    /// Whether D+ is pulled up: the device wants to be seen.
    pub fn is_pulled_up(&self) -> bool {
        self.usb.battery & BCDR_DPPU != 0 && self.usb.control & CNTR_PDWN == 0
    }

    /// Something other than a packet happens on the bus.
    pub fn signal(&mut self, signal: BusSignal) {
        let usb = &mut *self.usb;
        usb.line_held = matches!(signal, BusSignal::ResetBegins | BusSignal::ResumeBegins);
        if usb.is_held() {
            return;
        }
        if usb.control & CNTR_FSUSP != 0 {
            usb.status |= ISTR_WKUP;
            usb.control &= !CNTR_LPMODE;
        }
        match signal {
            BusSignal::ResetBegins => usb.reset_protocol(),
            BusSignal::StartOfFrame(number) => {
                usb.status |= ISTR_SOF;
                usb.frames_seen = (usb.frames_seen + 1).min(2);
                let locked = if usb.frames_seen == 2 { FNR_LCK } else { 0 };
                usb.frame = u32::from(number) & FNR_FRAME | locked;
            }
            BusSignal::ResetEnds | BusSignal::ResumeBegins | BusSignal::ResumeEnds => {}
        }
        usb.listen(self.effects.now);
        usb.update_interrupt(self.effects);
    }

    /// Whether packets to `address` are for this device, in its present state.
    fn hears(&self, address: u8) -> bool {
        let usb = &self.usb;
        !usb.is_held() && usb.clock && usb.control & CNTR_FSUSP == 0 && usb.address == DADDR_EF | u32::from(address)
    }

    pub fn token_in(&self, address: u8, number: u8) -> Answer {
        let serves = |endpoint: &Endpoint| endpoint.number() == number && endpoint.tx() != Stat::Disabled;
        let Some(index) = self.usb.endpoints.iter().position(serves).filter(|_| self.hears(address)) else {
            return Answer::Silence;
        };
        let endpoint = &self.usb.endpoints[index];
        match endpoint.tx() {
            Stat::Valid => Answer::Data {
                toggle: endpoint.0 & DTOG_TX != 0,
                bytes: self.usb.memory.bytes(self.usb.memory.tx_buffer(self.usb.entry(index))).to_vec(),
            },
            Stat::Nak => Answer::Nak,
            Stat::Stall => Answer::Stall,
            Stat::Disabled => Answer::Silence,
        }
    }

    /// The host has acknowledged the data that the last IN token brought.
    pub fn acknowledged(&mut self, address: u8, number: u8) {
        let sends = |endpoint: &&mut Endpoint| endpoint.number() == number && endpoint.tx() == Stat::Valid;
        if self.hears(address)
            && let Some(endpoint) = self.usb.endpoints.iter_mut().find(sends)
        {
            endpoint.complete_tx();
            self.usb.update_interrupt(self.effects);
        }
    }

    /// An OUT or SETUP token and its data packet, at the end of the latter.
    pub fn packet_out(&mut self, packet: OutPacket<'_>) -> Answer {
        let serves = |endpoint: &Endpoint| endpoint.number() == packet.endpoint && endpoint.rx() != Stat::Disabled;
        let Some(index) = self.usb.endpoints.iter().position(serves).filter(|_| self.hears(packet.address)) else {
            return Answer::Silence;
        };
        let entry = self.usb.entry(index);
        let Usb { endpoints, memory, .. } = &mut *self.usb;
        let endpoint = &mut endpoints[index];
        // A SETUP is taken in any state, unless the one before has not been seen yet.
        if packet.setup {
            if !endpoint.is_control() || endpoint.has_received() {
                return Answer::Silence;
            }
        } else {
            match endpoint.rx() {
                Stat::Nak => return Answer::Nak,
                Stat::Stall => return Answer::Stall,
                Stat::Disabled => return Answer::Silence,
                Stat::Valid => {}
            }
            // A control endpoint that takes only the empty packet of a status stage.
            if endpoint.is_control() && endpoint.0 & EP_KIND != 0 && !packet.bytes.is_empty() {
                return Answer::Stall;
            }
            // The host has missed the last handshake and repeats the packet.
            if packet.toggle != (endpoint.0 & DTOG_RX != 0) {
                return Answer::Ack;
            }
        }
        if packet.bytes.len() > memory.rx_buffer(entry).len() {
            return Answer::Silence;
        }
        memory.receive(entry, packet.bytes);
        if packet.setup {
            endpoint.complete_setup();
        } else {
            endpoint.complete_rx();
        }
        self.usb.update_interrupt(self.effects);
        Answer::Ack
    }
}

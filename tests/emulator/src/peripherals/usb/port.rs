//! The block as the host sees it: signals and packets, and what they do to registers and memory.

use super::endpoint::{Endpoint, Stat};
use super::{BCDR_DPPU, CNTR_FSUSP, CNTR_LPMODE, CNTR_PDWN, DADDR_EF, FNR_FRAME, FNR_LCK, ISTR_SOF, ISTR_WKUP, Usb};
use crate::peripherals::{Effects, Ticks};
use crate::usb_wire::{Answer, BusSignal, OutPacket};

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
        self.usb.signal(signal, self.effects.now());
        self.usb.update_interrupt(self.effects);
    }

    /// An IN token.
    pub fn token_in(&mut self, address: u8, endpoint: u8) -> Answer {
        self.usb.token_in(address, endpoint)
    }

    /// The host has acknowledged the data that the last IN token brought.
    pub fn acknowledged(&mut self, address: u8, endpoint: u8) {
        self.usb.acknowledged(address, endpoint);
        self.usb.update_interrupt(self.effects);
    }

    /// An OUT or SETUP token and its data packet, at the end of the latter.
    pub fn packet_out(&mut self, packet: OutPacket<'_>) -> Answer {
        let handshake = self.usb.packet_out(packet);
        self.usb.update_interrupt(self.effects);
        handshake
    }
}

impl Usb {
    fn signal(&mut self, signal: BusSignal, now: Ticks) {
        self.line_held = matches!(signal, BusSignal::ResetBegins | BusSignal::ResumeBegins);
        if self.is_held() {
            return;
        }
        if self.control & CNTR_FSUSP != 0 {
            self.status |= ISTR_WKUP;
            self.control &= !CNTR_LPMODE;
        }
        match signal {
            BusSignal::ResetBegins => self.reset_protocol(),
            BusSignal::StartOfFrame(number) => {
                self.status |= ISTR_SOF;
                self.frames_seen = (self.frames_seen + 1).min(2);
                let locked = if self.frames_seen == 2 { FNR_LCK } else { 0 };
                self.frame = u32::from(number) & FNR_FRAME | locked;
            }
            BusSignal::ResetEnds | BusSignal::ResumeBegins | BusSignal::ResumeEnds => {}
        }
        self.listen(now);
    }

    /// Whether packets to `address` are for this device, in its present state.
    fn hears(&self, address: u8) -> bool {
        self.is_running()
            && self.clock
            && self.control & CNTR_FSUSP == 0
            && self.address == DADDR_EF | u32::from(address)
    }

    fn token_in(&self, address: u8, number: u8) -> Answer {
        let serves = |endpoint: &Endpoint| endpoint.number() == number && endpoint.tx() != Stat::Disabled;
        let Some(index) = self.endpoints.iter().position(serves).filter(|_| self.hears(address)) else {
            return Answer::Silence;
        };
        let endpoint = &self.endpoints[index];
        match endpoint.tx() {
            Stat::Valid => Answer::Data {
                toggle: endpoint.tx_toggle(),
                bytes: self.memory.bytes(self.memory.tx_buffer(self.entry(index))).to_vec(),
            },
            Stat::Nak => Answer::Nak,
            Stat::Stall => Answer::Stall,
            Stat::Disabled => Answer::Silence,
        }
    }

    fn acknowledged(&mut self, address: u8, number: u8) {
        let sends = |endpoint: &&mut Endpoint| endpoint.number() == number && endpoint.tx() == Stat::Valid;
        if self.hears(address)
            && let Some(endpoint) = self.endpoints.iter_mut().find(sends)
        {
            endpoint.complete_tx();
        }
    }

    fn packet_out(&mut self, packet: OutPacket<'_>) -> Answer {
        let serves = |endpoint: &Endpoint| endpoint.number() == packet.endpoint && endpoint.rx() != Stat::Disabled;
        let Some(index) = self.endpoints.iter().position(serves).filter(|_| self.hears(packet.address)) else {
            return Answer::Silence;
        };
        let entry = self.entry(index);
        let endpoint = &mut self.endpoints[index];
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
            if endpoint.expects_status_out() && !packet.bytes.is_empty() {
                return Answer::Stall;
            }
            // The host has missed the last handshake and repeats the packet.
            if packet.toggle != endpoint.rx_toggle() {
                return Answer::Ack;
            }
        }
        if packet.bytes.len() > self.memory.rx_buffer(entry).len() {
            return Answer::Silence;
        }
        self.memory.receive(entry, packet.bytes);
        if packet.setup {
            endpoint.complete_setup();
        } else {
            endpoint.complete_rx();
        }
        Answer::Ack
    }
}

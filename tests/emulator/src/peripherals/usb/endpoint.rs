//! An endpoint register, USB_EPnR: the rules by which program and block write it.

const CTR_RX: u32 = 1 << 15;
const DTOG_RX: u32 = 1 << 14;
const STAT_RX: u32 = 0b11 << 12;
const SETUP: u32 = 1 << 11;
const EP_TYPE: u32 = 0b11 << 9;
const EP_KIND: u32 = 1 << 8;
const CTR_TX: u32 = 1 << 7;
const DTOG_TX: u32 = 1 << 6;
const STAT_TX: u32 = 0b11 << 4;
const EA: u32 = 0xf;

/// Bits that a one inverts and a zero leaves.
const TOGGLED: u32 = DTOG_RX | STAT_RX | DTOG_TX | STAT_TX;

/// Bits that a zero clears and a one leaves.
const CLEARED: u32 = CTR_RX | CTR_TX;

const TYPE_BULK: u32 = 0b00 << 9;
const TYPE_CONTROL: u32 = 0b01 << 9;
const TYPE_INTERRUPT: u32 = 0b11 << 9;

/// How one direction of an endpoint answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stat {
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
pub(super) struct Endpoint(u32);

impl Endpoint {
    pub(super) fn register(&self) -> u32 {
        self.0
    }

    /// A write by the program. SETUP is read-only.
    pub(super) fn write(&mut self, value: u32) {
        let kept = self.0 & SETUP;
        self.0 = kept | (self.0 & value & CLEARED) | ((self.0 ^ value) & TOGGLED) | value & (EP_TYPE | EP_KIND | EA);
    }

    /// A reset of the bus leaves what the program has not seen yet.
    pub(super) fn reset(&mut self) {
        self.0 &= CLEARED;
    }

    pub(super) fn number(&self) -> u8 {
        (self.0 & EA) as u8
    }

    pub(super) fn rx(&self) -> Stat {
        Stat::of(self.0 >> 12)
    }

    pub(super) fn tx(&self) -> Stat {
        Stat::of(self.0 >> 4)
    }

    pub(super) fn rx_toggle(&self) -> bool {
        self.0 & DTOG_RX != 0
    }

    pub(super) fn tx_toggle(&self) -> bool {
        self.0 & DTOG_TX != 0
    }

    pub(super) fn is_enabled(&self) -> bool {
        self.0 & (STAT_RX | STAT_TX) != 0
    }

    pub(super) fn is_control(&self) -> bool {
        self.0 & EP_TYPE == TYPE_CONTROL
    }

    /// Isochronous and double-buffered endpoints are not.
    pub(super) fn is_modelled(&self) -> bool {
        match self.0 & EP_TYPE {
            TYPE_BULK => self.0 & EP_KIND == 0,
            TYPE_CONTROL | TYPE_INTERRUPT => true,
            _ => false,
        }
    }

    /// A control endpoint that takes only the empty packet of a status stage.
    pub(super) fn expects_status_out(&self) -> bool {
        self.is_control() && self.0 & EP_KIND != 0
    }

    pub(super) fn has_received(&self) -> bool {
        self.0 & CTR_RX != 0
    }

    pub(super) fn has_completed(&self) -> bool {
        self.0 & CLEARED != 0
    }

    pub(super) fn complete_tx(&mut self) {
        self.0 = (self.0 ^ DTOG_TX) & !STAT_TX | nak_tx() | CTR_TX;
    }

    pub(super) fn complete_rx(&mut self) {
        self.0 = (self.0 ^ DTOG_RX) & !(STAT_RX | SETUP) | nak_rx() | CTR_RX;
    }

    /// A SETUP was received, as DATA0: both directions go on with DATA1, when the program has
    /// understood the request.
    pub(super) fn complete_setup(&mut self) {
        self.0 = self.0 & !(STAT_RX | STAT_TX) | nak_rx() | nak_tx() | DTOG_RX | DTOG_TX | SETUP | CTR_RX;
    }
}

const fn nak_rx() -> u32 {
    0b10 << 12
}

const fn nak_tx() -> u32 {
    0b10 << 4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn bits_are_those_of_st() {
        assert_facts!("USB_EP_"; CTR_RX, DTOG_RX, SETUP, EP_TYPE = "T_FIELD", EP_KIND = "KIND", CTR_TX, DTOG_TX);
        assert_facts!("USB_EP_"; TYPE_BULK = "BULK", TYPE_CONTROL = "CONTROL", TYPE_INTERRUPT = "INTERRUPT");
        assert_facts!("USB_"; STAT_RX = "EPRX_STAT", STAT_TX = "EPTX_STAT", EA = "EPADDR_FIELD");
    }
}

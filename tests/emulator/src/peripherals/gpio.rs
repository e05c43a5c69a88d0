//! General-purpose I/O ports A to G (RM0440, "General-purpose I/Os").
//!
//! Alternate functions are not followed to their pins: a pin in such a mode counts as not
//! driven here.

use super::Effects;

/// Number of ports, A to G.
pub const PORTS: usize = 7;

const MODER: u32 = 0x00;
const OTYPER: u32 = 0x04;
const OSPEEDR: u32 = 0x08;
const PUPDR: u32 = 0x0C;
const IDR: u32 = 0x10;
const ODR: u32 = 0x14;
const BSRR: u32 = 0x18;
const LCKR: u32 = 0x1C;
const AFRL: u32 = 0x20;
const AFRH: u32 = 0x24;
const BRR: u32 = 0x28;

/// One port of sixteen pins.
#[derive(Debug)]
pub struct Port {
    index: usize,
    moder: u32,
    otyper: u32,
    ospeedr: u32,
    pupdr: u32,
    odr: u32,
    lckr: u32,
    afr: [u32; 2],
    /// Levels that come from outside.
    inputs: u16,
    /// Pins in output mode with a push-pull stage.
    push_pull: u16,
}

impl Port {
    /// Port number `index` (0: A) after power-on. PA13–PA15 and PB3–PB4 serve the debugger.
    pub fn new(index: usize) -> Self {
        let (moder, ospeedr, pupdr) = match index {
            0 => (0xABFF_FFFF, 0x0C00_0000, 0x6400_0000),
            1 => (0xFFFF_FEBF, 0x0000_00C0, 0x0000_0100),
            _ => (0xFFFF_FFFF, 0, 0),
        };
        Self { index, moder, otyper: 0, ospeedr, pupdr, odr: 0, lckr: 0, afr: [0; 2], inputs: 0, push_pull: 0 }
    }

    /// State after reset; what comes from outside stays.
    pub fn reset(&mut self) {
        *self = Self { inputs: self.inputs, ..Self::new(self.index) };
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            MODER => self.moder,
            OTYPER => self.otyper,
            OSPEEDR => self.ospeedr,
            PUPDR => self.pupdr,
            IDR => u32::from(self.levels()),
            ODR => self.odr,
            BSRR | BRR => 0,
            LCKR => self.lckr,
            AFRL => self.afr[0],
            AFRH => self.afr[1],
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            BSRR => self.odr = self.odr & !(value >> 16) | value & 0xFFFF,
            BRR => self.odr &= !value,
            ODR => self.odr = value & 0xFFFF,
            MODER => self.moder = value,
            OTYPER => self.otyper = value & 0xFFFF,
            OSPEEDR => self.ospeedr = value,
            PUPDR => self.pupdr = value,
            AFRL => self.afr[0] = value,
            AFRH => self.afr[1] = value,
            IDR => effects.violation(value, "GPIOx_IDR is read-only"),
            LCKR => {
                effects.unmodelled();
                self.lckr = value;
            }
            _ => effects.unmodelled(),
        }
        if matches!(offset, MODER | OTYPER) {
            self.push_pull = push_pull_outputs(self.moder, self.otyper);
        }
    }

    /// Pins that are driven high by a push-pull output, bit n for pin n.
    #[inline]
    pub fn driven_high(&self) -> u16 {
        self.odr as u16 & self.push_pull
    }

    /// Sets the level that comes from outside to `pin`; returns whether it has changed.
    pub fn set_input(&mut self, pin: u8, level: bool) -> bool {
        let before = self.inputs;
        self.inputs = before & !(1 << pin) | u16::from(level) << pin;
        self.inputs != before
    }

    /// Levels at the pins: what outputs drive, else what comes from outside.
    fn levels(&self) -> u16 {
        self.driven_high() | self.inputs & !self.push_pull
    }
}

/// Pins whose mode is general-purpose output (MODER 01) and not open-drain.
fn push_pull_outputs(moder: u32, otyper: u32) -> u16 {
    (0..16).filter(|pin| moder >> (2 * pin) & 3 == 1 && otyper >> pin & 1 == 0).map(|pin| 1 << pin).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::assert_facts;

    #[test]
    fn only_push_pull_outputs_drive() {
        let (mut port, mut effects) = (Port::new(2), Effects::default());
        port.write(BSRR, 0x0FC0, &mut effects);
        assert_eq!(port.driven_high(), 0);
        port.write(MODER, !(0b10 << 12 | 0b10 << 14), &mut effects);
        assert_eq!(port.driven_high(), 0x00C0);
        port.write(OTYPER, 0x0080, &mut effects);
        assert_eq!(port.driven_high(), 0x0040);
    }

    #[test]
    fn set_wins_over_reset_in_bsrr() {
        let (mut port, mut effects) = (Port::new(2), Effects::default());
        port.write(BSRR, 0x0003, &mut effects);
        port.write(BSRR, 0x0006_0004, &mut effects);
        assert_eq!(port.read(ODR, &mut effects), 0x0005);
        port.write(BRR, 0x0001, &mut effects);
        assert_eq!(port.read(ODR, &mut effects), 0x0004);
    }

    #[test]
    fn inputs_are_read_where_nothing_is_driven() {
        let (mut port, mut effects) = (Port::new(2), Effects::default());
        assert!(port.set_input(13, true));
        assert!(!port.set_input(13, true));
        assert_eq!(port.read(IDR, &mut effects), 1 << 13);
        port.write(MODER, 1 << 26, &mut effects);
        assert_eq!(port.read(IDR, &mut effects), 0);
    }

    #[test]
    fn registers_are_those_of_st() {
        assert_facts!("GPIO_TypeDef."; MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, LCKR, AFRL = "AFR", BRR);
        assert_eq!(AFRH, AFRL + 4);
        let mut port = Port::new(2);
        port.write(MODER, crate::facts::bits("LL_GPIO_MODE_OUTPUT") << (2 * 6), &mut Effects::default());
        assert_eq!(port.push_pull, 1 << 6);
    }
}

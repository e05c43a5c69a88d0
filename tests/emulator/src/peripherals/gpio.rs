//! General-purpose I/O ports A to G (RM0440, "General-purpose I/Os").
//!
//! A pin in an alternate function counts as not driven here.

use super::Effects;
use super::effects::{ALL, Bank, Register};

pub const PORTS: usize = 7;

use crate::st::GPIO::{AFR, BSRR, IDR, MODER, ODR, OSPEEDR, OTYPER, PUPDR};

const REGISTERS: &[Register] = &[
    (MODER, 1, 0, ALL),
    (OTYPER, 1, 0, 0xFFFF),
    (OSPEEDR, 1, 0, ALL),
    (PUPDR, 1, 0, ALL),
    (IDR, 1, 0, 0),
    (ODR, 1, 0, 0xFFFF),
    (BSRR, 1, 0, 0),
    (AFR, 2, 0, ALL),
];

#[derive(Debug)]
pub struct Port {
    index: usize,
    bank: Bank,
    /// Pins in output mode with a push-pull stage.
    push_pull: u16,
    /// Pins that something outside holds high.
    pub held_high: u16,
}

impl Port {
    /// Port number `index` (0: A) after power-on. PA13–PA15 and PB3–PB4 serve the debugger.
    pub fn new(index: usize) -> Self {
        let mut bank = Bank::new(REGISTERS);
        (bank[MODER], bank[OSPEEDR], bank[PUPDR]) = match index {
            0 => (0xABFF_FFFF, 0x0C00_0000, 0x6400_0000),
            1 => (0xFFFF_FEBF, 0x0000_00C0, 0x0000_0100),
            _ => (0xFFFF_FFFF, 0, 0),
        };
        Self { index, bank, push_pull: 0, held_high: 0 }
    }

    pub fn reset(&mut self) {
        *self = Self { held_high: self.held_high, ..Self::new(self.index) };
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        if offset == IDR { (self.driven_high() | self.held_high).into() } else { self.bank.read(offset, effects) }
    }

    /// The alternate function of pin `number`, if it has one.
    pub fn function(&self, number: u32) -> Option<u32> {
        let is_alternate = self.bank[MODER] >> (2 * number) & 3 == crate::st::LL::GPIO_MODE_ALTERNATE;
        is_alternate.then(|| self.bank[AFR + number / 8 * 4] >> (4 * (number % 8)) & 0xF)
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            BSRR => self.bank[ODR] = self.bank[ODR] & !(value >> 16) | value & 0xFFFF,
            _ => self.bank.write(offset, value, effects),
        }
        if matches!(offset, MODER | OTYPER) {
            self.push_pull = push_pull_outputs(self.bank[MODER], self.bank[OTYPER]);
        }
    }

    /// Pins that are driven high by a push-pull output, bit n for pin n.
    #[inline]
    pub fn driven_high(&self) -> u16 {
        self.bank[ODR] as u16 & self.push_pull
    }
}

/// Pins whose mode is general-purpose output (MODER 01) and not open-drain.
fn push_pull_outputs(moder: u32, otyper: u32) -> u16 {
    (0..16)
        .filter(|pin| moder >> (2 * pin) & 3 == crate::st::LL::GPIO_MODE_OUTPUT && otyper >> pin & 1 == 0)
        .map(|pin| 1 << pin)
        .sum()
}

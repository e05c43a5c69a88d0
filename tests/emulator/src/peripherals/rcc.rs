//! Reset and clock control (RM0440, "RCC"): which peripherals have a clock, and why the device
//! was reset.
//!
//! Oscillators and the PLL are ready as soon as they are switched on. Frequencies are not
//! followed: the machine's tick is the core clock, whatever it is made of.

use super::{Effects, ResetCause};

const CR: u32 = 0x00;
const CFGR: u32 = 0x08;
const PLLCFGR: u32 = 0x0C;
const CIER: u32 = 0x18;
const CIFR: u32 = 0x1C;
const CICR: u32 = 0x20;
const AHB1RSTR: u32 = 0x28;
const APB2RSTR: u32 = 0x40;
const AHB1ENR: u32 = 0x48;
const APB2ENR: u32 = 0x60;
const AHB1SMENR: u32 = 0x68;
const APB2SMENR: u32 = 0x80;
const CCIPR: u32 = 0x88;
const BDCR: u32 = 0x90;
const CSR: u32 = 0x94;
const CRRCR: u32 = 0x98;
const CCIPR2: u32 = 0x9C;
const END: u32 = 0xA0;

const PLLON: u32 = 1 << 24;
/// On bits of CR and the ready bits that follow them.
const CR_READY: [(u32, u32); 3] = [(1 << 8, 1 << 10), (1 << 16, 1 << 17), (PLLON, 1 << 25)];
const BDRST: u32 = 1 << 16;
const RMVF: u32 = 1 << 23;
const CSR_FLAGS: u32 = 0xFE00_0000;
const PINRSTF: u32 = 1 << 26;
const BORRSTF: u32 = 1 << 27;
const SFTRSTF: u32 = 1 << 28;
const IWDGRSTF: u32 = 1 << 29;
const HSI48ON: u32 = 1;

/// A bit in the enable and reset registers: the offset of the enable register, and the bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gate {
    register: u32,
    bit: u32,
}

impl Gate {
    /// Bit `bit` of AHB1ENR.
    pub const fn ahb1(bit: u32) -> Self {
        Self { register: AHB1ENR, bit }
    }

    /// Bit `bit` of AHB2ENR.
    pub const fn ahb2(bit: u32) -> Self {
        Self { register: 0x4C, bit }
    }

    /// Bit `bit` of APB1ENR1.
    pub const fn apb1(bit: u32) -> Self {
        Self { register: 0x58, bit }
    }

    /// Bit `bit` of APB1ENR2.
    pub const fn apb1_2(bit: u32) -> Self {
        Self { register: 0x5C, bit }
    }

    /// Bit `bit` of APB2ENR.
    pub const fn apb2(bit: u32) -> Self {
        Self { register: APB2ENR, bit }
    }
}

/// What a write asks of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Nothing.
    None,
    /// A peripheral's reset bit was set.
    Reset(u32, u32),
    /// The backup domain is reset.
    BackupReset,
    /// Kernel clocks may have changed.
    Clocks,
}

impl Order {
    /// Whether the peripheral behind `gate` is reset.
    pub fn resets(self, gate: Gate) -> bool {
        // Reset registers lie in the same order as the enable registers, 0x20 before.
        matches!(self, Self::Reset(register, bits) if register + 0x20 == gate.register && bits >> gate.bit & 1 != 0)
    }
}

/// The registers.
#[derive(Debug)]
pub struct Rcc {
    words: [u32; (END / 4) as usize],
}

impl Rcc {
    /// State after power-on.
    pub fn new() -> Self {
        let mut rcc = Self { words: [0; (END / 4) as usize] };
        rcc.set_reset_values();
        rcc.note_reset(ResetCause::PowerOn);
        rcc
    }

    /// State after a system reset for `cause`: the backup domain's register and earlier flags stay.
    pub fn reset(&mut self, cause: ResetCause) {
        let (bdcr, csr) = (self.word(BDCR), self.word(CSR));
        self.words = [0; (END / 4) as usize];
        self.set_reset_values();
        self.set(BDCR, bdcr);
        self.set(CSR, csr & CSR_FLAGS);
        self.note_reset(cause);
    }

    fn set_reset_values(&mut self) {
        self.set(CR, 0x0000_0500);
        self.set(CFGR, 0x0000_0005);
        self.set(PLLCFGR, 0x0000_1000);
        self.set(AHB1ENR, 0x0000_0100);
        self.set(0x58, 0x0000_0400);
    }

    /// Every internal reset also pulls NRST low and shows as a pin reset.
    fn note_reset(&mut self, cause: ResetCause) {
        let flag = match cause {
            ResetCause::PowerOn | ResetCause::BrownOut => BORRSTF,
            ResetCause::Pin => 0,
            ResetCause::Software => SFTRSTF,
            ResetCause::Watchdog => IWDGRSTF,
        };
        self.set(CSR, self.word(CSR) | flag | PINRSTF);
    }

    /// Whether the peripheral behind `gate` has its clock.
    #[inline]
    pub fn is_enabled(&self, gate: Gate) -> bool {
        self.words[(gate.register / 4) as usize] >> gate.bit & 1 != 0
    }

    /// Whether the 48 MHz oscillator runs, which USB needs.
    pub fn has_hsi48(&self) -> bool {
        self.word(CRRCR) & HSI48ON != 0
    }

    /// Period of the converters' asynchronous clock in half ticks, for ADC1/2 and for ADC3 to 5;
    /// 0: none selected. Only the system clock is modelled.
    pub fn adc_half_ticks(&self) -> [u64; 2] {
        const SYSTEM: u32 = 2;
        [28, 30].map(|at| if self.word(CCIPR) >> at & 3 == SYSTEM { 2 } else { 0 })
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        if !is_known(offset) {
            effects.unmodelled();
        }
        self.words.get((offset / 4) as usize).copied().unwrap_or(0)
    }

    /// Writes a register. `may_write_backup`: PWR_CR1.DBP.
    pub fn write(&mut self, offset: u32, value: u32, may_write_backup: bool, effects: &mut Effects) -> Order {
        if !is_known(offset) {
            effects.unmodelled();
            return Order::None;
        }
        let before = self.word(offset);
        match offset {
            CR => self.set(CR, CR_READY.iter().fold(value, |value, &(on, ready)| follow(value, on, ready))),
            CFGR => self.set(CFGR, value & !0xC | (value & 3) << 2),
            PLLCFGR => {
                if self.word(CR) & PLLON != 0 {
                    effects.violation(value, "RCC_PLLCFGR is written only while the PLL is off");
                }
                self.set(PLLCFGR, value);
            }
            BDCR if !may_write_backup => {
                if value != before {
                    effects.violation(value, "RCC_BDCR is written only while PWR_CR1.DBP = 1");
                }
            }
            BDCR if value & BDRST != 0 => {
                self.set(BDCR, BDRST);
                return Order::BackupReset;
            }
            BDCR => self.set(BDCR, follow(value, 1, 1 << 1)),
            CSR => {
                let flags = if value & RMVF != 0 { 0 } else { before & CSR_FLAGS };
                self.set(CSR, follow(value & !CSR_FLAGS, 1, 1 << 1) | flags);
            }
            CRRCR => self.set(CRRCR, follow(value, HSI48ON, 1 << 1)),
            CIFR => {}
            CICR => self.set(CIFR, self.word(CIFR) & !value),
            AHB1RSTR..=APB2RSTR => {
                self.set(offset, value);
                return Order::Reset(offset, value & !before);
            }
            CCIPR => {
                self.set(CCIPR, value);
                return Order::Clocks;
            }
            _ => self.set(offset, value),
        }
        if offset == CRRCR { Order::Clocks } else { Order::None }
    }

    fn word(&self, offset: u32) -> u32 {
        self.words[(offset / 4) as usize]
    }

    fn set(&mut self, offset: u32, value: u32) {
        self.words[(offset / 4) as usize] = value;
    }
}

impl Default for Rcc {
    fn default() -> Self {
        Self::new()
    }
}

fn is_known(offset: u32) -> bool {
    matches!(offset, CR..=PLLCFGR | CIER..=CICR | AHB1RSTR..=APB2RSTR | AHB1ENR..=APB2ENR | AHB1SMENR..=APB2SMENR)
        || matches!(offset, CCIPR | BDCR | CSR | CRRCR | CCIPR2)
}

/// `value` with bit `ready` as bit `on` says.
fn follow(value: u32, on: u32, ready: u32) -> u32 {
    if value & on != 0 { value | ready } else { value & !ready }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resets_leave_their_flags_until_they_are_removed() {
        let mut effects = Effects::default();
        let mut rcc = Rcc::new();
        assert_eq!(rcc.read(CSR, &mut effects), BORRSTF | PINRSTF);
        rcc.reset(ResetCause::Watchdog);
        assert_eq!(rcc.read(CSR, &mut effects), BORRSTF | PINRSTF | IWDGRSTF);
        rcc.write(CSR, RMVF, false, &mut effects);
        assert_eq!(rcc.read(CSR, &mut effects) & CSR_FLAGS, 0);
        rcc.reset(ResetCause::Software);
        assert_eq!(rcc.read(CSR, &mut effects) & CSR_FLAGS, PINRSTF | SFTRSTF);
    }

    #[test]
    fn rules_of_pll_and_backup_domain() {
        let mut effects = Effects::default();
        let mut rcc = Rcc::new();
        rcc.write(PLLCFGR, 0x1234, false, &mut effects);
        rcc.write(CR, 0x500 | PLLON, false, &mut effects);
        assert_eq!(effects.violation_count(), 0);
        assert_ne!(rcc.read(CR, &mut effects) & 1 << 25, 0, "ready");
        rcc.write(PLLCFGR, 0x1235, false, &mut effects);
        rcc.write(BDCR, 1, false, &mut effects);
        assert_eq!(effects.violation_count(), 2);
        assert_eq!(rcc.write(BDCR, BDRST, true, &mut effects), Order::BackupReset);
    }

    #[test]
    fn a_reset_bit_finds_its_gate() {
        let mut rcc = Rcc::new();
        let order = rcc.write(0x38, 1, false, &mut Effects::default());
        assert!(order.resets(Gate::apb1(0)) && !order.resets(Gate::apb1(1)) && !order.resets(Gate::ahb1(0)));
        rcc.write(0x58, 1, false, &mut Effects::default());
        assert!(rcc.is_enabled(Gate::apb1(0)) && !rcc.is_enabled(Gate::apb1(3)));
    }
}

//! Reset and clock control (RM0440, "Reset and clock control").
//!
//! The crystal takes its start-up time; the other oscillators and the PLL are ready as soon as they are
//! switched on. Time does not follow the clock tree: the core clock is taken as 170 MHz throughout, and
//! a program that settles on another one is recorded as unmodelled.

use super::effects::{ALL, Register};
use super::{Bank, Effects, ResetCause, TICKS_PER_SECOND, Ticks, field};
use crate::faults::Fault;
use crate::st;
use crate::st::RCC::{
    AHB1ENR, AHB1ENR_FLASHEN, AHB1RSTR, AHB1SMENR, AHB2ENR, APB1ENR1, APB1ENR1_TIM2EN, APB1ENR1_TIM5EN, APB2RSTR,
    APB2SMENR, BDCR, BDCR_BDRST as BDRST, CCIPR, CCIPR_CLK48SEL, CFGR, CFGR_HPRE as HPRE, CFGR_HPRE_DIV2 as HPRE_HALF,
    CFGR_PPRE1, CFGR_PPRE2, CFGR_SW as SW, CFGR_SW_PLL as SW_PLL, CICR, CIER, CIFR, CR, CR_CSSON as CSSON,
    CR_HSEON as HSEON, CR_HSERDY as HSERDY, CR_HSION, CR_HSIRDY, CR_PLLON as PLLON, CR_PLLRDY, CRRCR, CRRCR_HSI48ON,
    CSR, CSR_BORRSTF as BORRSTF, CSR_IWDGRSTF as IWDGRSTF, CSR_PINRSTF as PINRSTF, CSR_RMVF as RMVF,
    CSR_SFTRSTF as SFTRSTF, ICSCR, PLLCFGR, PLLCFGR_PLLM, PLLCFGR_PLLN, PLLCFGR_PLLP, PLLCFGR_PLLPDIV,
    PLLCFGR_PLLPEN as PLLPEN, PLLCFGR_PLLQEN as PLLQEN, PLLCFGR_PLLR, PLLCFGR_PLLREN, PLLCFGR_PLLSRC,
    PLLCFGR_PLLSRC_HSE, PLLCFGR_PLLSRC_HSI,
};

const REGISTERS: &[Register] = &[
    (CR, 1, CR_HSION, ALL),
    (ICSCR, 1, 0x4000_0000, ALL),
    (CFGR, 1, 1, ALL),
    (PLLCFGR, 1, 0x1000, ALL),
    // To CICR; resets, clocks, and clocks in sleep of AHB and APB.
    (CIER, 3, 0, 0),
    (AHB1RSTR, 3, 0, ALL),
    (APB2RSTR - 8, 3, 0, ALL),
    (AHB1ENR, 1, AHB1ENR_FLASHEN, ALL),
    (AHB2ENR, 2, 0, ALL),
    (APB1ENR1, 3, 0, ALL),
    (AHB1SMENR, 3, 0, ALL),
    (APB2SMENR - 8, 3, 0, ALL),
    (CCIPR, 1, 0, ALL),
    // To CCIPR2.
    (BDCR, 4, 0, ALL),
];

/// (enable, ready) bits of HSI, HSE and PLL in RCC_CR.
const CR_READY: [(u32, u32); 3] = [(CR_HSION, CR_HSIRDY), (HSEON, HSERDY), (PLLON, CR_PLLRDY)];
const CSSF: u32 = 1 << 8;
/// Start of the timers that schedule frames.
const FRAME_TIMERS: u32 = APB1ENR1_TIM2EN | APB1ENR1_TIM5EN;
const RESET_FLAGS: u32 = 0xFE00_0000;

/// High-speed internal oscillator, and the crystal of the NUCLEO-G474RE, in hertz.
const HSI_HZ: u64 = 1_000_000 * st::one_word::HSI16 as u64;
const HSE_HZ: u64 = 1_000_000 * st::HSE::nucleo as u64;
/// Start-up of the crystal, typical.
const CRYSTAL_TICKS: Ticks = st::t::SU_HSE as u64 * TICKS_PER_SECOND / 1_000;
/// How long the bus stays at half speed after a switch above 80 MHz (RM0440, "Clock switching").
const HALF_SPEED_TICKS: Ticks = st::half::speed_time as u64 * TICKS_PER_SECOND / 1_000_000;

/// Bits of one of the clock-enable registers; the reset register has the same layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gate {
    pub register: u32,
    pub bit: u32,
}

impl Gate {
    pub fn meets(self, other: Self) -> bool {
        self.register == other.register && self.bit & other.bit != 0
    }
}

#[derive(Debug)]
pub struct Rcc {
    /// Registers without their ready bits.
    bank: Bank,
    crystal_since: Ticks,
    /// When the PLL became the system clock.
    switched_at: Ticks,
    /// CSSF of CIFR, alone.
    clock_lost: u32,
}

impl Rcc {
    pub fn new() -> Self {
        let mut rcc = Self { bank: Bank::new(REGISTERS), crystal_since: 0, switched_at: 0, clock_lost: 0 };
        rcc.reset(ResetCause::PowerOn);
        rcc
    }

    /// Reset of the device. RCC_BDCR belongs to the backup domain and stays; flags add up.
    pub fn reset(&mut self, cause: ResetCause) {
        let (backup, flags) = (self.get(BDCR), self.get(CSR) & RESET_FLAGS);
        self.bank.reset();
        self.clock_lost = 0;
        self.set(BDCR, backup);
        // Every internal reset also pulls the NRST pin.
        let flags = match cause {
            ResetCause::PowerOn => BORRSTF,
            ResetCause::BrownOut => flags | BORRSTF,
            ResetCause::Pin => flags,
            ResetCause::Software => flags | SFTRSTF,
            ResetCause::Watchdog => flags | IWDGRSTF,
        };
        self.set(CSR, flags | PINRSTF);
    }

    /// The backup domain has lost its supply.
    pub fn reset_backup_domain(&mut self) {
        self.set(BDCR, 0);
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CR => {
                let cr =
                    CR_READY.iter().fold(self.get(CR), |cr, &(on, ready)| cr | if cr & on != 0 { ready } else { 0 });
                if self.has_crystal(effects) { cr } else { cr & !HSERDY }
            }
            CFGR => self.get(CFGR) | (self.get(CFGR) & SW) << 2,
            BDCR | CSR | CRRCR => self.get(offset) | (self.get(offset) & 1) << 1,
            CIFR => self.clock_lost,
            _ => self.bank.read(offset, effects),
        }
    }

    /// Writes a register. Returns the resets that it pulls, as gates of the same layout.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) -> Option<Gate> {
        match offset {
            CR => self.write_cr(value, effects),
            CFGR => self.write_cfgr(value, effects),
            PLLCFGR => self.write_pllcfgr(value, effects),
            CICR => self.clock_lost &= !value,
            BDCR => self.set(BDCR, if value & BDRST != 0 { BDRST } else { value & !0b10 }),
            CSR => {
                let flags = if value & RMVF != 0 { 0 } else { self.get(CSR) & RESET_FLAGS };
                self.set(CSR, flags | value & 1);
            }
            CRRCR => self.set(CRRCR, value & 1),
            AHB1RSTR..=APB2RSTR => {
                let before = self.get(offset);
                self.bank.write(offset, value, effects);
                return Some(Gate { register: offset + AHB1ENR - AHB1RSTR, bit: value & !before });
            }
            APB1ENR1 => {
                let is_slow = self.runs_from_pll() && !self.is_at_full_speed();
                effects.unmodelled_bits(value & !self.get(offset) & if is_slow { FRAME_TIMERS } else { 0 });
                self.set(offset, value);
            }
            _ => self.bank.write(offset, value, effects),
        }
        None
    }

    #[inline]
    pub fn is_on(&self, gate: Gate) -> bool {
        self.get(gate.register) & gate.bit != 0
    }

    /// The crystal stops. With the clock security system on, the non-maskable interrupt comes (RM0440, "Clock security
    /// system"); that the core goes on from the internal oscillator does not show.
    pub fn lose_crystal(&mut self, effects: &mut Effects) {
        if self.get(CR) & (CSSON | HSEON) == CSSON | HSEON {
            self.clock_lost = CSSF;
            effects.raise_nmi();
        }
    }

    /// Whether core and buses run at 170 MHz.
    pub fn is_at_full_speed(&self) -> bool {
        self.runs_from_pll() && self.get(CFGR) & HPRE == 0
    }

    fn has_crystal(&self, effects: &Effects) -> bool {
        let is_dead = effects.faults.has(Fault::HseDead);
        self.get(CR) & HSEON != 0 && !is_dead && effects.now >= self.crystal_since + CRYSTAL_TICKS
    }

    /// Whether the core runs from the PLL.
    pub fn runs_from_pll(&self) -> bool {
        self.get(CFGR) & SW == SW_PLL
    }

    pub fn holds_backup_domain(&self) -> bool {
        self.get(BDCR) & BDRST != 0
    }

    /// Whether the USB block gets its 48 MHz.
    pub fn has_usb_clock(&self) -> bool {
        match field(self.get(CCIPR), CCIPR_CLK48SEL) {
            0 => self.get(CRRCR) & CRRCR_HSI48ON != 0,
            2 => self.get(CR) & PLLON != 0 && self.get(PLLCFGR) & PLLQEN != 0,
            _ => false,
        }
    }

    fn get(&self, offset: u32) -> u32 {
        self.bank[offset]
    }

    fn set(&mut self, offset: u32, value: u32) {
        self.bank[offset] = value;
    }

    fn write_cr(&mut self, value: u32, effects: &mut Effects) {
        if self.runs_from_pll() && value & PLLON == 0 {
            effects.violation(value, "the PLL is switched off only while it is not the system clock");
        }
        if value & HSEON != 0 && self.get(CR) & HSEON == 0 {
            self.crystal_since = effects.now;
        }
        if value & PLLON != 0
            && self.get(CR) & PLLON == 0
            && self.get(PLLCFGR) & PLLCFGR_PLLSRC == PLLCFGR_PLLSRC_HSE
            && !self.has_crystal(effects)
        {
            effects.violation(value, "the PLL is switched on only while its source is ready");
        }
        self.set(CR, CR_READY.iter().fold(value, |cr, &(_, ready)| cr & !ready));
    }

    fn write_cfgr(&mut self, value: u32, effects: &mut Effects) {
        let (was_pll, was_full) = (self.runs_from_pll(), self.is_at_full_speed());
        self.set(CFGR, value & !0b1100);
        if !self.runs_from_pll() {
            return;
        }
        if !was_pll {
            self.switched_at = effects.now;
            if value & HPRE != HPRE_HALF {
                effects.violation(value, "the system clock is raised above 80 MHz while HPRE = 2");
            }
        } else if self.is_at_full_speed() && !was_full && effects.now < self.switched_at + HALF_SPEED_TICKS {
            effects.violation(value, "HPRE is set to 1 at least 1 µs after the system clock was raised above 80 MHz");
        }
        if self.get(CR) & PLLON == 0 {
            effects.violation(value, "the PLL is selected only while it is ready");
        }
        effects.unmodelled_bits(value & (CFGR_PPRE1 | CFGR_PPRE2));
        effects.unmodelled_bits(if value & HPRE == HPRE_HALF { 0 } else { value & HPRE });
        effects.unmodelled_bits(u32::from(self.pll_hz() != TICKS_PER_SECOND));
    }

    fn write_pllcfgr(&mut self, value: u32, effects: &mut Effects) {
        // The outputs can be switched, and P divided, while the PLL runs; its loop cannot change.
        let fixed = !(PLLPEN | PLLCFGR_PLLP | PLLCFGR_PLLPDIV | PLLQEN | PLLCFGR_PLLREN);
        if self.get(CR) & PLLON != 0 && (value ^ self.get(PLLCFGR)) & fixed != 0 {
            effects.violation(value, "RCC_PLLCFGR is written only while the PLL is off");
        }
        self.set(PLLCFGR, value);
    }

    /// Frequency of the PLL's R output.
    fn pll_hz(&self) -> u64 {
        let pll = self.get(PLLCFGR);
        let source = match pll & PLLCFGR_PLLSRC {
            PLLCFGR_PLLSRC_HSI => HSI_HZ,
            PLLCFGR_PLLSRC_HSE => HSE_HZ,
            _ => 0,
        };
        let [m, n, r] = [PLLCFGR_PLLM, PLLCFGR_PLLN, PLLCFGR_PLLR].map(|mask| u64::from(field(pll, mask)));
        source * n / (m + 1) / (2 * (r + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// HSI / 4 × 85 / 2.
    const PLL_170_MHZ: u32 = 2 | 3 << 4 | 85 << 8 | 1 << 24;

    #[test]
    fn oscillators_become_ready_and_the_switch_follows() {
        let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
        rcc.write(PLLCFGR, PLL_170_MHZ, &mut effects);
        rcc.write(CR, 1 << 8 | PLLON, &mut effects);
        assert_eq!(rcc.read(CR, &mut effects), 1 << 8 | 1 << 10 | PLLON | 1 << 25);
        rcc.write(CFGR, HPRE_HALF | 3, &mut effects);
        effects.now += HALF_SPEED_TICKS;
        rcc.write(CFGR, 3, &mut effects);
        assert_eq!(rcc.read(CFGR, &mut effects), 0b1111);
        assert_eq!((effects.violation_count, effects.unmodelled.len()), (0, 0));
        rcc.write(PLLCFGR, PLL_170_MHZ + (1 << 8), &mut effects);
        rcc.write(CR, 1 << 8, &mut effects);
        assert_eq!(effects.violation_count, 2);
        let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
        rcc.write(PLLCFGR, PLL_170_MHZ - (1 << 8), &mut effects);
        rcc.write(CR, 1 << 8 | PLLON, &mut effects);
        rcc.write(CFGR, 3, &mut effects);
        assert_eq!(effects.unmodelled.len(), 1, "another core clock");
    }

    #[test]
    fn the_clock_is_raised_by_way_of_half_the_bus_clock() {
        for (steps, broken) in [
            // (value of CFGR, ticks until then)
            (&[(HPRE_HALF | 3, 0), (3, HALF_SPEED_TICKS)][..], 0),
            (&[(HPRE_HALF | 3, 0), (3, HALF_SPEED_TICKS - 1)], 1),
            (&[(3, 0)], 1),
        ] {
            let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
            rcc.write(PLLCFGR, PLL_170_MHZ, &mut effects);
            rcc.write(CR, 1 << 8 | PLLON, &mut effects);
            for &(value, ticks) in steps {
                effects.now += ticks;
                rcc.write(CFGR, value, &mut effects);
            }
            assert_eq!(effects.violation_count, broken, "{steps:?}");
            assert!(rcc.is_at_full_speed());
        }
    }

    #[test]
    fn usb_has_the_clock_that_is_selected_and_runs() {
        let mut rcc = Rcc::new();
        assert!(!rcc.has_usb_clock());
        rcc.set(CRRCR, CRRCR_HSI48ON);
        assert!(rcc.has_usb_clock());
        rcc.set(CCIPR, 1 << CCIPR_CLK48SEL.trailing_zeros());
        assert!(!rcc.has_usb_clock(), "01 is reserved");
    }
}

//! What one peripheral does to the others: interrupt lines, DMA requests, triggers, resets,
//! and the record of broken rules.

use super::Ticks;
use crate::memory::Bits;
use crate::silicon::Silicon;
use std::collections::BTreeMap;

/// Position of an interrupt in the vector table (RM0440, "Interrupt and exception vectors").
pub mod interrupt {
    #![allow(missing_docs)]
    pub const PVD_PVM: u8 = 1;
    pub const FLASH: u8 = 4;
    pub const RCC: u8 = 5;
    pub const EXTI0: u8 = 6;
    pub const DMA1_CHANNEL1: u8 = 11;
    pub const ADC1_2: u8 = 18;
    pub const USB_HP: u8 = 19;
    pub const USB_LP: u8 = 20;
    pub const EXTI9_5: u8 = 23;
    pub const TIM2: u8 = 28;
    pub const TIM3: u8 = 29;
    pub const TIM4: u8 = 30;
    pub const USART1: u8 = 37;
    pub const EXTI15_10: u8 = 40;
    pub const USB_WAKEUP: u8 = 42;
    pub const ADC3: u8 = 47;
    pub const TIM5: u8 = 50;
    pub const DMA2_CHANNEL1: u8 = 56;
    pub const ADC4: u8 = 61;
    pub const ADC5: u8 = 62;
    pub const CRS: u8 = 75;
    pub const LPUART1: u8 = 91;
    pub const DMA1_CHANNEL8: u8 = 96;
    pub const DMA2_CHANNEL6: u8 = 97;
}

/// Number of a DMA request line (RM0440, "DMAMUX: assignment of multiplexer inputs to
/// resources").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request(pub u8);

impl Request {
    /// ADC1 has a result.
    pub const ADC1: Self = Self(5);
    /// USART1 has received a byte.
    pub const USART1_RX: Self = Self(24);
    /// USART1 has room for a byte to send.
    pub const USART1_TX: Self = Self(25);
    /// LPUART1 has received a byte.
    pub const LPUART1_RX: Self = Self(34);
    /// LPUART1 has room for a byte to send.
    pub const LPUART1_TX: Self = Self(35);
    /// ADC2 has a result.
    pub const ADC2: Self = Self(36);
    /// ADC3 has a result; ADC4 and ADC5 follow.
    pub const ADC3: Self = Self(37);
    /// TIM2 compare 1; channels 2 to 4 and the update follow.
    pub const TIM2_CH1: Self = Self(56);
    /// TIM2 update.
    pub const TIM2_UP: Self = Self(60);
    /// TIM3 compare 1; channels 2 to 4 and the update follow.
    pub const TIM3_CH1: Self = Self(61);
    /// TIM4 compare 1; channels 2 to 4 and the update follow.
    pub const TIM4_CH1: Self = Self(67);
    /// TIM5 compare 1; channels 2 to 4 and the update follow.
    pub const TIM5_CH1: Self = Self(72);
}

/// Trigger outputs (TRGO) of the general-purpose timers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// TIM2_TRGO.
    Tim2,
    /// TIM3_TRGO.
    Tim3,
    /// TIM4_TRGO.
    Tim4,
    /// TIM5_TRGO (no converter listens to it).
    Tim5,
}

/// Direction of a trigger's edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// Low to high.
    Rising,
    /// High to low.
    Falling,
}

/// Why the device was reset (RM0440, "RCC_CSR").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// The supply came up from nothing.
    PowerOn,
    /// The supply fell below the brown-out threshold and came back.
    BrownOut,
    /// NRST was pulled low.
    Pin,
    /// SYSRESETREQ.
    Software,
    /// The independent watchdog ran out, or was fed outside its window.
    Watchdog,
}

/// A rule of the reference manual that the program has broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When, in ticks since power-on.
    pub at: Ticks,
    /// Address of the instruction (during a DMA transfer: of the instruction beside it).
    pub pc: u32,
    /// Register or memory address.
    pub address: u32,
    /// Value written, or 0 for a read.
    pub value: u32,
    /// The rule.
    pub rule: &'static str,
}

/// Violations kept in full; those after them are only counted.
const VIOLATIONS_KEPT: usize = 1_000;

/// Everything that passes between peripherals, the core and the outside.
#[derive(Debug, Default)]
pub struct Effects {
    /// The present, in ticks since power-on.
    pub(crate) now: Ticks,
    /// Address of the instruction being executed.
    pub(crate) pc: u32,
    /// Address of the access being made.
    pub(crate) address: u32,
    lines: [u32; 4],
    /// The core or the machine has to look: lines, reset, NMI, stall, changed code or boot loader.
    pub(crate) attention: bool,
    requests: u128,
    triggers: u16,
    pub(crate) reset: Option<ResetCause>,
    pub(crate) nmi: bool,
    /// Flash has new content.
    pub(crate) code_changed: bool,
    /// The core has jumped into the factory's boot loader.
    pub(crate) boot_loader_entered: bool,
    /// The core waits on the bus until this instant.
    pub(crate) stalled_until: Ticks,
    /// What the silicon does against its manual.
    pub(crate) silicon: Silicon,
    /// What it does by chance.
    pub(crate) chance: Bits,
    /// Phase of the converters' clock, in ticks of any period.
    pub(crate) clock_phase: Ticks,
    violations: Vec<Violation>,
    violation_count: u64,
    unmodelled: BTreeMap<u32, u64>,
}

impl Effects {
    /// Nothing has happened yet, and it is tick `now`.
    #[cfg(test)]
    pub(crate) fn starting_at(now: Ticks) -> Self {
        Self { now, ..Self::default() }
    }

    /// The present, in ticks since power-on.
    pub fn now(&self) -> Ticks {
        self.now
    }

    /// Sets the level of interrupt line `number` (see [`interrupt`]).
    #[inline]
    pub fn set_line(&mut self, number: u8, level: bool) {
        let (word, bit) = (usize::from(number / 32), 1 << (number % 32));
        let before = self.lines[word];
        self.lines[word] = if level { before | bit } else { before & !bit };
        self.attention |= self.lines[word] != before;
    }

    /// Levels of all interrupt lines.
    pub fn lines(&self) -> &[u32; 4] {
        &self.lines
    }

    /// Raises a DMA request. It stays until a channel serves it or it is withdrawn.
    #[inline]
    pub fn request(&mut self, request: Request) {
        self.requests |= 1 << request.0;
    }

    /// Takes a DMA request back: its cause is gone (data read, DMA enable bit cleared).
    #[inline]
    pub fn withdraw(&mut self, request: Request) {
        self.requests &= !(1 << request.0);
    }

    /// DMA requests that wait, bit n for request n.
    #[inline]
    pub fn pending_requests(&self) -> u128 {
        self.requests
    }

    /// Sends an edge of a timer's trigger output.
    #[inline]
    pub fn trigger(&mut self, trigger: Trigger, edge: Edge) {
        self.triggers |= 1 << (2 * trigger as u16 + u16::from(edge == Edge::Falling));
    }

    /// Edges sent since the last call, as bits 2·trigger (rising) and 2·trigger + 1 (falling).
    #[inline]
    pub(crate) fn take_triggers(&mut self) -> u16 {
        std::mem::take(&mut self.triggers)
    }

    /// Asks for a reset of the whole device.
    pub fn request_reset(&mut self, cause: ResetCause) {
        self.reset = Some(cause);
        self.attention = true;
    }

    /// Makes the non-maskable interrupt pending.
    pub(crate) fn raise_nmi(&mut self) {
        self.nmi = true;
        self.attention = true;
    }

    /// Lets the core wait until `end`.
    pub(crate) fn stall_until(&mut self, end: Ticks) {
        self.stalled_until = self.stalled_until.max(end);
        self.attention = true;
    }

    /// Decoded code is out of date.
    pub(crate) fn forget_code(&mut self) {
        self.code_changed = true;
        self.attention = true;
    }

    /// Code is fetched from the boot loader.
    pub(crate) fn enter_boot_loader(&mut self) {
        self.boot_loader_entered = true;
        self.attention = true;
    }

    /// Forgets all that waits, for a reset; the records stay.
    pub(crate) fn clear_signals(&mut self) {
        self.lines = [0; 4];
        self.requests = 0;
        self.triggers = 0;
        self.reset = None;
        self.nmi = false;
        self.stalled_until = 0;
        self.boot_loader_entered = false;
        self.attention = true;
    }

    /// Records a broken rule at the address being accessed. `value`: what was written, or 0.
    #[cold]
    pub fn violation(&mut self, value: u32, rule: &'static str) {
        self.violation_count += 1;
        if self.violations.len() < VIOLATIONS_KEPT {
            self.violations.push(Violation { at: self.now, pc: self.pc, address: self.address, value, rule });
        }
    }

    /// Counts the choice of a mode that no model knows, if any of `bits` is set.
    #[inline]
    pub fn unmodelled_bits(&mut self, bits: u32) {
        if bits != 0 {
            self.unmodelled();
        }
    }

    /// Counts an access to a register, or the choice of a mode, that no model knows.
    #[cold]
    pub fn unmodelled(&mut self) {
        *self.unmodelled.entry(self.address).or_default() += 1;
    }

    /// Broken rules in order; at most a thousand are kept.
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    /// Number of broken rules, kept or not.
    pub fn violation_count(&self) -> u64 {
        self.violation_count
    }

    /// Addresses that no model knows, with the number of accesses.
    pub fn unmodelled_accesses(&self) -> &BTreeMap<u32, u64> {
        &self.unmodelled
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::facts::{self, assert_facts};

    #[test]
    fn interrupts_are_those_of_st() {
        use interrupt::*;
        assert_facts!(""; PVD_PVM = "PVD_PVM_IRQn", FLASH = "FLASH_IRQn", RCC = "RCC_IRQn", EXTI0 = "EXTI0_IRQn");
        assert_facts!(""; DMA1_CHANNEL1 = "DMA1_Channel1_IRQn", ADC1_2 = "ADC1_2_IRQn", USB_HP = "USB_HP_IRQn");
        assert_facts!(""; USB_LP = "USB_LP_IRQn", EXTI9_5 = "EXTI9_5_IRQn", TIM2 = "TIM2_IRQn", TIM3 = "TIM3_IRQn");
        assert_facts!(""; TIM4 = "TIM4_IRQn", EXTI15_10 = "EXTI15_10_IRQn", USB_WAKEUP = "USBWakeUp_IRQn");
        assert_facts!(""; ADC3 = "ADC3_IRQn", TIM5 = "TIM5_IRQn", DMA2_CHANNEL1 = "DMA2_Channel1_IRQn");
        assert_facts!(""; ADC4 = "ADC4_IRQn", ADC5 = "ADC5_IRQn", CRS = "CRS_IRQn", LPUART1 = "LPUART1_IRQn", USART1 = "USART1_IRQn");
        assert_facts!(""; DMA1_CHANNEL8 = "DMA1_Channel8_IRQn", DMA2_CHANNEL6 = "DMA2_Channel6_IRQn");
    }

    #[test]
    fn requests_are_those_of_st() {
        let offset = |request: Request, by: u8| Request(request.0 + by);
        let requests = [
            ("ADC1", Request::ADC1),
            ("USART1_RX", Request::USART1_RX),
            ("USART1_TX", Request::USART1_TX),
            ("LPUART1_RX", Request::LPUART1_RX),
            ("LPUART1_TX", Request::LPUART1_TX),
            ("ADC2", Request::ADC2),
            ("ADC3", Request::ADC3),
            ("ADC4", offset(Request::ADC3, 1)),
            ("ADC5", offset(Request::ADC3, 2)),
            ("TIM2_CH1", Request::TIM2_CH1),
            ("TIM2_CH2", offset(Request::TIM2_CH1, 1)),
            ("TIM2_CH3", offset(Request::TIM2_CH1, 2)),
            ("TIM2_CH4", offset(Request::TIM2_CH1, 3)),
            ("TIM2_UP", Request::TIM2_UP),
            ("TIM2_UP", offset(Request::TIM2_CH1, 4)),
            ("TIM3_CH1", Request::TIM3_CH1),
            ("TIM3_UP", offset(Request::TIM3_CH1, 4)),
            ("TIM4_CH1", Request::TIM4_CH1),
            ("TIM4_UP", offset(Request::TIM4_CH1, 4)),
            ("TIM5_CH1", Request::TIM5_CH1),
            ("TIM5_UP", offset(Request::TIM5_CH1, 4)),
        ];
        for (name, request) in requests {
            assert_eq!(u32::from(request.0), facts::bits(&format!("LL_DMAMUX_REQ_{name}")), "{name}");
        }
    }
}

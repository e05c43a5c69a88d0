//! What one peripheral does to the others: interrupt lines, DMA requests, triggers, resets,
//! and the record of broken rules.

use super::Ticks;
use crate::faults::Faults;
use crate::memory::Bits;
use std::collections::BTreeMap;

/// Numbers by ST's names, and `ALL`, the table of them for a test.
macro_rules! numbered {
    ($type:ty; |$number:ident| $make:expr; $($name:ident = $value:literal,)+) => {
        $(pub const $name: $type = { let $number = $value; $make };)+
        #[cfg(test)]
        pub const ALL: &[(&str, u32)] = &[$((stringify!($name), $value)),+];
    };
}

/// Position of an interrupt in the vector table (RM0440, "Interrupt and exception vectors").
pub mod interrupt {
    numbered! { u8; |number| number;
        PVD_PVM = 1,
        FLASH = 4,
        EXTI0 = 6,
        DMA1_CHANNEL1 = 11,
        ADC1_2 = 18,
        USB_LP = 20,
        EXTI9_5 = 23,
        TIM2 = 28,
        TIM3 = 29,
        TIM4 = 30,
        USART1 = 37,
        EXTI15_10 = 40,
        ADC3 = 47,
        TIM5 = 50,
        DMA2_CHANNEL1 = 56,
        ADC4 = 61,
        ADC5 = 62,
        LPUART1 = 91,
        DMA1_CHANNEL8 = 96,
        DMA2_CHANNEL6 = 97,
    }
}

/// Number of a DMA request line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request(pub u8);

impl Request {
    /// The request `offset` lines on: ADC4 and ADC5 follow ADC3, channels 2 to 4 and the update follow channel 1 of a timer.
    pub fn after(self, offset: u8) -> Self {
        Self(self.0 + offset)
    }
}

/// RM0440, "DMAMUX: assignment of multiplexer inputs to resources".
pub mod request {
    use super::Request;

    numbered! { Request; |number| Request(number);
        ADC1 = 5,
        USART1_RX = 24,
        USART1_TX = 25,
        LPUART1_RX = 34,
        LPUART1_TX = 35,
        ADC2 = 36,
        ADC3 = 37,
        TIM2_CH1 = 56,
        TIM3_CH1 = 61,
        TIM4_CH1 = 67,
        TIM5_CH1 = 72,
    }
}

/// Trigger outputs (TRGO) of the general-purpose timers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    Tim2,
    Tim3,
    Tim4,
    /// TIM5_TRGO (no converter listens to it).
    Tim5,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    Rising,
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
    pub at: Ticks,
    /// Address of the instruction (during a DMA transfer: of the instruction beside it).
    pub pc: u32,
    pub address: u32,
    /// Value written, or 0 for a read.
    pub value: u32,
    pub rule: &'static str,
}

/// Violations kept in full; those after them are only counted.
const VIOLATIONS_KEPT: usize = 1_000;

/// Everything that passes between peripherals, the core and the outside.
#[derive(Debug, Default)]
pub struct Effects {
    pub now: Ticks,
    pub pc: u32,
    pub address: u32,
    lines: [u32; 4],
    /// The core or the machine has to look: lines, reset, NMI, stall, changed code or boot loader.
    pub attention: bool,
    requests: u128,
    triggers: u16,
    pub reset: Option<ResetCause>,
    pub nmi: bool,
    /// Flash has new content.
    pub code_changed: bool,
    /// The core has jumped into the factory's boot loader.
    pub boot_loader_entered: bool,
    /// The core waits on the bus until this instant.
    pub stalled_until: Ticks,
    /// What the silicon does against its manual.
    pub faults: Faults,
    /// What it does by chance.
    pub chance: Bits,
    /// Phase of the converters' clock, in ticks of any period.
    pub clock_phase: Ticks,
    violations: Vec<Violation>,
    violation_count: u64,
    unmodelled: BTreeMap<u32, u64>,
}

impl Effects {
    #[cfg(test)]
    pub fn starting_at(now: Ticks) -> Self {
        Self { now, ..Self::default() }
    }

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
    pub fn take_triggers(&mut self) -> u16 {
        std::mem::take(&mut self.triggers)
    }

    /// Asks for a reset of the whole device.
    pub fn request_reset(&mut self, cause: ResetCause) {
        self.reset = Some(cause);
        self.attention = true;
    }

    pub fn raise_nmi(&mut self) {
        self.nmi = true;
        self.attention = true;
    }

    /// Lets the core wait until `end`.
    pub fn stall_until(&mut self, end: Ticks) {
        self.stalled_until = self.stalled_until.max(end);
        self.attention = true;
    }

    /// Decoded code is out of date.
    pub fn forget_code(&mut self) {
        self.code_changed = true;
        self.attention = true;
    }

    /// Code is fetched from the boot loader.
    pub fn enter_boot_loader(&mut self) {
        self.boot_loader_entered = true;
        self.attention = true;
    }

    /// Forgets all that waits, for a reset; the records stay.
    pub fn clear_signals(&mut self) {
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
    use crate::facts;

    #[test]
    fn interrupts_are_those_of_st() {
        for (name, number) in interrupt::ALL {
            let name = name.replace("CHANNEL", "Channel");
            assert_eq!(*number, facts::bits(&format!("{name}_IRQn")), "{name}");
        }
    }

    #[test]
    fn requests_are_those_of_st() {
        let after = |name, number: &u32, by| (name, number + by);
        let [_, _, _, _, _, _, (_, adc3), (_, tim2), (_, tim3), (_, tim4), (_, tim5)] = request::ALL else { panic!() };
        let following = [
            after("ADC4", adc3, 1),
            after("ADC5", adc3, 2),
            after("TIM2_CH2", tim2, 1),
            after("TIM2_CH3", tim2, 2),
            after("TIM2_CH4", tim2, 3),
            after("TIM2_UP", tim2, 4),
            after("TIM3_UP", tim3, 4),
            after("TIM4_UP", tim4, 4),
            after("TIM5_UP", tim5, 4),
        ];
        for (name, number) in request::ALL.iter().copied().chain(following) {
            assert_eq!(number, facts::bits(&format!("LL_DMAMUX_REQ_{name}")), "{name}");
        }
    }
}

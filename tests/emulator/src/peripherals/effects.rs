//! What one peripheral does to the others: interrupt lines, DMA requests, triggers, resets,
//! and the record of broken rules; and registers that hold what is written, as tables.

use super::Ticks;
use crate::faults::Faults;
use crate::memory::Bits;
use std::collections::BTreeMap;
use std::ops::{Index, IndexMut};

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
    /// The independent watchdog ran out.
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
    pub lines: [u32; 4],
    /// The core or the machine has to look: lines, reset, NMI or boot loader.
    pub attention: bool,
    /// DMA requests that wait, bit n for request n.
    pub requests: u128,
    /// TIM2's trigger output (TRGO) has risen.
    pub triggered: bool,
    pub reset: Option<ResetCause>,
    pub nmi: bool,
    /// The core has jumped into the factory's boot loader.
    pub boot_loader_entered: bool,
    /// What the silicon does against its manual.
    pub faults: Faults,
    pub chance: Bits,
    /// Phase of the converters' clock, in ticks of any period.
    pub clock_phase: Ticks,
    /// Broken rules in order; at most a thousand are kept.
    pub violations: Vec<Violation>,
    pub violation_count: u64,
    /// Addresses that no model knows, with the number of accesses.
    pub unmodelled: BTreeMap<u32, u64>,
}

impl Effects {
    /// Sets the level of the interrupt line with this position in the vector table (ST's `…_IRQn`).
    #[inline]
    pub fn set_line(&mut self, number: u32, level: bool) {
        let (word, bit) = ((number / 32) as usize, 1 << (number % 32));
        let before = self.lines[word];
        self.lines[word] = if level { before | bit } else { before & !bit };
        self.attention |= self.lines[word] != before;
    }

    /// Raises the DMA request of this number (ST's `LL_DMAMUX_REQ_…`). It stays until a channel serves it or it is withdrawn.
    #[inline]
    pub fn request(&mut self, request: u32) {
        self.requests |= 1 << request;
    }

    /// Takes a DMA request back: its cause is gone (data read, DMA enable bit cleared).
    #[inline]
    pub fn withdraw(&mut self, request: u32) {
        self.requests &= !(1 << request);
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

    /// Code is fetched from the boot loader.
    pub fn enter_boot_loader(&mut self) {
        self.boot_loader_entered = true;
        self.attention = true;
    }

    /// Forgets all that waits, for a reset; the records stay.
    pub fn clear_signals(&mut self) {
        self.lines = [0; 4];
        self.requests = 0;
        self.triggered = false;
        self.reset = None;
        self.nmi = false;
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
}

/// Registers that are alike: the offset of the first, how many they are, value after reset, and the bits that a write sets or
/// clears; no model knows a write that changes others, unless the unit's own code answers for it.
pub type Register = (u32, u32, u32, u32);

pub const ALL: u32 = u32::MAX;

/// Room for the registers of any unit.
const WORDS: usize = 96;

#[derive(Clone, Debug)]
pub struct Bank {
    table: &'static [Register],
    words: [u32; WORDS],
}

impl Default for Bank {
    fn default() -> Self {
        Self::new(&[])
    }
}

impl Bank {
    pub fn new(table: &'static [Register]) -> Self {
        let mut bank = Self { table, words: [0; WORDS] };
        bank.reset();
        bank
    }

    pub fn reset(&mut self) {
        for &(first, count, reset, _) in self.table {
            (0..count).for_each(|index| self[first + 4 * index] = reset);
        }
    }

    /// Bits that a write to the register keeps, if there is one.
    fn keeps(&self, offset: u32) -> Option<u32> {
        let row = self.table.iter().find(|(first, count, ..)| (*first..first + 4 * count).contains(&offset));
        row.map(|row| row.3)
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        if self.keeps(offset).is_none() {
            effects.unmodelled();
            return 0;
        }
        self[offset]
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match self.keeps(offset) {
            None => effects.unmodelled(),
            Some(keeps) => {
                effects.unmodelled_bits((self[offset] ^ value) & !keeps);
                self[offset] = self[offset] & !keeps | value & keeps;
            }
        }
    }
}

impl Index<u32> for Bank {
    type Output = u32;

    #[inline]
    fn index(&self, offset: u32) -> &u32 {
        &self.words[(offset / 4) as usize]
    }
}

impl IndexMut<u32> for Bank {
    #[inline]
    fn index_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.words[(offset / 4) as usize]
    }
}

//! Exceptions waiting, enabled and active, and which of them comes next (DDI0403, B1.5 and B3.4).
//!
//! One bit per exception number: 16 system exceptions and interrupts 0–111 (the STM32G474 has 102).

use super::registers::Registers;

/// Exception numbers (DDI0403, B1.5.2).
pub(super) const NMI: u8 = 2;
pub(super) const HARD_FAULT: u8 = 3;
/// Number of interrupt 0.
pub(super) const FIRST_INTERRUPT: u8 = 16;

/// Lower in urgency than every exception.
const THREAD_PRIORITY: i16 = 256;

#[derive(Clone, Debug)]
pub(super) struct Nvic {
    pub pending: u128,
    pub enabled: u128,
    pub active: u128,
    /// Levels of the interrupt lines, at the bit of their exception.
    lines: u128,
    /// Priorities by exception number; the STM32 has the upper four bits.
    priority: [u8; 128],
}

/// Exceptions that cannot be disabled.
const ALWAYS_ENABLED: u128 = 1 << NMI | 1 << HARD_FAULT;

impl Default for Nvic {
    fn default() -> Self {
        Self { pending: 0, enabled: ALWAYS_ENABLED, active: 0, lines: 0, priority: [0; 128] }
    }
}

impl Nvic {
    /// Takes the levels of the interrupt lines; a rising one becomes pending. Returns whether one did.
    pub fn set_lines(&mut self, lines: &[u32; 4]) -> bool {
        let lines = lines.iter().rev().fold(0u128, |all, &word| all << 32 | u128::from(word)) << FIRST_INTERRUPT;
        let rising = lines & !self.lines;
        self.lines = lines;
        self.pend_all(rising);
        rising != 0
    }

    pub fn pend(&mut self, exception: u8) {
        self.pend_all(1 << exception);
    }

    pub fn pend_all(&mut self, exceptions: u128) {
        self.pending |= exceptions;
    }

    /// Clears pending bits; an interrupt whose line is high and which is not active stays.
    pub fn unpend_all(&mut self, exceptions: u128) {
        self.pending &= !exceptions | self.lines & !self.active;
    }

    pub fn is_active(&self, exception: u8) -> bool {
        self.active >> exception & 1 != 0
    }

    pub fn activate(&mut self, exception: u8) {
        self.pending &= !(1 << exception);
        self.active |= 1 << exception;
    }

    /// The handler ends; a line that is still high makes its interrupt pending again.
    pub fn deactivate(&mut self, exception: u8) {
        self.active &= !(1 << exception);
        self.pend_all(self.lines & 1 << exception);
    }

    pub fn priority(&self, exception: u8) -> u8 {
        self.priority[usize::from(exception & 127)]
    }

    pub fn set_priority(&mut self, exception: u8, priority: u8) {
        self.priority[usize::from(exception & 127)] = priority & 0xf0;
    }

    /// Preemption priority of an exception; smaller is more urgent.
    pub fn urgency(&self, exception: u8) -> i16 {
        match exception {
            0..=NMI => -2,
            HARD_FAULT => -1,
            _ => self.priority(exception).into(),
        }
    }

    /// ExecutionPriority: of the active exceptions and PRIMASK.
    pub fn execution_priority(&self, registers: &Registers) -> i16 {
        let mut priority = numbers(self.active).map(|n| self.urgency(n)).min().unwrap_or(THREAD_PRIORITY);
        if registers.primask {
            priority = priority.min(0);
        }
        priority
    }

    /// The most urgent exception that is pending, enabled, and preempts execution at `priority`; the lowest number among
    /// equals.
    pub fn preempting(&self, priority: i16) -> Option<u8> {
        let most_urgent = numbers(self.pending & self.enabled).min_by_key(|&n| self.urgency(n));
        most_urgent.filter(|&n| self.urgency(n) < priority)
    }
}

/// Numbers of the bits that are set, ascending.
fn numbers(mut bits: u128) -> impl Iterator<Item = u8> {
    std::iter::from_fn(move || {
        let number = bits.trailing_zeros() as u8;
        bits &= bits.wrapping_sub(1);
        (number < 128).then_some(number)
    })
}

/// Reason of a fault (DDI0403, B1.5.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    #[error("bus fault: data access to {address:#010x}")]
    DataBus { address: u32 },
    #[error("memory fault: data access to guarded {address:#010x}")]
    Guarded { address: u32 },
    #[error("bus fault: instruction fetch from {address:#010x}")]
    FetchBus { address: u32 },
    #[error("memory fault: instruction fetch from non-executable {address:#010x}")]
    FetchNeverExecute { address: u32 },
    #[error("bus fault while stacking at {address:#010x}")]
    Stacking { address: u32 },
    #[error("memory fault while stacking at guarded {address:#010x}")]
    StackingGuarded { address: u32 },
    #[error("bus fault while unstacking at {address:#010x}")]
    Unstacking { address: u32 },
    #[error("bus fault while reading the vector at {address:#010x}")]
    VectorTable { address: u32 },
    #[error("usage fault: FPSCR {fpscr:#010x} asks for a mode that the emulator does not model")]
    FloatMode { fpscr: u32 },
    #[error("usage fault: undefined instruction {first:#06x} {second:#06x}")]
    Undefined { first: u16, second: u16 },
    #[error("usage fault: execution with EPSR.T clear")]
    InvalidState,
    #[error("usage fault: invalid exception return {value:#010x}")]
    InvalidReturn { value: u32 },
    #[error("usage fault: coprocessor absent or not enabled")]
    NoCoprocessor,
    #[error("usage fault: unaligned access to {address:#010x}")]
    Unaligned { address: u32 },
}

/// The state of the core when a fault was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{fault} at pc {pc:#010x} (lr {lr:#010x}, sp {sp:#010x}, xpsr {xpsr:#010x}, CFSR {cfsr:#010x})")]
pub struct FaultReport {
    pub fault: Fault,
    pub pc: u32,
    pub lr: u32,
    pub sp: u32,
    pub xpsr: u32,
    pub cfsr: u32,
}

impl Fault {
    /// Its bit in CFSR.
    pub(super) fn status(self) -> u32 {
        match self {
            Self::FetchNeverExecute { .. } => 1 << 0,
            Self::Guarded { .. } => 1 << 1,
            Self::StackingGuarded { .. } => 1 << 4,
            Self::FetchBus { .. } => 1 << 8,
            Self::DataBus { .. } => 1 << 9,
            Self::Unstacking { .. } => 1 << 11,
            Self::Stacking { .. } => 1 << 12,
            Self::Undefined { .. } | Self::FloatMode { .. } => 1 << 16,
            Self::InvalidState => 1 << 17,
            Self::InvalidReturn { .. } => 1 << 18,
            Self::NoCoprocessor => 1 << 19,
            Self::Unaligned { .. } => 1 << 24,
            Self::VectorTable { .. } => 0,
        }
    }
}

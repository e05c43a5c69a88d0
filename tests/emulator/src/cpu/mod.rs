//! The processor core: a Cortex-M4F (ARMv7E-M, FPv4-SP) with its NVIC, cycle counter and system control
//! block.
//!
//! Halfwords become `instruction::Instruction`s (`decode`), once per address of flash; `execute` and its
//! siblings carry them out; `exceptions` takes interrupts and faults; `system` is the private peripheral bus
//! 0xE000_0000–0xE00F_FFFF, which the [`Board`] never sees.
//!
//! Not modelled: what the image leaves alone: WFI, SVC, BKPT, PendSV, SysTick, priorities of system handlers, unprivileged code, the process stack, BASEPRI and FAULTMASK, groups of
//! priorities; code that is programmed while the core runs; instructions that no compiler makes (see `instruction`); the MPU but for data accesses to a region 0 that allows none, debug halting, and the imprecision of bus faults on buffered
//! writes (they are all precise here). Floating-point registers are stacked at once; their cycles are charged
//! when the handler first uses the floating-point unit, as lazy stacking would.

mod arithmetic;
mod code;
mod decode;
mod exceptions;
mod execute;
mod execute_memory;
mod float;
mod instruction;
mod nvic;
mod registers;
mod system;
#[cfg(test)]
mod tests;

use crate::board::Board;
use code::{Accelerator, Code, Decoded, NOTHING_IN_FLIGHT};
use float::FloatUnit;
use instruction::Reg;
use nvic::Nvic;
pub use nvic::{Fault, FaultReport};
use registers::Registers;
use system::System;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Size {
    pub fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }
}

/// The address answers nothing, or refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusFault;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// One instruction was executed or one exception entered.
    Ran { cycles: u32 },
    /// WFE waits and nothing wakes the core.
    Asleep,
    /// AIRCR.SYSRESETREQ was written; the core stands still until [`Cpu::reset`].
    ResetRequested,
    /// A fault with no handler left to take it; the core stands still until [`Cpu::reset`].
    Lockup(FaultReport),
}

/// Registers as the programmer sees them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// R0–R12, stack pointer in use, LR, address of the next instruction.
    pub r: [u32; 16],
    /// Flags, IT state and exception number.
    pub xpsr: u32,
    /// Bits of S0–S31.
    pub s: [u32; 32],
    /// Floating-point status and control.
    pub fpscr: u32,
}

/// Why an instruction does not simply end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trap {
    Fault(Fault),
    ExceptionReturn(u32),
}

impl From<Fault> for Trap {
    fn from(fault: Fault) -> Self {
        Self::Fault(fault)
    }
}

/// The core. It starts unreset: call [`Cpu::reset`] first.
#[derive(Clone, Debug, Default)]
pub struct Cpu {
    registers: Registers,
    /// Address of the next instruction.
    pc: u32,
    float: FloatUnit,
    nvic: Nvic,
    system: System,
    code: Code,
    accelerator: Accelerator,
    /// Levels of the interrupt lines, as last told.
    lines: [u32; 4],
    /// Something may have to happen before the next instruction: see `attend`.
    attention: bool,
    /// WFE waits.
    is_waiting: bool,
    /// See [`Cpu::fetch_wrong_behind_sleep`].
    fetches_wrong_behind_sleep: bool,
    /// The event register of WFE.
    event: bool,
    /// The local exclusive monitor; that of the Cortex-M4 keeps no address (DDI0439, 3.7).
    exclusive: bool,
    /// Registers the next access's address cannot use at once: see `code::Timing`.
    in_flight: u16,
    /// Whether the instruction being executed stands in an IT block.
    in_it_block: bool,
    /// Cycles of the current step.
    cycles: u32,
    /// Cycles executed since the first reset, without sleep.
    executed: u64,
    instructions: u64,
    last_fault: Option<FaultReport>,
    lockup: Option<FaultReport>,
}

/// Where the vector table is found at reset; the STM32G474 shows its flash at 0 and at 0x0800_0000.
const RESET_VECTORS: u32 = 0x0800_0000;

impl Cpu {
    /// Resets the core: stack pointer and program counter from the vector table at 0x0800_0000. Counters of
    /// instructions and cycles, the report of the last fault and decoded code stay; interrupt lines count as low
    /// until [`Self::set_lines`] tells otherwise.
    pub fn reset(&mut self, board: &mut Board) {
        // A vector that cannot be read is all ones: the first fetch will fault and, without a handler, lock up.
        let mut vector = |address| board.read(address, Size::Word).unwrap_or(0xffff_ffff);
        self.registers = Registers::at_reset(vector(RESET_VECTORS));
        let start = vector(RESET_VECTORS + 4);
        self.registers.thumb = start & 1 != 0;
        self.pc = start & !1;
        self.float = FloatUnit::default();
        self.nvic = Nvic::default();
        self.lines = [0; 4];
        self.system = System::default();
        self.accelerator = Accelerator::default();
        self.attention = true;
        self.is_waiting = false;
        self.event = false;
        self.exclusive = false;
        self.in_flight = NOTHING_IN_FLIGHT;
        self.lockup = None;
    }

    /// VTOR.
    pub fn vectors(&self) -> u32 {
        self.system.vectors
    }

    /// Forgets decoded code: flash gets another program while the core runs the boot loader.
    pub fn forget_code(&mut self) {
        self.code = Code::default();
    }

    /// Tells the levels of interrupt lines 0–127; 112 and up do not exist and are ignored.
    #[inline]
    pub fn set_lines(&mut self, lines: &[u32; 4]) {
        if self.lines != *lines {
            self.lines = *lines;
            self.attention |= self.nvic.set_lines(lines);
        }
    }

    /// Makes the non-maskable interrupt pending.
    pub fn raise_nmi(&mut self) {
        self.nvic.pend(nvic::NMI);
        self.attention = true;
    }

    /// Whether a WFE that sleeps has an undefined instruction behind it, whatever is there but ISB; see
    /// [`crate::faults::Fault::SleepFetch`].
    pub fn fetch_wrong_behind_sleep(&mut self, wrong: bool) {
        self.fetches_wrong_behind_sleep = wrong;
    }

    /// Address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.pc
    }

    /// Peripherals that stand still while a debugger halts the core, as DBGMCU_APB1FZR1 has them.
    pub fn frozen_in_halt(&self) -> u32 {
        self.system.frozen_in_halt
    }

    /// Lowest value of the main stack pointer since reset.
    pub fn min_sp(&self) -> u32 {
        self.registers.min_msp
    }

    /// The registers a debugger would show.
    pub fn state(&self) -> State {
        let mut r = self.registers.r;
        r[15] = self.pc;
        State { r, xpsr: self.registers.xpsr(), s: self.float.s, fpscr: self.float.fpscr() }
    }

    /// Sets the registers, as a debugger would.
    pub fn set_state(&mut self, state: &State) {
        self.registers.r = state.r;
        self.registers.set_xpsr(state.xpsr);
        self.pc = state.r[15] & !1;
        self.float.s = state.s;
        self.float.restore_fpscr(state.fpscr);
        self.attention = true;
    }

    /// Instructions executed since the first reset.
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// The last fault taken, also if its handler returned.
    pub fn last_fault(&self) -> Option<&FaultReport> {
        self.last_fault.as_ref()
    }

    /// Takes a pending exception or executes one instruction.
    #[inline]
    pub fn step(&mut self, board: &mut Board) -> Step {
        if self.attention
            && let Some(step) = self.attend(board)
        {
            return step;
        }
        self.execute_next(board)
    }

    fn execute_next(&mut self, board: &mut Board) -> Step {
        let address = self.pc;
        self.cycles = 0;
        let decoded = match self.code.get(address) {
            Some(decoded) => decoded,
            None => match self.code.load(board, address) {
                Ok(decoded) => decoded,
                Err(fault) => return self.take_fault(board, fault, address),
            },
        };
        if self.accelerator.misses_instruction(address) {
            self.cycles += board.wait_states(address);
        }
        self.cycles += u32::from(decoded.timing.cycles);
        if decoded.timing.needs & self.in_flight == 0 {
            self.cycles -= 1;
        }
        self.in_flight = decoded.timing.busy;
        self.registers.r[15] = address.wrapping_add(4);
        self.pc = address.wrapping_add(u32::from(decoded.bytes));
        self.instructions += 1;
        if self.registers.it != 0 {
            return self.execute_in_it_block(board, address, decoded);
        }
        self.in_it_block = false;
        match self.execute(board, decoded.instruction) {
            Ok(()) => self.ran(),
            Err(trap) => self.take_trap(board, trap, address),
        }
    }

    #[cold]
    #[inline(never)]
    fn execute_in_it_block(&mut self, board: &mut Board, address: u32, decoded: Decoded) -> Step {
        let instruction = decoded.instruction;
        let state = self.registers.it;
        // ITAdvance.
        self.registers.it = if state & 7 == 0 { 0 } else { state & 0xe0 | state << 1 & 0x1f };
        if !self.registers.flags.pass(state >> 4) {
            // One cycle, and the waiting for flash.
            self.cycles = (self.cycles + 1 - u32::from(decoded.timing.cycles)).max(1);
            self.in_flight = NOTHING_IN_FLIGHT;
            return self.ran();
        }
        self.in_it_block = true;
        match self.execute(board, instruction) {
            Ok(()) => self.ran(),
            Err(trap) => {
                if matches!(trap, Trap::Fault(_)) {
                    self.registers.it = state;
                }
                self.take_trap(board, trap, address)
            }
        }
    }

    #[inline(always)]
    fn ran(&mut self) -> Step {
        self.executed += u64::from(self.cycles);
        Step::Ran { cycles: self.cycles }
    }

    #[cold]
    #[inline(never)]
    fn take_trap(&mut self, board: &mut Board, trap: Trap, address: u32) -> Step {
        match trap {
            Trap::Fault(fault) => self.take_fault(board, fault, address),
            Trap::ExceptionReturn(value) => self.exception_return(board, value),
        }
    }

    #[inline(always)]
    fn get(&self, register: Reg) -> u32 {
        self.registers.get(register)
    }

    #[inline(always)]
    fn set(&mut self, register: Reg, value: u32) {
        self.registers.set(register, value);
    }
}

//! Exception entry and return, faults, sleep (DDI0403, B1.5).
//!
//! Simplified: a fault while stacking becomes HardFault at once instead of competing as a derived exception; a vector that
//! cannot be read, or a return that cannot be made, locks the core up; late arrival is not modelled.

use super::code::{ENTRY, FLOAT_FRAME, NOTHING_IN_FLIGHT, RETURN, TAIL_CHAIN};
use super::nvic::HARD_FAULT;
use super::{Cpu, Fault, FaultReport, Size, Step};
use crate::board::Board;

/// R0–R3, R12, LR, return address, xPSR.
const BASIC_FRAME: u32 = 0x20;
/// The basic frame, S0–S15, FPSCR and a reserved word.
const FLOAT_FRAME_BYTES: u32 = 0x68;

impl Cpu {
    /// What may have to happen before the next instruction: reset, lockup, an exception, sleep. `None`: execute.
    #[cold]
    #[inline(never)]
    pub(super) fn attend(&mut self, board: &mut Board) -> Option<Step> {
        if self.system.reset_requested {
            return Some(Step::ResetRequested);
        }
        if let Some(report) = self.lockup {
            return Some(Step::Lockup(report));
        }
        if let Some(exception) = self.nvic.preempting(self.execution_priority()) {
            self.is_waiting = false;
            self.cycles = 0;
            return Some(self.enter_exception(board, exception, self.pc));
        }
        if self.is_waiting && !std::mem::take(&mut self.event) {
            return Some(Step::Asleep);
        }
        self.is_waiting = false;
        self.attention = false;
        if !self.registers.thumb {
            self.cycles = 0;
            return Some(self.take_fault(board, Fault::InvalidState, self.pc));
        }
        None
    }

    pub(super) fn execution_priority(&self) -> i16 {
        self.nvic.execution_priority(&self.registers)
    }

    /// ExceptionEntry.
    fn enter_exception(&mut self, board: &mut Board, exception: u8, return_address: u32) -> Step {
        self.cycles += ENTRY;
        match self.push_frame(board, return_address) {
            Ok(()) => self.take_exception(board, exception),
            Err(fault) if exception < HARD_FAULT => self.lock_up(fault, return_address),
            // Also on the way to HardFault: what was preempted is less urgent, so the handler is entered without its frame
            // (DDI0403, B1.5.11, DerivedLateArrival).
            Err(fault) => {
                self.report(fault, return_address);
                self.take_exception(board, HARD_FAULT)
            }
        }
    }

    /// PushStack: the frame, and EXC_RETURN in LR.
    fn push_frame(&mut self, board: &mut Board, return_address: u32) -> Result<(), Fault> {
        let float = self.registers.float_active;
        let bytes = if float { FLOAT_FRAME_BYTES } else { BASIC_FRAME };
        let old = self.registers.sp();
        let padded = old & 4 != 0;
        let base = old.wrapping_sub(bytes) & !7;
        let xpsr = self.registers.xpsr() | u32::from(padded) << 9;
        self.registers.set_sp(base);
        let r = &self.registers.r;
        let frame = [r[0], r[1], r[2], r[3], r[12], r[14], return_address, xpsr];
        self.store_frame(board, base, &frame)?;
        if float {
            let (low, status) = (self.float.s, self.float.fpscr());
            self.store_frame(board, base.wrapping_add(BASIC_FRAME), &low[..16])?;
            self.store_frame(board, base.wrapping_add(BASIC_FRAME + 64), &[status])?;
            // Paid when the floating-point unit is used.
            self.float.stacking_unpaid = true;
        }
        let mode: u32 = if self.registers.ipsr != 0 { 0xffff_fff1 } else { 0xffff_fff9 };
        self.registers.r[14] = mode & !(u32::from(float) << 4);
        Ok(())
    }

    fn store_frame(&mut self, board: &mut Board, base: u32, words: &[u32]) -> Result<(), Fault> {
        for (address, &word) in (base..).step_by(4).zip(words) {
            if self.is_guarded(address) {
                return Err(Fault::StackingGuarded { address });
            }
            board.write(address, Size::Word, word).map_err(|_| Fault::Stacking { address })?;
        }
        Ok(())
    }

    /// ExceptionTaken: the handler starts with the registers as they are.
    fn take_exception(&mut self, board: &mut Board, exception: u8) -> Step {
        self.nvic.activate(exception);
        self.registers.ipsr = exception.into();
        self.registers.float_active = false;
        self.registers.it = 0;
        self.exclusive = false;
        self.event = true;
        self.attention = true;
        self.in_flight = NOTHING_IN_FLIGHT;
        let address = self.system.vectors + 4 * u32::from(exception);
        match board.read(address, Size::Word) {
            Ok(vector) => {
                self.registers.thumb = vector & 1 != 0;
                self.pc = vector & !1;
                self.ran()
            }
            Err(_) => self.lock_up(Fault::VectorTable { address }, self.pc),
        }
    }

    /// ExceptionReturn with the EXC_RETURN `value`.
    pub(super) fn exception_return(&mut self, board: &mut Board, value: u32) -> Step {
        let returning = (self.registers.ipsr & 127) as u8;
        // The integrity checks of B1.5.8.
        let mode = if self.nvic.active.count_ones() > 1 { 0xffff_ffe1 } else { 0xffff_ffe9 };
        if value & !0x10 != mode || !self.nvic.is_active(returning) {
            return self.lock_up(Fault::InvalidReturn { value }, self.pc);
        }
        self.nvic.deactivate(returning);
        self.attention = true;
        self.exclusive = false;
        self.event = true;
        self.in_flight = NOTHING_IN_FLIGHT;
        if let Some(next) = self.nvic.preempting(self.execution_priority()) {
            self.cycles += TAIL_CHAIN;
            self.registers.r[14] = value;
            return self.take_exception(board, next);
        }
        self.cycles += RETURN;
        match self.pop_frame(board, value) {
            Ok(()) => self.ran(),
            Err(fault) => self.lock_up(fault, self.pc),
        }
    }

    /// PopStack.
    fn pop_frame(&mut self, board: &mut Board, value: u32) -> Result<(), Fault> {
        let float = value & 0x10 == 0;
        let base = self.registers.sp();
        let mut frame = [0; 8];
        load_frame(board, base, &mut frame)?;
        let [r0, r1, r2, r3, r12, lr, pc, xpsr] = frame;
        let to_thread = value & 8 != 0;
        if (xpsr & 0x1ff == 0) != to_thread {
            return Err(Fault::InvalidReturn { value });
        }
        if float {
            let mut words = [0; 17];
            load_frame(board, base.wrapping_add(BASIC_FRAME), &mut words)?;
            self.float.s[..16].copy_from_slice(&words[..16]);
            self.float.restore_fpscr(words[16]);
            if !std::mem::take(&mut self.float.stacking_unpaid) {
                self.cycles += FLOAT_FRAME;
            }
        }
        self.registers.float_active = float;
        self.registers.r[..4].copy_from_slice(&[r0, r1, r2, r3]);
        self.registers.r[12] = r12;
        self.registers.r[14] = lr;
        self.registers.set_xpsr(xpsr);
        let bytes = if float { FLOAT_FRAME_BYTES } else { BASIC_FRAME };
        let padding = if xpsr >> 9 & 1 != 0 { 4 } else { 0 };
        self.registers.set_sp(base.wrapping_add(bytes + padding));
        self.pc = pc & !1;
        Ok(())
    }

    #[cold]
    pub(super) fn take_fault(&mut self, board: &mut Board, fault: Fault, address: u32) -> Step {
        self.report(fault, address);
        // No fault has a handler of its own.
        let can_escalate = self.execution_priority() > -1;
        if can_escalate { self.enter_exception(board, HARD_FAULT, address) } else { self.lock_up(fault, address) }
    }

    /// Writes the fault status register and keeps a report.
    fn report(&mut self, fault: Fault, pc: u32) -> FaultReport {
        self.system.cfsr |= fault.status();
        let report = FaultReport {
            fault,
            pc,
            lr: self.registers.r[14],
            sp: self.registers.sp(),
            xpsr: self.registers.xpsr(),
            cfsr: self.system.cfsr,
        };
        self.last_fault = Some(report);
        report
    }

    fn lock_up(&mut self, fault: Fault, pc: u32) -> Step {
        let report = self.report(fault, pc);
        self.lockup = Some(report);
        self.attention = true;
        Step::Lockup(report)
    }
}

fn load_frame(board: &mut Board, base: u32, words: &mut [u32]) -> Result<(), Fault> {
    for (address, word) in (base..).step_by(4).zip(words) {
        *word = board.read(address, Size::Word).map_err(|_| Fault::Unstacking { address })?;
    }
    Ok(())
}

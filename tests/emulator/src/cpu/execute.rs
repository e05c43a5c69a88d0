//! Execution: data processing, branches and system instructions. Operands are read, one function of the
//! pseudocode is applied, results are written.

use super::arithmetic::{add_with_carry, extend, extract, field_mask, half, shift, shift_by, subtract_bytes, unary};
use super::code::{REFILL, division};
use super::instruction::{AluOp, ImmediateCarry, Instruction, Reg, RegisterOp, SetFlags, Special};
use super::{Cpu, Fault, Size, Trap};
use crate::board::Board;

/// The halfwords of ISB.
const ISB: [u16; 2] = [0xf3bf, 0x8f6f];

impl Cpu {
    /// Executes `instruction`; PC is already past it.
    #[inline(always)]
    pub(super) fn execute(&mut self, board: &mut Board, instruction: Instruction) -> Result<(), Trap> {
        match instruction {
            Instruction::AluImmediate { op, flags, rd, rn, carry, value } => {
                let carry = match carry {
                    ImmediateCarry::Keep => self.registers.flags.c,
                    ImmediateCarry::Bit31 => value >> 31 != 0,
                };
                self.alu(op, flags, rd, self.get(rn), value, carry);
            }
            Instruction::AluRegister { op, flags, rd, rn, rm, shift: by } => {
                let (value, carry) = shift(self.get(rm), by, self.registers.flags.c);
                self.alu(op, flags, rd, self.get(rn), value, carry);
            }
            Instruction::Registers { op, flags, rd, rn, rm } => self.registers(op, flags, rd, rn, rm),
            Instruction::PcRelative { rd, offset } => {
                let base = self.get(Reg::PC) & !3;
                self.set(rd, base.wrapping_add_signed(offset.into()));
            }
            Instruction::MoveTop { rd, value } => self.set(rd, self.get(rd) & 0xffff | u32::from(value) << 16),
            Instruction::BitfieldExtract { signed, rd, rn, lsb, width } => {
                self.set(rd, extract(self.get(rn), lsb, width, signed));
            }
            Instruction::BitfieldInsert { rd, rn, lsb, width } => {
                let mask = field_mask(lsb, width);
                let field = rn.map_or(0, |rn| self.get(rn) << lsb);
                self.set(rd, self.get(rd) & !mask | field & mask);
            }
            Instruction::Extend { extension, rd, rn, rm, rotate } => {
                let base = rn.map_or(0, |rn| self.get(rn));
                self.set(rd, extend(extension, self.get(rm).rotate_right(rotate.into()), base));
            }
            Instruction::Unary { op, rd, rm } => self.set(rd, unary(op, self.get(rm))),

            Instruction::Load { size, signed, rt, address } => self.load(board, size, signed, rt, address)?,
            Instruction::Store { size, rt, address } => self.store(board, size, rt, address)?,
            Instruction::MovePair { is_load, rt, rt2, address } => {
                self.move_pair(board, is_load, [rt, rt2], address)?;
            }
            Instruction::MoveMultiple { is_load, registers, address } => {
                self.move_multiple(board, is_load, registers, address)?;
            }
            Instruction::MoveFloat { is_load, first, count, address } => {
                self.move_float(board, is_load, first, count, address)?;
            }

            Instruction::Branch { offset } => self.branch_by(offset),
            Instruction::BranchIf { condition, offset } => {
                if self.registers.flags.pass(condition) {
                    self.branch_by(offset);
                }
            }
            Instruction::BranchLink { offset } => {
                self.registers.r[14] = self.pc | 1;
                self.branch_by(offset);
            }
            Instruction::BranchExchange { rm } => self.branch_exchange(self.get(rm))?,
            Instruction::BranchLinkExchange { rm } => {
                let target = self.get(rm);
                self.registers.r[14] = self.pc | 1;
                self.interwork(target);
            }
            Instruction::CompareBranch { nonzero, rn, offset } => {
                if (self.get(rn) != 0) == nonzero {
                    self.branch_by(offset.into());
                }
            }
            Instruction::IfThen { state } => self.registers.it = state,
            Instruction::Nop => {}
            Instruction::Float(float) => self.execute_float(float)?,
            _ => return self.execute_rare(board, instruction),
        }
        Ok(())
    }

    /// Instructions too rare to be worth a place in the first table.
    #[inline(never)]
    fn execute_rare(&mut self, board: &mut Board, instruction: Instruction) -> Result<(), Trap> {
        match instruction {
            Instruction::TableBranch { half, rn, rm } => self.table_branch(board, half, rn, rm)?,
            Instruction::LoadExclusive { size, rt, rn, offset } => self.load_exclusive(board, size, rt, rn, offset)?,
            Instruction::StoreExclusive { size, rd, rt, rn, offset } => {
                self.store_exclusive(board, size, rd, rt, rn, offset)?;
            }
            Instruction::ClearExclusive => self.exclusive = false,
            Instruction::Wfe => {
                if self.event {
                    self.event = false;
                } else {
                    self.wait_for_event(board)?;
                }
            }
            Instruction::Sev => self.event = true,
            Instruction::ChangeMask { disable } => {
                self.registers.primask = disable;
                self.attention = true;
            }
            Instruction::ReadSpecial { rd, special } => self.set(rd, self.registers.read_special(special)),
            // Unprivileged code and the process stack are not modelled.
            Instruction::WriteSpecial { special: Special::Control, rn } if self.get(rn) & 3 != 0 => {
                return Err(self.undefined(board).into());
            }
            Instruction::WriteSpecial { special, rn } => {
                self.registers.write_special(special, self.get(rn));
                self.attention = true;
            }
            Instruction::Undefined => return Err(self.undefined(board).into()),
            Instruction::NoCoprocessor => return Err(Fault::NoCoprocessor.into()),
            Instruction::Pack { tb, rd, rn, rm, shift: by } => {
                let (x, y) = (self.get(rn), shift(self.get(rm), by, false).0);
                let (top, bottom) = if tb { (x, y) } else { (y, x) };
                self.set(rd, top & 0xffff_0000 | bottom & 0xffff);
            }
            Instruction::MultiplyAdd { subtract, rd, rn, rm, ra } => {
                let product = self.get(rn).wrapping_mul(self.get(rm));
                let base = self.get(ra);
                self.set(rd, if subtract { base.wrapping_sub(product) } else { base.wrapping_add(product) });
            }
            Instruction::MultiplyHalves { rd, rn, rm, ra, n_top, m_top } => {
                let product = half(self.get(rn), n_top) * half(self.get(rm), m_top);
                // Q when the sum does not fit.
                let sum = product + ra.map_or(0, |ra| self.signed(ra));
                self.set(rd, sum as u32);
                self.registers.flags.q |= i64::from(sum as i32) != sum;
            }
            Instruction::MultiplyLong { signed, accumulate, lo, hi, rn, rm } => {
                let product = if signed {
                    (self.signed(rn) * self.signed(rm)) as u64
                } else {
                    u64::from(self.get(rn)) * u64::from(self.get(rm))
                };
                let base = if accumulate { self.pair(lo, hi) } else { 0 };
                self.set_pair(lo, hi, base.wrapping_add(product));
            }
            other => unreachable!("{other:?} is executed elsewhere"),
        }
        Ok(())
    }

    /// Whether flags are to be written now.
    #[inline(always)]
    pub(super) fn sets(&self, flags: SetFlags) -> bool {
        match flags {
            SetFlags::No => false,
            SetFlags::Yes => true,
            SetFlags::OutsideIt => !self.in_it_block,
        }
    }

    /// `rd = x op y`; `carry` is the carry out of making `y`.
    #[inline(always)]
    fn alu(&mut self, op: AluOp, flags: SetFlags, rd: Reg, x: u32, y: u32, carry: bool) {
        let carry_in = self.registers.flags.c;
        let keep = self.registers.flags.v;
        let (result, carry, overflow) = match op {
            AluOp::And | AluOp::Tst => (x & y, carry, keep),
            AluOp::Bic => (x & !y, carry, keep),
            AluOp::Orr => (x | y, carry, keep),
            AluOp::Orn => (x | !y, carry, keep),
            AluOp::Eor | AluOp::Teq => (x ^ y, carry, keep),
            AluOp::Mov => (y, carry, keep),
            AluOp::Mvn => (!y, carry, keep),
            AluOp::Add | AluOp::Cmn => add_with_carry(x, y, false),
            AluOp::Adc => add_with_carry(x, y, carry_in),
            AluOp::Sub | AluOp::Cmp => add_with_carry(x, !y, true),
            AluOp::Sbc => add_with_carry(x, !y, carry_in),
            AluOp::Rsb => add_with_carry(!x, y, true),
        };
        if self.sets(flags) {
            self.registers.flags.set_nz(result);
            self.registers.flags.c = carry;
            self.registers.flags.v = overflow;
        }
        match op {
            AluOp::Tst | AluOp::Teq | AluOp::Cmp | AluOp::Cmn => {}
            // Only ADD and MOV can name PC; both branch without a change of state.
            _ if rd == Reg::PC => self.branch_to(result),
            _ => self.set(rd, result),
        }
    }

    /// `rd = rn op rm`.
    fn registers(&mut self, op: RegisterOp, flags: SetFlags, rd: Reg, rn: Reg, rm: Reg) {
        let (x, y, mut carry) = (self.get(rn), self.get(rm), self.registers.flags.c);
        let result = match op {
            RegisterOp::Shift(kind) => {
                let (result, last_out) = shift_by(x, kind, y & 255, carry);
                carry = last_out;
                result
            }
            RegisterOp::Multiply => x.wrapping_mul(y),
            RegisterOp::UnsignedDivide => {
                self.cycles += division(x, y);
                x.checked_div(y).unwrap_or(0)
            }
            RegisterOp::SignedDivide => {
                let (x, y) = (x as i32, y as i32);
                self.cycles += division(x.unsigned_abs(), y.unsigned_abs());
                if y == 0 { 0 } else { x.wrapping_div(y) as u32 }
            }
            RegisterOp::SubtractBytes => subtract_bytes(x, y),
        };
        self.set(rd, result);
        if self.sets(flags) {
            self.registers.flags.set_nz(result);
            self.registers.flags.c = carry;
        }
    }

    /// BranchTo, with the refill of the pipeline.
    #[inline(always)]
    fn branch_to(&mut self, address: u32) {
        self.pc = address & !1;
        self.cycles += REFILL;
    }

    #[inline(always)]
    fn branch_by(&mut self, offset: i32) {
        self.branch_to(self.get(Reg::PC).wrapping_add_signed(offset));
    }

    /// BLXWritePC: bit 0 becomes EPSR.T; the fault of a cleared one belongs to the next instruction.
    #[inline(always)]
    fn interwork(&mut self, target: u32) {
        self.branch_to(target);
        if target & 1 == 0 {
            self.registers.thumb = false;
            self.attention = true;
        }
    }

    /// BXWritePC, LoadWritePC: a branch, or in an exception handler its end.
    #[inline(always)]
    pub(super) fn branch_exchange(&mut self, target: u32) -> Result<(), Trap> {
        if self.registers.ipsr != 0 && target >= 0xf000_0000 {
            return Err(Trap::ExceptionReturn(target));
        }
        self.interwork(target);
        Ok(())
    }

    fn table_branch(&mut self, board: &mut Board, half: bool, rn: Reg, rm: Reg) -> Result<(), Trap> {
        let (base, index) = (self.get(rn), self.get(rm));
        let entry = if half {
            self.access(board, base.wrapping_add(index << 1), Size::Half, None)?
        } else {
            self.access(board, base.wrapping_add(index), Size::Byte, None)?
        };
        self.branch_by((entry * 2) as i32);
        Ok(())
    }

    fn wait_for_event(&mut self, board: &mut Board) -> Result<(), Trap> {
        if self.fetches_wrong_behind_sleep {
            let [first, second] = [0, 2].map(|offset| board.fetch(self.pc.wrapping_add(offset)).unwrap_or(0));
            if [first, second] != ISB {
                return Err(Fault::Undefined { first, second }.into());
            }
        }
        self.is_waiting = true;
        self.attention = true;
        Ok(())
    }

    /// The fault of the instruction being executed, with its halfwords.
    fn undefined(&self, board: &mut Board) -> Fault {
        let address = self.get(Reg::PC).wrapping_sub(4);
        let wide = self.pc.wrapping_sub(address) == 4;
        let mut fetch = |address| board.fetch(address).unwrap_or(0);
        Fault::Undefined { first: fetch(address), second: if wide { fetch(address.wrapping_add(2)) } else { 0 } }
    }

    fn signed(&self, register: Reg) -> i64 {
        i64::from(self.get(register) as i32)
    }

    fn pair(&self, lo: Reg, hi: Reg) -> u64 {
        u64::from(self.get(hi)) << 32 | u64::from(self.get(lo))
    }

    fn set_pair(&mut self, lo: Reg, hi: Reg, value: u64) {
        self.set(lo, value as u32);
        self.set(hi, (value >> 32) as u32);
    }
}

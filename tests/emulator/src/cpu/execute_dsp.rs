//! Execution: multiplications other than MUL, and the DSP extension.

use super::Cpu;
use super::arithmetic::{self as dsp, saturate_signed, saturate_unsigned, shift};
use super::instruction::{Instruction, Reg};

impl Cpu {
    /// Executes an instruction of the multiply and DSP groups.
    ///
    /// # Panics
    /// If it belongs elsewhere.
    pub(super) fn execute_dsp(&mut self, instruction: Instruction) {
        match instruction {
            Instruction::SaturateHalves { signed, rd, rn, bits } => {
                let value = self.get(rn);
                let one = |top| {
                    let half = dsp::half(value, top);
                    if signed { saturate_signed(half, bits) } else { saturate_unsigned(half, bits) }
                };
                let ((low, low_saturated), (high, high_saturated)) = (one(false), one(true));
                self.set(rd, low & 0xffff | high << 16);
                self.registers.flags.q |= low_saturated | high_saturated;
            }
            Instruction::Pack { tb, rd, rn, rm, shift: by } => {
                let (x, y) = (self.get(rn), shift(self.get(rm), by, false).0);
                let (top, bottom) = if tb { (x, y) } else { (y, x) };
                self.set(rd, top & 0xffff_0000 | bottom & 0xffff);
            }
            Instruction::Parallel { op, kind, rd, rn, rm } => {
                let (result, ge) = dsp::parallel(op, kind, self.get(rn), self.get(rm));
                self.set(rd, result);
                self.registers.flags.ge = ge.unwrap_or(self.registers.flags.ge);
            }
            Instruction::SaturatingAdd { op, rd, rn, rm } => {
                let (result, saturated) = dsp::saturating_add(op, self.get(rm), self.get(rn));
                self.set(rd, result);
                self.registers.flags.q |= saturated;
            }
            Instruction::Select { rd, rn, rm } => {
                self.set(rd, dsp::select(self.registers.flags.ge, self.get(rn), self.get(rm)));
            }
            _ => self.execute_multiply(instruction),
        }
    }

    fn execute_multiply(&mut self, instruction: Instruction) {
        match instruction {
            Instruction::MultiplyAdd { subtract, rd, rn, rm, ra } => {
                let product = self.get(rn).wrapping_mul(self.get(rm));
                let base = self.get(ra);
                self.set(rd, if subtract { base.wrapping_sub(product) } else { base.wrapping_add(product) });
            }
            Instruction::MultiplyHalves { rd, rn, rm, ra, n_top, m_top } => {
                let product = dsp::half(self.get(rn), n_top) * dsp::half(self.get(rm), m_top);
                self.accumulate(rd, product, ra);
            }
            Instruction::MultiplyWordHalf { rd, rn, rm, ra, m_top } => {
                let product = self.signed(rn) * dsp::half(self.get(rm), m_top);
                self.accumulate(rd, product >> 16, ra);
            }
            Instruction::DualMultiply { subtract, exchange, rd, rn, rm, ra } => {
                let (low, high) = dsp::dual_products(self.get(rn), self.get(rm), exchange);
                self.accumulate(rd, if subtract { low - high } else { low + high }, ra);
            }
            Instruction::MultiplyHigh { subtract, round, rd, rn, rm, ra } => {
                let base = ra.map_or(0, |ra| self.signed(ra) << 32);
                let product = self.signed(rn) * self.signed(rm);
                let sum = if subtract { base.wrapping_sub(product) } else { base.wrapping_add(product) };
                let sum = if round { sum.wrapping_add(0x8000_0000) } else { sum };
                self.set(rd, (sum >> 32) as u32);
            }
            Instruction::AbsoluteDifferences { rd, rn, rm, ra } => {
                let base = ra.map_or(0, |ra| self.get(ra));
                self.set(rd, base.wrapping_add(dsp::absolute_differences(self.get(rn), self.get(rm))));
            }
            _ => self.execute_long_multiply(instruction),
        }
    }

    fn execute_long_multiply(&mut self, instruction: Instruction) {
        match instruction {
            Instruction::MultiplyLong { signed, accumulate, lo, hi, rn, rm } => {
                let product = if signed {
                    (self.signed(rn) * self.signed(rm)) as u64
                } else {
                    u64::from(self.get(rn)) * u64::from(self.get(rm))
                };
                let base = if accumulate { self.pair(lo, hi) } else { 0 };
                self.set_pair(lo, hi, base.wrapping_add(product));
            }
            Instruction::MultiplyAddAddLong { lo, hi, rn, rm } => {
                let product = u64::from(self.get(rn)) * u64::from(self.get(rm));
                self.set_pair(lo, hi, product + u64::from(self.get(lo)) + u64::from(self.get(hi)));
            }
            Instruction::MultiplyHalvesLong { lo, hi, rn, rm, n_top, m_top } => {
                let product = dsp::half(self.get(rn), n_top) * dsp::half(self.get(rm), m_top);
                self.set_pair(lo, hi, self.pair(lo, hi).wrapping_add_signed(product));
            }
            Instruction::DualMultiplyLong { subtract, exchange, lo, hi, rn, rm } => {
                let (low, high) = dsp::dual_products(self.get(rn), self.get(rm), exchange);
                let sum = if subtract { low - high } else { low + high };
                self.set_pair(lo, hi, self.pair(lo, hi).wrapping_add_signed(sum));
            }
            other => unreachable!("{other:?} is executed elsewhere"),
        }
    }

    /// `rd = value + ra`; Q when the sum does not fit.
    fn accumulate(&mut self, rd: Reg, value: i64, ra: Option<Reg>) {
        let sum = value + ra.map_or(0, |ra| self.signed(ra));
        self.set(rd, sum as u32);
        self.registers.flags.q |= i64::from(sum as i32) != sum;
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

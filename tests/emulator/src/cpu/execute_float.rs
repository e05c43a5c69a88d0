//! Execution: the floating-point extension.

use super::code::FLOAT_FRAME;
use super::float::{FloatUnit, fixed_from_float, float_from_fixed};
use super::instruction::{Fixed, FloatAddress, FloatInstruction, FloatUnaryOp, Reg, SReg};
use super::registers::Flags;
use super::{Bus, Cpu, Fault, Trap};

impl Cpu {
    #[inline(always)]
    pub(super) fn execute_float<B: Bus>(&mut self, bus: &mut B, instruction: FloatInstruction) -> Result<(), Trap> {
        self.check_float()?;
        match instruction {
            FloatInstruction::Arithmetic { op, sd, sn, sm } => {
                self.await_float(&[sd, sn, sm]);
                let result = FloatUnit::arithmetic(op, self.float.get(sd), self.float.get(sn), self.float.get(sm));
                self.float.set(sd, result);
                self.float.made(sd, self.instructions);
            }
            FloatInstruction::Unary { op, sd, sm } => {
                self.await_float(&[sm]);
                let result = FloatUnit::unary(op, self.float.get(sm));
                self.float.set(sd, result);
                if op == FloatUnaryOp::Sqrt {
                    self.float.made(sd, self.instructions);
                }
            }
            FloatInstruction::Constant { sd, value } => self.float.set(sd, value),
            FloatInstruction::Compare { sd, sm } => {
                self.await_float(&[sd, sm.unwrap_or(sd)]);
                let other = sm.map_or(0, |sm| self.float.get(sm));
                self.float.compare(self.float.get(sd), other);
            }
            FloatInstruction::Load { first, count, address } => self.load_float(bus, first, count, address)?,
            FloatInstruction::Store { first, count, address } => self.store_float(bus, first, count, address)?,
            FloatInstruction::ToCore { rt, sn } => {
                self.await_float(&[sn]);
                self.set(rt, self.float.get(sn));
            }
            FloatInstruction::FromCore { sn, rt } => self.float.set(sn, self.get(rt)),
            FloatInstruction::PairToCore { rt, rt2, sm } => {
                self.await_float(&[sm, SReg(sm.0 + 1)]);
                self.set(rt, self.float.get(sm));
                self.set(rt2, self.float.get(SReg(sm.0 + 1)));
            }
            FloatInstruction::PairFromCore { sm, rt, rt2 } => {
                self.float.set(sm, self.get(rt));
                self.float.set(SReg(sm.0 + 1), self.get(rt2));
            }
            FloatInstruction::ReadStatus { rt: Reg::PC } => {
                let apsr = self.registers.flags.to_bits() & 0x0fff_ffff;
                self.registers.flags = Flags::from_bits(apsr | self.float.fpscr() & 0xf000_0000);
            }
            FloatInstruction::ReadStatus { rt } => self.set(rt, self.float.fpscr()),
            FloatInstruction::WriteStatus { rt } => self.float.set_fpscr(self.get(rt))?,
            conversion => self.convert(conversion),
        }
        Ok(())
    }

    /// ExecuteFPCheck: the unit must be enabled; its first use makes it part of the context.
    #[inline(always)]
    fn check_float(&mut self) -> Result<(), Trap> {
        if !self.system.float_enabled(self.registers.privileged()) {
            return Err(Fault::NoCoprocessor.into());
        }
        if self.float.stacking_unpaid {
            self.float.stacking_unpaid = false;
            self.cycles += FLOAT_FRAME;
        }
        if !self.registers.float_active && self.system.tracks_float() {
            self.registers.float_active = true;
            self.float.set_fpscr(self.float.fpscr() | self.system.fpdscr)?;
        }
        Ok(())
    }

    #[inline(always)]
    fn await_float(&mut self, sources: &[SReg]) {
        self.cycles += self.float.stall(sources, self.instructions);
    }

    /// The conversions, which all have one operand and one result.
    fn convert(&mut self, instruction: FloatInstruction) {
        let (sd, sm) = match instruction {
            FloatInstruction::ToFixed { sd, sm, .. } | FloatInstruction::FromFixed { sd, sm, .. } => (sd, sm),
            other => unreachable!("{other:?} is executed elsewhere"),
        };
        self.await_float(&[sm]);
        let operand = self.float.get(sm);
        let result = match instruction {
            FloatInstruction::ToFixed { fixed: Fixed { signed, bits, fraction }, truncate, .. } => {
                fixed_from_float(operand, bits, signed, fraction, truncate)
            }
            FloatInstruction::FromFixed { fixed, .. } => float_from_fixed(widen(operand, fixed), fixed.fraction),
            _ => operand,
        };
        self.float.set(sd, result);
        self.float.made(sd, self.instructions);
    }

    /// Lowest address, and what write-back puts into the base register.
    fn locate_float(&self, address: FloatAddress) -> (u32, Option<(Reg, u32)>) {
        match address {
            FloatAddress::Offset { rn, offset } => {
                let base = if rn == Reg::PC { self.get(rn) & !3 } else { self.get(rn) };
                (base.wrapping_add_signed(offset.into()), None)
            }
            FloatAddress::Increment { rn, bytes: 0 } => (self.get(rn), None),
            FloatAddress::Increment { rn, bytes } => {
                let base = self.get(rn);
                (base, Some((rn, base.wrapping_add(bytes.into()))))
            }
            FloatAddress::Decrement { rn, bytes } => {
                let lowest = self.get(rn).wrapping_sub(bytes.into());
                (lowest, Some((rn, lowest)))
            }
        }
    }

    #[inline(always)]
    fn load_float<B: Bus>(&mut self, bus: &mut B, first: SReg, count: u8, address: FloatAddress) -> Result<(), Trap> {
        let (base, moved) = self.locate_float(address);
        for n in 0..count {
            let word = self.read_word(bus, base.wrapping_add(4 * u32::from(n)))?;
            self.float.set(SReg(first.0 + n), word);
        }
        if let Some((rn, value)) = moved {
            self.set(rn, value);
        }
        Ok(())
    }

    #[inline(always)]
    fn store_float<B: Bus>(&mut self, bus: &mut B, first: SReg, count: u8, address: FloatAddress) -> Result<(), Trap> {
        let (base, moved) = self.locate_float(address);
        self.await_float(&[first]);
        for n in 0..count {
            self.write_word(bus, base.wrapping_add(4 * u32::from(n)), self.float.get(SReg(first.0 + n)))?;
        }
        if let Some((rn, value)) = moved {
            self.set(rn, value);
        }
        Ok(())
    }
}

/// The fixed-point number in the low bits of `word`.
fn widen(word: u32, fixed: Fixed) -> i64 {
    match (fixed.bits, fixed.signed) {
        (16, true) => (word as i16).into(),
        (16, false) => (word as u16).into(),
        (_, true) => (word as i32).into(),
        (_, false) => word.into(),
    }
}

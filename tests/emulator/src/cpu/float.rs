//! The floating-point unit: S0–S31, FPSCR, and operations on them.
//!
//! The host's arithmetic is that of IEEE 754 as the core's is, rounding to nearest. What the two may do differently stands
//! here: which NaN comes out (DDI0403, A2.5, FPProcessNaNs). The modes of FPSCR (other rounding, flush to zero, default NaN,
//! other half precision) are not modelled: code that switches one on ends in a usage fault. Cumulative exception flags stay as
//! they are written.

use super::code::FLOAT_FRAME;
use super::instruction::{FloatInstruction, FloatOp, FloatUnaryOp, Reg, SReg};
use super::registers::Flags;
use super::{Cpu, Fault, Trap};

/// FPSCR: alternative half precision, default NaN, flush to zero, rounding mode.
const MODES: u32 = 1 << 26 | 1 << 25 | 1 << 24 | 3 << 22;
const FPSCR_BITS: u32 = 0xf7c0_009f;
const SIGN: u32 = 0x8000_0000;
const QUIET: u32 = 0x0040_0000;
const DEFAULT_NAN: u32 = 0x7fc0_0000;

#[derive(Clone, Debug, Default)]
pub(super) struct FloatUnit {
    /// Bits of S0–S31.
    pub s: [u32; 32],
    status: u32,
    /// Lazy stacking of the interrupted context has not been charged yet.
    pub stacking_unpaid: bool,
    /// Register of the last arithmetic result, and the number of the instruction that has to wait for it.
    result: (SReg, u64),
}

impl FloatUnit {
    pub fn fpscr(&self) -> u32 {
        self.status
    }

    /// Takes a new FPSCR.
    pub fn set_fpscr(&mut self, fpscr: u32) -> Result<(), Fault> {
        if fpscr & MODES != 0 {
            return Err(Fault::FloatMode { fpscr });
        }
        self.restore_fpscr(fpscr);
        Ok(())
    }

    /// Takes an FPSCR that this unit had before.
    pub fn restore_fpscr(&mut self, fpscr: u32) {
        self.status = fpscr & FPSCR_BITS & !MODES;
    }

    #[inline(always)]
    pub fn get(&self, register: SReg) -> u32 {
        self.s[register.index()]
    }

    #[inline(always)]
    pub fn set(&mut self, register: SReg, value: u32) {
        self.s[register.index()] = value;
    }

    /// Notes that instruction number `now` makes its result in `register`.
    #[inline(always)]
    pub fn made(&mut self, register: SReg, now: u64) {
        self.result = (register, now + 1);
    }

    /// One cycle if the instruction before `now` made one of `sources`: such a result is late by one (DDI0439,
    /// 7.2.3).
    #[inline(always)]
    pub fn stall(&self, sources: &[SReg], now: u64) -> u32 {
        u32::from(self.result.1 == now && sources.contains(&self.result.0))
    }

    #[inline(always)]
    pub fn arithmetic(op: FloatOp, n: u32, m: u32) -> u32 {
        match op {
            FloatOp::Add => result(f32::from_bits(n) + f32::from_bits(m), &[n, m]),
            // FPSub: a NaN keeps its sign.
            FloatOp::Sub => result(f32::from_bits(n) - f32::from_bits(m), &[n, m]),
            FloatOp::Mul => mul(n, m),
            FloatOp::Nmul => mul(n, m) ^ SIGN,
            FloatOp::Div => result(f32::from_bits(n) / f32::from_bits(m), &[n, m]),
        }
    }

    #[inline(always)]
    pub fn unary(op: FloatUnaryOp, m: u32) -> u32 {
        match op {
            FloatUnaryOp::Mov => m,
            FloatUnaryOp::Abs => m & !SIGN,
            FloatUnaryOp::Neg => m ^ SIGN,
            FloatUnaryOp::Sqrt => result(f32::from_bits(m).sqrt(), &[m]),
        }
    }

    /// Compares and puts the outcome into N, Z, C, V of FPSCR.
    pub fn compare(&mut self, x: u32, y: u32) {
        let nzcv = match f32::from_bits(x).partial_cmp(&f32::from_bits(y)) {
            Some(std::cmp::Ordering::Less) => 0b1000,
            Some(std::cmp::Ordering::Equal) => 0b0110,
            Some(std::cmp::Ordering::Greater) => 0b0010,
            None => 0b0011,
        };
        self.status = self.status & !(15 << 28) | nzcv << 28;
    }
}

fn is_signaling(bits: u32) -> bool {
    f32::from_bits(bits).is_nan() && bits & QUIET == 0
}

/// The bits of `value`, or the NaN that `operands` lead to: the first signalling one, else the first quiet one, else the
/// default NaN of an invalid operation.
#[inline(always)]
fn result(value: f32, operands: &[u32]) -> u32 {
    if value.is_nan() { nan_of(operands) } else { value.to_bits() }
}

#[inline(never)]
fn nan_of(operands: &[u32]) -> u32 {
    let signaling = operands.iter().find(|&&bits| is_signaling(bits));
    let nan = signaling.or_else(|| operands.iter().find(|&&bits| f32::from_bits(bits).is_nan()));
    nan.map_or(DEFAULT_NAN, |nan| nan | QUIET)
}

#[inline(always)]
fn mul(x: u32, y: u32) -> u32 {
    result(f32::from_bits(x) * f32::from_bits(y), &[x, y])
}

/// To an integer: saturates, and gives 0 for NaN.
fn to_integer(x: u32, signed: bool, truncate: bool) -> u32 {
    let x = f32::from_bits(x);
    let whole = if truncate { x.trunc() } else { x.round_ties_even() };
    if signed { whole as i32 as u32 } else { whole as u32 }
}

impl Cpu {
    #[inline(always)]
    pub(super) fn execute_float(&mut self, instruction: FloatInstruction) -> Result<(), Trap> {
        self.check_float()?;
        match instruction {
            FloatInstruction::Arithmetic { op, sd, sn, sm } => {
                self.await_float(&[sd, sn, sm]);
                let result = FloatUnit::arithmetic(op, self.float.get(sn), self.float.get(sm));
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
            FloatInstruction::MoveCore { to_core, sn, rt, rt2 } => {
                let second = rt2.map(|rt2| (SReg(sn.0 + 1), rt2));
                for (single, core) in [Some((sn, rt)), second].into_iter().flatten() {
                    if to_core {
                        self.await_float(&[single]);
                        self.set(core, self.float.get(single));
                    } else {
                        self.float.set(single, self.get(core));
                    }
                }
            }
            FloatInstruction::ReadStatus { rt: Reg::PC } => {
                let apsr = self.registers.flags.to_bits() & 0x0fff_ffff;
                self.registers.flags = Flags::from_bits(apsr | self.float.fpscr() & 0xf000_0000);
            }
            FloatInstruction::ReadStatus { rt } => self.set(rt, self.float.fpscr()),
            FloatInstruction::WriteStatus { rt } => self.float.set_fpscr(self.get(rt))?,
            FloatInstruction::ToInteger { sd, sm, signed, truncate } => {
                self.convert(sd, sm, |bits| to_integer(bits, signed, truncate));
            }
            FloatInstruction::FromInteger { sd, sm, signed } => {
                self.convert(sd, sm, |bits| if signed { bits as i32 as f32 } else { bits as f32 }.to_bits());
            }
        }
        Ok(())
    }

    /// ExecuteFPCheck: the unit must be enabled; its first use makes it part of the context.
    #[inline(always)]
    pub(super) fn check_float(&mut self) -> Result<(), Trap> {
        // CPACR grants coprocessors 10 and 11.
        if self.system.cpacr >> 20 & 15 != 0b1111 {
            return Err(Fault::NoCoprocessor.into());
        }
        if self.float.stacking_unpaid {
            self.float.stacking_unpaid = false;
            self.cycles += FLOAT_FRAME;
        }
        self.registers.float_active = true;
        Ok(())
    }

    #[inline(always)]
    pub(super) fn await_float(&mut self, sources: &[SReg]) {
        self.cycles += self.float.stall(sources, self.instructions);
    }

    /// Waits for `sm`, and lets `operation` make `sd` of it.
    fn convert(&mut self, sd: SReg, sm: SReg, operation: impl Fn(u32) -> u32) {
        self.await_float(&[sm]);
        self.float.set(sd, operation(self.float.get(sm)));
        self.float.made(sd, self.instructions);
    }
}

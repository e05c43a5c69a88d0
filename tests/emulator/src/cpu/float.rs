//! The floating-point unit: S0–S31, FPSCR, and operations on them.
//!
//! The rule is `softfloat`. The host's own arithmetic takes over where it is bound to give the same: rounding
//! to nearest, no special mode, a result that is a normal number, and FPSCR.IXC set already (it stays set until
//! software clears it), so that no flag can change.

use super::instruction::{FloatOp, FloatUnaryOp, SReg};
use super::softfloat::{Context, INEXACT, Rounding};

/// FPSCR bits: alternative half precision, default NaN, flush to zero, rounding mode.
const AHP: u32 = 1 << 26;
const DN: u32 = 1 << 25;
const FZ: u32 = 1 << 24;
const RMODE: u32 = 3 << 22;
/// Bits that exist.
const FPSCR_BITS: u32 = 0xf7c0_009f;
const CUMULATIVE: u32 = 0x9f;
const SIGN: u32 = 0x8000_0000;

#[derive(Clone, Debug)]
pub(super) struct FloatUnit {
    /// Bits of S0–S31.
    pub s: [u32; 32],
    status: u32,
    /// Lazy stacking of the interrupted context has not been charged yet.
    pub stacking_unpaid: bool,
    /// Register of the last arithmetic result, and the number of the instruction that made it.
    result: (SReg, u64),
}

impl FloatUnit {
    pub fn new() -> Self {
        Self { s: [0; 32], status: 0, stacking_unpaid: false, result: (SReg(0), u64::MAX) }
    }

    pub fn fpscr(&self) -> u32 {
        self.status
    }

    pub fn set_fpscr(&mut self, fpscr: u32) {
        self.status = fpscr & FPSCR_BITS;
    }

    /// Takes the modes of a new context from FPDSCR.
    pub fn set_modes(&mut self, fpdscr: u32) {
        let modes = AHP | DN | FZ | RMODE;
        self.status = self.status & !modes | fpdscr & modes;
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
        self.result = (register, now);
    }

    /// One cycle if the instruction before `now` made one of `sources`: such a result is late by one (DDI0439,
    /// 7.2.3).
    #[inline(always)]
    pub fn stall(&self, sources: &[SReg], now: u64) -> u32 {
        u32::from(self.result.1.wrapping_add(1) == now && sources.contains(&self.result.0))
    }

    /// Whether the host's arithmetic may be used: see the module.
    #[inline(always)]
    fn host_allowed(&self) -> bool {
        self.status & (DN | FZ | RMODE | INEXACT) == INEXACT
    }

    /// Runs `operation` by the rule and keeps its flags.
    fn by_rule<T>(&mut self, operation: impl FnOnce(&mut Context) -> T) -> T {
        let rounding =
            [Rounding::Nearest, Rounding::Up, Rounding::Down, Rounding::Zero][(self.status >> 22 & 3) as usize];
        self.with_rounding(rounding, operation)
    }

    fn with_rounding<T>(&mut self, rounding: Rounding, operation: impl FnOnce(&mut Context) -> T) -> T {
        let (flush, default_nan) = (self.status & FZ != 0, self.status & DN != 0);
        let mut context = Context { rounding, flush, default_nan, flags: 0 };
        let result = operation(&mut context);
        self.status |= context.flags & CUMULATIVE;
        result
    }

    /// An operation on `n`, `m` and, for the accumulating ones, `d`.
    #[inline(always)]
    pub fn arithmetic(&mut self, op: FloatOp, d: u32, n: u32, m: u32) -> u32 {
        if self.host_allowed()
            && let Some(bits) = on_host(op, d, n, m)
        {
            return bits;
        }
        self.arithmetic_by_rule(op, d, n, m)
    }

    #[inline(never)]
    fn arithmetic_by_rule(&mut self, op: FloatOp, d: u32, n: u32, m: u32) -> u32 {
        self.by_rule(|context| match op {
            FloatOp::Add => context.add(n, m),
            FloatOp::Sub => context.sub(n, m),
            FloatOp::Mul => context.mul(n, m),
            FloatOp::Nmul => context.mul(n, m) ^ SIGN,
            FloatOp::Div => context.div(n, m),
            FloatOp::Mla => {
                let product = context.mul(n, m);
                context.add(d, product)
            }
            FloatOp::Mls => {
                let product = context.mul(n, m);
                context.add(d, product ^ SIGN)
            }
            FloatOp::Nmla => {
                let product = context.mul(n, m);
                context.add(d ^ SIGN, product ^ SIGN)
            }
            FloatOp::Nmls => {
                let product = context.mul(n, m);
                context.add(d ^ SIGN, product)
            }
            FloatOp::Fma => context.mul_add(d, n, m),
            FloatOp::Fms => context.mul_add(d, n ^ SIGN, m),
            FloatOp::Fnma => context.mul_add(d ^ SIGN, n ^ SIGN, m),
            FloatOp::Fnms => context.mul_add(d ^ SIGN, n, m),
        })
    }

    #[inline(always)]
    pub fn unary(&mut self, op: FloatUnaryOp, m: u32) -> u32 {
        match op {
            FloatUnaryOp::Mov => m,
            FloatUnaryOp::Abs => m & !SIGN,
            FloatUnaryOp::Neg => m ^ SIGN,
            FloatUnaryOp::Sqrt => self.sqrt(m),
        }
    }

    fn sqrt(&mut self, m: u32) -> u32 {
        if self.host_allowed()
            && let Some(bits) = normal(f32::from_bits(m).sqrt())
        {
            return bits;
        }
        self.by_rule(|context| context.sqrt(m))
    }

    /// Compares and puts the outcome into N, Z, C, V of FPSCR.
    pub fn compare(&mut self, x: u32, y: u32, signal: bool) {
        let nzcv = self.by_rule(|context| context.compare(x, y, signal));
        self.status = self.status & !(15 << 28) | nzcv << 28;
    }

    /// To an integer of `bits` bits and `fraction` of them behind the point.
    pub fn fixed_from_float(&mut self, x: u32, bits: u8, signed: bool, fraction: u8, truncate: bool) -> u32 {
        let convert = |context: &mut Context| context.fixed_from_float(x, bits.into(), signed, fraction.into());
        let value = if truncate { self.with_rounding(Rounding::Zero, convert) } else { self.by_rule(convert) };
        value as u32
    }

    pub fn float_from_fixed(&mut self, value: i64, fraction: u8, nearest: bool) -> u32 {
        let convert = |context: &mut Context| context.float_from_fixed(value, fraction.into());
        if nearest { self.with_rounding(Rounding::Nearest, convert) } else { self.by_rule(convert) }
    }

    pub fn half_from_float(&mut self, x: u32) -> u32 {
        let alternative = self.status & AHP != 0;
        self.by_rule(|context| context.half_from_float(x, alternative))
    }

    pub fn float_from_half(&mut self, half: u32) -> u32 {
        let alternative = self.status & AHP != 0;
        self.by_rule(|context| context.float_from_half(half, alternative))
    }
}

/// The bits of a normal number other than the smallest (which may be the rounding of a subnormal one).
#[inline(always)]
fn normal(x: f32) -> Option<u32> {
    let magnitude = x.abs();
    (magnitude > f32::MIN_POSITIVE && magnitude < f32::INFINITY).then(|| x.to_bits())
}

/// The result by the host's arithmetic, if it and every intermediate result is normal.
#[inline(always)]
fn on_host(op: FloatOp, d: u32, n: u32, m: u32) -> Option<u32> {
    let [d, n, m] = [d, n, m].map(f32::from_bits);
    let product = || normal(n * m).map(f32::from_bits);
    normal(match op {
        FloatOp::Add => n + m,
        FloatOp::Sub => n - m,
        FloatOp::Mul => n * m,
        FloatOp::Nmul => -(n * m),
        FloatOp::Div => n / m,
        FloatOp::Mla => d + product()?,
        FloatOp::Mls => d - product()?,
        FloatOp::Nmla => -d - product()?,
        FloatOp::Nmls => -d + product()?,
        FloatOp::Fma => n.mul_add(m, d),
        FloatOp::Fms => (-n).mul_add(m, d),
        FloatOp::Fnma => (-n).mul_add(m, -d),
        FloatOp::Fnms => n.mul_add(m, -d),
    })
}

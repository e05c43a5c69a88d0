//! The floating-point unit: S0–S31, FPSCR, and operations on them.
//!
//! The host's arithmetic is that of IEEE 754 as the core's is, rounding to nearest. What the two may do differently stands
//! here: which NaN comes out (DDI0403, A2.5, FPProcessNaNs). The modes of FPSCR (other rounding, flush to zero, default NaN,
//! other half precision) are not modelled: code that switches one on ends in a usage fault. Cumulative exception flags stay as
//! they are written.

use super::Fault;
use super::instruction::{FloatOp, FloatUnaryOp, SReg};

/// FPSCR: alternative half precision, default NaN, flush to zero, rounding mode.
const MODES: u32 = 1 << 26 | 1 << 25 | 1 << 24 | 3 << 22;
/// Bits that exist.
const FPSCR_BITS: u32 = 0xf7c0_009f;
const SIGN: u32 = 0x8000_0000;
const QUIET: u32 = 0x0040_0000;
const DEFAULT_NAN: u32 = 0x7fc0_0000;

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

    /// Takes a new FPSCR.
    ///
    /// # Errors
    /// If it switches on a mode that is not modelled.
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
        self.result = (register, now);
    }

    /// One cycle if the instruction before `now` made one of `sources`: such a result is late by one (DDI0439,
    /// 7.2.3).
    #[inline(always)]
    pub fn stall(&self, sources: &[SReg], now: u64) -> u32 {
        u32::from(self.result.1.wrapping_add(1) == now && sources.contains(&self.result.0))
    }

    /// An operation on `n`, `m` and, for the accumulating ones, `d`.
    #[inline(always)]
    pub fn arithmetic(op: FloatOp, d: u32, n: u32, m: u32) -> u32 {
        match op {
            FloatOp::Add => add(n, m),
            FloatOp::Sub => sub(n, m),
            FloatOp::Mul => mul(n, m),
            FloatOp::Nmul => mul(n, m) ^ SIGN,
            FloatOp::Div => result(f32::from_bits(n) / f32::from_bits(m), &[n, m]),
            FloatOp::Mla => add(d, mul(n, m)),
            FloatOp::Mls => add(d, mul(n, m) ^ SIGN),
            FloatOp::Nmla => add(d ^ SIGN, mul(n, m) ^ SIGN),
            FloatOp::Nmls => add(d ^ SIGN, mul(n, m)),
            FloatOp::Fma => mul_add(d, n, m),
            FloatOp::Fms => mul_add(d, n ^ SIGN, m),
            FloatOp::Fnma => mul_add(d ^ SIGN, n ^ SIGN, m),
            FloatOp::Fnms => mul_add(d ^ SIGN, n, m),
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
fn add(x: u32, y: u32) -> u32 {
    result(f32::from_bits(x) + f32::from_bits(y), &[x, y])
}

/// FPSub: a NaN keeps its sign.
#[inline(always)]
fn sub(x: u32, y: u32) -> u32 {
    result(f32::from_bits(x) - f32::from_bits(y), &[x, y])
}

#[inline(always)]
fn mul(x: u32, y: u32) -> u32 {
    result(f32::from_bits(x) * f32::from_bits(y), &[x, y])
}

/// FPMulAdd: `addend + x · y`, rounded once. Infinity times zero gives the default NaN even beside a quiet NaN.
#[inline(always)]
fn mul_add(addend: u32, x: u32, y: u32) -> u32 {
    let [a, b, c] = [x, y, addend].map(f32::from_bits);
    let is_undefined = a.is_infinite() && b == 0.0 || a == 0.0 && b.is_infinite();
    if is_undefined && !is_signaling(addend) { DEFAULT_NAN } else { result(a.mul_add(b, c), &[addend, x, y]) }
}

/// To an integer of `bits` bits, `fraction` of them behind the point: saturates, and gives 0 for NaN. Both scaling and
/// rounding are exact in `f64`.
pub(super) fn fixed_from_float(x: u32, bits: u8, signed: bool, fraction: u8, truncate: bool) -> u32 {
    let scaled = f64::from(f32::from_bits(x)) * f64::from(fraction).exp2();
    let whole = if truncate { scaled.trunc() } else { scaled.round_ties_even() };
    let range = f64::from(bits - u8::from(signed)).exp2();
    let least = if signed { -range } else { 0.0 };
    whole.clamp(least, range - 1.0) as i64 as u32
}

/// A fixed-point number with `fraction` bits behind the point, rounded to nearest.
pub(super) fn float_from_fixed(value: i64, fraction: u8) -> u32 {
    ((value as f64 * (-f64::from(fraction)).exp2()) as f32).to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nans_follow_the_manual() {
        let (signaling, quiet, other) = (0x7f80_0001, 0x7fc0_0002, 0xffc0_0003);
        let [inf, one] = [f32::INFINITY, 1.0].map(f32::to_bits);
        for (found, expected) in [
            (add(quiet, signaling), signaling | QUIET),
            (add(other, quiet), other),
            (sub(one, other), other),
            (mul(inf, 0), DEFAULT_NAN),
            (sub(inf, inf), DEFAULT_NAN),
            (mul_add(quiet, inf, SIGN), DEFAULT_NAN),
            (mul_add(signaling, inf, 0), signaling | QUIET),
            (mul_add(one, quiet, other), quiet),
            (FloatUnit::unary(FloatUnaryOp::Sqrt, one | SIGN), DEFAULT_NAN),
            (FloatUnit::arithmetic(FloatOp::Div, 0, 0, 0), DEFAULT_NAN),
        ] {
            assert_eq!(found, expected, "{found:08x}, not {expected:08x}");
        }
    }

    #[test]
    fn conversions_round_and_saturate() {
        let to =
            |x: f32, bits, signed, fraction, truncate| fixed_from_float(x.to_bits(), bits, signed, fraction, truncate);
        assert_eq!(
            [to(2.5, 32, true, 0, false), to(3.5, 32, true, 0, false), to(-2.9, 32, true, 0, true)],
            [2, 4, -2i32 as u32]
        );
        assert_eq!([to(3e9, 32, true, 0, true), to(-3e9, 32, true, 0, true)], [i32::MAX as u32, i32::MIN as u32]);
        assert_eq!(
            [to(5e9, 32, false, 0, true), to(-1.0, 32, false, 0, true), to(f32::NAN, 32, true, 0, true)],
            [u32::MAX, 0, 0]
        );
        assert_eq!([to(0.75, 16, true, 15, true), to(1.0, 16, true, 15, true)], [0x6000, 0x7fff]);
        assert_eq!(to(-1.0, 16, true, 15, true), -0x8000i32 as u32);
        assert_eq!(
            [float_from_fixed(0x6000, 15), float_from_fixed(i64::from(u32::MAX), 0)],
            [0.75f32.to_bits(), 4_294_967_296f32.to_bits()]
        );
    }
}

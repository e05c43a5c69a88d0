//! Single-precision arithmetic by the ARMv7-M pseudocode (DDI0403, A2.5), exact in integers and rounded once:
//! every rounding mode, flush-to-zero, default NaN and all cumulative flags.

/// Rounding mode, FPSCR.RMode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rounding {
    Nearest,
    Up,
    Down,
    Zero,
}

/// What the result depends on besides the operands, and the flags it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Context {
    pub rounding: Rounding,
    /// FPSCR.FZ: subnormal operands and results count as zero.
    pub flush: bool,
    /// FPSCR.DN: every NaN result is the default one.
    pub default_nan: bool,
    /// Cumulative exception flags, as in FPSCR.
    pub flags: u32,
}

/// Cumulative flags of FPSCR.
pub(super) const INVALID: u32 = 1 << 0;
pub(super) const DIVIDE_BY_ZERO: u32 = 1 << 1;
pub(super) const OVERFLOW: u32 = 1 << 2;
pub(super) const UNDERFLOW: u32 = 1 << 3;
pub(super) const INEXACT: u32 = 1 << 4;
pub(super) const INPUT_SUBNORMAL: u32 = 1 << 7;

pub(super) const DEFAULT_NAN: u32 = 0x7fc0_0000;
pub(super) const INFINITY: u32 = 0x7f80_0000;
pub(super) const QUIET: u32 = 0x0040_0000;
pub(super) const SIGN: u32 = 0x8000_0000;

/// A finite number other than zero: `significand · 2^exponent`. Bit 0 of the significand may stand for "a bit
/// more than this" (sticky) when there are bits enough above it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finite {
    pub negative: bool,
    pub exponent: i32,
    pub significand: u128,
}

impl Finite {
    /// Exponent of the leading one.
    pub fn leading(self) -> i32 {
        self.exponent + 127 - self.significand.leading_zeros() as i32
    }
}

/// The whole multiples of `2^unit` in a number, and the rest in quarters of that, bit 0 being sticky.
pub(super) fn split(value: Finite, unit: i32) -> (u32, u32) {
    let up = value.exponent - unit + 2;
    let quarters =
        if up >= 0 { value.significand << up } else { shift_right_sticky(value.significand, up.unsigned_abs()) };
    ((quarters >> 2) as u32, (quarters & 3) as u32)
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Value {
    Zero { negative: bool },
    Finite(Finite),
    Infinite { negative: bool },
    Nan,
}

impl Value {
    fn negative(self) -> bool {
        match self {
            Self::Zero { negative } | Self::Infinite { negative } | Self::Finite(Finite { negative, .. }) => negative,
            Self::Nan => false,
        }
    }

    fn is_zero(self) -> bool {
        matches!(self, Self::Zero { .. })
    }

    fn is_infinite(self) -> bool {
        matches!(self, Self::Infinite { .. })
    }
}

pub(super) fn is_nan(bits: u32) -> bool {
    bits & !SIGN > INFINITY
}

pub(super) fn is_signaling(bits: u32) -> bool {
    is_nan(bits) && bits & QUIET == 0
}

/// Shifts right and keeps in bit 0 whether anything was lost.
pub(super) fn shift_right_sticky(value: u128, places: u32) -> u128 {
    match places {
        0 => value,
        1..=127 => value >> places | u128::from(value << (128 - places) != 0),
        _ => u128::from(value != 0),
    }
}

fn signed_zero(negative: bool) -> u32 {
    u32::from(negative) << 31
}

impl Context {
    /// FPUnpack.
    pub(super) fn unpack(&mut self, bits: u32) -> Value {
        let negative = bits & SIGN != 0;
        let (exponent, fraction) = ((bits >> 23 & 255) as i32, bits & 0x7f_ffff);
        match (exponent, fraction) {
            (0, 0) => Value::Zero { negative },
            (0, _) if self.flush => {
                self.flags |= INPUT_SUBNORMAL;
                Value::Zero { negative }
            }
            (0, _) => Value::Finite(Finite { negative, exponent: -149, significand: fraction.into() }),
            (255, 0) => Value::Infinite { negative },
            (255, _) => Value::Nan,
            _ => {
                Value::Finite(Finite { negative, exponent: exponent - 150, significand: (fraction | 0x80_0000).into() })
            }
        }
    }

    /// FPProcessNaNs: the result when an operand is a NaN; the first signalling one, else the first.
    fn nan_of(&mut self, operands: &[u32]) -> Option<u32> {
        let signaling = operands.iter().find(|&&bits| is_signaling(bits));
        if signaling.is_some() {
            self.flags |= INVALID;
        }
        let nan = *signaling.or_else(|| operands.iter().find(|&&bits| is_nan(bits)))?;
        Some(if self.default_nan { DEFAULT_NAN } else { nan | QUIET })
    }

    fn invalid(&mut self) -> u32 {
        self.flags |= INVALID;
        DEFAULT_NAN
    }

    /// Whether to round away from zero, `rest` being the fraction cut off in units of 2^-2 with sticky bit 0.
    pub(super) fn rounds_away(&self, negative: bool, odd: bool, rest: u32) -> bool {
        match self.rounding {
            Rounding::Nearest => rest > 2 || rest == 2 && odd,
            Rounding::Up => rest != 0 && !negative,
            Rounding::Down => rest != 0 && negative,
            Rounding::Zero => false,
        }
    }

    /// FPRound.
    pub(super) fn round(&mut self, value: Finite) -> u32 {
        let negative = value.negative;
        let sign = signed_zero(negative);
        // Below −126 the result is subnormal.
        let leading = value.leading();
        if self.flush && leading < -126 {
            self.flags |= UNDERFLOW;
            return sign;
        }
        let (whole, rest) = split(value, leading.max(-126) - 23);
        if rest != 0 {
            self.flags |= INEXACT | if leading < -126 { UNDERFLOW } else { 0 };
        }
        let rounded = whole + u32::from(self.rounds_away(negative, whole & 1 != 0, rest));
        // A carry out of the fraction moves into the exponent by itself.
        let biased = if leading < -126 { 0 } else { (leading + 126) as u32 };
        let bits = rounded + (biased << 23);
        if leading > 127 || bits >= INFINITY { self.overflow(negative) } else { sign | bits }
    }

    pub(super) fn overflow(&mut self, negative: bool) -> u32 {
        self.flags |= OVERFLOW | INEXACT;
        let to_infinity = match self.rounding {
            Rounding::Nearest => true,
            Rounding::Up => !negative,
            Rounding::Down => negative,
            Rounding::Zero => false,
        };
        signed_zero(negative) | if to_infinity { INFINITY } else { INFINITY - 1 }
    }

    /// Exact sum, rounded. `x` and `y` are not NaN.
    fn add_values(&mut self, x: Value, y: Value) -> u32 {
        let exact_zero = signed_zero(self.rounding == Rounding::Down);
        match (x, y) {
            (Value::Infinite { negative: a }, Value::Infinite { negative: b }) if a != b => self.invalid(),
            (Value::Infinite { negative }, _) | (_, Value::Infinite { negative }) => signed_zero(negative) | INFINITY,
            (Value::Zero { negative: a }, Value::Zero { negative: b }) if a == b => signed_zero(a),
            (Value::Finite(x), Value::Finite(y)) => match sum(x, y) {
                Some(sum) => self.round(sum),
                None => exact_zero,
            },
            (Value::Finite(x), _) | (_, Value::Finite(x)) => self.round(x),
            _ => exact_zero,
        }
    }

    /// FPAdd.
    pub fn add(&mut self, x: u32, y: u32) -> u32 {
        let (a, b) = (self.unpack(x), self.unpack(y));
        self.nan_of(&[x, y]).unwrap_or_else(|| self.add_values(a, b))
    }

    /// FPSub.
    pub fn sub(&mut self, x: u32, y: u32) -> u32 {
        let (a, b) = (self.unpack(x), self.unpack(y ^ SIGN));
        self.nan_of(&[x, y]).unwrap_or_else(|| self.add_values(a, b))
    }

    /// FPMul.
    pub fn mul(&mut self, x: u32, y: u32) -> u32 {
        let (a, b) = (self.unpack(x), self.unpack(y));
        if let Some(nan) = self.nan_of(&[x, y]) {
            return nan;
        }
        match product(a, b) {
            Value::Nan => self.invalid(),
            Value::Infinite { negative } => signed_zero(negative) | INFINITY,
            Value::Zero { negative } => signed_zero(negative),
            Value::Finite(product) => self.round(product),
        }
    }

    /// FPMulAdd: `addend + x · y`, rounded once.
    pub fn mul_add(&mut self, addend: u32, x: u32, y: u32) -> u32 {
        let (c, a, b) = (self.unpack(addend), self.unpack(x), self.unpack(y));
        let product = product(a, b);
        let undefined_product = !is_nan(x) && !is_nan(y) && matches!(product, Value::Nan);
        if undefined_product && is_nan(addend) && !is_signaling(addend) {
            return self.invalid();
        }
        if let Some(nan) = self.nan_of(&[addend, x, y]) {
            return nan;
        }
        if undefined_product { self.invalid() } else { self.add_values(c, product) }
    }

    /// FPDiv.
    pub fn div(&mut self, x: u32, y: u32) -> u32 {
        let (a, b) = (self.unpack(x), self.unpack(y));
        if let Some(nan) = self.nan_of(&[x, y]) {
            return nan;
        }
        let negative = a.negative() != b.negative();
        match (a, b) {
            _ if a.is_infinite() && b.is_infinite() || a.is_zero() && b.is_zero() => self.invalid(),
            (Value::Infinite { .. }, _) => signed_zero(negative) | INFINITY,
            (_, Value::Infinite { .. }) | (Value::Zero { .. }, _) => signed_zero(negative),
            (Value::Finite(a), Value::Finite(b)) => {
                let dividend = a.significand << 64;
                let sticky = u128::from(dividend % b.significand != 0);
                let significand = (dividend / b.significand) | sticky;
                self.round(Finite { negative, exponent: a.exponent - b.exponent - 64, significand })
            }
            _ => {
                self.flags |= DIVIDE_BY_ZERO;
                signed_zero(negative) | INFINITY
            }
        }
    }

    /// FPSqrt.
    pub fn sqrt(&mut self, x: u32) -> u32 {
        let value = self.unpack(x);
        if let Some(nan) = self.nan_of(&[x]) {
            return nan;
        }
        match value {
            Value::Zero { negative } => signed_zero(negative),
            Value::Infinite { negative: false } => INFINITY,
            Value::Finite(Finite { negative: false, exponent, significand }) => {
                // An even exponent, and 64 bits more so that the root has more than enough.
                let odd = exponent & 1;
                let radicand = significand << (64 + odd);
                let root = radicand.isqrt();
                let significand = root << 1 | u128::from(root * root != radicand);
                self.round(Finite { negative: false, exponent: (exponent - odd - 64) / 2 - 1, significand })
            }
            _ => self.invalid(),
        }
    }

    /// FPCompare: the flags N, Z, C, V from bit 3 down. `signal`: quiet NaNs are invalid too.
    pub fn compare(&mut self, x: u32, y: u32, signal: bool) -> u32 {
        let (a, b) = (self.unpack(x), self.unpack(y));
        if is_nan(x) || is_nan(y) {
            if signal || is_signaling(x) || is_signaling(y) {
                self.flags |= INVALID;
            }
            return 0b0011;
        }
        let order = |value: Value, bits: u32| match value {
            Value::Zero { .. } => 0,
            _ if bits & SIGN != 0 => -i64::from(bits & !SIGN),
            _ => i64::from(bits),
        };
        match order(a, x).cmp(&order(b, y)) {
            std::cmp::Ordering::Less => 0b1000,
            std::cmp::Ordering::Equal => 0b0110,
            std::cmp::Ordering::Greater => 0b0010,
        }
    }
}

/// Exact product; NaN for infinity times zero. `x` and `y` as NaN give anything.
fn product(x: Value, y: Value) -> Value {
    let negative = x.negative() != y.negative();
    match (x, y) {
        (Value::Nan, _) | (_, Value::Nan) => Value::Nan,
        _ if x.is_infinite() && y.is_zero() || x.is_zero() && y.is_infinite() => Value::Nan,
        (Value::Infinite { .. }, _) | (_, Value::Infinite { .. }) => Value::Infinite { negative },
        (Value::Zero { .. }, _) | (_, Value::Zero { .. }) => Value::Zero { negative },
        (Value::Finite(x), Value::Finite(y)) => Value::Finite(Finite {
            negative,
            exponent: x.exponent + y.exponent,
            significand: x.significand * y.significand,
        }),
    }
}

/// Exact sum but for a sticky bit far below; `None` for zero.
fn sum(x: Finite, y: Finite) -> Option<Finite> {
    // Both leading ones come to bit 125, so that the sum has room and at least 77 bits lie below either operand.
    let normal = |value: Finite| {
        let up = value.significand.leading_zeros() as i32 - 2;
        (value.exponent - up, value.significand << up, value.negative)
    };
    let (x, y) = (normal(x), normal(y));
    let (large, small) = if (x.0, x.1) >= (y.0, y.1) { (x, y) } else { (y, x) };
    let shifted = shift_right_sticky(small.1, (large.0 - small.0).unsigned_abs());
    let significand = if large.2 == small.2 { large.1 + shifted } else { large.1 - shifted };
    (significand != 0).then_some(Finite { negative: large.2, exponent: large.0, significand })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: u32 = 0x3f80_0000;
    /// 2^-24: half a unit of the last place of 1.
    const HALF_UNIT: u32 = 0x3380_0000;

    fn context(rounding: Rounding) -> Context {
        Context { rounding, flush: false, default_nan: false, flags: 0 }
    }

    /// Result and flags of an operation in a mode.
    fn run(rounding: Rounding, operation: impl Fn(&mut Context) -> u32) -> (u32, u32) {
        let mut context = context(rounding);
        (operation(&mut context), context.flags)
    }

    #[test]
    fn ties_go_to_even_and_modes_differ() {
        let sum = |rounding| run(rounding, |c| c.add(ONE, HALF_UNIT));
        assert_eq!(sum(Rounding::Nearest), (ONE, INEXACT));
        assert_eq!(sum(Rounding::Up), (ONE + 1, INEXACT));
        assert_eq!(sum(Rounding::Down), (ONE, INEXACT));
        assert_eq!(run(Rounding::Nearest, |c| c.add(ONE + 1, HALF_UNIT)), (ONE + 2, INEXACT));
        assert_eq!(run(Rounding::Down, |c| c.sub(ONE, HALF_UNIT + 0x80_0000 * 8)).1, 0, "2^-16 is exact");
    }

    #[test]
    fn zeros_have_signs() {
        assert_eq!(run(Rounding::Nearest, |c| c.sub(ONE, ONE)), (0, 0));
        assert_eq!(run(Rounding::Down, |c| c.sub(ONE, ONE)), (SIGN, 0));
        assert_eq!(run(Rounding::Nearest, |c| c.add(SIGN, SIGN)), (SIGN, 0));
        assert_eq!(run(Rounding::Nearest, |c| c.mul(ONE, SIGN)), (SIGN, 0));
    }

    #[test]
    fn the_ends_of_the_range() {
        let largest = INFINITY - 1;
        assert_eq!(run(Rounding::Nearest, |c| c.add(largest, largest)), (INFINITY, OVERFLOW | INEXACT));
        assert_eq!(run(Rounding::Zero, |c| c.add(largest, largest)), (largest, OVERFLOW | INEXACT));
        // The smallest subnormal halved, and a subnormal that is exact.
        assert_eq!(run(Rounding::Nearest, |c| c.mul(1, 0x3f00_0000)), (0, UNDERFLOW | INEXACT));
        assert_eq!(run(Rounding::Up, |c| c.mul(1, 0x3f00_0000)), (1, UNDERFLOW | INEXACT));
        assert_eq!(run(Rounding::Nearest, |c| c.mul(2, 0x3f00_0000)), (1, 0));
        let flushing = |c: &mut Context| {
            c.flush = true;
            c.mul(0x0080_0000, 0x3f00_0000)
        };
        assert_eq!(run(Rounding::Nearest, flushing), (0, UNDERFLOW));
    }

    #[test]
    fn nans_propagate_signalling_first() {
        let (quiet, signaling) = (0x7fc0_0001, 0x7f80_0002);
        assert_eq!(run(Rounding::Nearest, |c| c.add(quiet, signaling)), (0x7fc0_0002, INVALID));
        assert_eq!(run(Rounding::Nearest, |c| c.mul(ONE, quiet)), (quiet, 0));
        assert_eq!(run(Rounding::Nearest, |c| c.sub(INFINITY, INFINITY)), (DEFAULT_NAN, INVALID));
        assert_eq!(run(Rounding::Nearest, |c| c.mul_add(quiet, INFINITY, 0)), (DEFAULT_NAN, INVALID));
    }

    #[test]
    fn quotients_and_roots() {
        assert_eq!(run(Rounding::Nearest, |c| c.div(ONE, 0x4040_0000)), (0x3eaa_aaab, INEXACT));
        assert_eq!(run(Rounding::Zero, |c| c.div(ONE, 0x4040_0000)), (0x3eaa_aaaa, INEXACT));
        assert_eq!(run(Rounding::Nearest, |c| c.div(ONE, SIGN)), (SIGN | INFINITY, DIVIDE_BY_ZERO));
        assert_eq!(run(Rounding::Nearest, |c| c.sqrt(0x4110_0000)), (0x4040_0000, 0));
        assert_eq!(run(Rounding::Nearest, |c| c.sqrt(0x4000_0000)), (0x3fb5_04f3, INEXACT));
        assert_eq!(run(Rounding::Nearest, |c| c.sqrt(SIGN | ONE)), (DEFAULT_NAN, INVALID));
    }

    #[test]
    fn a_fused_product_is_not_rounded() {
        // x = 1 + 2^-12: x² − 1 = 2^-11 + 2^-24, whereas x² alone rounds to 1 + 2^-11.
        let x = ONE + 0x800;
        assert_eq!(run(Rounding::Nearest, |c| c.mul_add(SIGN | ONE, x, x)), (0x3a00_0400, 0));
        assert_eq!(run(Rounding::Nearest, |c| c.mul(x, x)), (ONE + 0x1000, INEXACT));
    }
}

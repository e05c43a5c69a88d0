//! Conversions between single precision and integers, fixed point and half precision (DDI0403, A2.5).

use super::softfloat::{
    Context, DEFAULT_NAN, Finite, INEXACT, INFINITY, INVALID, QUIET, SIGN, UNDERFLOW, Value, is_signaling,
    shift_right_sticky, split,
};

impl Context {
    /// FPToFixed: to an integer of `bits` bits after multiplication by `2^fraction`, saturating.
    pub fn fixed_from_float(&mut self, x: u32, bits: u32, signed: bool, fraction: u32) -> i64 {
        let (low, high) =
            if signed { (-1i64 << (bits - 1), (1i64 << (bits - 1)) - 1) } else { (0, (1i64 << bits) - 1) };
        let Finite { negative, exponent, significand } = match self.unpack(x) {
            Value::Zero { .. } => return 0,
            Value::Nan => {
                self.flags |= INVALID;
                return 0;
            }
            Value::Infinite { negative } => {
                self.flags |= INVALID;
                return if negative { low } else { high };
            }
            Value::Finite(value) => value,
        };
        let up = exponent + fraction as i32 + 2;
        // 2^40 and more saturates in any case.
        let quarters =
            if up >= 0 { significand << up.min(64) } else { shift_right_sticky(significand, up.unsigned_abs()) };
        let (whole, rest) = ((quarters >> 2) as i128, (quarters & 3) as u32);
        let rounded = whole + i128::from(self.rounds_away(negative, whole & 1 != 0, rest));
        let value = if negative { -rounded } else { rounded };
        let clamped = value.clamp(low.into(), high.into());
        if clamped != value {
            self.flags |= INVALID;
        } else if rest != 0 {
            self.flags |= INEXACT;
        }
        clamped as i64
    }

    /// FixedToFP: `value / 2^fraction`.
    pub fn float_from_fixed(&mut self, value: i64, fraction: u32) -> u32 {
        if value == 0 {
            return 0;
        }
        let significand = value.unsigned_abs().into();
        self.round(Finite { negative: value < 0, exponent: -(fraction as i32), significand })
    }

    /// FPHalfToSingle; `alternative`: no infinities and NaNs (FPSCR.AHP).
    pub fn float_from_half(&mut self, half: u32, alternative: bool) -> u32 {
        let sign = (half & 0x8000) << 16;
        let (exponent, fraction) = (half >> 10 & 31, half & 0x3ff);
        match (exponent, fraction) {
            (0, 0) => sign,
            // Never subnormal in single precision, so neither rounded nor flushed.
            (0, _) => self.round(Finite { negative: sign != 0, exponent: -24, significand: fraction.into() }),
            (31, 0) if !alternative => sign | INFINITY,
            (31, _) if !alternative => {
                if fraction & 0x200 == 0 {
                    self.flags |= INVALID;
                }
                if self.default_nan { DEFAULT_NAN } else { sign | INFINITY | QUIET | fraction << 13 }
            }
            _ => sign | (exponent + 112) << 23 | fraction << 13,
        }
    }

    /// FPSingleToHalf; see [`Self::float_from_half`].
    pub fn half_from_float(&mut self, x: u32, alternative: bool) -> u32 {
        let sign = x >> 16 & 0x8000;
        match self.unpack(x) {
            Value::Zero { .. } => sign,
            Value::Nan => {
                if alternative || is_signaling(x) {
                    self.flags |= INVALID;
                }
                match (alternative, self.default_nan) {
                    (true, _) => sign,
                    (false, true) => 0x7e00,
                    (false, false) => sign | 0x7e00 | x >> 13 & 0x1ff,
                }
            }
            Value::Infinite { .. } if alternative => {
                self.flags |= INVALID;
                sign | 0x7fff
            }
            Value::Infinite { .. } => sign | 0x7c00,
            Value::Finite(value) => sign | self.round_half(value, alternative),
        }
    }

    /// Rounds to half precision, without sign.
    fn round_half(&mut self, value: Finite, alternative: bool) -> u32 {
        let (negative, leading) = (value.negative, value.leading());
        let (whole, rest) = split(value, leading.max(-14) - 10);
        let rounded = whole + u32::from(self.rounds_away(negative, whole & 1 != 0, rest));
        let biased = if leading < -14 { 0 } else { (leading + 14) as u32 };
        let bits = rounded + (biased << 10);
        let limit = if alternative { 0x8000 } else { 0x7c00 };
        if bits >= limit {
            if alternative {
                self.flags |= INVALID;
                return 0x7fff;
            }
            let infinite = self.overflow(negative) & !SIGN == INFINITY;
            return if infinite { 0x7c00 } else { 0x7bff };
        }
        if rest != 0 {
            self.flags |= INEXACT | if leading < -14 { UNDERFLOW } else { 0 };
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::super::softfloat::{OVERFLOW, Rounding};
    use super::*;

    fn context() -> Context {
        Context { rounding: Rounding::Nearest, flush: false, default_nan: false, flags: 0 }
    }

    #[test]
    fn integers_saturate_and_ties_go_to_even() {
        let convert = |x: f32, signed| {
            let mut context = context();
            (context.fixed_from_float(x.to_bits(), 32, signed, 0), context.flags)
        };
        assert_eq!(convert(2.5, true), (2, INEXACT));
        assert_eq!(convert(-3.5, true), (-4, INEXACT));
        assert_eq!(convert(3e9, true), (i64::from(i32::MAX), INVALID));
        assert_eq!(convert(3e9, false), (3_000_000_000, 0));
        assert_eq!(convert(-1.0, false), (0, INVALID));
        assert_eq!(convert(f32::NAN, true), (0, INVALID));
    }

    #[test]
    fn fixed_point_has_its_point() {
        assert_eq!(context().fixed_from_float(1.5f32.to_bits(), 16, true, 8), 0x180);
        assert_eq!(context().float_from_fixed(-0x180, 8), (-1.5f32).to_bits());
    }

    #[test]
    fn half_precision() {
        let convert = |x: f32| {
            let mut context = context();
            (context.half_from_float(x.to_bits(), false), context.flags)
        };
        assert_eq!(convert(1.0), (0x3c00, 0));
        assert_eq!(convert(65504.0), (0x7bff, 0));
        assert_eq!(convert(65520.0), (0x7c00, OVERFLOW | INEXACT));
        assert_eq!(convert(2f32.powi(-24)), (1, 0));
        assert_eq!(convert(2f32.powi(-25)), (0, UNDERFLOW | INEXACT));
        assert_eq!(context().float_from_half(0x0001, false), 2f32.powi(-24).to_bits());
        assert_eq!(context().float_from_half(0xfc00, false), f32::NEG_INFINITY.to_bits());
        assert_eq!(context().float_from_half(0x7c00, true), 65536f32.to_bits());
    }
}

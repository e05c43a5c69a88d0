//! Integer arithmetic of the ARMv7-M pseudocode (DDI0403, A2.2.1): pure functions of their arguments.

use super::instruction::{Shift, ShiftKind, UnaryOp};

/// AddWithCarry: sum, carry out, overflow.
#[inline(always)]
pub(super) fn add_with_carry(x: u32, y: u32, carry: bool) -> (u32, bool, bool) {
    let (partial, carry_1) = x.overflowing_add(y);
    let (sum, carry_2) = partial.overflowing_add(carry.into());
    let overflow = ((x ^ sum) & (y ^ sum)) >> 31 != 0;
    (sum, carry_1 | carry_2, overflow)
}

/// Shift_C by a constant.
#[inline(always)]
pub(super) fn shift(value: u32, shift: Shift, carry: bool) -> (u32, bool) {
    if shift == Shift::NONE { (value, carry) } else { shift_by(value, shift.kind, shift.amount.into(), carry) }
}

/// Shift_C by 0–255 places.
pub(super) fn shift_by(value: u32, kind: ShiftKind, amount: u32, carry: bool) -> (u32, bool) {
    let bit = |n: u32| value >> n & 1 != 0;
    match (kind, amount) {
        (_, 0) => (value, carry),
        (ShiftKind::Lsl, 1..=31) => (value << amount, bit(32 - amount)),
        (ShiftKind::Lsl, 32) => (0, bit(0)),
        (ShiftKind::Lsr, 1..=31) => (value >> amount, bit(amount - 1)),
        (ShiftKind::Lsr, 32) => (0, bit(31)),
        (ShiftKind::Lsl | ShiftKind::Lsr, _) => (0, false),
        (ShiftKind::Asr, 1..=31) => ((value as i32 >> amount) as u32, bit(amount - 1)),
        (ShiftKind::Asr, _) => ((value as i32 >> 31) as u32, bit(31)),
        (ShiftKind::Ror, _) => {
            let rotated = value.rotate_right(amount & 31);
            (rotated, rotated >> 31 != 0)
        }
        (ShiftKind::Rrx, _) => (u32::from(carry) << 31 | value >> 1, bit(0)),
    }
}

/// SignedSat to `bits` bits: result and whether it saturated.
pub(super) fn saturate_signed(value: i64, bits: u8) -> (u32, bool) {
    let limit = 1i64 << (bits - 1);
    let result = value.clamp(-limit, limit - 1);
    (result as u32, result != value)
}

/// UnsignedSat to `bits` bits: result and whether it saturated.
pub(super) fn saturate_unsigned(value: i64, bits: u8) -> (u32, bool) {
    let result = value.clamp(0, (1i64 << bits) - 1);
    (result as u32, result != value)
}

/// A mask of `width` (1–32) ones from bit `lsb` on.
pub(super) fn field_mask(lsb: u8, width: u8) -> u32 {
    (u32::MAX >> (32 - u32::from(width))) << lsb
}

/// SBFX, UBFX.
pub(super) fn extract(value: u32, lsb: u8, width: u8, signed: bool) -> u32 {
    let unused = (32 - u32::from(width)).saturating_sub(u32::from(lsb));
    let top = value << unused;
    let down = 32 - u32::from(width);
    if signed { (top as i32 >> down) as u32 } else { top >> down }
}

/// Operations with one operand.
pub(super) fn unary(op: UnaryOp, value: u32) -> u32 {
    match op {
        UnaryOp::Clz => value.leading_zeros(),
        UnaryOp::Rbit => value.reverse_bits(),
        UnaryOp::Rev => value.swap_bytes(),
        UnaryOp::Rev16 => value.swap_bytes().rotate_right(16),
        UnaryOp::Revsh => i32::from((value as u16).swap_bytes() as i16) as u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addition_carries_and_overflows() {
        assert_eq!(add_with_carry(0xffff_ffff, 1, false), (0, true, false));
        assert_eq!(add_with_carry(0x7fff_ffff, 0, true), (0x8000_0000, false, true));
        // 5 − 5: no borrow is carry.
        assert_eq!(add_with_carry(5, !5, true), (0, true, false));
        assert_eq!(add_with_carry(0x8000_0000, !1, true), (0x7fff_ffff, true, true));
        // The carry alone wraps.
        assert_eq!(add_with_carry(0xffff_ffff, 0, true), (0, true, false));
    }

    #[test]
    fn shifts_by_0_32_and_more() {
        let x = 0x8000_0001;
        assert_eq!(shift_by(x, ShiftKind::Lsl, 0, true), (x, true));
        assert_eq!(shift_by(x, ShiftKind::Lsl, 1, false), (2, true));
        assert_eq!(shift_by(x, ShiftKind::Lsl, 32, false), (0, true));
        assert_eq!(shift_by(x, ShiftKind::Lsl, 33, true), (0, false));
        assert_eq!(shift_by(x, ShiftKind::Lsr, 32, false), (0, true));
        assert_eq!(shift_by(x, ShiftKind::Lsr, 255, true), (0, false));
        assert_eq!(shift_by(x, ShiftKind::Asr, 32, false), (0xffff_ffff, true));
        assert_eq!(shift_by(x, ShiftKind::Asr, 200, false), (0xffff_ffff, true));
        assert_eq!(shift_by(x, ShiftKind::Ror, 32, false), (x, true));
        assert_eq!(shift_by(x, ShiftKind::Ror, 1, false), (0xc000_0000, true));
        assert_eq!(shift_by(x, ShiftKind::Rrx, 1, false), (0x4000_0000, true));
    }

    #[test]
    fn saturation_reports_itself() {
        assert_eq!(saturate_signed(200, 8), (127, true));
        assert_eq!(saturate_signed(-128, 8), (-128i32 as u32, false));
        assert_eq!(saturate_unsigned(-1, 8), (0, true));
        assert_eq!(saturate_unsigned(255, 8), (255, false));
        assert_eq!(saturate_signed(i64::from(i32::MAX) + 1, 32), (i32::MAX as u32, true));
        assert_eq!(saturate_unsigned(5, 0), (0, true));
    }

    #[test]
    fn bit_fields() {
        assert_eq!(field_mask(4, 8), 0xff0);
        assert_eq!(field_mask(0, 32), 0xffff_ffff);
        assert_eq!(extract(0xabcd_1234, 8, 8, false), 0x12);
        assert_eq!(extract(0xabcd_1234, 28, 4, true), 0xffff_fffa);
        assert_eq!(extract(0xabcd_1234, 0, 32, true), 0xabcd_1234);
    }

    #[test]
    fn reversals() {
        assert_eq!(unary(UnaryOp::Rev, 0x1122_3344), 0x4433_2211);
        assert_eq!(unary(UnaryOp::Rev16, 0x1122_3344), 0x2211_4433);
        assert_eq!(unary(UnaryOp::Revsh, 0x1122_3384), 0xffff_8433);
        assert_eq!(unary(UnaryOp::Clz, 0), 32);
    }
}

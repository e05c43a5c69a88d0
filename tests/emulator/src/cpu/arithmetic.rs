//! Integer arithmetic of the ARMv7-M pseudocode (DDI0403, A2.2.1), and of the DSP extension on the halfwords and bytes of a
//! register (A4.4.3 to A4.4.5): pure functions of their arguments.

use super::instruction::{Extension, Shift, ShiftKind, UnaryOp};

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

pub(super) fn unary(op: UnaryOp, value: u32) -> u32 {
    match op {
        UnaryOp::Clz => value.leading_zeros(),
        UnaryOp::Rbit => value.reverse_bits(),
        UnaryOp::Rev => value.swap_bytes(),
        UnaryOp::Rev16 => value.swap_bytes().rotate_right(16),
        UnaryOp::Revsh => i32::from((value as u16).swap_bytes() as i16) as u32,
    }
}

/// The signed low halfword of `x`, or its high one.
pub(super) fn half(x: u32, top: bool) -> i64 {
    i64::from(if top { (x >> 16) as i16 } else { x as i16 })
}

/// Each byte of `x` less that of `y`, at least zero.
pub(super) fn subtract_bytes(x: u32, y: u32) -> u32 {
    let (x, y) = (x.to_le_bytes(), y.to_le_bytes());
    u32::from_le_bytes(std::array::from_fn(|lane| x[lane].saturating_sub(y[lane])))
}

/// The widened part of `rotated`, added to `base`.
pub(super) fn extend(extension: Extension, rotated: u32, base: u32) -> u32 {
    let halves = |low: u32, high: u32| base.wrapping_add(low) & 0xffff | (base >> 16).wrapping_add(high) << 16;
    match extension {
        Extension::SignedByte => base.wrapping_add(rotated as i8 as u32),
        Extension::SignedHalf => base.wrapping_add(rotated as i16 as u32),
        Extension::Byte => base.wrapping_add(rotated & 0xff),
        Extension::Half => base.wrapping_add(rotated & 0xffff),
        Extension::SignedBytes => halves(rotated as i8 as u32, (rotated >> 16) as i8 as u32),
        Extension::Bytes => halves(rotated & 0xff, rotated >> 16 & 0xff),
    }
}

//! Fields that instructions of several groups have.

use super::instruction::{Instruction, Reg, SetFlags, Shift, ShiftKind};

/// Bit `n` of `word`.
pub(super) fn bit(word: u32, n: u32) -> bool {
    word >> n & 1 != 0
}

/// The low `bits` bits of `value` as a two's complement number.
pub(super) fn sign_extend(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)) as i32 >> (32 - bits)
}

/// DecodeImmShift.
pub(super) fn immediate_shift(kind: u32, amount: u32) -> Shift {
    let or_32 = if amount == 0 { 32 } else { amount as u8 };
    match (kind & 3, amount) {
        (0, _) => Shift { kind: ShiftKind::Lsl, amount: amount as u8 },
        (1, _) => Shift { kind: ShiftKind::Lsr, amount: or_32 },
        (2, _) => Shift { kind: ShiftKind::Asr, amount: or_32 },
        (_, 0) => Shift { kind: ShiftKind::Rrx, amount: 1 },
        _ => Shift { kind: ShiftKind::Ror, amount: amount as u8 },
    }
}

/// The hints of both widths by number.
pub(super) fn hint(number: u32) -> Instruction {
    match number {
        2 => Instruction::Wfe,
        3 => Instruction::Wfi,
        4 => Instruction::Sev,
        _ => Instruction::Nop,
    }
}

/// Field Rn.
pub(super) fn rn(w: u32) -> Reg {
    Reg::at(w, 16)
}

/// Field Rd of data processing.
pub(super) fn rd(w: u32) -> Reg {
    Reg::at(w, 8)
}

/// Field Rm.
pub(super) fn rm(w: u32) -> Reg {
    Reg::at(w, 0)
}

/// Field Rt of loads and stores, Ra and RdLo of multiplications.
pub(super) fn rt(w: u32) -> Reg {
    Reg::at(w, 12)
}

/// A register field in which 15 stands for "none".
pub(super) fn unless_15(register: Reg) -> Option<Reg> {
    (register != Reg::PC).then_some(register)
}

/// Bit S.
pub(super) fn set_flags(w: u32) -> SetFlags {
    if bit(w, 20) { SetFlags::Yes } else { SetFlags::No }
}

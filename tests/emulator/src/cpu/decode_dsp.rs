//! The 32-bit encodings of operations on registers alone: shifts, extensions, DSP, multiplication, division.

use super::decode_fields::{bit, rd, rm, rn, rt, set_flags, unless_15};
use super::instruction::{
    Extension, Instruction, ParallelKind, ParallelOp, SaturatingOp, SetFlags, ShiftKind, UnaryOp,
};

/// DDI0403, A5.3.12 to A5.3.15.
pub(super) fn register_operations(w: u32) -> Instruction {
    if w >> 12 & 15 != 15 {
        return Instruction::Undefined;
    }
    let (rd, rn, rm) = (rd(w), rn(w), rm(w));
    match (w >> 20 & 15, w >> 4 & 15) {
        (op @ 0..=7, 0) => {
            let kind = [ShiftKind::Lsl, ShiftKind::Lsr, ShiftKind::Asr, ShiftKind::Ror][op as usize >> 1];
            Instruction::ShiftRegister { kind, flags: set_flags(w), rd, rn, rm }
        }
        (op @ 0..=5, 8..=15) => {
            let extension = [
                Extension::SignedHalf,
                Extension::Half,
                Extension::SignedBytes,
                Extension::Bytes,
                Extension::SignedByte,
                Extension::Byte,
            ][op as usize];
            Instruction::Extend { extension, rd, rn: unless_15(rn), rm, rotate: (w >> 1 & 0x18) as u8 }
        }
        (op @ 8..=15, kind @ 0..=7) => parallel(op & 7, kind)
            .map_or(Instruction::Undefined, |(op, kind)| Instruction::Parallel { op, kind, rd, rn, rm }),
        (8, 8) => Instruction::SaturatingAdd { op: SaturatingOp::Qadd, rd, rn, rm },
        (8, 9) => Instruction::SaturatingAdd { op: SaturatingOp::Qdadd, rd, rn, rm },
        (8, 10) => Instruction::SaturatingAdd { op: SaturatingOp::Qsub, rd, rn, rm },
        (8, 11) => Instruction::SaturatingAdd { op: SaturatingOp::Qdsub, rd, rn, rm },
        (9, 8) => Instruction::Unary { op: UnaryOp::Rev, rd, rm },
        (9, 9) => Instruction::Unary { op: UnaryOp::Rev16, rd, rm },
        (9, 10) => Instruction::Unary { op: UnaryOp::Rbit, rd, rm },
        (9, 11) => Instruction::Unary { op: UnaryOp::Revsh, rd, rm },
        (10, 8) => Instruction::Select { rd, rn, rm },
        (11, 8) => Instruction::Unary { op: UnaryOp::Clz, rd, rm },
        _ => Instruction::Undefined,
    }
}

fn parallel(op: u32, kind: u32) -> Option<(ParallelOp, ParallelKind)> {
    let op = match op {
        0 => ParallelOp::Add8,
        1 => ParallelOp::Add16,
        2 => ParallelOp::Asx,
        4 => ParallelOp::Sub8,
        5 => ParallelOp::Sub16,
        6 => ParallelOp::Sax,
        _ => return None,
    };
    let kind = match kind {
        0 => ParallelKind::Signed,
        1 => ParallelKind::SignedSaturating,
        2 => ParallelKind::SignedHalving,
        4 => ParallelKind::Unsigned,
        5 => ParallelKind::UnsignedSaturating,
        6 => ParallelKind::UnsignedHalving,
        _ => return None,
    };
    Some((op, kind))
}

/// DDI0403, A5.3.16.
pub(super) fn multiply(w: u32) -> Instruction {
    let (rd, rn, rm, ra) = (rd(w), rn(w), rm(w), unless_15(rt(w)));
    let (first, second) = (bit(w, 5), bit(w, 4));
    if w >> 6 & 3 != 0 {
        return Instruction::Undefined;
    }
    match (w >> 20 & 7, first, second) {
        (0, false, false) => match ra {
            Some(ra) => Instruction::MultiplyAdd { subtract: false, rd, rn, rm, ra },
            None => Instruction::Multiply { flags: SetFlags::No, rd, rn, rm },
        },
        (0, false, true) => Instruction::MultiplyAdd { subtract: true, rd, rn, rm, ra: rt(w) },
        (1, n_top, m_top) => Instruction::MultiplyHalves { rd, rn, rm, ra, n_top, m_top },
        (2, false, exchange) => Instruction::DualMultiply { subtract: false, exchange, rd, rn, rm, ra },
        (3, false, m_top) => Instruction::MultiplyWordHalf { rd, rn, rm, ra, m_top },
        (4, false, exchange) => Instruction::DualMultiply { subtract: true, exchange, rd, rn, rm, ra },
        (5, false, round) => Instruction::MultiplyHigh { subtract: false, round, rd, rn, rm, ra },
        (6, false, round) => Instruction::MultiplyHigh { subtract: true, round, rd, rn, rm, ra },
        (7, false, false) => Instruction::AbsoluteDifferences { rd, rn, rm, ra },
        _ => Instruction::Undefined,
    }
}

/// DDI0403, A5.3.17.
pub(super) fn multiply_long(w: u32) -> Instruction {
    let (lo, hi, rn, rm) = (rt(w), rd(w), rn(w), rm(w));
    let long = |signed, accumulate| Instruction::MultiplyLong { signed, accumulate, lo, hi, rn, rm };
    match (w >> 20 & 7, w >> 4 & 15) {
        (0, 0) => long(true, false),
        (1, 15) => Instruction::Divide { signed: true, rd: hi, rn, rm },
        (2, 0) => long(false, false),
        (3, 15) => Instruction::Divide { signed: false, rd: hi, rn, rm },
        (4, 0) => long(true, true),
        (4, 8..=11) => Instruction::MultiplyHalvesLong { lo, hi, rn, rm, n_top: bit(w, 5), m_top: bit(w, 4) },
        (op @ (4 | 5), 12 | 13) => {
            Instruction::DualMultiplyLong { subtract: op == 5, exchange: bit(w, 4), lo, hi, rn, rm }
        }
        (6, 0) => long(false, true),
        (6, 6) => Instruction::MultiplyAddAddLong { lo, hi, rn, rm },
        _ => Instruction::Undefined,
    }
}

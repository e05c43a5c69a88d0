//! Encodings of the coprocessors: FPv4-SP is coprocessors 10 and 11 (DDI0403, A6), others do not exist.

use super::decode::bit;
use super::instruction::{Fixed, FloatAddress, FloatInstruction, FloatOp, FloatUnaryOp, Instruction, Reg, SReg};

/// Decodes an instruction of the coprocessor space.
pub(super) fn decode_coprocessor(w: u32) -> Instruction {
    if !matches!(w >> 8 & 15, 10 | 11) {
        return Instruction::NoCoprocessor;
    }
    if bit(w, 28) {
        return Instruction::Undefined;
    }
    let float = match w >> 24 & 3 {
        2 if bit(w, 4) => transfer(w),
        2 => data_processing(w),
        3 => None,
        _ if w >> 21 & 15 == 2 => transfer_pair(w),
        _ => load_store(w),
    };
    float.map_or(Instruction::Undefined, Instruction::Float)
}

/// A single-precision register of four bits at `position` and the lowest bit at `extra`.
fn single(w: u32, position: u32, extra: u32) -> SReg {
    SReg((w >> position << 1 & 0x1e | w >> extra & 1) as u8)
}

/// The lower half of the double-precision register at `position`; D16 and up do not exist.
fn double(w: u32, position: u32, extra: u32) -> Option<SReg> {
    (!bit(w, extra)).then(|| SReg((w >> position << 1 & 0x1e) as u8))
}

fn sd(w: u32) -> SReg {
    single(w, 12, 22)
}

fn sn(w: u32) -> SReg {
    single(w, 16, 7)
}

fn sm(w: u32) -> SReg {
    single(w, 0, 5)
}

/// DDI0403, A6.4. Double precision is undefined.
fn data_processing(w: u32) -> Option<FloatInstruction> {
    if bit(w, 8) {
        return None;
    }
    let op = match (w >> 20 & 11, bit(w, 6)) {
        (0, false) => FloatOp::Mla,
        (0, true) => FloatOp::Mls,
        (1, false) => FloatOp::Nmls,
        (1, true) => FloatOp::Nmla,
        (2, false) => FloatOp::Mul,
        (2, true) => FloatOp::Nmul,
        (3, false) => FloatOp::Add,
        (3, true) => FloatOp::Sub,
        (8, false) => FloatOp::Div,
        (9, false) => FloatOp::Fnms,
        (9, true) => FloatOp::Fnma,
        (10, false) => FloatOp::Fma,
        (10, true) => FloatOp::Fms,
        (11, false) => return Some(FloatInstruction::Constant { sd: sd(w), value: expand(w) }),
        (11, true) => return other_data_processing(w),
        _ => return None,
    };
    Some(FloatInstruction::Arithmetic { op, sd: sd(w), sn: sn(w), sm: sm(w) })
}

/// VFPExpandImm for 32 bits.
fn expand(w: u32) -> u32 {
    let bits = w >> 12 & 0xf0 | w & 15;
    let exponent = if bit(bits, 6) { 0x1f << 25 } else { 1 << 30 };
    (bits & 0x80) << 24 | exponent | (bits & 0x3f) << 19
}

fn other_data_processing(w: u32) -> Option<FloatInstruction> {
    let (sd, sm, high) = (sd(w), sm(w), bit(w, 7));
    let unary = |op| FloatInstruction::Unary { op, sd, sm };
    let integer = |signed| Fixed { signed, bits: 32, fraction: 0 };
    Some(match (w >> 16 & 15, high) {
        (0, false) => unary(FloatUnaryOp::Mov),
        (0, true) => unary(FloatUnaryOp::Abs),
        (1, false) => unary(FloatUnaryOp::Neg),
        (1, true) => unary(FloatUnaryOp::Sqrt),
        (4, _) => FloatInstruction::Compare { sd, sm: Some(sm) },
        (5, _) => FloatInstruction::Compare { sd, sm: None },
        (8, signed) => FloatInstruction::FromFixed { sd, sm, fixed: integer(signed) },
        (12, truncate) => FloatInstruction::ToFixed { sd, sm, fixed: integer(false), truncate },
        (13, truncate) => FloatInstruction::ToFixed { sd, sm, fixed: integer(true), truncate },
        (10 | 11 | 14 | 15, _) => return fixed_point(w),
        _ => return None,
    })
}

/// VCVT between floating and fixed point, in place.
fn fixed_point(w: u32) -> Option<FloatInstruction> {
    let bits: u8 = if bit(w, 7) { 32 } else { 16 };
    let fraction = bits.checked_sub((w << 1 & 0x1e | w >> 5 & 1) as u8)?;
    let fixed = Fixed { signed: !bit(w, 16), bits, fraction };
    let (sd, sm) = (sd(w), sd(w));
    Some(if bit(w, 18) {
        FloatInstruction::ToFixed { sd, sm, fixed, truncate: true }
    } else {
        FloatInstruction::FromFixed { sd, sm, fixed }
    })
}

/// DDI0403, A6.6.
fn transfer(w: u32) -> Option<FloatInstruction> {
    let rt = Reg::at(w, 12);
    let is_read = bit(w, 20);
    let register = match (bit(w, 8), w >> 21 & 7) {
        (false, 0) => sn(w),
        (false, 7) if w >> 16 & 15 == 1 => {
            return Some(if is_read {
                FloatInstruction::ReadStatus { rt }
            } else {
                FloatInstruction::WriteStatus { rt }
            });
        }
        // VMOV of one word of a double-precision register.
        (true, word @ (0 | 1)) if w >> 5 & 3 == 0 => SReg(double(w, 16, 7)?.0 + word as u8),
        _ => return None,
    };
    Some(if is_read {
        FloatInstruction::ToCore { rt, sn: register }
    } else {
        FloatInstruction::FromCore { sn: register, rt }
    })
}

/// DDI0403, A6.7.
fn transfer_pair(w: u32) -> Option<FloatInstruction> {
    if w >> 6 & 3 != 0 || !bit(w, 4) {
        return None;
    }
    let (rt, rt2) = (Reg::at(w, 12), Reg::at(w, 16));
    let sm = if bit(w, 8) { double(w, 0, 5)? } else { sm(w) };
    Some(if bit(w, 20) {
        FloatInstruction::PairToCore { rt, rt2, sm }
    } else {
        FloatInstruction::PairFromCore { sm, rt, rt2 }
    })
}

/// DDI0403, A6.5.
fn load_store(w: u32) -> Option<FloatInstruction> {
    let rn = Reg::at(w, 16);
    let (before, up, writeback, is_load) = (bit(w, 24), bit(w, 23), bit(w, 21), bit(w, 20));
    let is_double = bit(w, 8);
    let first = if is_double { double(w, 12, 22)? } else { sd(w) };
    let words = w & 255;
    let (count, address) = match (before, up, writeback) {
        (true, _, false) => {
            let bytes = (words << 2) as i16;
            let offset = if up { bytes } else { -bytes };
            (if is_double { 2 } else { 1 }, FloatAddress::Offset { rn, offset })
        }
        (false, true, _) => {
            let bytes = if writeback { words << 2 } else { 0 };
            (words, FloatAddress::Increment { rn, bytes: u8::try_from(bytes).ok()? })
        }
        (true, false, true) => (words, FloatAddress::Decrement { rn, bytes: u8::try_from(words << 2).ok()? }),
        _ => return None,
    };
    // An odd count of double-precision words is FLDMX or FSTMX: the last word is skipped, not moved.
    let count = if is_double { count & !1 } else { count };
    if count == 0 || u32::from(first.0) + count > 32 {
        return None;
    }
    let count = count as u8;
    Some(if is_load {
        FloatInstruction::Load { first, count, address }
    } else {
        FloatInstruction::Store { first, count, address }
    })
}

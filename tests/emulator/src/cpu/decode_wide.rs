//! The 32-bit encodings (DDI0403, A5.3). Bits are numbered in the word `first halfword << 16 | second`.

use super::Size;
use super::decode::{
    bit, block, decode_coprocessor, hint, immediate_shift, move_words, rd, rm, rn, rt, set_flags, sign_extend,
    unless_15,
};
use super::instruction::{
    Address, AluOp, Extension, ImmediateCarry, Instruction, LoadKind, Reg, SetFlags, ShiftKind, Special, UnaryOp, Words,
};

/// Decodes the 32-bit instruction `w`.
pub(super) fn decode_wide(w: u32) -> Instruction {
    match (w >> 27 & 3, w >> 20 & 0x7f) {
        (1, op) if op & 0x64 == 0x00 => multiple(w),
        (1, op) if op & 0x64 == 0x04 => pair_exclusive_table(w),
        (1, op) if op & 0x60 == 0x20 => data_processing_register(w),
        (2, _) if bit(w, 15) => branch_and_control(w),
        (2, op) if op & 0x20 == 0 => data_processing_immediate(w),
        (2, _) => plain_immediate(w),
        (3, op) if op & 0x71 == 0x00 => store_single(w),
        (3, op) if op & 0x61 == 0x01 => load_single(w),
        (3, op) if op & 0x70 == 0x20 => register_operations(w),
        (3, op) if op & 0x78 == 0x30 => multiply(w),
        (3, op) if op & 0x78 == 0x38 => multiply_long(w),
        (1 | 3, op) if op & 0x40 != 0 => decode_coprocessor(w),
        _ => Instruction::Undefined,
    }
}

fn multiple(w: u32) -> Instruction {
    let words = Words::Core(w as u16);
    let downwards = match w >> 23 & 3 {
        1 => false,
        2 => true,
        _ => return Instruction::Undefined,
    };
    move_words(bit(w, 20), words, block(rn(w), words, downwards, bit(w, 21)))
}

/// Addressing by P (bit 24), U (bit 23), W (bit 21) as LDRD has it; `bytes` is the offset's magnitude.
fn indexed(w: u32, p: u32, u: u32, writeback: u32, bytes: u32) -> Address {
    let rn = rn(w);
    let offset = if bit(w, u) { bytes as i16 } else { -(bytes as i16) };
    match (bit(w, p), bit(w, writeback)) {
        (false, _) => Address::PostIndexed { rn, offset },
        (true, true) => Address::PreIndexed { rn, offset },
        (true, false) => Address::Offset { rn, offset },
    }
}

/// DDI0403, A5.3.6.
fn pair_exclusive_table(w: u32) -> Instruction {
    let is_load = bit(w, 20);
    if bit(w, 24) || bit(w, 21) {
        let address = indexed(w, 24, 23, 21, (w & 255) << 2);
        return move_words(is_load, Words::Pair(rt(w), Reg::at(w, 8)), address);
    }
    if !bit(w, 23) {
        let offset = ((w & 255) << 2) as u16;
        return exclusive(w, is_load, Size::Word, Reg::at(w, 8), offset);
    }
    match (w >> 4 & 15, is_load) {
        (0, true) => Instruction::TableBranch { half: false, rn: rn(w), rm: rm(w) },
        (1, true) => Instruction::TableBranch { half: true, rn: rn(w), rm: rm(w) },
        (4, _) => exclusive(w, is_load, Size::Byte, rm(w), 0),
        (5, _) => exclusive(w, is_load, Size::Half, rm(w), 0),
        _ => Instruction::Undefined,
    }
}

fn exclusive(w: u32, is_load: bool, size: Size, rd: Reg, offset: u16) -> Instruction {
    let (rt, rn) = (rt(w), rn(w));
    if is_load {
        Instruction::LoadExclusive { size, rt, rn, offset }
    } else {
        Instruction::StoreExclusive { size, rd, rt, rn, offset }
    }
}

/// The operation of field `op` (bits 24–21) of data processing, with the destination or the first operand
/// that is 15 turning it into a test or a move.
fn alu_op(w: u32) -> Option<AluOp> {
    let test = rd(w) == Reg::PC && bit(w, 20);
    let alone = rn(w) == Reg::PC;
    Some(match w >> 21 & 15 {
        0 if test => AluOp::Tst,
        0 => AluOp::And,
        1 => AluOp::Bic,
        2 if alone => AluOp::Mov,
        2 => AluOp::Orr,
        3 if alone => AluOp::Mvn,
        3 => AluOp::Orn,
        4 if test => AluOp::Teq,
        4 => AluOp::Eor,
        8 if test => AluOp::Cmn,
        8 => AluOp::Add,
        10 => AluOp::Adc,
        11 => AluOp::Sbc,
        13 if test => AluOp::Cmp,
        13 => AluOp::Sub,
        14 => AluOp::Rsb,
        _ => return None,
    })
}

fn data_processing_register(w: u32) -> Instruction {
    let shift = immediate_shift(w >> 4 & 3, w >> 10 & 0x1c | w >> 6 & 3);
    let (rd, rn, rm) = (rd(w), rn(w), rm(w));
    if w >> 21 & 15 == 6 && !bit(w, 20) && !bit(w, 4) {
        return Instruction::Pack { tb: bit(w, 5), rd, rn, rm, shift };
    }
    match alu_op(w) {
        Some(op) => Instruction::AluRegister { op, flags: set_flags(w), rd, rn, rm, shift },
        None => Instruction::Undefined,
    }
}

/// The 12 bits i:imm3:imm8.
fn immediate_12(w: u32) -> u32 {
    w >> 15 & 0x800 | w >> 4 & 0x700 | w & 255
}

/// ThumbExpandImm.
fn expand(bits: u32) -> (u32, ImmediateCarry) {
    let byte = bits & 255;
    let value = match bits >> 8 {
        0 => byte,
        1 => byte * 0x0001_0001,
        2 => byte * 0x0100_0100,
        3 => byte * 0x0101_0101,
        _ => return ((0x80 | bits & 0x7f).rotate_right(bits >> 7), ImmediateCarry::Bit31),
    };
    (value, ImmediateCarry::Keep)
}

fn data_processing_immediate(w: u32) -> Instruction {
    let (value, carry) = expand(immediate_12(w));
    match alu_op(w) {
        Some(op) => Instruction::AluImmediate { op, flags: set_flags(w), rd: rd(w), rn: rn(w), carry, value },
        None => Instruction::Undefined,
    }
}

/// DDI0403, A5.3.3.
fn plain_immediate(w: u32) -> Instruction {
    let (rd, rn) = (rd(w), rn(w));
    let imm12 = immediate_12(w);
    let imm16 = (w >> 4 & 0xf000 | imm12) as u16;
    let lsb = (w >> 10 & 0x1c | w >> 6 & 3) as u8;
    let low_5 = (w & 31) as u8;
    let alu =
        |op, value| Instruction::AluImmediate { op, flags: SetFlags::No, rd, rn, carry: ImmediateCarry::Keep, value };
    match w >> 20 & 31 {
        0b00000 if rn == Reg::PC => Instruction::PcRelative { rd, offset: imm12 as i16 },
        0b00000 => alu(AluOp::Add, imm12),
        0b00100 => alu(AluOp::Mov, imm16.into()),
        0b01010 if rn == Reg::PC => Instruction::PcRelative { rd, offset: -(imm12 as i16) },
        0b01010 => alu(AluOp::Sub, imm12),
        0b01100 => Instruction::MoveTop { rd, value: imm16 },
        0b10100 => Instruction::BitfieldExtract { signed: true, rd, rn, lsb, width: low_5 + 1 },
        0b11100 => Instruction::BitfieldExtract { signed: false, rd, rn, lsb, width: low_5 + 1 },
        0b10110 if low_5 >= lsb => Instruction::BitfieldInsert { rd, rn: unless_15(rn), lsb, width: low_5 + 1 - lsb },
        _ => Instruction::Undefined,
    }
}

/// DDI0403, A5.3.4.
fn branch_and_control(w: u32) -> Instruction {
    match (w >> 12 & 7, w >> 20 & 0x7f) {
        (0 | 2, op) if op & 0x38 != 0x38 => conditional_branch(w),
        (0 | 2, 0x38 | 0x39) => {
            let special = special(w & 255).filter(|_| w >> 10 & 3 == 2);
            special.map_or(Instruction::Undefined, |special| Instruction::WriteSpecial { special, rn: rn(w) })
        }
        (0 | 2, 0x3a) if w >> 8 & 7 == 0 => hint(w & 255),
        (0 | 2, 0x3b) => match w >> 4 & 15 {
            2 => Instruction::ClearExclusive,
            4..=6 => Instruction::Barrier,
            _ => Instruction::Undefined,
        },
        (0 | 2, 0x3e | 0x3f) => {
            special(w & 255).map_or(Instruction::Undefined, |special| Instruction::ReadSpecial { rd: rd(w), special })
        }
        (1 | 3, _) => Instruction::Branch { offset: far_offset(w) },
        (5 | 7, _) => Instruction::BranchLink { offset: far_offset(w) },
        _ => Instruction::Undefined,
    }
}

fn conditional_branch(w: u32) -> Instruction {
    let magnitude = w >> 6 & 1 << 20 | w << 8 & 1 << 19 | w << 5 & 1 << 18 | w >> 4 & 0x3_f000 | w << 1 & 0xffe;
    Instruction::BranchIf { condition: (w >> 22 & 15) as u8, offset: sign_extend(magnitude, 21) }
}

/// Offset of B (T4) and BL: S:I1:I2:imm10:imm11:0, where I = NOT(J XOR S).
fn far_offset(w: u32) -> i32 {
    let s = w >> 26 & 1;
    let i1 = !(w >> 13 ^ s) & 1;
    let i2 = !(w >> 11 ^ s) & 1;
    sign_extend(s << 24 | i1 << 23 | i2 << 22 | w >> 4 & 0x3f_f000 | w << 1 & 0xffe, 25)
}

/// The special register of field SYSm (DDI0403, B5.1.1).
fn special(number: u32) -> Option<Special> {
    Some(match number {
        0..=3 | 5..=7 => Special::Psr(number as u8),
        8 => Special::Msp,
        16 => Special::Primask,
        20 => Special::Control,
        _ => return None,
    })
}

/// Address of a single load or store whose 12-bit form is selected by bit 23.
fn single_address(w: u32) -> Option<Address> {
    let rn = rn(w);
    if bit(w, 23) {
        Some(Address::Offset { rn, offset: (w & 0xfff) as i16 })
    } else if bit(w, 11) {
        // P = 0 with W = 0 is undefined; P, U, W = 1, 1, 0 (LDRT, STRT) is an ordinary access: there is no MPU.
        (bit(w, 10) || bit(w, 8)).then(|| indexed(w, 10, 9, 8, w & 255))
    } else {
        (w >> 6 & 0x3f == 0).then(|| Address::Register { rn, rm: rm(w), shift: (w >> 4 & 3) as u8 })
    }
}

fn store_single(w: u32) -> Instruction {
    let size = match w >> 21 & 3 {
        0 => Size::Byte,
        1 => Size::Half,
        2 => Size::Word,
        _ => return Instruction::Undefined,
    };
    match single_address(w) {
        Some(address) if rn(w) != Reg::PC => Instruction::Store { size, rt: rt(w), address },
        _ => Instruction::Undefined,
    }
}

fn load_single(w: u32) -> Instruction {
    let kind = match (w >> 21 & 3, bit(w, 24)) {
        (0, false) => LoadKind::Byte,
        (0, true) => LoadKind::SignedByte,
        (1, false) => LoadKind::Half,
        (1, true) => LoadKind::SignedHalf,
        (2, false) => LoadKind::Word,
        _ => return Instruction::Undefined,
    };
    if rt(w) == Reg::PC && kind != LoadKind::Word {
        return Instruction::Nop; // PLD, PLI.
    }
    let address = if rn(w) == Reg::PC {
        let bytes = (w & 0xfff) as i16;
        Some(Address::Offset { rn: Reg::PC, offset: if bit(w, 23) { bytes } else { -bytes } })
    } else {
        single_address(w)
    };
    address.map_or(Instruction::Undefined, |address| Instruction::Load { kind, rt: rt(w), address })
}

/// DDI0403, A5.3.12 to A5.3.15.
fn register_operations(w: u32) -> Instruction {
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
        (12, 5) => Instruction::SubtractBytes { rd, rn, rm },
        (9, 8) => Instruction::Unary { op: UnaryOp::Rev, rd, rm },
        (9, 9) => Instruction::Unary { op: UnaryOp::Rev16, rd, rm },
        (9, 10) => Instruction::Unary { op: UnaryOp::Rbit, rd, rm },
        (9, 11) => Instruction::Unary { op: UnaryOp::Revsh, rd, rm },
        (11, 8) => Instruction::Unary { op: UnaryOp::Clz, rd, rm },
        _ => Instruction::Undefined,
    }
}

/// DDI0403, A5.3.16.
fn multiply(w: u32) -> Instruction {
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
        _ => Instruction::Undefined,
    }
}

/// DDI0403, A5.3.17.
fn multiply_long(w: u32) -> Instruction {
    let (lo, hi, rn, rm) = (rt(w), rd(w), rn(w), rm(w));
    let long = |signed, accumulate| Instruction::MultiplyLong { signed, accumulate, lo, hi, rn, rm };
    match (w >> 20 & 7, w >> 4 & 15) {
        (0, 0) => long(true, false),
        (1, 15) => Instruction::Divide { signed: true, rd: hi, rn, rm },
        (2, 0) => long(false, false),
        (3, 15) => Instruction::Divide { signed: false, rd: hi, rn, rm },
        (4, 0) => long(true, true),
        (6, 0) => long(false, true),
        _ => Instruction::Undefined,
    }
}

//! From halfwords to [`Instruction`]: the 16-bit encodings (DDI0403, A5.2), those of the coprocessors (FPv4-SP is coprocessors
//! 10 and 11, A6; others do not exist), and what all share.

use super::instruction::{
    Address, AluOp, Extension, FloatInstruction, FloatOp, FloatUnaryOp, ImmediateCarry, Instruction, LoadKind, Reg,
    SReg, SetFlags, Shift, ShiftKind, UnaryOp, Words,
};
use super::{Size, decode_wide};

/// Whether `first` is the first half of a 32-bit instruction (DDI0403, A5.1).
pub fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// Decodes a 32-bit instruction, or a 16-bit one (`second` is then ignored).
pub fn decode(first: u16, second: u16) -> Instruction {
    if is_wide(first) {
        decode_wide::decode_wide(u32::from(first) << 16 | u32::from(second))
    } else {
        decode_narrow(u32::from(first))
    }
}

fn low(word: u32, position: u32) -> Reg {
    Reg((word >> position & 7) as u8)
}

fn immediate(op: AluOp, flags: SetFlags, rd: Reg, rn: Reg, value: u32) -> Instruction {
    Instruction::AluImmediate { op, flags, rd, rn, carry: ImmediateCarry::Keep, value }
}

fn decode_narrow(h: u32) -> Instruction {
    match h >> 11 {
        0..=2 => Instruction::AluRegister {
            op: AluOp::Mov,
            flags: SetFlags::OutsideIt,
            rd: low(h, 0),
            rn: low(h, 0),
            rm: low(h, 3),
            shift: immediate_shift(h >> 11, h >> 6 & 31),
        },
        3 => add_subtract(h),
        4 => immediate(AluOp::Mov, SetFlags::OutsideIt, low(h, 8), low(h, 8), h & 255),
        5 => immediate(AluOp::Cmp, SetFlags::Yes, low(h, 8), low(h, 8), h & 255),
        6 => immediate(AluOp::Add, SetFlags::OutsideIt, low(h, 8), low(h, 8), h & 255),
        7 => immediate(AluOp::Sub, SetFlags::OutsideIt, low(h, 8), low(h, 8), h & 255),
        8 if !bit(h, 10) => data_processing(h),
        8 => special_data(h),
        9 => load(LoadKind::Word, low(h, 8), offset(Reg::PC, (h & 255) << 2)),
        10 | 11 => load_store_register(h),
        12 => store(Size::Word, low(h, 0), offset(low(h, 3), h >> 4 & 0x7c)),
        13 => load(LoadKind::Word, low(h, 0), offset(low(h, 3), h >> 4 & 0x7c)),
        14 => store(Size::Byte, low(h, 0), offset(low(h, 3), h >> 6 & 31)),
        15 => load(LoadKind::Byte, low(h, 0), offset(low(h, 3), h >> 6 & 31)),
        16 => store(Size::Half, low(h, 0), offset(low(h, 3), h >> 5 & 0x3e)),
        17 => load(LoadKind::Half, low(h, 0), offset(low(h, 3), h >> 5 & 0x3e)),
        18 => store(Size::Word, low(h, 8), offset(Reg::SP, (h & 255) << 2)),
        19 => load(LoadKind::Word, low(h, 8), offset(Reg::SP, (h & 255) << 2)),
        20 => Instruction::PcRelative { rd: low(h, 8), offset: ((h & 255) << 2) as i16 },
        21 => immediate(AluOp::Add, SetFlags::No, low(h, 8), Reg::SP, (h & 255) << 2),
        22 | 23 => miscellaneous(h),
        24 => multiple(h, false),
        25 => multiple(h, true),
        26 | 27 => conditional_branch(h),
        28 => Instruction::Branch { offset: sign_extend(h << 1, 12) },
        _ => Instruction::Undefined,
    }
}

fn load(kind: LoadKind, rt: Reg, address: Address) -> Instruction {
    Instruction::Load { kind, rt, address }
}

fn store(size: Size, rt: Reg, address: Address) -> Instruction {
    Instruction::Store { size, rt, address }
}

fn offset(rn: Reg, bytes: u32) -> Address {
    Address::Offset { rn, offset: bytes as i16 }
}

fn add_subtract(h: u32) -> Instruction {
    let op = if bit(h, 9) { AluOp::Sub } else { AluOp::Add };
    let (rd, rn, flags) = (low(h, 0), low(h, 3), SetFlags::OutsideIt);
    if bit(h, 10) {
        immediate(op, flags, rd, rn, h >> 6 & 7)
    } else {
        Instruction::AluRegister { op, flags, rd, rn, rm: low(h, 6), shift: Shift::NONE }
    }
}

fn data_processing(h: u32) -> Instruction {
    let (rd, rm, flags) = (low(h, 0), low(h, 3), SetFlags::OutsideIt);
    let alu = |op, flags| Instruction::AluRegister { op, flags, rd, rn: rd, rm, shift: Shift::NONE };
    let shift = |kind| Instruction::ShiftRegister { kind, flags, rd, rn: rd, rm };
    match h >> 6 & 15 {
        0 => alu(AluOp::And, flags),
        1 => alu(AluOp::Eor, flags),
        2 => shift(ShiftKind::Lsl),
        3 => shift(ShiftKind::Lsr),
        4 => shift(ShiftKind::Asr),
        5 => alu(AluOp::Adc, flags),
        6 => alu(AluOp::Sbc, flags),
        7 => shift(ShiftKind::Ror),
        8 => alu(AluOp::Tst, SetFlags::Yes),
        9 => immediate(AluOp::Rsb, flags, rd, rm, 0),
        10 => alu(AluOp::Cmp, SetFlags::Yes),
        11 => alu(AluOp::Cmn, SetFlags::Yes),
        12 => alu(AluOp::Orr, flags),
        13 => Instruction::Multiply { flags, rd, rn: rm, rm: rd },
        14 => alu(AluOp::Bic, flags),
        _ => alu(AluOp::Mvn, flags),
    }
}

/// Operations on any register, and branches to a register.
fn special_data(h: u32) -> Instruction {
    let rd = Reg((h >> 4 & 8 | h & 7) as u8);
    let rm = Reg::at(h, 3);
    let alu = |op, flags| Instruction::AluRegister { op, flags, rd, rn: rd, rm, shift: Shift::NONE };
    match h >> 8 & 3 {
        0 => alu(AluOp::Add, SetFlags::No),
        1 => alu(AluOp::Cmp, SetFlags::Yes),
        2 => alu(AluOp::Mov, SetFlags::No),
        _ if bit(h, 7) => Instruction::BranchLinkExchange { rm },
        _ => Instruction::BranchExchange { rm },
    }
}

fn load_store_register(h: u32) -> Instruction {
    let (rt, address) = (low(h, 0), Address::Register { rn: low(h, 3), rm: low(h, 6), shift: 0 });
    match h >> 9 & 7 {
        0 => store(Size::Word, rt, address),
        1 => store(Size::Half, rt, address),
        2 => store(Size::Byte, rt, address),
        3 => load(LoadKind::SignedByte, rt, address),
        4 => load(LoadKind::Word, rt, address),
        5 => load(LoadKind::Half, rt, address),
        6 => load(LoadKind::Byte, rt, address),
        _ => load(LoadKind::SignedHalf, rt, address),
    }
}

/// DDI0403, A5.2.5.
fn miscellaneous(h: u32) -> Instruction {
    let extend = |extension| Instruction::Extend { extension, rd: low(h, 0), rn: None, rm: low(h, 3), rotate: 0 };
    let unary = |op| Instruction::Unary { op, rd: low(h, 0), rm: low(h, 3) };
    match h >> 6 & 0x3f {
        0b000000 | 0b000001 => immediate(AluOp::Add, SetFlags::No, Reg::SP, Reg::SP, (h & 0x7f) << 2),
        0b000010 | 0b000011 => immediate(AluOp::Sub, SetFlags::No, Reg::SP, Reg::SP, (h & 0x7f) << 2),
        0b001000 => extend(Extension::SignedHalf),
        0b001001 => extend(Extension::SignedByte),
        0b001010 => extend(Extension::Half),
        0b001011 => extend(Extension::Byte),
        0b101000 => unary(UnaryOp::Rev),
        0b101001 => unary(UnaryOp::Rev16),
        0b101011 => unary(UnaryOp::Revsh),
        0b011001 if bit(h, 5) && h & 3 == 2 => Instruction::ChangeMask { disable: bit(h, 4) },
        op if op & 0b010100 == 0b000100 => Instruction::CompareBranch {
            nonzero: bit(h, 11),
            rn: low(h, 0),
            offset: (h >> 3 & 0x40 | h >> 2 & 0x3e) as u8,
        },
        op if op & 0b111000 == 0b010000 => {
            let words = Words::Core((h & 255 | h << 6 & 1 << 14) as u16);
            Instruction::StoreWords { words, address: block(Reg::SP, words, true, true) }
        }
        op if op & 0b111000 == 0b110000 => {
            let words = Words::Core((h & 255 | h << 7 & 1 << 15) as u16);
            Instruction::LoadWords { words, address: block(Reg::SP, words, false, true) }
        }
        op if op & 0b111100 == 0b111100 => if_then_or_hint(h),
        _ => Instruction::Undefined,
    }
}

fn if_then_or_hint(h: u32) -> Instruction {
    if h & 15 != 0 { Instruction::IfThen { state: h as u8 } } else { hint(h >> 4 & 15) }
}

fn multiple(h: u32, is_load: bool) -> Instruction {
    let (rn, registers) = (low(h, 8), (h & 255) as u16);
    let words = Words::Core(registers);
    // A loaded base register keeps what was loaded.
    let writeback = !is_load || registers & rn.bit() == 0;
    move_words(is_load, words, block(rn, words, false, writeback))
}

pub(super) fn move_words(is_load: bool, words: Words, address: Address) -> Instruction {
    if is_load { Instruction::LoadWords { words, address } } else { Instruction::StoreWords { words, address } }
}

/// Where `words` lie upwards from `rn`, or downwards below it.
pub(super) fn block(rn: Reg, words: Words, downwards: bool, writeback: bool) -> Address {
    let bytes = 4 * i16::from(words.count());
    match (downwards, writeback) {
        (false, true) => Address::PostIndexed { rn, offset: bytes },
        (false, false) => Address::Offset { rn, offset: 0 },
        (true, true) => Address::PreIndexed { rn, offset: -bytes },
        (true, false) => Address::Offset { rn, offset: -bytes },
    }
}

fn conditional_branch(h: u32) -> Instruction {
    match h >> 8 & 15 {
        // UDF, and SVC, which no image has.
        14 | 15 => Instruction::Undefined,
        condition => Instruction::BranchIf { condition: condition as u8, offset: sign_extend(h << 1, 9) },
    }
}

// Fields that instructions of several groups have.

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

/// The hints of both widths by number. WFI is not modelled: no image sleeps by it.
pub(super) fn hint(number: u32) -> Instruction {
    match number {
        2 => Instruction::Wfe,
        3 => Instruction::Undefined,
        4 => Instruction::Sev,
        _ => Instruction::Nop,
    }
}

pub(super) fn rn(w: u32) -> Reg {
    Reg::at(w, 16)
}

pub(super) fn rd(w: u32) -> Reg {
    Reg::at(w, 8)
}

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

pub(super) fn set_flags(w: u32) -> SetFlags {
    if bit(w, 20) { SetFlags::Yes } else { SetFlags::No }
}

pub(super) fn decode_coprocessor(w: u32) -> Instruction {
    if !matches!(w >> 8 & 15, 10 | 11) {
        return Instruction::NoCoprocessor;
    }
    if bit(w, 28) {
        return Instruction::Undefined;
    }
    let float = match w >> 24 & 3 {
        2 if bit(w, 4) => transfer(w),
        2 => float_processing(w),
        3 => None,
        _ if w >> 21 & 15 == 2 => transfer_pair(w),
        _ => return load_store(w).unwrap_or(Instruction::Undefined),
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

/// DDI0403, A6.4. Double precision is undefined, and so are multiplications that accumulate.
fn float_processing(w: u32) -> Option<FloatInstruction> {
    if bit(w, 8) {
        return None;
    }
    let op = match (w >> 20 & 11, bit(w, 6)) {
        (2, false) => FloatOp::Mul,
        (2, true) => FloatOp::Nmul,
        (3, false) => FloatOp::Add,
        (3, true) => FloatOp::Sub,
        (8, false) => FloatOp::Div,
        (11, false) => return Some(FloatInstruction::Constant { sd: sd(w), value: expand(w) }),
        (11, true) => return other_float_processing(w),
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

fn other_float_processing(w: u32) -> Option<FloatInstruction> {
    let (sd, sm, high) = (sd(w), sm(w), bit(w, 7));
    let unary = |op| FloatInstruction::Unary { op, sd, sm };
    Some(match (w >> 16 & 15, high) {
        (0, false) => unary(FloatUnaryOp::Mov),
        (0, true) => unary(FloatUnaryOp::Abs),
        (1, false) => unary(FloatUnaryOp::Neg),
        (1, true) => unary(FloatUnaryOp::Sqrt),
        (4, _) => FloatInstruction::Compare { sd, sm: Some(sm) },
        (5, _) => FloatInstruction::Compare { sd, sm: None },
        (8, signed) => FloatInstruction::FromInteger { sd, sm, signed },
        (12, truncate) => FloatInstruction::ToInteger { sd, sm, signed: false, truncate },
        (13, truncate) => FloatInstruction::ToInteger { sd, sm, signed: true, truncate },
        _ => return None,
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
fn load_store(w: u32) -> Option<Instruction> {
    let rn = Reg::at(w, 16);
    let is_double = bit(w, 8);
    let first = if is_double { double(w, 12, 22)? } else { sd(w) };
    let (before, up, writeback) = (bit(w, 24), bit(w, 23), bit(w, 21));
    let moves = |count: u32, address: &dyn Fn(Words) -> Address| {
        let words = Words::Float { first, count: count as u8 };
        (count > 0 && u32::from(first.0) + count <= 32).then(|| move_words(bit(w, 20), words, address(words)))
    };
    match (before, up, writeback) {
        (true, _, false) => {
            let bytes = ((w & 255) << 2) as i16;
            moves(1 + u32::from(is_double), &|_| Address::Offset { rn, offset: if up { bytes } else { -bytes } })
        }
        // An odd count of double-precision words is FLDMX or FSTMX, which no compiler makes.
        (false, true, _) | (true, false, true) if !(is_double && bit(w, 0)) => {
            moves(w & 255, &|words| block(rn, words, before, writeback))
        }
        _ => None,
    }
}

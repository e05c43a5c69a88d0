//! What the rows of the tables make of their fields.

use super::{Fields, sign_extend};
use crate::cpu::Size;
use crate::cpu::instruction::{
    Address, AluOp, Extension, FloatInstruction, FloatOp, FloatUnaryOp, ImmediateCarry, Instruction, Reg, RegisterOp,
    SReg, SetFlags, Shift, Special, UnaryOp,
};

pub(super) fn shifted(op: AluOp, flags: SetFlags, f: &Fields, rn: char, shift: Shift) -> Instruction {
    Instruction::AluRegister { op, flags, rd: f.reg('d'), rn: f.reg(rn), rm: f.reg('m'), shift }
}

pub(super) fn alu(op: AluOp, flags: SetFlags, f: &Fields, rn: char) -> Instruction {
    shifted(op, flags, f, rn, Shift::NONE)
}

pub(super) fn immediate(op: AluOp, flags: SetFlags, f: &Fields, rn: char) -> Instruction {
    let carry = ImmediateCarry::Keep;
    Instruction::AluImmediate { op, flags, rd: f.reg('d'), rn: f.reg(rn), carry, value: f.get('i') }
}

/// Of ThumbExpandImm of field `i`.
pub(super) fn expanded(op: AluOp, f: &Fields) -> Instruction {
    let (byte, kind) = (f.get('i') & 255, f.get('i') >> 8);
    let (value, carry) = match kind {
        0 => (byte, ImmediateCarry::Keep),
        1 => (byte * 0x0001_0001, ImmediateCarry::Keep),
        2 => (byte * 0x0100_0100, ImmediateCarry::Keep),
        3 => (byte * 0x0101_0101, ImmediateCarry::Keep),
        _ => ((0x80 | byte & 0x7f).rotate_right(f.get('i') >> 7), ImmediateCarry::Bit31),
    };
    Instruction::AluImmediate { op, flags: f.set_flags(), rd: f.reg('d'), rn: f.reg('n'), carry, value }
}

/// What `make` makes of the operation of field `o` of data processing, with the destination or the first operand that is 15
/// turning it into a test or a move.
pub(super) fn alu_op(f: &Fields, make: impl Fn(AluOp) -> Instruction) -> Instruction {
    let test = f.reg('d') == Reg::PC && f.is('s');
    let alone = f.reg('n') == Reg::PC;
    make(match f.get('o') {
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
        _ => return Instruction::Undefined,
    })
}

/// ADD and SUB of the stack pointer and words.
pub(super) fn move_sp(op: AluOp, rd: Reg, f: &Fields) -> Instruction {
    let carry = ImmediateCarry::Keep;
    Instruction::AluImmediate { op, flags: SetFlags::No, rd, rn: Reg::SP, carry, value: f.get('i') << 2 }
}

pub(super) fn registers(op: RegisterOp, flags: SetFlags, f: &Fields, rn: char, rm: char) -> Instruction {
    Instruction::Registers { op, flags, rd: f.reg('d'), rn: f.reg(rn), rm: f.reg(rm) }
}

pub(super) fn extend(extension: Extension, f: &Fields, rn: Option<Reg>) -> Instruction {
    Instruction::Extend { extension, rd: f.reg('d'), rn, rm: f.reg('m'), rotate: 8 * f.get('r') as u8 }
}

pub(super) fn unary(op: UnaryOp, f: &Fields) -> Instruction {
    Instruction::Unary { op, rd: f.reg('d'), rm: f.reg('m') }
}

/// The hints of both widths. WFI is not modelled: no image sleeps by it.
pub(super) fn hint(f: &Fields) -> Instruction {
    match f.get('h') {
        2 => Instruction::Wfe,
        3 => Instruction::Undefined,
        4 => Instruction::Sev,
        _ => Instruction::Nop,
    }
}

/// MRS and MSR of the register of field `y` (DDI0403, B5.1.1).
pub(super) fn special(f: &Fields, make: impl Fn(Special) -> Instruction) -> Instruction {
    make(match f.get('y') {
        number @ (0..=3 | 5..=7) => Special::Psr(number as u8),
        8 => Special::Msp,
        16 => Special::Primask,
        20 => Special::Control,
        _ => return Instruction::Undefined,
    })
}

pub(super) fn pack(f: &Fields) -> Instruction {
    let shift = f.shift(f.get('b') << 1);
    Instruction::Pack { tb: f.is('b'), rd: f.reg('d'), rn: f.reg('n'), rm: f.reg('m'), shift }
}

/// MOVW.
pub(super) fn move_wide(f: &Fields) -> Instruction {
    let (carry, value) = (ImmediateCarry::Keep, f.get_16().into());
    Instruction::AluImmediate { op: AluOp::Mov, flags: SetFlags::No, rd: f.reg('d'), rn: f.reg('n'), carry, value }
}

pub(super) fn bitfield_extract(signed: bool, f: &Fields) -> Instruction {
    let (lsb, width) = (f.get('i') as u8, f.get('w') as u8 + 1);
    Instruction::BitfieldExtract { signed, rd: f.reg('d'), rn: f.reg('n'), lsb, width }
}

pub(super) fn bitfield_insert(f: &Fields) -> Instruction {
    let (lsb, last) = (f.get('i') as u8, f.get('w') as u8);
    if last < lsb {
        return Instruction::Undefined;
    }
    Instruction::BitfieldInsert { rd: f.reg('d'), rn: f.some_reg('n'), lsb, width: last + 1 - lsb }
}

pub(super) fn multiply_add(f: &Fields) -> Instruction {
    let subtract = f.is('s');
    Instruction::MultiplyAdd { subtract, rd: f.reg('d'), rn: f.reg('n'), rm: f.reg('m'), ra: f.reg('a') }
}

pub(super) fn multiply_halves(f: &Fields) -> Instruction {
    let (ra, n_top, m_top) = (f.some_reg('a'), f.is('x'), f.is('y'));
    Instruction::MultiplyHalves { rd: f.reg('d'), rn: f.reg('n'), rm: f.reg('m'), ra, n_top, m_top }
}

pub(super) fn multiply_long(f: &Fields) -> Instruction {
    let (signed, accumulate) = (f.get('u') & 1 == 0, f.get('u') & 2 != 0);
    Instruction::MultiplyLong { signed, accumulate, lo: f.reg('l'), hi: f.reg('h'), rn: f.reg('n'), rm: f.reg('m') }
}

pub(super) fn compare_branch(f: &Fields) -> Instruction {
    Instruction::CompareBranch { nonzero: f.is('z'), rn: f.reg('n'), offset: (f.get('i') << 1) as u8 }
}

pub(super) fn table_branch(half: bool, f: &Fields) -> Instruction {
    Instruction::TableBranch { half, rn: f.reg('n'), rm: f.reg('m') }
}

/// B (T3): S:J2:J1:imm6:imm11:0.
pub(super) fn branch_if(f: &Fields) -> Instruction {
    let bits = f.get('s') << 20 | f.get('k') << 19 | f.get('j') << 18 | f.get('i') << 1;
    Instruction::BranchIf { condition: f.get('c') as u8, offset: sign_extend(bits, 21) }
}

/// Offset of B (T4) and BL: S:I1:I2:imm10:imm11:0, where I = NOT(J XOR S).
pub(super) fn far_offset(f: &Fields) -> i32 {
    let s = f.get('s');
    let [i1, i2] = ['j', 'k'].map(|j| !(f.get(j) ^ s) & 1);
    sign_extend(s << 24 | i1 << 23 | i2 << 22 | f.get('i') << 1, 25)
}

pub(super) fn load(size: Size, signed: bool, f: &Fields, address: Address) -> Instruction {
    Instruction::Load { size, signed, rt: f.reg('t'), address }
}

pub(super) fn store(size: Size, f: &Fields, address: Address) -> Instruction {
    Instruction::Store { size, rt: f.reg('t'), address }
}

pub(super) fn offset(rn: Reg, bytes: u32) -> Address {
    Address::Offset { rn, offset: bytes as i16 }
}

/// With field `k` as a shift, if there is one.
pub(super) fn indexed_by_register(f: &Fields) -> Address {
    Address::Register { rn: f.reg('n'), rm: f.reg('m'), shift: f.get('k') as u8 }
}

/// `bytes` above the register of field `n`, or below it, by field `u`.
pub(super) fn indexed(f: &Fields, before: bool, writeback: bool, bytes: u32) -> Address {
    let (rn, offset) = (f.reg('n'), if f.is('u') { bytes as i16 } else { -(bytes as i16) });
    match (before, writeback) {
        (false, _) => Address::PostIndexed { rn, offset },
        (true, true) => Address::PreIndexed { rn, offset },
        (true, false) => Address::Offset { rn, offset },
    }
}

fn size(f: &Fields) -> Option<Size> {
    [Size::Byte, Size::Half, Size::Word].get(f.get('z') as usize).copied()
}

pub(super) fn store_single(f: &Fields, address: Address) -> Instruction {
    match size(f) {
        Some(size) if f.reg('n') != Reg::PC => store(size, f, address),
        _ => Instruction::Undefined,
    }
}

pub(super) fn load_single(f: &Fields, address: Address) -> Instruction {
    match (size(f), f.is('g')) {
        (None, _) | (Some(Size::Word), true) => Instruction::Undefined,
        // PLD, PLI.
        (Some(Size::Byte | Size::Half), _) if f.reg('t') == Reg::PC => Instruction::Nop,
        (Some(size), signed) => load(size, signed, f, address),
    }
}

pub(super) fn exclusive(size: Size, f: &Fields, offset: u16) -> Instruction {
    let (rt, rn) = (f.reg('t'), f.reg('n'));
    if f.is('l') {
        Instruction::LoadExclusive { size, rt, rn, offset }
    } else {
        Instruction::StoreExclusive { size, rd: f.reg('d'), rt, rn, offset }
    }
}

pub(super) fn pair(f: &Fields, address: Address) -> Instruction {
    Instruction::MovePair { is_load: f.is('l'), rt: f.reg('t'), rt2: f.reg('v'), address }
}

pub(super) fn block(is_load: bool, rn: Reg, registers: u32, downwards: bool, writeback: bool) -> Instruction {
    let address = beside(rn, registers.count_ones(), downwards, writeback);
    Instruction::MoveMultiple { is_load, registers: registers as u16, address }
}

/// Where `count` words lie upwards from `rn`, or downwards below it.
fn beside(rn: Reg, count: u32, downwards: bool, writeback: bool) -> Address {
    let bytes = 4 * count as i16;
    match (downwards, writeback) {
        (false, true) => Address::PostIndexed { rn, offset: bytes },
        (false, false) => Address::Offset { rn, offset: 0 },
        (true, true) => Address::PreIndexed { rn, offset: -bytes },
        (true, false) => Address::Offset { rn, offset: -bytes },
    }
}

/// VLDR and VSTR of one word, or of two.
pub(super) fn float_beside(f: &Fields, count: u32) -> Instruction {
    float_words(f, count, indexed(f, true, false, f.get('i') << 2))
}

/// VLDM and VSTM.
pub(super) fn float_block(f: &Fields, count: u32, downwards: bool, writeback: bool) -> Instruction {
    float_words(f, count, beside(f.reg('n'), count, downwards, writeback))
}

/// Of registers that exist.
fn float_words(f: &Fields, count: u32, address: Address) -> Instruction {
    let first = f.sd();
    match u8::try_from(count) {
        Ok(count @ 1..=32) if first.0 + count <= 32 => {
            Instruction::MoveFloat { is_load: f.is('l'), first, count, address }
        }
        _ => Instruction::Undefined,
    }
}

pub(super) fn float(instruction: FloatInstruction) -> Instruction {
    Instruction::Float(instruction)
}

pub(super) fn float_operation(op: FloatOp, f: &Fields) -> Instruction {
    let sn = SReg(f.get('n') as u8);
    float(FloatInstruction::Arithmetic { op, sd: f.sd(), sn, sm: f.sm() })
}

pub(super) fn float_unary(op: FloatUnaryOp, f: &Fields) -> Instruction {
    float(FloatInstruction::Unary { op, sd: f.sd(), sm: f.sm() })
}

/// VFPExpandImm for 32 bits.
pub(super) fn float_constant(f: &Fields) -> Instruction {
    let bits = f.get('i');
    let exponent = if bits & 0x40 != 0 { 0x1f << 25 } else { 1 << 30 };
    let value = (bits & 0x80) << 24 | exponent | (bits & 0x3f) << 19;
    float(FloatInstruction::Constant { sd: f.sd(), value })
}

pub(super) fn float_compare(f: &Fields, sm: Option<SReg>) -> Instruction {
    float(FloatInstruction::Compare { sd: f.sd(), sm })
}

pub(super) fn from_integer(f: &Fields) -> Instruction {
    float(FloatInstruction::FromInteger { sd: f.sd(), sm: f.sm(), signed: f.is('s') })
}

pub(super) fn to_integer(f: &Fields) -> Instruction {
    float(FloatInstruction::ToInteger { sd: f.sd(), sm: f.sm(), signed: f.is('s'), truncate: f.is('t') })
}

pub(super) fn move_core(f: &Fields, sn: SReg, rt2: Option<Reg>) -> Instruction {
    float(FloatInstruction::MoveCore { to_core: f.is('l'), sn, rt: f.reg('t'), rt2 })
}

//! From halfwords to [`Instruction`]: tables of the encodings as the manual draws them (DDI0403, A5.2, A5.3, A6.4 to A6.7).
//!
//! In a pattern 0 and 1 are fixed, a dot is any bit, and a letter is a field, whose bits may lie apart; the first row that
//! fits decides. FPv4-SP is coprocessors 10 and 11; others do not exist. Double precision is undefined, and so are
//! floating-point multiplications that accumulate, and the odd counts of FLDMX and FSTMX.

mod operations;

use super::Size;
use super::instruction::{
    Address, AluOp, Extension, FloatInstruction, FloatOp, FloatUnaryOp, Instruction, Reg, RegisterOp, SReg, SetFlags,
    Shift, ShiftKind, UnaryOp,
};
use operations::*;

/// Whether `first` is the first half of a 32-bit instruction (DDI0403, A5.1).
pub fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// Decodes a 32-bit instruction, or a 16-bit one (`second` is then ignored).
pub fn decode(first: u16, second: u16) -> Instruction {
    let (table, word) = match is_wide(first) {
        true => (WIDE, u32::from(first) << 16 | u32::from(second)),
        false => (NARROW, first.into()),
    };
    let row = table.iter().find(|row| word & row.mask == row.value);
    row.map_or(Instruction::Undefined, |row| (row.decode)(&Fields { word, pattern: row.pattern }))
}

type Decode = fn(&Fields) -> Instruction;

struct Row {
    pattern: &'static str,
    /// The bits that are fixed, and what they are.
    mask: u32,
    value: u32,
    decode: Decode,
}

const fn row(pattern: &'static str, decode: Decode) -> Row {
    let (text, mut mask, mut value, mut at) = (pattern.as_bytes(), 0, 0, 0);
    while at < text.len() {
        if text[at] != b' ' {
            mask = mask << 1 | matches!(text[at], b'0' | b'1') as u32;
            value = value << 1 | (text[at] == b'1') as u32;
        }
        at += 1;
    }
    Row { pattern, mask, value, decode }
}

/// An instruction, and the pattern that it fits.
struct Fields {
    word: u32,
    pattern: &'static str,
}

impl Fields {
    /// The bits of field `letter` in their order.
    fn get(&self, letter: char) -> u32 {
        let letters = self.pattern.bytes().filter(|&letter| letter != b' ').rev().enumerate();
        let places = letters.filter(|&(_, found)| found == letter as u8);
        places.enumerate().fold(0, |value, (bit, (place, _))| value | (self.word >> place & 1) << bit)
    }

    /// imm4:i:imm3:imm8 of MOVW and MOVT.
    fn get_16(&self) -> u16 {
        (self.get('n') << 12 | self.get('i')) as u16
    }

    fn is(&self, letter: char) -> bool {
        self.get(letter) != 0
    }

    fn reg(&self, letter: char) -> Reg {
        Reg(self.get(letter) as u8)
    }

    /// A register field in which 15 stands for "none".
    fn some_reg(&self, letter: char) -> Option<Reg> {
        Some(self.reg(letter)).filter(|&register| register != Reg::PC)
    }

    fn sd(&self) -> SReg {
        self.single('d', 'D')
    }

    fn sm(&self) -> SReg {
        self.single('m', 'M')
    }

    /// A single-precision register of the bits of `high` and one of `low`.
    fn single(&self, high: char, low: char) -> SReg {
        SReg((self.get(high) << 1 | self.get(low)) as u8)
    }

    /// The field `i` as a two's complement number of halfwords.
    fn branch(&self, bits: u32) -> i32 {
        sign_extend(self.get('i') << 1, bits)
    }

    fn set_flags(&self) -> SetFlags {
        if self.is('s') { SetFlags::Yes } else { SetFlags::No }
    }

    /// DecodeImmShift of field `i` and a kind.
    fn shift(&self, kind: u32) -> Shift {
        let amount = self.get('i') as u8;
        let or_32 = if amount == 0 { 32 } else { amount };
        let (kind, amount) = match (kind, amount) {
            (0, _) => (ShiftKind::Lsl, amount),
            (1, _) => (ShiftKind::Lsr, or_32),
            (2, _) => (ShiftKind::Asr, or_32),
            (_, 0) => (ShiftKind::Rrx, 1),
            _ => (ShiftKind::Ror, amount),
        };
        Shift { kind, amount }
    }
}

/// The low `bits` bits of `value` as a two's complement number.
fn sign_extend(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)) as i32 >> (32 - bits)
}

#[rustfmt::skip] // One line an encoding.
const NARROW: &[Row] = &[
    row("0001100mmmnnnddd", |f| alu(AluOp::Add, SetFlags::OutsideIt, f, 'n')),
    row("0001101mmmnnnddd", |f| alu(AluOp::Sub, SetFlags::OutsideIt, f, 'n')),
    row("0001110iiinnnddd", |f| immediate(AluOp::Add, SetFlags::OutsideIt, f, 'n')),
    row("0001111iiinnnddd", |f| immediate(AluOp::Sub, SetFlags::OutsideIt, f, 'n')),
    row("000kkiiiiimmmddd", |f| shifted(AluOp::Mov, SetFlags::OutsideIt, f, 'd', f.shift(f.get('k')))),
    row("00100dddiiiiiiii", |f| immediate(AluOp::Mov, SetFlags::OutsideIt, f, 'd')),
    row("00101dddiiiiiiii", |f| immediate(AluOp::Cmp, SetFlags::Yes, f, 'd')),
    row("00110dddiiiiiiii", |f| immediate(AluOp::Add, SetFlags::OutsideIt, f, 'd')),
    row("00111dddiiiiiiii", |f| immediate(AluOp::Sub, SetFlags::OutsideIt, f, 'd')),
    row("0100000000mmmddd", |f| alu(AluOp::And, SetFlags::OutsideIt, f, 'd')),
    row("0100000001mmmddd", |f| alu(AluOp::Eor, SetFlags::OutsideIt, f, 'd')),
    row("0100000010mmmddd", |f| registers(RegisterOp::Shift(ShiftKind::Lsl), SetFlags::OutsideIt, f, 'd', 'm')),
    row("0100000011mmmddd", |f| registers(RegisterOp::Shift(ShiftKind::Lsr), SetFlags::OutsideIt, f, 'd', 'm')),
    row("0100000100mmmddd", |f| registers(RegisterOp::Shift(ShiftKind::Asr), SetFlags::OutsideIt, f, 'd', 'm')),
    row("0100000101mmmddd", |f| alu(AluOp::Adc, SetFlags::OutsideIt, f, 'd')),
    row("0100000110mmmddd", |f| alu(AluOp::Sbc, SetFlags::OutsideIt, f, 'd')),
    row("0100000111mmmddd", |f| registers(RegisterOp::Shift(ShiftKind::Ror), SetFlags::OutsideIt, f, 'd', 'm')),
    row("0100001000mmmddd", |f| alu(AluOp::Tst, SetFlags::Yes, f, 'd')),
    row("0100001001nnnddd", |f| immediate(AluOp::Rsb, SetFlags::OutsideIt, f, 'n')),
    row("0100001010mmmddd", |f| alu(AluOp::Cmp, SetFlags::Yes, f, 'd')),
    row("0100001011mmmddd", |f| alu(AluOp::Cmn, SetFlags::Yes, f, 'd')),
    row("0100001100mmmddd", |f| alu(AluOp::Orr, SetFlags::OutsideIt, f, 'd')),
    row("0100001101nnnddd", |f| registers(RegisterOp::Multiply, SetFlags::OutsideIt, f, 'n', 'd')),
    row("0100001110mmmddd", |f| alu(AluOp::Bic, SetFlags::OutsideIt, f, 'd')),
    row("0100001111mmmddd", |f| alu(AluOp::Mvn, SetFlags::OutsideIt, f, 'd')),
    row("01000100dmmmmddd", |f| alu(AluOp::Add, SetFlags::No, f, 'd')),
    row("01000101dmmmmddd", |f| alu(AluOp::Cmp, SetFlags::Yes, f, 'd')),
    row("01000110dmmmmddd", |f| alu(AluOp::Mov, SetFlags::No, f, 'd')),
    row("010001110mmmm...", |f| Instruction::BranchExchange { rm: f.reg('m') }),
    row("010001111mmmm...", |f| Instruction::BranchLinkExchange { rm: f.reg('m') }),
    row("01001tttiiiiiiii", |f| load(Size::Word, false, f, offset(Reg::PC, f.get('i') << 2))),
    row("0101000mmmnnnttt", |f| store(Size::Word, f, indexed_by_register(f))),
    row("0101001mmmnnnttt", |f| store(Size::Half, f, indexed_by_register(f))),
    row("0101010mmmnnnttt", |f| store(Size::Byte, f, indexed_by_register(f))),
    row("0101011mmmnnnttt", |f| load(Size::Byte, true, f, indexed_by_register(f))),
    row("0101100mmmnnnttt", |f| load(Size::Word, false, f, indexed_by_register(f))),
    row("0101101mmmnnnttt", |f| load(Size::Half, false, f, indexed_by_register(f))),
    row("0101110mmmnnnttt", |f| load(Size::Byte, false, f, indexed_by_register(f))),
    row("0101111mmmnnnttt", |f| load(Size::Half, true, f, indexed_by_register(f))),
    row("01100iiiiinnnttt", |f| store(Size::Word, f, offset(f.reg('n'), f.get('i') << 2))),
    row("01101iiiiinnnttt", |f| load(Size::Word, false, f, offset(f.reg('n'), f.get('i') << 2))),
    row("01110iiiiinnnttt", |f| store(Size::Byte, f, offset(f.reg('n'), f.get('i')))),
    row("01111iiiiinnnttt", |f| load(Size::Byte, false, f, offset(f.reg('n'), f.get('i')))),
    row("10000iiiiinnnttt", |f| store(Size::Half, f, offset(f.reg('n'), f.get('i') << 1))),
    row("10001iiiiinnnttt", |f| load(Size::Half, false, f, offset(f.reg('n'), f.get('i') << 1))),
    row("10010tttiiiiiiii", |f| store(Size::Word, f, offset(Reg::SP, f.get('i') << 2))),
    row("10011tttiiiiiiii", |f| load(Size::Word, false, f, offset(Reg::SP, f.get('i') << 2))),
    row("10100dddiiiiiiii", |f| Instruction::PcRelative { rd: f.reg('d'), offset: (f.get('i') << 2) as i16 }),
    row("10101dddiiiiiiii", |f| move_sp(AluOp::Add, f.reg('d'), f)),
    row("101100000iiiiiii", |f| move_sp(AluOp::Add, Reg::SP, f)),
    row("101100001iiiiiii", |f| move_sp(AluOp::Sub, Reg::SP, f)),
    row("1011001000mmmddd", |f| extend(Extension::SignedHalf, f, None)),
    row("1011001001mmmddd", |f| extend(Extension::SignedByte, f, None)),
    row("1011001010mmmddd", |f| extend(Extension::Half, f, None)),
    row("1011001011mmmddd", |f| extend(Extension::Byte, f, None)),
    row("1011101000mmmddd", |f| unary(UnaryOp::Rev, f)),
    row("1011101001mmmddd", |f| unary(UnaryOp::Rev16, f)),
    row("1011101011mmmddd", |f| unary(UnaryOp::Revsh, f)),
    row("10110110011i..10", |f| Instruction::ChangeMask { disable: f.is('i') }),
    row("1011z0i1iiiiinnn", compare_branch),
    row("1011010lrrrrrrrr", |f| block(false, Reg::SP, f.get('l') << 14 | f.get('r'), true, true)),
    row("1011110prrrrrrrr", |f| block(true, Reg::SP, f.get('p') << 15 | f.get('r'), false, true)),
    row("10111111hhhh0000", hint),
    row("10111111iiiiiiii", |f| Instruction::IfThen { state: f.get('i') as u8 }),
    row("11000nnnrrrrrrrr", |f| block(false, f.reg('n'), f.get('r'), false, true)),
    // A loaded base register keeps what was loaded.
    row("11001nnnrrrrrrrr", |f| block(true, f.reg('n'), f.get('r'), false, f.get('r') >> f.get('n') & 1 == 0)),
    // UDF, and SVC, which no image has.
    row("1101111.........", |_| Instruction::Undefined),
    row("1101cccciiiiiiii", |f| Instruction::BranchIf { condition: f.get('c') as u8, offset: f.branch(9) }),
    row("11100iiiiiiiiiii", |f| Instruction::Branch { offset: f.branch(12) }),
];

#[rustfmt::skip] // One line an encoding.
const WIDE: &[Row] = &[
    row("1110100010wlnnnn rrrrrrrrrrrrrrrr", |f| block(f.is('l'), f.reg('n'), f.get('r'), false, f.is('w'))),
    row("1110100100wlnnnn rrrrrrrrrrrrrrrr", |f| block(f.is('l'), f.reg('n'), f.get('r'), true, f.is('w'))),
    row("11101000010lnnnn ttttddddiiiiiiii", |f| exclusive(Size::Word, f, (f.get('i') << 2) as u16)),
    row("111010001101nnnn ........0000mmmm", |f| table_branch(false, f)),
    row("111010001101nnnn ........0001mmmm", |f| table_branch(true, f)),
    row("11101000110lnnnn tttt....0100dddd", |f| exclusive(Size::Byte, f, 0)),
    row("11101000110lnnnn tttt....0101dddd", |f| exclusive(Size::Half, f, 0)),
    row("1110100pu11lnnnn ttttvvvviiiiiiii", |f| pair(f, indexed(f, f.is('p'), true, f.get('i') << 2))),
    row("11101001u10lnnnn ttttvvvviiiiiiii", |f| pair(f, indexed(f, true, false, f.get('i') << 2))),
    row("111010101100nnnn .iiiddddiib0mmmm", pack),
    row("1110101oooosnnnn .iiiddddiikkmmmm", |f| alu_op(f, |op| shifted(op, f.set_flags(), f, 'n', f.shift(f.get('k'))))),

    row("11110011100.nnnn 10.010..yyyyyyyy", |f| special(f, |special| Instruction::WriteSpecial { special, rn: f.reg('n') })),
    row("111100111010.... 10.0.000hhhhhhhh", hint),
    row("111100111011.... 10.0....0010....", |_| Instruction::ClearExclusive),
    row("111100111011.... 10.0....010.....", |_| Instruction::Nop),
    row("111100111011.... 10.0....0110....", |_| Instruction::Nop),
    row("11110011111..... 10.0ddddyyyyyyyy", |f| special(f, |special| Instruction::ReadSpecial { rd: f.reg('d'), special })),
    row("11110.111....... 10.0............", |_| Instruction::Undefined),
    row("11110scccciiiiii 10j0kiiiiiiiiiii", branch_if),
    row("11110siiiiiiiiii 10j1kiiiiiiiiiii", |f| Instruction::Branch { offset: far_offset(f) }),
    row("11110siiiiiiiiii 11j1kiiiiiiiiiii", |f| Instruction::BranchLink { offset: far_offset(f) }),

    row("11110i0oooosnnnn 0iiiddddiiiiiiii", |f| alu_op(f, |op| expanded(op, f))),
    row("11110i1000001111 0iiiddddiiiiiiii", |f| Instruction::PcRelative { rd: f.reg('d'), offset: f.get('i') as i16 }),
    row("11110i100000nnnn 0iiiddddiiiiiiii", |f| immediate(AluOp::Add, SetFlags::No, f, 'n')),
    row("11110i100100nnnn 0iiiddddiiiiiiii", move_wide),
    row("11110i1010101111 0iiiddddiiiiiiii", |f| Instruction::PcRelative { rd: f.reg('d'), offset: -(f.get('i') as i16) }),
    row("11110i101010nnnn 0iiiddddiiiiiiii", |f| immediate(AluOp::Sub, SetFlags::No, f, 'n')),
    row("11110i101100nnnn 0iiiddddiiiiiiii", |f| Instruction::MoveTop { rd: f.reg('d'), value: f.get_16() }),
    row("11110.110100nnnn 0iiiddddii.wwwww", |f| bitfield_extract(true, f)),
    row("11110.111100nnnn 0iiiddddii.wwwww", |f| bitfield_extract(false, f)),
    row("11110.110110nnnn 0iiiddddii.wwwww", bitfield_insert),

    row("111110001zz0nnnn ttttiiiiiiiiiiii", |f| store_single(f, offset(f.reg('n'), f.get('i')))),
    // Also STRT and LDRT, which are ordinary accesses: there is no unprivileged code.
    row("111110000zz0nnnn tttt11uwiiiiiiii", |f| store_single(f, indexed(f, true, f.is('w'), f.get('i')))),
    row("111110000zz0nnnn tttt10u1iiiiiiii", |f| store_single(f, indexed(f, false, true, f.get('i')))),
    row("111110000zz0nnnn tttt000000kkmmmm", |f| store_single(f, indexed_by_register(f))),
    row("1111100g0zz11111 ttttiiiiiiiiiiii", |f| load_single(f, Address::Offset { rn: Reg::PC, offset: -(f.get('i') as i16) })),
    row("1111100g1zz1nnnn ttttiiiiiiiiiiii", |f| load_single(f, offset(f.reg('n'), f.get('i')))),
    row("1111100g0zz1nnnn tttt11uwiiiiiiii", |f| load_single(f, indexed(f, true, f.is('w'), f.get('i')))),
    row("1111100g0zz1nnnn tttt10u1iiiiiiii", |f| load_single(f, indexed(f, false, true, f.get('i')))),
    row("1111100g0zz1nnnn tttt000000kkmmmm", |f| load_single(f, indexed_by_register(f))),
    row("11111010000snnnn 1111dddd0000mmmm", |f| registers(RegisterOp::Shift(ShiftKind::Lsl), f.set_flags(), f, 'n', 'm')),
    row("11111010001snnnn 1111dddd0000mmmm", |f| registers(RegisterOp::Shift(ShiftKind::Lsr), f.set_flags(), f, 'n', 'm')),
    row("11111010010snnnn 1111dddd0000mmmm", |f| registers(RegisterOp::Shift(ShiftKind::Asr), f.set_flags(), f, 'n', 'm')),
    row("11111010011snnnn 1111dddd0000mmmm", |f| registers(RegisterOp::Shift(ShiftKind::Ror), f.set_flags(), f, 'n', 'm')),
    row("111110100000nnnn 1111dddd1.rrmmmm", |f| extend(Extension::SignedHalf, f, f.some_reg('n'))),
    row("111110100001nnnn 1111dddd1.rrmmmm", |f| extend(Extension::Half, f, f.some_reg('n'))),
    row("111110100010nnnn 1111dddd1.rrmmmm", |f| extend(Extension::SignedBytes, f, f.some_reg('n'))),
    row("111110100011nnnn 1111dddd1.rrmmmm", |f| extend(Extension::Bytes, f, f.some_reg('n'))),
    row("111110100100nnnn 1111dddd1.rrmmmm", |f| extend(Extension::SignedByte, f, f.some_reg('n'))),
    row("111110100101nnnn 1111dddd1.rrmmmm", |f| extend(Extension::Byte, f, f.some_reg('n'))),
    row("111110101100nnnn 1111dddd0101mmmm", |f| registers(RegisterOp::SubtractBytes, SetFlags::No, f, 'n', 'm')),
    row("111110101001.... 1111dddd1000mmmm", |f| unary(UnaryOp::Rev, f)),
    row("111110101001.... 1111dddd1001mmmm", |f| unary(UnaryOp::Rev16, f)),
    row("111110101001.... 1111dddd1010mmmm", |f| unary(UnaryOp::Rbit, f)),
    row("111110101001.... 1111dddd1011mmmm", |f| unary(UnaryOp::Revsh, f)),
    row("111110101011.... 1111dddd1000mmmm", |f| unary(UnaryOp::Clz, f)),
    row("111110110000nnnn 1111dddd0000mmmm", |f| registers(RegisterOp::Multiply, SetFlags::No, f, 'n', 'm')),
    row("111110110000nnnn aaaadddd000smmmm", multiply_add),
    row("111110110001nnnn aaaadddd00xymmmm", multiply_halves),
    row("111110111uu0nnnn llllhhhh0000mmmm", multiply_long),
    row("111110111001nnnn ....dddd1111mmmm", |f| registers(RegisterOp::SignedDivide, SetFlags::No, f, 'n', 'm')),
    row("111110111011nnnn ....dddd1111mmmm", |f| registers(RegisterOp::UnsignedDivide, SetFlags::No, f, 'n', 'm')),

    row("111011100D10nnnn dddd1010n0M0mmmm", |f| float_operation(FloatOp::Mul, f)),
    row("111011100D10nnnn dddd1010n1M0mmmm", |f| float_operation(FloatOp::Nmul, f)),
    row("111011100D11nnnn dddd1010n0M0mmmm", |f| float_operation(FloatOp::Add, f)),
    row("111011100D11nnnn dddd1010n1M0mmmm", |f| float_operation(FloatOp::Sub, f)),
    row("111011101D00nnnn dddd1010n0M0mmmm", |f| float_operation(FloatOp::Div, f)),
    row("111011101D11iiii dddd1010.0.0iiii", float_constant),
    row("111011101D110000 dddd101001M0mmmm", |f| float_unary(FloatUnaryOp::Mov, f)),
    row("111011101D110000 dddd101011M0mmmm", |f| float_unary(FloatUnaryOp::Abs, f)),
    row("111011101D110001 dddd101001M0mmmm", |f| float_unary(FloatUnaryOp::Neg, f)),
    row("111011101D110001 dddd101011M0mmmm", |f| float_unary(FloatUnaryOp::Sqrt, f)),
    row("111011101D110100 dddd1010.1M0mmmm", |f| float_compare(f, Some(f.sm()))),
    row("111011101D110101 dddd1010.1.0....", |f| float_compare(f, None)),
    row("111011101D111000 dddd1010s1M0mmmm", from_integer),
    row("111011101D11110s dddd1010t1M0mmmm", to_integer),
    row("11101110000lnnnn tttt1010N..1....", |f| move_core(f, f.single('n', 'N'), None)),
    // One word of a double-precision register; D16 and up do not exist.
    row("1110111000wlnnnn tttt10110001....", |f| move_core(f, f.single('n', 'w'), None)),
    row("1110111011100001 tttt1010...1....", |f| float(FloatInstruction::WriteStatus { rt: f.reg('t') })),
    row("1110111011110001 tttt1010...1....", |f| float(FloatInstruction::ReadStatus { rt: f.reg('t') })),
    row("11101100010lvvvv tttt101000M1mmmm", |f| move_core(f, f.sm(), Some(f.reg('v')))),
    row("11101100010lvvvv tttt10110001mmmm", |f| move_core(f, f.sm(), Some(f.reg('v')))),
    row("11101101uD0lnnnn dddd1010iiiiiiii", |f| float_beside(f, 1)),
    row("11101101u00lnnnn dddd1011iiiiiiii", |f| float_beside(f, 2)),
    row("111011001Dwlnnnn dddd1010iiiiiiii", |f| float_block(f, f.get('i'), false, f.is('w'))),
    row("1110110010wlnnnn dddd1011iiiiiii0", |f| float_block(f, f.get('i') << 1, false, f.is('w'))),
    row("111011010D1lnnnn dddd1010iiiiiiii", |f| float_block(f, f.get('i'), true, true)),
    row("11101101001lnnnn dddd1011iiiiiii0", |f| float_block(f, f.get('i') << 1, true, true)),
    row("111.11.......... ....101.........", |_| Instruction::Undefined),
    row("111.11.......... ................", |_| Instruction::NoCoprocessor),
];

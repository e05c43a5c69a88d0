//! What instructions are made of: registers, operations, shifts, addresses.

use super::Size;

/// A core register, 0–15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reg(pub u8);

impl Reg {
    /// Stack pointer (the one in use of MSP and PSP).
    pub const SP: Self = Self(13);
    /// Link register.
    pub const LR: Self = Self(14);
    /// Program counter; reads as the address of the instruction plus 4.
    pub const PC: Self = Self(15);

    /// The four bits of `word` from bit `low` on, as a register.
    pub(super) fn at(word: u32, low: u32) -> Self {
        Self((word >> low & 15) as u8)
    }

    /// Index into an array of 16.
    pub(super) fn index(self) -> usize {
        usize::from(self.0 & 15)
    }

    /// A mask with this register's bit set.
    pub(super) fn bit(self) -> u16 {
        1 << (self.0 & 15)
    }
}

/// Whether an instruction writes the flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetFlags {
    /// Flags stay.
    No,
    /// Flags are written.
    Yes,
    /// 16-bit encodings: flags are written outside an IT block only.
    OutsideIt,
}

/// Data-processing operations with two operands (`Mov`, `Mvn` use the second alone).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The ARMv7-M mnemonics.
pub enum AluOp {
    And,
    Bic,
    Orr,
    Orn,
    Eor,
    Mov,
    Mvn,
    Add,
    Adc,
    Sub,
    Sbc,
    Rsb,
    /// Flags of `And`, no result.
    Tst,
    /// Flags of `Eor`, no result.
    Teq,
    /// Flags of `Sub`, no result.
    Cmp,
    /// Flags of `Add`, no result.
    Cmn,
}

/// What an immediate operand does to the carry flag in a logical operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImmediateCarry {
    /// The immediate was not rotated: carry stays.
    Keep,
    /// The immediate was rotated: carry becomes its bit 31.
    Bit31,
}

/// Kinds of shift.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShiftKind {
    /// Logical left.
    Lsl,
    /// Logical right.
    Lsr,
    /// Arithmetic right.
    Asr,
    /// Rotate right.
    Ror,
    /// Rotate right by one through the carry flag.
    Rrx,
}

/// A shift by a constant; `amount` is 0–32, as `DecodeImmShift` gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shift {
    /// Kind of shift.
    pub kind: ShiftKind,
    /// Places.
    pub amount: u8,
}

impl Shift {
    /// No shift.
    pub const NONE: Self = Self { kind: ShiftKind::Lsl, amount: 0 };
}

/// Operations with one operand register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The ARMv7-M mnemonics.
pub enum UnaryOp {
    Clz,
    Rbit,
    Rev,
    Rev16,
    Revsh,
}

/// Which part of the (rotated) register an extension widens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extension {
    /// SXTB, SXTAB.
    SignedByte,
    /// SXTH, SXTAH.
    SignedHalf,
    /// SXTB16, SXTAB16: bytes 0 and 2 to two halfwords.
    SignedBytes,
    /// UXTB, UXTAB.
    Byte,
    /// UXTH, UXTAH.
    Half,
    /// UXTB16, UXTAB16.
    Bytes,
}

/// Operation of a parallel addition or subtraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The suffixes of the ARMv7-M mnemonics.
pub enum ParallelOp {
    Add8,
    Add16,
    /// Exchange halves of the second operand; add high, subtract low.
    Asx,
    /// Exchange halves of the second operand; subtract high, add low.
    Sax,
    Sub8,
    Sub16,
}

/// Arithmetic of a parallel addition or subtraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParallelKind {
    /// S…: modulo, GE flags.
    Signed,
    /// Q…: saturating.
    SignedSaturating,
    /// SH…: halved.
    SignedHalving,
    /// U…: modulo, GE flags.
    Unsigned,
    /// UQ…: saturating.
    UnsignedSaturating,
    /// UH…: halved.
    UnsignedHalving,
}

/// Saturating additions of whole words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The ARMv7-M mnemonics.
pub enum SaturatingOp {
    Qadd,
    Qdadd,
    Qsub,
    Qdsub,
}

/// What a load puts into its register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadKind {
    /// LDR.
    Word,
    /// LDRH.
    Half,
    /// LDRB.
    Byte,
    /// LDRSH.
    SignedHalf,
    /// LDRSB.
    SignedByte,
}

impl LoadKind {
    /// Width of the access.
    pub fn size(self) -> Size {
        match self {
            Self::Word => Size::Word,
            Self::Half | Self::SignedHalf => Size::Half,
            Self::Byte | Self::SignedByte => Size::Byte,
        }
    }
}

/// Address of a load or store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Field names are those of the ARMv7-M ARM; offsets are in bytes.
pub enum Address {
    /// `[rn, #offset]`; with `rn` = PC the PC is aligned down to a word first.
    Offset { rn: Reg, offset: i16 },
    /// `[rn, #offset]!`.
    PreIndexed { rn: Reg, offset: i16 },
    /// `[rn], #offset`.
    PostIndexed { rn: Reg, offset: i16 },
    /// `[rn, rm, LSL #shift]`.
    Register { rn: Reg, rm: Reg, shift: u8 },
}

/// A special register of MRS and MSR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Names of DDI0403, B5.1.1.
pub enum Special {
    /// The combinations of APSR, IPSR and EPSR: bit 0 of the number adds IPSR, bit 2 leaves APSR out.
    Psr(u8),
    Msp,
    Psp,
    Primask,
    Basepri,
    /// BASEPRI, only ever raised in urgency.
    BasepriMax,
    Faultmask,
    Control,
}

/// A single-precision register, 0–31.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SReg(pub u8);

impl SReg {
    /// Index into an array of 32.
    pub(super) fn index(self) -> usize {
        usize::from(self.0 & 31)
    }
}

/// Operations with two operands and, for the multiply-accumulates, the destination as third.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The ARMv7-M mnemonics without their V.
pub enum FloatOp {
    Add,
    Sub,
    Mul,
    Nmul,
    Div,
    Mla,
    Mls,
    Nmla,
    Nmls,
    Fma,
    Fms,
    Fnma,
    Fnms,
}

/// Operations with one operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The ARMv7-M mnemonics without their V.
pub enum FloatUnaryOp {
    Mov,
    Abs,
    Neg,
    Sqrt,
}

/// Number format of the integer or fixed-point side of a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fixed {
    /// Two's complement.
    pub signed: bool,
    /// 16 or 32 bits.
    pub bits: u8,
    /// Bits right of the binary point; 0 for an integer.
    pub fraction: u8,
}

/// Address of a floating-point load or store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Field names are those of the ARMv7-M ARM; offsets are in bytes.
pub enum FloatAddress {
    /// VLDR, VSTR.
    Offset { rn: Reg, offset: i16 },
    /// VLDM, VSTM upwards from `rn`; `bytes` is what write-back adds, or 0.
    Increment { rn: Reg, bytes: u8 },
    /// VLDMDB, VSTMDB downwards from `rn`, by `bytes`, with write-back.
    Decrement { rn: Reg, bytes: u8 },
}

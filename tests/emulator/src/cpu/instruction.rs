//! The instructions of ARMv7E-M with FPv4-SP, decoded.
//!
//! One variant stands for one *operation*; the several encodings of it (16-bit, 32-bit, with or without
//! flags) differ only in fields. Names follow the ARMv7-M ARM (DDI0403), chapter A7. Undefined here is what is in no image:
//! parallel operations but UQSUB8, additions and numbers that saturate (QADD, SSAT, USAT and their kin), SMMUL, UMAAL, USAD8,
//! SMLAD, SMLAW, SMLALxy, SMLALD and their kin, VCVT of fixed-point numbers, floating-point multiplications that accumulate, which the compiler does not
//! fuse, and access to BASEPRI, FAULTMASK and the process stack.

use super::Size;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[rustfmt::skip] // One line an operation: it reads as a table.
pub enum Instruction {
    AluImmediate { op: AluOp, flags: SetFlags, rd: Reg, rn: Reg, carry: ImmediateCarry, value: u32 },
    AluRegister { op: AluOp, flags: SetFlags, rd: Reg, rn: Reg, rm: Reg, shift: Shift },
    Registers { op: RegisterOp, flags: SetFlags, rd: Reg, rn: Reg, rm: Reg },
    /// ADR.
    PcRelative { rd: Reg, offset: i16 },
    /// MOVT.
    MoveTop { rd: Reg, value: u16 },
    BitfieldExtract { signed: bool, rd: Reg, rn: Reg, lsb: u8, width: u8 },
    /// BFI, or BFC when there is no `rn`.
    BitfieldInsert { rd: Reg, rn: Option<Reg>, lsb: u8, width: u8 },
    /// SXTB…UXTB16, and with `rn` SXTAB…UXTAB16.
    Extend { extension: Extension, rd: Reg, rn: Option<Reg>, rm: Reg, rotate: u8 },
    Unary { op: UnaryOp, rd: Reg, rm: Reg },
    /// PKHBT, or with `tb` PKHTB.
    Pack { tb: bool, rd: Reg, rn: Reg, rm: Reg, shift: Shift },

    /// MLA, MLS.
    MultiplyAdd { subtract: bool, rd: Reg, rn: Reg, rm: Reg, ra: Reg },
    /// SMULxy, SMLAxy.
    MultiplyHalves { rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg>, n_top: bool, m_top: bool },
    /// SMULL, UMULL, SMLAL, UMLAL.
    MultiplyLong { signed: bool, accumulate: bool, lo: Reg, hi: Reg, rn: Reg, rm: Reg },

    Load { size: Size, signed: bool, rt: Reg, address: Address },
    Store { size: Size, rt: Reg, address: Address },
    /// LDRD, STRD.
    MovePair { is_load: bool, rt: Reg, rt2: Reg, address: Address },
    /// LDM, LDMDB, POP, STM, STMDB, PUSH; registers by their bits.
    MoveMultiple { is_load: bool, registers: u16, address: Address },
    /// VLDR and VSTR of `count` words, VLDM, VPOP, VSTM, VPUSH.
    MoveFloat { is_load: bool, first: SReg, count: u8, address: Address },
    LoadExclusive { size: Size, rt: Reg, rn: Reg, offset: u16 },
    StoreExclusive { size: Size, rd: Reg, rt: Reg, rn: Reg, offset: u16 },
    /// CLREX.
    ClearExclusive,

    Branch { offset: i32 },
    BranchIf { condition: u8, offset: i32 },
    /// BL.
    BranchLink { offset: i32 },
    /// BX.
    BranchExchange { rm: Reg },
    /// BLX.
    BranchLinkExchange { rm: Reg },
    /// CBZ, CBNZ.
    CompareBranch { nonzero: bool, rn: Reg, offset: u8 },
    /// TBB, TBH.
    TableBranch { half: bool, rn: Reg, rm: Reg },
    /// IT; `state` becomes ITSTATE.
    IfThen { state: u8 },

    /// NOP, YIELD, DBG, PLD, PLI and hints without a meaning; DSB, DMB and ISB, as everything is in order here.
    Nop,
    Wfe,
    Sev,
    /// CPSID i, CPSIE i.
    ChangeMask { disable: bool },
    /// MRS.
    ReadSpecial { rd: Reg, special: Special },
    /// MSR.
    WriteSpecial { special: Special, rn: Reg },
    Float(FloatInstruction),
    /// An encoding without a meaning, or one reserved as undefined.
    Undefined,
    /// An instruction of a coprocessor that is not there.
    NoCoprocessor,
}

/// A decoded instruction of the floating-point extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[rustfmt::skip] // One line an operation: it reads as a table.
pub enum FloatInstruction {
    Arithmetic { op: FloatOp, sd: SReg, sn: SReg, sm: SReg },
    Unary { op: FloatUnaryOp, sd: SReg, sm: SReg },
    /// VMOV of a constant.
    Constant { sd: SReg, value: u32 },
    /// VCMP, VCMPE; with zero when there is no `sm`.
    Compare { sd: SReg, sm: Option<SReg> },
    /// VCVT and VCVTR to an integer; `truncate`: towards zero, else to nearest.
    ToInteger { sd: SReg, sm: SReg, signed: bool, truncate: bool },
    /// VCVT from an integer.
    FromInteger { sd: SReg, sm: SReg, signed: bool },
    /// VMOV between `sn` and `rt`, and between the register behind `sn` and `rt2`, if there is one.
    MoveCore { to_core: bool, sn: SReg, rt: Reg, rt2: Option<Reg> },
    /// VMRS; `rt` = PC stands for the flags.
    ReadStatus { rt: Reg },
    /// VMSR.
    WriteStatus { rt: Reg },
}

const _: () = assert!(size_of::<Instruction>() <= 12, "the decoded-instruction cache relies on small instructions");

/// A core register, 0–15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reg(pub u8);

impl Reg {
    /// The main stack pointer.
    pub const SP: Self = Self(13);
    /// Program counter; reads as the address of the instruction plus 4.
    pub const PC: Self = Self(15);

    /// Index into an array of 16.
    #[inline]
    pub(super) fn index(self) -> usize {
        usize::from(self.0 & 15)
    }

    /// A mask with this register's bit set.
    #[inline]
    pub(super) fn bit(self) -> u16 {
        1 << (self.0 & 15)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetFlags {
    No,
    Yes,
    /// 16-bit encodings: flags are written outside an IT block only.
    OutsideIt,
}

/// Data-processing operations with two operands (`Mov`, `Mvn` use the second alone).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    Tst,
    Teq,
    Cmp,
    Cmn,
}

/// Operations on two registers as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegisterOp {
    /// By the low byte of the second.
    Shift(ShiftKind),
    Multiply,
    UnsignedDivide,
    SignedDivide,
    /// UQSUB8.
    SubtractBytes,
}

/// What an immediate operand does to the carry flag in a logical operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImmediateCarry {
    /// The immediate was not rotated: carry stays.
    Keep,
    /// The immediate was rotated: carry becomes its bit 31.
    Bit31,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShiftKind {
    Lsl,
    Lsr,
    Asr,
    Ror,
    /// Rotate right by one through the carry flag.
    Rrx,
}

/// A shift by a constant; `amount` is 0–32, as `DecodeImmShift` gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shift {
    pub kind: ShiftKind,
    pub amount: u8,
}

impl Shift {
    pub const NONE: Self = Self { kind: ShiftKind::Lsl, amount: 0 };
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    SignedByte,
    SignedHalf,
    /// SXTB16, SXTAB16: bytes 0 and 2 to two halfwords.
    SignedBytes,
    Byte,
    Half,
    Bytes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
pub enum Special {
    /// The combinations of APSR, IPSR and EPSR: bit 0 of the number adds IPSR, bit 2 leaves APSR out.
    Psr(u8),
    Msp,
    Primask,
    Control,
}

/// A single-precision register, 0–31.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SReg(pub u8);

impl SReg {
    /// Index into an array of 32.
    #[inline]
    pub(super) fn index(self) -> usize {
        usize::from(self.0 & 31)
    }
}

/// Operations with two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FloatOp {
    Add,
    Sub,
    Mul,
    Nmul,
    Div,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FloatUnaryOp {
    Mov,
    Abs,
    Neg,
    Sqrt,
}

//! The instructions of ARMv7E-M with FPv4-SP, decoded.
//!
//! One variant stands for one *operation*; the several encodings of it (16-bit, 32-bit, with or without
//! flags) differ only in fields. Names follow the ARMv7-M ARM (DDI0403), chapter A7.

use super::Size;
pub use super::operands::{
    Address, AluOp, Extension, Fixed, FloatAddress, FloatOp, FloatUnaryOp, ImmediateCarry, LoadKind, ParallelKind,
    ParallelOp, Reg, SReg, SaturatingOp, SetFlags, Shift, ShiftKind, Special, UnaryOp,
};

/// A decoded instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Field names are those of the ARMv7-M ARM; offsets are in bytes, branch offsets from PC.
#[rustfmt::skip] // One line an operation: it reads as a table.
pub enum Instruction {
    AluImmediate { op: AluOp, flags: SetFlags, rd: Reg, rn: Reg, carry: ImmediateCarry, value: u32 },
    AluRegister { op: AluOp, flags: SetFlags, rd: Reg, rn: Reg, rm: Reg, shift: Shift },
    /// `rd = rn shifted by the low byte of rm`.
    ShiftRegister { kind: ShiftKind, flags: SetFlags, rd: Reg, rn: Reg, rm: Reg },
    /// ADR.
    PcRelative { rd: Reg, offset: i16 },
    /// MOVT.
    MoveTop { rd: Reg, value: u16 },
    BitfieldExtract { signed: bool, rd: Reg, rn: Reg, lsb: u8, width: u8 },
    /// BFI, or BFC when there is no `rn`.
    BitfieldInsert { rd: Reg, rn: Option<Reg>, lsb: u8, width: u8 },
    /// SSAT or USAT to `bits` bits.
    Saturate { signed: bool, rd: Reg, rn: Reg, bits: u8, shift: Shift },
    /// SSAT16 or USAT16.
    SaturateHalves { signed: bool, rd: Reg, rn: Reg, bits: u8 },
    /// SXTB…UXTB16, and with `rn` SXTAB…UXTAB16.
    Extend { extension: Extension, rd: Reg, rn: Option<Reg>, rm: Reg, rotate: u8 },
    Unary { op: UnaryOp, rd: Reg, rm: Reg },
    /// PKHBT, or with `tb` PKHTB.
    Pack { tb: bool, rd: Reg, rn: Reg, rm: Reg, shift: Shift },
    Parallel { op: ParallelOp, kind: ParallelKind, rd: Reg, rn: Reg, rm: Reg },
    SaturatingAdd { op: SaturatingOp, rd: Reg, rn: Reg, rm: Reg },
    /// SEL.
    Select { rd: Reg, rn: Reg, rm: Reg },

    Multiply { flags: SetFlags, rd: Reg, rn: Reg, rm: Reg },
    /// MLA, MLS.
    MultiplyAdd { subtract: bool, rd: Reg, rn: Reg, rm: Reg, ra: Reg },
    /// SMULxy, SMLAxy.
    MultiplyHalves { rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg>, n_top: bool, m_top: bool },
    /// SMULWy, SMLAWy.
    MultiplyWordHalf { rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg>, m_top: bool },
    /// SMUAD, SMUSD, SMLAD, SMLSD.
    DualMultiply { subtract: bool, exchange: bool, rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg> },
    /// SMMUL, SMMLA, SMMLS.
    MultiplyHigh { subtract: bool, round: bool, rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg> },
    /// USAD8, USADA8.
    AbsoluteDifferences { rd: Reg, rn: Reg, rm: Reg, ra: Option<Reg> },
    /// SMULL, UMULL, SMLAL, UMLAL.
    MultiplyLong { signed: bool, accumulate: bool, lo: Reg, hi: Reg, rn: Reg, rm: Reg },
    /// UMAAL.
    MultiplyAddAddLong { lo: Reg, hi: Reg, rn: Reg, rm: Reg },
    /// SMLALxy.
    MultiplyHalvesLong { lo: Reg, hi: Reg, rn: Reg, rm: Reg, n_top: bool, m_top: bool },
    /// SMLALD, SMLSLD.
    DualMultiplyLong { subtract: bool, exchange: bool, lo: Reg, hi: Reg, rn: Reg, rm: Reg },
    Divide { signed: bool, rd: Reg, rn: Reg, rm: Reg },

    Load { kind: LoadKind, rt: Reg, address: Address },
    Store { size: Size, rt: Reg, address: Address },
    /// LDRD.
    LoadPair { rt: Reg, rt2: Reg, address: Address },
    /// STRD.
    StorePair { rt: Reg, rt2: Reg, address: Address },
    /// LDM, LDMDB, POP.
    LoadMultiple { rn: Reg, registers: u16, decrement: bool, writeback: bool },
    /// STM, STMDB, PUSH.
    StoreMultiple { rn: Reg, registers: u16, decrement: bool, writeback: bool },
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

    /// NOP, YIELD, DBG, PLD, PLI and hints without a meaning.
    Nop,
    /// DSB, DMB, ISB: everything is in order here.
    Barrier,
    Wfe,
    Wfi,
    Sev,
    Breakpoint,
    SupervisorCall,
    /// CPSID, CPSIE.
    ChangeMasks { disable: bool, primask: bool, faultmask: bool },
    /// MRS.
    ReadSpecial { rd: Reg, special: Special },
    /// MSR; bit 1 of `mask` selects the flags, bit 0 the GE bits (PSR only).
    WriteSpecial { special: Special, rn: Reg, mask: u8 },
    Float(FloatInstruction),
    /// An encoding without a meaning, or one reserved as undefined.
    Undefined,
    /// An instruction of a coprocessor that is not there.
    NoCoprocessor,
}

/// A decoded instruction of the floating-point extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Field names are those of the ARMv7-M ARM.
#[rustfmt::skip] // One line an operation: it reads as a table.
pub enum FloatInstruction {
    Arithmetic { op: FloatOp, sd: SReg, sn: SReg, sm: SReg },
    Unary { op: FloatUnaryOp, sd: SReg, sm: SReg },
    /// VMOV of a constant.
    Constant { sd: SReg, value: u32 },
    /// VCMP, VCMPE; with zero when there is no `sm`.
    Compare { sd: SReg, sm: Option<SReg> },
    /// VCVT and VCVTR to an integer or a fixed-point number; `truncate`: towards zero, else to nearest.
    ToFixed { sd: SReg, sm: SReg, fixed: Fixed, truncate: bool },
    /// VCVT from an integer or a fixed-point number.
    FromFixed { sd: SReg, sm: SReg, fixed: Fixed },
    ToCore { rt: Reg, sn: SReg },
    FromCore { sn: SReg, rt: Reg },
    /// Two consecutive registers from `sm` on.
    PairToCore { rt: Reg, rt2: Reg, sm: SReg },
    PairFromCore { sm: SReg, rt: Reg, rt2: Reg },
    /// VMRS; `rt` = PC stands for the flags.
    ReadStatus { rt: Reg },
    /// VMSR.
    WriteStatus { rt: Reg },
    /// VLDR of `count` words, VLDM, VPOP.
    Load { first: SReg, count: u8, address: FloatAddress },
    /// VSTR of `count` words, VSTM, VPUSH.
    Store { first: SReg, count: u8, address: FloatAddress },
}

const _: () = assert!(size_of::<Instruction>() <= 12, "the decoded-instruction cache relies on small instructions");

//! Decoded instructions by address, and how long they take: the table of the Cortex-M4 Technical Reference Manual (DDI0439,
//! 3.3.1 and 7.2.3).
//!
//! The manual leaves ranges open; the choices made here are the constants below. Also simplified: IT is never
//! folded, a skipped instruction takes its one cycle, the write buffer never fills, and a floating-point result that
//! the next instruction consumes is not waited for (a cycle each: some 2 % of the pose solver).

use crate::memory::{CCM_BASE, CCM_BYTES};

use super::Fault;
use super::decode::{decode, is_wide};
use super::instruction::{Address, FloatInstruction, FloatOp, FloatUnaryOp, Instruction, RegisterOp};
use crate::board::Board;

/// Flash of the STM32G474RE, bytes; it shows at 0 and at 0x0800_0000.
const FLASH_BYTES: u32 = 512 * 1024;
/// The address bit in which both views of flash differ.
const VIEW: u32 = 0x0800_0000;

/// An instruction with what the core needs to know before it executes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decoded {
    pub instruction: Instruction,
    pub timing: Timing,
    /// Length: 2 or 4, or 0 for "not decoded yet".
    pub bytes: u8,
}

/// Decoded instructions: one entry per halfword of flash; and one per halfword of 32 KiB for code elsewhere, with the bits it
/// was decoded from, as RAM can change.
#[derive(Clone, Debug)]
pub(super) struct Code {
    decoded: Vec<Decoded>,
    elsewhere: Vec<(u32, Decoded)>,
}

impl Default for Code {
    fn default() -> Self {
        let instruction = Instruction::Undefined;
        let none = Decoded { instruction, timing: timing(&instruction), bytes: 0 };
        Self { decoded: vec![none; FLASH_BYTES as usize / 2], elsewhere: vec![(0, none); CCM_BYTES / 2] }
    }
}

impl Code {
    /// The instruction at `address`, if it has been decoded.
    #[inline(always)]
    pub fn get(&self, address: u32) -> Option<Decoded> {
        let offset = address & !VIEW;
        self.decoded.get(offset as usize / 2).copied().filter(|decoded| decoded.bytes != 0)
    }

    /// Fetches and decodes the instruction at `address`, and remembers it if it is in flash.
    #[inline(never)]
    pub fn load(&mut self, board: &mut Board, address: u32) -> Result<Decoded, Fault> {
        let mut fetch = |address: u32| {
            if never_executable(address) {
                return Err(Fault::FetchNeverExecute { address });
            }
            board.fetch(address).map_err(|_| Fault::FetchBus { address })
        };
        let first = fetch(address)?;
        let (second, bytes) = if is_wide(first) { (fetch(address.wrapping_add(2))?, 4) } else { (0, 2) };
        let bits = u32::from(first) << 16 | u32::from(second);
        let (known_bits, known) = &mut self.elsewhere[address as usize / 2 % (CCM_BYTES / 2)];
        if (*known_bits, known.bytes) != (bits, bytes) {
            let instruction = decode(first, second);
            (*known_bits, *known) = (bits, Decoded { instruction, timing: timing(&instruction), bytes });
        }
        if let Some(slot) = self.decoded.get_mut((address & !VIEW) as usize / 2) {
            *slot = *known;
        }
        Ok(*known)
    }
}

/// Regions of the system address map without code (DDI0403, B3.1).
fn never_executable(address: u32) -> bool {
    matches!(address, 0x4000_0000..0x6000_0000 | 0xa000_0000..)
}

const _: () = assert!(size_of::<Decoded>() <= 20, "decoded flash takes 5 MB and no more");

/// Refill of the pipeline after a taken branch, "P" of the manual: 1 to 3 by alignment and width of the target.
pub(super) const REFILL: u32 = 2;
/// Exception entry without wait states, up to the first instruction of the handler.
pub(super) const ENTRY: u32 = 12;
pub(super) const RETURN: u32 = 10;
/// From the return of one exception straight into the next.
pub(super) const TAIL_CHAIN: u32 = 6;
/// Stacking or unstacking of S0–S15 and FPSCR: one word a cycle.
pub(super) const FLOAT_FRAME: u32 = 17;

/// What the timing of an instruction depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timing {
    /// Cycles without branch, wait states and operand-dependent parts.
    pub cycles: u8,
    /// Registers whose recent load would forbid this access to overlap the one before it; all for instructions
    /// that never overlap.
    pub needs: u16,
    /// Registers that are not ready for the address of the next access; all when it cannot overlap.
    pub busy: u16,
}

/// No overlap with neighbours.
const NONE: u16 = 0xffff;

/// The fixed part of the timing of `instruction`.
pub(super) fn timing(instruction: &Instruction) -> Timing {
    let alone = |cycles| Timing { cycles, needs: NONE, busy: NONE };
    match *instruction {
        Instruction::Load { rt, address, .. } => {
            Timing { cycles: 2, needs: address_registers(address), busy: rt.bit() }
        }
        // The address of a store with an immediate offset is made in its only cycle.
        Instruction::Store { address: Address::Register { rn, rm, .. }, .. } => {
            Timing { cycles: 2, needs: rn.bit() | rm.bit(), busy: 0 }
        }
        Instruction::Store { .. } => Timing { cycles: 1, needs: NONE, busy: 0 },
        Instruction::MoveFloat { is_load: true, count: 1, address: Address::Offset { rn, .. }, .. } => {
            Timing { cycles: 2, needs: rn.bit(), busy: 0 }
        }
        Instruction::MoveFloat { count, .. } => alone(1 + count),
        Instruction::MoveMultiple { registers, .. } => alone(1 + registers.count_ones() as u8),
        Instruction::MovePair { .. } => alone(3),
        Instruction::LoadExclusive { .. } | Instruction::StoreExclusive { .. } => alone(2),
        Instruction::TableBranch { .. } => alone(2),
        Instruction::Registers { op: RegisterOp::UnsignedDivide | RegisterOp::SignedDivide, .. } => alone(2),
        Instruction::Float(float) => float_timing(float),
        _ => alone(1),
    }
}

fn address_registers(address: Address) -> u16 {
    match address {
        Address::Offset { rn, .. } | Address::PreIndexed { rn, .. } | Address::PostIndexed { rn, .. } => rn.bit(),
        Address::Register { rn, rm, .. } => rn.bit() | rm.bit(),
    }
}

fn float_timing(float: FloatInstruction) -> Timing {
    let alone = |cycles| Timing { cycles, needs: NONE, busy: NONE };
    match float {
        FloatInstruction::Arithmetic { op: FloatOp::Div, .. }
        | FloatInstruction::Unary { op: FloatUnaryOp::Sqrt, .. } => alone(14),
        FloatInstruction::MoveCore { rt2: Some(_), .. } => alone(2),
        _ => alone(1),
    }
}

/// Cycles of a division beyond the first two: 0 to 10. The manual gives only the range and that it depends on
/// the leading bits; here it is linear in the number of quotient bits.
pub(super) fn division(dividend: u32, divisor: u32) -> u32 {
    let quotient_bits = (divisor.leading_zeros() + 1).saturating_sub(dividend.leading_zeros());
    if divisor == 0 { 0 } else { (quotient_bits * 10).div_ceil(32) }
}

/// Lines of the flash accelerator's caches: 32 of instructions and 8 of data, 32 bytes each (RM0440, "Adaptive
/// real-time memory accelerator").
///
/// Simplified: the caches are direct-mapped and always enabled, and a missed line costs the wait states of one
/// flash access (the rest of the line is taken as prefetched).
#[derive(Clone, Debug)]
pub(super) struct Accelerator {
    current: u32,
    instructions: [u32; 32],
    data: [u32; 8],
}

/// A line number no address has.
const NO_LINE: u32 = u32::MAX;

impl Default for Accelerator {
    fn default() -> Self {
        Self { current: NO_LINE, instructions: [NO_LINE; 32], data: [NO_LINE; 8] }
    }
}

impl Accelerator {
    /// Whether an instruction at `address` has to be waited for. Only those in flash pass through the caches.
    #[inline(always)]
    pub fn misses_instruction(&mut self, address: u32) -> bool {
        let line = address >> 5;
        line != self.current && self.enter_line(line)
    }

    fn enter_line(&mut self, line: u32) -> bool {
        self.current = line;
        if !is_flash(line) {
            return false;
        }
        let slot = &mut self.instructions[line as usize % 32];
        std::mem::replace(slot, line) != line
    }

    pub fn misses_data(&mut self, address: u32) -> bool {
        let line = address >> 5;
        if !is_flash(line) {
            return false;
        }
        let slot = &mut self.data[line as usize % 8];
        std::mem::replace(slot, line) != line
    }
}

/// Whether a line lies in flash: below CCM SRAM.
fn is_flash(line: u32) -> bool {
    line < CCM_BASE >> 5
}

/// Registers loaded by [`Timing::busy`] at the start: nothing overlaps.
pub(super) const NOTHING_IN_FLIGHT: u16 = NONE;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_entries() {
        let cycles = |first, second| timing(&decode(first, second)).cycles;
        assert_eq!(cycles(0x1840, 0), 1); // adds r0, r0, r1
        assert_eq!(cycles(0x6808, 0), 2); // ldr r0, [r1]
        assert_eq!(cycles(0x6008, 0), 1); // str r0, [r1]
        assert_eq!(cycles(0xb5f0, 0), 6); // push {r4-r7, lr}
        assert_eq!(cycles(0xe9d1, 0x0200), 3); // ldrd r0, r2, [r1]
        assert_eq!(cycles(0xee80, 0x0a20), 14); // vdiv.f32 s0, s0, s1
        assert_eq!(cycles(0xecbd, 0x8a10), 17); // vpop {s16-s31}
    }

    #[test]
    fn division_is_quick_when_the_quotient_is_short() {
        assert_eq!(division(7, 5), 1);
        assert_eq!(division(1, 0xffff), 0);
        assert_eq!(division(u32::MAX, 1), 10);
    }

    #[test]
    fn code_in_ccm_sram_is_not_waited_for_and_leaves_the_caches_alone() {
        let mut accelerator = Accelerator::default();
        assert!(accelerator.misses_instruction(0x0800_0000) && accelerator.misses_data(0x0800_0000));
        assert!(!accelerator.misses_instruction(CCM_BASE) && !accelerator.misses_data(CCM_BASE));
        assert!(!accelerator.misses_instruction(0x0800_0000) && !accelerator.misses_data(0x0800_0000));
    }
}

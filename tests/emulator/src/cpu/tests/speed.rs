//! How fast the core is on this computer.

use std::time::Instant;

use super::*;

/// A loop of 24 instructions in the mix of compiled firmware: loads and stores (a third), integer arithmetic,
/// an IT block, five floating-point operations, push and pop, one branch.
const MIX: [u16; 38] = [
    0xf850, 0x3022, // ldr.w r3, [r0, r2, lsl #2]
    0x6844, // ldr r4, [r0, #4]
    0x191d, // adds r5, r3, r4
    0xea85, 0x05c2, // eor.w r5, r5, r2, lsl #3
    0x6085, // str r5, [r0, #8]
    0xfba5, 0x6703, // umull r6, r7, r5, r3
    0xe9d0, 0x8904, // ldrd r8, r9, [r0, #16]
    0x42be, // cmp r6, r7
    0xbf88, // it hi
    0x463e, // movhi r6, r7
    0xed90, 0x0a08, // vldr s0, [r0, #32]
    0xedd0, 0x0a09, // vldr s1, [r0, #36]
    0xee20, 0x1a20, // vmul.f32 s2, s0, s1
    0xeee0, 0x1a01, // vfma.f32 s3, s0, s2
    0xee31, 0x2a00, // vadd.f32 s4, s2, s0
    0xed80, 0x2a0a, // vstr s4, [r0, #40]
    0xf3c5, 0x1a07, // ubfx r10, r5, #4, #8
    0xf880, 0xa00c, // strb.w r10, [r0, #12]
    0xb570, // push {r4, r5, r6, lr}
    0xe8bd, 0x4070, // pop.w {r4, r5, r6, lr}
    0x1c52, // adds r2, r2, #1
    0xf002, 0x0207, // and r2, r2, #7
    0x1e49, // subs r1, r1, #1
    0xd1d9, // bne to the start
];

/// Prints the rate; run with `--release -- --ignored --nocapture speed`.
#[test]
#[ignore = "a measurement"]
fn speed() {
    let mut board = Board::new(&MIX).with_float();
    board.set(0, RAM);
    board.set(1, 4_000_000);
    board.store(RAM + 32, 0x3f81_2345);
    board.store(RAM + 36, 0x3f7e_dcba);
    let (start, mut cycles) = (Instant::now(), 0u64);
    while board.r1() != 0 {
        match board.step() {
            Step::Ran { cycles: more } => cycles += u64::from(more),
            other => panic!("{other:?}"),
        }
    }
    let (instructions, seconds) = (board.cpu.instructions(), start.elapsed().as_secs_f64());
    println!(
        "{instructions} instructions ({:.2} cycles each) in {seconds:.2} s: {:.1} million a second",
        cycles as f64 / instructions as f64,
        instructions as f64 / seconds / 1e6
    );
    assert!(instructions > 90_000_000);
}

impl Board {
    fn r1(&self) -> u32 {
        self.cpu.registers.r[1]
    }
}

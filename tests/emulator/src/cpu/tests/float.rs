//! The floating-point unit as programs see it; the arithmetic has its own tests.

use super::*;

const ONE: u32 = 0x3f80_0000;
/// vadd.f32 s2, s0, s1
const VADD: [u16; 2] = [0xee30, 0x1a20];
/// vcmp.f32 s0, s1; vmrs APSR_nzcv, fpscr
const COMPARE: [u16; 4] = [0xeeb4, 0x0a60, 0xeef1, 0xfa10];

fn with_operands(program: &[u16], s0: u32, s1: u32) -> Board {
    let mut board = Board::new(program).with_float();
    (board.cpu.float.s[0], board.cpu.float.s[1]) = (s0, s1);
    board
}

#[test]
fn disabled_unit_is_a_usage_fault() {
    let mut board = Board::new(&VADD);
    board.run(1);
    assert_eq!(board.fault(), Some(Fault::NoCoprocessor));
    assert_eq!(board.cpu.exception(), 3, "escalated: UsageFault is not enabled");
}

#[test]
fn use_makes_the_registers_part_of_the_context() {
    let mut board = with_operands(&VADD, ONE, ONE);
    assert!(!board.cpu.registers.float_active);
    board.run(1);
    assert!(board.cpu.registers.float_active);
    assert_eq!(board.cpu.state().s[2], 0x4000_0000);
}

#[test]
fn comparison_reaches_the_flags() {
    let compare = |s0, s1| {
        let mut board = with_operands(&COMPARE, s0, s1);
        board.run(2);
        board.nzcv()
    };
    assert_eq!(compare(ONE, ONE), 0b0110);
    assert_eq!(compare(0, 0x8000_0000), 0b0110);
    assert_eq!(compare(ONE, 0x4000_0000), 0b1000);
    assert_eq!(compare(0x4000_0000, 0xbf80_0000), 0b0010);
    assert_eq!(compare(ONE, 0x7fc0_0000), 0b0011);
}

#[test]
fn a_result_used_at_once_costs_a_cycle() {
    // vadd s2, s0, s1; vadd s4, s2, s2; vadd s2, s0, s1
    let mut board = with_operands(&[0xee30, 0x1a20, 0xee31, 0x2a01, 0xee30, 0x1a20], ONE, ONE);
    assert_eq!([board.run(1), board.run(1), board.run(1)], [1, 2, 1]);
}

#[test]
fn modes_that_are_not_modelled_are_faults() {
    // vmsr fpscr, r1; vadd s2, s0, s1
    let program = [0xeee1, 0x1a10, VADD[0], VADD[1]];
    for fpscr in [0x9f, 1 << 22, 1 << 24, 1 << 25, 1 << 26] {
        let mut board = with_operands(&program, ONE, ONE);
        board.set(1, fpscr);
        board.run(1);
        assert_eq!(board.fault(), (fpscr != 0x9f).then_some(Fault::FloatMode { fpscr }));
    }
}

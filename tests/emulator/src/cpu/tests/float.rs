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
fn host_arithmetic_and_the_rule_agree() {
    use crate::cpu::instruction::FloatOp;
    let ops = [FloatOp::Add, FloatOp::Sub, FloatOp::Mul, FloatOp::Div, FloatOp::Mla, FloatOp::Fma, FloatOp::Fnms];
    let mut random = 1u64;
    let mut next = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 32) as u32
    };
    let mut host = crate::cpu::float::FloatUnit::new();
    for n in 0..20_000 {
        // Exponents close enough together for sums that round, and now and then any.
        let mut operand = || if n % 4 == 0 { next() } else { next() & 0x87ff_ffff | 0x3800_0000 };
        let (d, n_, m) = (operand(), operand(), operand());
        for op in ops {
            let mut rule = crate::cpu::float::FloatUnit::new();
            host.set_fpscr(1 << 4); // inexact already: the host may be used
            rule.set_fpscr(0);
            assert_eq!(
                host.arithmetic(op, d, n_, m),
                rule.arithmetic(op, d, n_, m),
                "{op:?} of {d:08x} {n_:08x} {m:08x}"
            );
            assert_eq!(host.fpscr(), rule.fpscr() | 1 << 4, "{op:?} of {d:08x} {n_:08x} {m:08x}");
        }
    }
}

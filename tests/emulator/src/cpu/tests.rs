//! Programs of a few halfwords on the whole core: what it takes of time, by its manual, and what it refuses. What instructions
//! compute is judged by `oracle/run`, and by poses that are a host's bit for bit; what exceptions do, by the image, which
//! lives by them.

use super::{Cpu, Fault, Size, Step};
use crate::board::Board;
use crate::memory::{FLASH_BASE, FlashArray};
use crate::st::FLASH;

/// Where the programs stand; a handler stands at `HANDLERS + 64 · exception number`.
const PROGRAM: u32 = 0x0800_0200;
const HANDLERS: u32 = 0x0800_1000;
const STACK: u32 = 0x2000_0800;
const RAM: u32 = 0x2000_0000;
const FLASH_ACR: u32 = FLASH::R_BASE + FLASH::ACR;

/// A core on a dark board.
struct Bench {
    cpu: Cpu,
    board: Board,
}

impl Bench {
    /// A core reset into `program`; every handler is `BX LR`.
    fn new(program: &[u16]) -> Self {
        Self::with_handler(program, 0, &[])
    }

    /// The same with another handler of `exception`.
    fn with_handler(program: &[u16], exception: u32, handler: &[u16]) -> Self {
        let mut flash = FlashArray::erased();
        let mut place = |address: u32, bytes: &[u8]| flash.load((address - FLASH_BASE) as usize, bytes);
        let code = |code: &[u16]| code.iter().flat_map(|half| half.to_le_bytes()).collect::<Vec<_>>();
        place(FLASH_BASE, &STACK.to_le_bytes());
        place(FLASH_BASE + 4, &(PROGRAM | 1).to_le_bytes());
        for number in 2..48 {
            place(FLASH_BASE + 4 * number, &((HANDLERS + 64 * number) | 1).to_le_bytes());
            place(HANDLERS + 64 * number, &code(if number == exception { handler } else { &[0x4770] }));
        }
        place(PROGRAM, &code(program));
        let mut bench = Self { cpu: Cpu::default(), board: Board::new(flash, None) };
        bench.cpu.reset(&mut bench.board);
        bench
    }

    fn with_float(mut self) -> Self {
        self.cpu.system.cpacr = 0xf << 20;
        self
    }

    fn store(&mut self, address: u32, word: u32) {
        self.board.write(address, Size::Word, word).unwrap();
    }

    fn set(&mut self, number: usize, value: u32) {
        let mut state = self.cpu.state();
        state.r[number] = value;
        self.cpu.set_state(&state);
    }

    fn step(&mut self) -> Step {
        self.cpu.step(&mut self.board)
    }

    /// Takes `steps` steps and returns their cycles.
    fn run(&mut self, steps: usize) -> u32 {
        (0..steps)
            .map(|_| match self.step() {
                Step::Ran { cycles } => cycles,
                other => panic!("{other:?}"),
            })
            .sum()
    }

    /// Takes interrupt 0, number 16; gives the cycles.
    fn interrupt(&mut self) -> u32 {
        self.cpu.nvic.enabled |= 1 << 16;
        self.cpu.set_lines(&[1, 0, 0, 0]);
        let cycles = self.run(1);
        self.cpu.set_lines(&[0; 4]);
        cycles
    }

    fn fault(&self) -> Option<Fault> {
        self.cpu.last_fault().map(|report| report.fault)
    }
}

/// A board with R0–R4 set, after one step of `program` for each of `steps`.
fn after(program: &[u16], registers: [u32; 5], steps: usize) -> Bench {
    let mut board = Bench::new(program);
    for (number, value) in registers.into_iter().enumerate() {
        board.set(number, value);
    }
    board.run(steps);
    board
}

#[test]
fn neighbouring_loads_overlap_unless_one_needs_the_other() {
    // ldr r0, [r1]; ldr r2, [r1]; ldr r3, [r2]
    let mut board = after(&[0x6808, 0x680a, 0x6813], [0, RAM, 0, 0, 0], 0);
    board.store(RAM, RAM + 4);
    assert_eq!([board.run(1), board.run(1), board.run(1)], [2, 1, 2]);
}

#[test]
fn flash_lines_are_waited_for_once() {
    let mut board = Bench::new(&[0xbf00, 0xe7fd]); // nop; b back
    board.store(FLASH_ACR, 4);
    assert_eq!([board.run(2), board.run(2)], [8, 4]);
}

const ONE: u32 = 0x3f80_0000;
/// vadd.f32 s2, s0, s1
const VADD: [u16; 2] = [0xee30, 0x1a20];

fn with_operands(program: &[u16], s0: u32, s1: u32) -> Bench {
    let mut board = Bench::new(program).with_float();
    (board.cpu.float.s[0], board.cpu.float.s[1]) = (s0, s1);
    board
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

#[test]
fn unprivileged_code_and_the_process_stack_are_not_modelled() {
    for control in [1, 2] {
        let board = after(&[0xf380, 0x8814], [control, 0, 0, 0, 0], 1); // msr control, r0
        assert_eq!(board.fault(), Some(Fault::Undefined { first: 0xf380, second: 0x8814 }));
    }
}

#[test]
fn lazy_stacking_is_paid_on_first_use() {
    // nop; the handler: vmov.f32 s0, s1; bx lr.
    let mut board = Bench::with_handler(&[0xbf00], 16, &[0xeeb0, 0x0a60, 0x4770]).with_float();
    board.cpu.registers.float_active = true;
    assert_eq!([board.interrupt(), board.run(1), board.run(1)], [12, 1 + 17, 1 + 10 + 17]);
    let mut board = Bench::new(&[0xbf00]).with_float();
    board.cpu.registers.float_active = true;
    assert_eq!([board.interrupt(), board.run(1)], [12, 11]);
}

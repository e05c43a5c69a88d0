//! Programs of a few halfwords on the whole core, with results worked out by hand from the ARMv7-M ARM.

mod exceptions;

use super::{Bus, BusFault, Cpu, Fault, Size, Step};

/// Where the programs stand; a handler stands at `HANDLERS + 64 · exception number`.
const PROGRAM: u32 = 0x0800_0200;
const HANDLERS: u32 = 0x0800_1000;
const STACK: u32 = 0x2000_0800;
const RAM: u32 = 0x2000_0000;

/// 8 KB of flash, seen twice, and 4 KB of RAM.
struct Memory {
    flash: Vec<u8>,
    ram: Vec<u8>,
    flash_wait_states: u32,
}

impl Memory {
    fn bytes(&mut self, address: u32, size: Size) -> Result<&mut [u8], BusFault> {
        let (memory, start) = match address {
            0x0000_0000..0x1000_0000 => (&mut self.flash, address & !0x0800_0000),
            _ => (&mut self.ram, address.wrapping_sub(RAM)),
        };
        memory.get_mut(start as usize..).and_then(|rest| rest.get_mut(..size.bytes() as usize)).ok_or(BusFault)
    }
}

impl Bus for Memory {
    fn fetch(&mut self, address: u32) -> Result<u16, BusFault> {
        self.read(address, Size::Half).map(|half| half as u16)
    }

    fn read(&mut self, address: u32, size: Size) -> Result<u32, BusFault> {
        assert_eq!(address % size.bytes(), 0, "accesses are aligned");
        Ok(self.bytes(address, size)?.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte)))
    }

    fn write(&mut self, address: u32, size: Size, value: u32) -> Result<(), BusFault> {
        assert_eq!(address % size.bytes(), 0, "accesses are aligned");
        let bytes = self.bytes(address, size)?;
        bytes.copy_from_slice(&value.to_le_bytes()[..bytes.len()]);
        Ok(())
    }

    fn wait_states(&self, address: u32) -> u32 {
        if address < RAM { self.flash_wait_states } else { 0 }
    }
}

struct Board {
    cpu: Cpu,
    memory: Memory,
}

impl Board {
    /// A board reset into `program`; every handler is `BX LR`.
    fn new(program: &[u16]) -> Self {
        let memory = Memory { flash: vec![0; 0x2000], ram: vec![0; 0x1000], flash_wait_states: 0 };
        let mut board = Self { cpu: Cpu::new(), memory };
        board.store(0x0800_0000, STACK);
        board.store(0x0800_0004, PROGRAM | 1);
        for exception in 2..48 {
            board.store(0x0800_0000 + 4 * exception, (HANDLERS + 64 * exception) | 1);
            board = board.with_handler(exception, &[0x4770]);
        }
        board.place(PROGRAM, program);
        board.cpu.reset(&mut board.memory);
        board
    }

    fn with_handler(mut self, exception: u32, code: &[u16]) -> Self {
        self.place(HANDLERS + 64 * exception, code);
        self
    }

    fn with_float(mut self) -> Self {
        self.cpu.system.cpacr = 0xf << 20;
        self
    }

    fn place(&mut self, address: u32, code: &[u16]) {
        for (n, &half) in code.iter().enumerate() {
            self.memory.write(address + 2 * n as u32, Size::Half, half.into()).unwrap();
        }
    }

    fn store(&mut self, address: u32, word: u32) {
        self.memory.write(address, Size::Word, word).unwrap();
    }

    fn word(&mut self, address: u32) -> u32 {
        self.memory.read(address, Size::Word).unwrap()
    }

    fn set(&mut self, number: usize, value: u32) {
        let mut state = self.cpu.state();
        state.r[number] = value;
        self.cpu.set_state(&state);
    }

    fn r(&self, number: usize) -> u32 {
        self.cpu.state().r[number]
    }

    /// N, Z, C, V as the bits of a number.
    fn nzcv(&self) -> u32 {
        self.cpu.state().xpsr >> 28
    }

    fn step(&mut self) -> Step {
        self.cpu.step(&mut self.memory)
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

    fn fault(&self) -> Option<Fault> {
        self.cpu.last_fault().map(|report| report.fault)
    }
}

/// A board with R0–R4 set, after one step of `program` for each of `steps`.
fn after(program: &[u16], registers: [u32; 5], steps: usize) -> Board {
    let mut board = Board::new(program);
    for (number, value) in registers.into_iter().enumerate() {
        board.set(number, value);
    }
    board.run(steps);
    board
}

#[test]
fn additions_and_their_flags() {
    let run = |code: u16, r1, r2| {
        let board = after(&[code], [0, r1, r2, 0, 0], 1);
        (board.r(0), board.nzcv())
    };
    assert_eq!(run(0x1888, 1, 2), (3, 0b0000)); // adds r0, r1, r2
    assert_eq!(run(0x1888, 0xffff_ffff, 1), (0, 0b0110));
    assert_eq!(run(0x1888, 0x7fff_ffff, 1), (0x8000_0000, 0b1001));
    assert_eq!(run(0x1a88, 5, 5), (0, 0b0110)); // subs r0, r1, r2
    assert_eq!(run(0x1a88, 5, 6), (0xffff_ffff, 0b1000));
    assert_eq!(run(0x1a88, 0x8000_0000, 1), (0x7fff_ffff, 0b0011));
    assert_eq!(run(0x4248, 0x8000_0000, 0), (0x8000_0000, 0b1001)); // rsbs r0, r1, #0
}

#[test]
fn carry_chains() {
    // adds r0, r1, r2; adcs r3, r4: 0x1_0000_0000 in two words.
    let board = after(&[0x1888, 0x4163], [0, 0xffff_ffff, 1, 7, 8], 2);
    assert_eq!((board.r(0), board.r(3), board.nzcv()), (0, 16, 0b0000));
    // subs r0, r1, r2; sbcs r3, r4: a borrow.
    let board = after(&[0x1a88, 0x41a3], [0, 0, 1, 8, 7], 2);
    assert_eq!((board.r(0), board.r(3), board.nzcv()), (0xffff_ffff, 0, 0b0110));
}

#[test]
fn shifts_in_the_instruction_and_by_register() {
    let board = after(&[0x0808], [0, 0x8000_0000, 0, 0, 0], 1); // lsrs r0, r1, #32
    assert_eq!((board.r(0), board.nzcv()), (0, 0b0110));
    let board = after(&[0x4088], [1, 0x0000_0120, 0, 0, 0], 1); // lsls r0, r1: only the low byte counts
    assert_eq!((board.r(0), board.nzcv()), (0, 0b0110));
}

#[test]
fn rotated_immediates_set_carry() {
    let board = after(&[0xf05f, 0x4000], [0; 5], 1); // movs.w r0, #0x80000000
    assert_eq!((board.r(0), board.nzcv()), (0x8000_0000, 0b1010));
}

#[test]
fn sixteen_bit_instructions_leave_flags_alone_in_an_it_block() {
    // cmp r0, r0; ite eq; moveq r1, #0; movne r2, #2: Z stays, so the second half is skipped.
    let mut board = after(&[0x4280, 0xbf0c, 0x2100, 0x2202], [0, 9, 9, 0, 0], 4);
    assert_eq!((board.r(1), board.r(2), board.nzcv()), (0, 9, 0b0110));
    assert_eq!(board.cpu.state().xpsr & 0x0600_fc00, 0, "the block is over");
    assert_eq!(board.r(15), PROGRAM + 8);
    board.place(PROGRAM + 8, &[0x2101]);
    board.run(1); // movs r1, #1 outside the block does set them
    assert_eq!(board.nzcv(), 0b0010);
}

#[test]
fn branches_link_and_return() {
    // bl +16 … bx lr
    let mut board = Board::new(&[0xf000, 0xf808]);
    board.place(PROGRAM + 20, &[0x4770]);
    assert_eq!(board.run(1), 3);
    assert_eq!((board.r(15), board.r(14)), (PROGRAM + 20, (PROGRAM + 4) | 1));
    board.run(1);
    assert_eq!(board.r(15), PROGRAM + 4);
    // tbb [pc, r0], table {1, 3}
    let board = after(&[0xe8df, 0xf000, 0x0301], [1, 0, 0, 0, 0], 1);
    assert_eq!(board.r(15), PROGRAM + 4 + 6);
}

#[test]
fn division_and_multiplication() {
    let sdiv = |x: u32, y: u32| after(&[0xfb91, 0xf0f2], [9, x, y, 0, 0], 1).r(0);
    assert_eq!(sdiv(-7i32 as u32, 2), -3i32 as u32);
    assert_eq!(sdiv(0x8000_0000, 0xffff_ffff), 0x8000_0000);
    assert_eq!(sdiv(5, 0), 0);
    // smlad r0, r1, r2, r3: 2·4 + 3·5 + 7fff_fff0 overflows, Q.
    let board = after(&[0xfb21, 0x3002], [0, 0x0003_0002, 0x0005_0004, 0x7fff_fff0, 0], 1);
    assert_eq!((board.r(0), board.cpu.state().xpsr >> 27 & 1), (0x8000_0007, 1));
}

#[test]
fn saturation_lanes_and_bit_fields() {
    let board = after(&[0xf301, 0x0007], [0, 1000, 0, 0, 0], 1); // ssat r0, #8, r1
    assert_eq!((board.r(0), board.cpu.state().xpsr >> 27 & 1), (127, 1));
    let board = after(&[0xfac1, 0xf052], [0, 0x0180_0102, 0x0101_0203, 0, 0], 1); // uqsub8 r0, r1, r2
    assert_eq!(board.r(0), 0x007f_0000);
    let board = after(&[0xf361, 0x200b], [0xffff_ffff, 0x5, 0, 0, 0], 1); // bfi r0, r1, #8, #4
    assert_eq!(board.r(0), 0xffff_f5ff);
}

#[test]
fn loads_and_stores() {
    let mut board = after(&[0xf8d1, 0x0001], [0, RAM, 0, 0, 0], 0);
    board.store(RAM, 0x4433_2211);
    board.store(RAM + 4, 0x8877_6655);
    board.run(1); // ldr.w r0, [r1, #1]
    assert_eq!(board.r(0), 0x5544_3322);
    // push {r4, lr}; pop {r4, pc}
    let mut board = after(&[0xb510, 0xbd10], [0, 0, 0, 0, 0x1234], 0);
    board.set(14, PROGRAM + 0x101);
    assert_eq!(board.run(1), 3);
    assert_eq!((board.r(13), board.word(STACK - 8), board.word(STACK - 4)), (STACK - 8, 0x1234, PROGRAM + 0x101));
    assert_eq!(board.run(1), 5);
    assert_eq!((board.r(13), board.r(15), board.cpu.min_sp()), (STACK, PROGRAM + 0x100, STACK - 8));
}

#[test]
fn exclusive_stores_need_an_open_monitor() {
    // ldrex r0, [r1]; strex r2, r0, [r1]; strex r2, r0, [r1]
    let mut board = after(&[0xe851, 0x0f00, 0xe841, 0x0200, 0xe841, 0x0200], [0, RAM, 9, 0, 0], 2);
    assert_eq!(board.r(2), 0);
    board.run(1);
    assert_eq!(board.r(2), 1);
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
    let mut board = Board::new(&[0xbf00, 0xe7fd]); // nop; b back
    board.memory.flash_wait_states = 4;
    assert_eq!([board.run(2), board.run(2)], [8, 4]);
}

#[test]
fn code_in_flash_is_decoded_once_until_told() {
    let mut board = Board::new(&[0x2001, 0xe7fd]); // movs r0, #1; b back
    board.run(2);
    board.place(PROGRAM, &[0x2002]);
    board.run(2);
    assert_eq!(board.r(0), 1);
    board.cpu.invalidate_code();
    board.run(1);
    assert_eq!(board.r(0), 2);
}

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

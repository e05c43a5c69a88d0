//! Programs of a few halfwords on the whole core, with results worked out by hand from the ARMv7-M ARM.

mod exceptions;
mod instructions;
mod system;

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

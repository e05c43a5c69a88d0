//! The emulator's half of the comparison with another processor emulator: see `oracle/run`.
//!
//! Reads one trial a line, all words in hexadecimal: R0–R15, xPSR, S0–S31, FPSCR, number of steps, code
//! halfwords separated by commas, memory as bytes. Writes the same state after the steps, and the memory.

use std::io::{BufRead, Write, stdin, stdout};

use slitpose_emulator::cpu::{Bus, BusFault, Cpu, Size, State, Step};

const CODE: u32 = 0x1000_0000;
const DATA: u32 = 0x2000_0000;

struct Memory {
    code: Vec<u16>,
    data: Vec<u8>,
}

impl Memory {
    fn data(&mut self, address: u32, size: Size) -> Result<&mut [u8], BusFault> {
        let start = address.wrapping_sub(DATA) as usize;
        self.data.get_mut(start..start.saturating_add(size.bytes() as usize)).ok_or(BusFault)
    }
}

impl Bus for Memory {
    fn fetch(&mut self, address: u32) -> Result<u16, BusFault> {
        self.code.get(address.wrapping_sub(CODE) as usize / 2).copied().ok_or(BusFault)
    }

    fn read(&mut self, address: u32, size: Size) -> Result<u32, BusFault> {
        if let Ok(code) = self.fetch(address) {
            let high = self.fetch(address.wrapping_add(2)).unwrap_or(0);
            let word = u32::from(code) | u32::from(high) << 16;
            return Ok(word >> (8 * (address & 1)) & u32::MAX >> (32 - 8 * size.bytes()));
        }
        let bytes = self.data(address, size)?;
        Ok(bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte)))
    }

    fn write(&mut self, address: u32, size: Size, value: u32) -> Result<(), BusFault> {
        let bytes = self.data(address, size)?;
        bytes.copy_from_slice(&value.to_le_bytes()[..bytes.len()]);
        Ok(())
    }
}

fn hexadecimal(word: &str) -> Result<u32, std::num::ParseIntError> {
    u32::from_str_radix(word, 16)
}

/// A core in thread mode that has enabled its floating-point unit and used it: the first use sets the modes.
fn core_with_float() -> Cpu {
    let mut cpu = Cpu::default();
    let mut memory = Memory { code: vec![0x6001, 0xeeb0, 0x0a40], data: Vec::new() }; // str r1, [r0]; vmov s0, s0
    cpu.reset(&mut memory);
    let mut state = cpu.state();
    state.r = [0; 16];
    (state.r[0], state.r[1], state.r[15]) = (0xe000_ed88, 0x00f0_0000, CODE);
    state.xpsr = 1 << 24;
    cpu.set_state(&state);
    for _ in 0..2 {
        cpu.step(&mut memory);
    }
    cpu
}

/// Runs one trial; a core that has seen a fault is replaced by a new one.
fn trial(cpu: &mut Cpu, line: &str) -> Result<String, Box<dyn std::error::Error>> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let words = fields.iter().take(51).map(|word| hexadecimal(word)).collect::<Result<Vec<u32>, _>>()?;
    let code = fields[51].split(',').map(|half| u16::from_str_radix(half, 16)).collect::<Result<_, _>>()?;
    let data = (0..fields[52].len() / 2)
        .map(|n| u8::from_str_radix(&fields[52][2 * n..2 * n + 2], 16))
        .collect::<Result<_, _>>()?;
    let mut memory = Memory { code, data };
    let mut state = State { r: [0; 16], xpsr: words[16], s: [0; 32], fpscr: words[49] };
    state.r.copy_from_slice(&words[..16]);
    state.s.copy_from_slice(&words[17..49]);
    cpu.set_state(&state);
    for _ in 0..words[50] {
        let step = cpu.step(&mut memory);
        if !matches!(step, Step::Ran { .. }) || cpu.last_fault().is_some() {
            let fault = format!("fault {:?}", cpu.last_fault());
            *cpu = core_with_float();
            return Ok(fault);
        }
    }
    let after = cpu.state();
    let words = after.r.iter().chain([&after.xpsr]).chain(&after.s).chain([&after.fpscr]);
    let words: Vec<String> = words.map(|word| format!("{word:x}")).collect();
    let data: String = memory.data.iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(format!("{} {data}", words.join(" ")))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut cpu = core_with_float();
    let mut out = stdout().lock();
    for line in stdin().lock().lines() {
        writeln!(out, "{}", trial(&mut cpu, &line?)?)?;
    }
    Ok(())
}

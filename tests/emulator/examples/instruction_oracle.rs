//! The emulator's half of the comparison with another processor emulator: see `oracle/run`.
//!
//! Reads one trial a line, all words in hexadecimal: R0–R15, xPSR, S0–S31, FPSCR, number of steps, code
//! halfwords separated by commas, memory as bytes. Writes the same state after the steps, and the memory.

use std::io::{BufRead, Write, stdin, stdout};

use slitpose_emulator::board::Board;
use slitpose_emulator::cpu::{Cpu, Size, State, Step};
use slitpose_emulator::memory::{CCM_BASE, FlashArray, RAM_BASE};

/// Where `compare.py` has code and data.
const CODE: u32 = CCM_BASE;
const DATA: u32 = RAM_BASE;

/// Puts `values` into RAM, one behind another.
fn store(board: &mut Board, base: u32, size: Size, values: &[u32]) {
    for (address, &value) in (base..).step_by(size.bytes() as usize).zip(values) {
        board.write(address, size, value).expect("RAM");
    }
}

fn hexadecimal(word: &str) -> Result<u32, std::num::ParseIntError> {
    u32::from_str_radix(word, 16)
}

/// A core in thread mode that has enabled its floating-point unit and used it: the first use sets the modes.
fn core_with_float(board: &mut Board) -> Cpu {
    let mut cpu = Cpu::default();
    store(board, CODE, Size::Half, &[0x6001, 0xeeb0, 0x0a40]); // str r1, [r0]; vmov s0, s0
    cpu.reset(board);
    let mut state = cpu.state();
    state.r = [0; 16];
    (state.r[0], state.r[1], state.r[15]) = (0xe000_ed88, 0x00f0_0000, CODE);
    state.xpsr = 1 << 24;
    cpu.set_state(&state);
    for _ in 0..2 {
        cpu.step(board);
    }
    cpu
}

/// Runs one trial; a core that has seen a fault is replaced by a new one.
fn trial(cpu: &mut Cpu, board: &mut Board, line: &str) -> Result<String, Box<dyn std::error::Error>> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let words = fields.iter().take(51).map(|word| hexadecimal(word)).collect::<Result<Vec<u32>, _>>()?;
    let code = fields[51].split(',').map(hexadecimal).collect::<Result<Vec<_>, _>>()?;
    let data_bytes = fields[52].len() / 2;
    let data = (0..data_bytes).map(|n| hexadecimal(&fields[52][2 * n..2 * n + 2])).collect::<Result<Vec<_>, _>>()?;
    store(board, CODE, Size::Half, &code);
    store(board, DATA, Size::Byte, &data);
    let mut state = State { r: [0; 16], xpsr: words[16], s: [0; 32], fpscr: words[49] };
    state.r.copy_from_slice(&words[..16]);
    state.s.copy_from_slice(&words[17..49]);
    cpu.set_state(&state);
    for _ in 0..words[50] {
        let step = cpu.step(board);
        if !matches!(step, Step::Ran { .. }) || cpu.last_fault().is_some() {
            let fault = format!("fault {:?}", cpu.last_fault());
            *cpu = core_with_float(board);
            return Ok(fault);
        }
    }
    let after = cpu.state();
    let words = after.r.iter().chain([&after.xpsr]).chain(&after.s).chain([&after.fpscr]);
    let words: Vec<String> = words.map(|word| format!("{word:x}")).collect();
    let bytes = (DATA..).take(data_bytes).map(|address| board.read(address, Size::Byte).expect("RAM"));
    let data: String = bytes.map(|byte| format!("{byte:02x}")).collect();
    Ok(format!("{} {data}", words.join(" ")))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut board = Board::new(FlashArray::erased(), None);
    let mut cpu = core_with_float(&mut board);
    let mut out = stdout().lock();
    for line in stdin().lock().lines() {
        writeln!(out, "{}", trial(&mut cpu, &mut board, &line?)?)?;
    }
    Ok(())
}

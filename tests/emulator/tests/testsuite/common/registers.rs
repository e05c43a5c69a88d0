//! Registers of the board, read as by a debugger, at the addresses of the facts table.

use slitpose_emulator::board::Board;
use slitpose_emulator::cpu::{Bus, Size};
use slitpose_emulator::facts::bits;
use slitpose_emulator::world::World;

/// The register at `offset` from `base`, both facts, and `more`.
pub fn register<W: World>(board: &mut Board<W>, base: &str, offset: &str, more: u32) -> u32 {
    read(board, bits(base) + bits(offset) + more)
}

/// The multiplexer channel `channel`, from 0: those of DMA1, then those of DMA2.
pub fn multiplexer<W: World>(board: &mut Board<W>, channel: usize) -> u32 {
    let base = bits("DMAMUX1_BASE");
    read(board, base + (bits("DMAMUX1_Channel1_BASE") - base) * channel as u32)
}

/// The channel of DMA1, from 0, that serves `request`; its multiplexer channel has the same number.
pub fn channel_of<W: World>(board: &mut Board<W>, request: &str) -> usize {
    let number = bits(&format!("LL_DMAMUX_REQ_{request}"));
    let channel = (0..8).find(|&channel| multiplexer(board, channel) == number);
    channel.unwrap_or_else(|| panic!("no channel serves {request}, {number}"))
}

fn read<W: World>(board: &mut Board<W>, address: u32) -> u32 {
    board.read(address, Size::Word).expect("it answers")
}

//! The board's wiring table (`firmware/README.md`), and the converters' inputs that follow from it and from ST's pin
//! data: from neither the image nor the emulator. Registers of the board, read as by a debugger, at the addresses of the
//! facts table.

use slitpose_emulator::board::Board;
use slitpose_emulator::cpu::{Bus, Size};
use slitpose_emulator::facts::{self, bits};
use slitpose_emulator::world::World;

const PAGE: &str = include_str!("../../../../../firmware/README.md");

#[derive(Clone, Debug)]
pub struct Wire {
    pub signal: &'static str,
    /// `PA0`.
    pub pin: &'static str,
    pub function: &'static str,
    /// Contact on the Nucleo's Morpho connectors.
    pub morpho: &'static str,
    /// Contact on its Arduino connectors; empty if there is none.
    pub arduino: &'static str,
}

impl Wire {
    /// Whether only the image that solves poses drives the pin.
    pub fn is_for_poses(&self) -> bool {
        self.function.ends_with("image with poses")
    }
}

/// All rows, those of two pins as two.
pub fn wires() -> Vec<Wire> {
    let table = PAGE.split_once("| signal | pin |").expect("the table").1;
    let rows = table.lines().skip(2).take_while(|row| row.starts_with('|'));
    let both = |cell: &'static str| cell.split(", ").collect::<Vec<_>>();
    rows.flat_map(|row| {
        let cells: Vec<&'static str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [signal, pins, function, morpho, arduino] = cells[..] else { panic!("{row}") };
        let pairs = both(pins).into_iter().zip(both(morpho));
        pairs.map(|(pin, morpho)| Wire { signal, pin, function, morpho, arduino }).collect::<Vec<_>>()
    })
    .collect()
}

/// The pin of `signal`.
pub fn pin(signal: &str) -> &'static str {
    wires().iter().find(|wire| wire.signal == signal).unwrap_or_else(|| panic!("no wire is called `{signal}`")).pin
}

/// Index of the port (0: A) and number of `pin`.
pub fn port_and_number(pin: &str) -> (u32, u32) {
    let port = pin.as_bytes()[1] - b'A';
    (port.into(), pin[2..].parse().expect("a number"))
}

/// Inputs of ADC1 and ADC2 by cell.
pub fn inputs() -> [[u8; 6]; 2] {
    let input = |electrode: usize, cell: usize| {
        let pin = pin(&format!("I_X{electrode}, cell {cell}"));
        bits(&format!("ADC{electrode}_IN_{pin}")) as u8
    };
    [1, 2].map(|electrode| std::array::from_fn(|cell| input(electrode, cell)))
}

pub fn level_line(emitter: usize) -> usize {
    let lines = ["level of emitters 0 to 2", "level of emitters 3 to 5"];
    let holds = |signal: &str| {
        let range = signal.strip_prefix("level of emitters ").and_then(|range| range.split_once(" to "));
        let (first, last) = range.expect("a range");
        (first.parse().expect("a number")..=last.parse().expect("a number")).contains(&emitter)
    };
    let line = lines.iter().position(|line| holds(line)).expect("each emitter is on a line");
    // The first line is that of DAC1.
    assert!(pin(lines[line]) == facts::fact(["DAC1_OUT1", "DAC2_OUT1"][line]).value);
    line
}

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

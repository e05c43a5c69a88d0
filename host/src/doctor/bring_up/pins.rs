//! Signals of the board, its pins and the Nucleo's connectors, for findings that send an engineer to a pin.
//!
//! The wiring table of `firmware/README.md` holds the same; a test compares both.

use std::fmt;

use slitpose_head::simulator::Electrode;

/// A pin of the microcontroller, and its place on the Morpho connectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pin {
    name: &'static str,
    morpho: &'static str,
}

const fn pin(name: &'static str, morpho: &'static str) -> Pin {
    Pin { name, morpho }
}

/// Inputs of I_X1, by cell.
const X1: [Pin; 6] = [
    pin("PA0", "CN7-28"),
    pin("PA1", "CN7-30"),
    pin("PC0", "CN7-38"),
    pin("PC1", "CN7-36"),
    pin("PC2", "CN7-35"),
    pin("PC3", "CN7-37"),
];

/// Inputs of I_X2, by cell.
const X2: [Pin; 6] = [
    pin("PA7", "CN10-15"),
    pin("PC4", "CN10-34"),
    pin("PC5", "CN10-6"),
    pin("PB2", "CN10-22"),
    pin("PB11", "CN10-18"),
    pin("PB15", "CN10-26"),
];

/// Gates, by emitter.
const GATES: [Pin; 6] = [
    pin("PC6", "CN10-4"),
    pin("PC7", "CN10-19"),
    pin("PC8", "CN10-2"),
    pin("PC9", "CN10-1"),
    pin("PC10", "CN7-1"),
    pin("PC11", "CN7-2"),
];

/// Level lines, and the emitters of each.
const LEVELS: [(Pin, std::ops::RangeInclusive<usize>); 2] =
    [(pin("PA4", "CN7-32"), 0..=2), (pin("PA6", "CN10-13"), 3..=5)];

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}", self.name, self.morpho)
    }
}

/// The two electrodes of a cell, in the order of its words.
pub(super) const ELECTRODES: [Electrode; 2] = [Electrode::X1, Electrode::X2];

/// An electrode with its pin: `I_X1 of cell 2 (PC0, CN7-38)`.
pub(super) fn electrode(cell: usize, electrode: Electrode) -> String {
    let (name, pins) = match electrode {
        Electrode::X1 => ("I_X1", X1),
        Electrode::X2 => ("I_X2", X2),
    };
    match pins.get(cell) {
        Some(pin) => format!("{name} of cell {cell} ({pin})"),
        None => format!("{name} of cell {cell}"),
    }
}

/// The gate of an emitter with its pin: `gate of emitter 4 (PC10, CN7-1)`.
pub(super) fn gate(emitter: usize) -> String {
    match GATES.get(emitter) {
        Some(pin) => format!("gate of emitter {emitter} ({pin})"),
        None => format!("gate of emitter {emitter}"),
    }
}

/// The level line of an emitter with its pin, and the other emitters of that line.
pub(super) fn level_line(emitter: usize) -> Option<(String, std::ops::RangeInclusive<usize>)> {
    let (pin, emitters) = LEVELS.into_iter().find(|(_, emitters)| emitters.contains(&emitter))?;
    let name = format!("level line of emitters {} to {} ({pin})", emitters.start(), emitters.end());
    Some((name, emitters))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of the wiring table: signal, pin, Morpho.
    fn rows() -> Vec<[&'static str; 3]> {
        let page = include_str!("../../../../firmware/README.md");
        let table = page.lines().skip_while(|line| !line.starts_with("| signal |")).skip(2);
        table
            .take_while(|line| line.starts_with('|'))
            .map(|line| {
                let fields: Vec<&str> = line.split('|').map(str::trim).collect();
                [fields[1], fields[2], fields[4]]
            })
            .collect()
    }

    #[test]
    fn pins_are_those_of_the_wiring_table() {
        let rows = rows();
        let listed = |signal: String, pin: Pin| {
            assert!(rows.contains(&[&signal, pin.name, pin.morpho]), "{signal}: {pin}, but the table has {rows:?}");
        };
        for k in 0..6 {
            listed(format!("I_X1, cell {k}"), X1[k]);
            listed(format!("I_X2, cell {k}"), X2[k]);
            listed(format!("gate, emitter {k}"), GATES[k]);
        }
        for (pin, emitters) in LEVELS {
            listed(format!("level of emitters {} to {}", emitters.start(), emitters.end()), pin);
        }
    }

    #[test]
    fn signals_beyond_the_board_are_named_without_a_pin() {
        assert_eq!(electrode(2, Electrode::X1), "I_X1 of cell 2 (PC0, CN7-38)");
        assert_eq!(electrode(6, Electrode::X2), "I_X2 of cell 6");
        assert_eq!((gate(4), gate(9)), ("gate of emitter 4 (PC10, CN7-1)".into(), "gate of emitter 9".into()));
        assert!(level_line(4).is_some_and(|(name, emitters)| name.contains("PA6") && emitters == (3..=5)));
        assert!(level_line(6).is_none());
    }
}

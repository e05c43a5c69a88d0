//! Signals of a board by name, with pin and contact if this program knows the board's wiring.
//!
//! It knows that of the Nucleo: the wiring table of `firmware/README.md` holds the same; a test compares both.

use std::fmt;

use slitpose_head::finding::Finding;
use slitpose_head::simulator::Electrode;
use slitpose_protocol::BoardKind;

use crate::device::BoardInfo;

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

/// The name in the hello of the board whose wiring is known.
const NUCLEO: &str = "NUCLEO-G474RE";

/// Whether pins of a board are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Wiring {
    /// The first board, a NUCLEO-G474RE.
    Nucleo,
    /// Another board, or a simulated one: signals have no pins.
    #[default]
    Unknown,
}

impl Wiring {
    /// The wiring of the board of that name.
    pub(super) fn of(board: &str) -> Self {
        if board == NUCLEO { Self::Nucleo } else { Self::Unknown }
    }

    /// `signal`, with the pin of its place in `pins`: `gate of emitter 4 (PC10, CN7-1)`.
    fn named(self, signal: String, pins: &[Pin], place: usize) -> String {
        match (self, pins.get(place)) {
            (Self::Nucleo, Some(pin)) => format!("{signal} ({pin})"),
            _ => signal,
        }
    }

    pub(super) fn electrode(self, cell: usize, electrode: Electrode) -> String {
        let (name, pins) = match electrode {
            Electrode::X1 => ("I_X1", X1),
            Electrode::X2 => ("I_X2", X2),
        };
        self.named(format!("{name} of cell {cell}"), &pins, cell)
    }

    pub(super) fn gate(self, emitter: usize) -> String {
        self.named(format!("gate of emitter {emitter}"), &GATES, emitter)
    }

    /// The level line of an emitter, and all emitters of that line; `None` if that is not known.
    pub(super) fn level_line(self, emitter: usize) -> Option<(String, std::ops::RangeInclusive<usize>)> {
        let (pin, emitters) = LEVELS.into_iter().find(|(_, emitters)| emitters.contains(&emitter))?;
        let name = format!("level line of emitters {} to {} ({pin})", emitters.start(), emitters.end());
        (self == Self::Nucleo).then_some((name, emitters))
    }
}

/// A warning, if signals of a real board cannot be named by their pins.
pub(super) fn unknown_board(info: &BoardInfo) -> Option<Finding> {
    let is_unknown = info.kind == BoardKind::Physical && Wiring::of(&info.board) == Wiring::Unknown;
    is_unknown.then(|| {
        Finding::warning(
            "wiring",
            format!("the pins of a board `{}` are not known; findings name signals only", info.board),
            format!("look the pins up in the wiring table of this board; the known one is {NUCLEO}"),
        )
    })
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
    fn signals_beyond_the_board_and_of_other_boards_are_named_without_a_pin() {
        let wiring = Wiring::of("NUCLEO-G474RE");
        assert_eq!(wiring.electrode(2, Electrode::X1), "I_X1 of cell 2 (PC0, CN7-38)");
        assert_eq!(wiring.electrode(6, Electrode::X2), "I_X2 of cell 6");
        assert_eq!(
            (wiring.gate(4), wiring.gate(9)),
            ("gate of emitter 4 (PC10, CN7-1)".into(), "gate of emitter 9".into())
        );
        assert!(wiring.level_line(4).is_some_and(|(name, emitters)| name.contains("PA6") && emitters == (3..=5)));
        assert!(wiring.level_line(6).is_none());
        for board in ["simulated", "NUCLEO-G491RE", "nucleo-g474re", "NUCLEO-G474RE ", ""] {
            let other = Wiring::of(board);
            let signals = [other.electrode(2, Electrode::X1), other.electrode(0, Electrode::X2), other.gate(4)];
            assert_eq!(signals, ["I_X1 of cell 2", "I_X2 of cell 0", "gate of emitter 4"], "{board}");
            assert!(other.level_line(4).is_none(), "{board}");
        }
    }

    #[test]
    fn an_unknown_board_is_named() {
        let device = crate::device::SimulatedDevice::at_rest(&slitpose_head::scene_file::WIDE.read().unwrap()).unwrap();
        let mut board = crate::device::Conversation::open(Box::new(device)).unwrap();
        let simulated = board.introduce(std::time::Duration::from_secs(1)).unwrap();
        let of = |kind, board: &str| unknown_board(&BoardInfo { kind, board: board.to_owned(), ..simulated.clone() });
        assert_eq!(of(BoardKind::Simulated, "simulated"), None);
        assert_eq!(of(BoardKind::Physical, "NUCLEO-G474RE"), None);
        let other = of(BoardKind::Physical, "SLITPOSE-2").expect("a warning").to_string();
        assert!(other.contains("`SLITPOSE-2`") && other.contains("signals only"), "{other}");
    }
}

//! Signals of a board by name, with pin and contact if this program knows the board's wiring: that of the Nucleo, from the
//! wiring table of `firmware/README.md`.

use std::ops::RangeInclusive;

use slitpose_head::finding::Finding;
use slitpose_head::simulator::Electrode;
use slitpose_protocol::BoardKind;

use crate::device::BoardInfo;

/// The page with the wiring table: signal, pin, function, place on the Morpho connectors.
const PAGE: &str = include_str!("../../../../firmware/README.md");

const LEVELS: [RangeInclusive<usize>; 2] = [0..=2, 3..=5];

/// The pin of the microcontroller for `signal`, and its place on the Morpho connectors: `PC10, CN7-1`.
fn pin(signal: &str) -> Option<String> {
    PAGE.lines().find_map(|line| {
        let fields: Vec<&str> = line.strip_prefix("| ")?.split(" | ").collect();
        match fields[..] {
            [name, pin, _, morpho, ..] if name == signal => Some(format!("{pin}, {morpho}")),
            _ => None,
        }
    })
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

    /// The pin of `signal` by the table, if the board is the one it describes.
    fn pin(self, signal: &str) -> Option<String> {
        (self == Self::Nucleo).then(|| pin(signal))?
    }

    /// `name`, with the pin of `signal` in the table: `gate of emitter 4 (PC10, CN7-1)`.
    fn named(self, name: &str, signal: &str) -> String {
        self.pin(signal).map_or(name.to_owned(), |pin| format!("{name} ({pin})"))
    }

    pub(super) fn electrode(self, cell: usize, electrode: Electrode) -> String {
        let name = match electrode {
            Electrode::X1 => "I_X1",
            Electrode::X2 => "I_X2",
        };
        self.named(&format!("{name} of cell {cell}"), &format!("{name}, cell {cell}"))
    }

    pub(super) fn gate(self, emitter: usize) -> String {
        self.named(&format!("gate of emitter {emitter}"), &format!("gate, emitter {emitter}"))
    }

    /// The level line of an emitter, and all emitters of that line; `None` if that is not known.
    pub(super) fn level_line(self, emitter: usize) -> Option<(String, RangeInclusive<usize>)> {
        let emitters = LEVELS.into_iter().find(|emitters| emitters.contains(&emitter))?;
        let line = format!("emitters {} to {}", emitters.start(), emitters.end());
        let pin = self.pin(&format!("level of {line}"))?;
        Some((format!("level line of {line} ({pin})"), emitters))
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

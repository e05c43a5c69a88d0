//! The board on the bench: connects, takes scans by a configuration, leaves the board dark; and names its signals, with
//! pin and contact if this program knows the board's wiring: that of the Nucleo, from the wiring table of the firmware.

use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use anyhow::{Error, Result, anyhow, bail};
use slitpose_firmware::pcb::pins;
use slitpose_model::{CompiledScene, Tier};
use slitpose_protocol::{
    AdcScaling, BoardKind, Configuration, Decoder, Edge, HardwareFault, MAX_MESSAGE_BYTES, Message, Pulse, Rejection,
    Schedule, Severity,
};

use super::sampling::{Expected, Sampling};
use crate::device::{BoardInfo, Contact, Conversation, Device, DeviceError, Selector, SimulatedDevice};
use crate::doctor::measurement::patience;
use slitpose_head::finding::Finding;
use slitpose_head::front_end;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Electrode, TrajectoryKind};
use slitpose_tracking::link::{Segment, Versions};

/// Scans after a start that are left out: the first may hold light of what was lit before.
const FIRST_SCANS: usize = 4;

/// Most warnings and errors of the board that are kept.
const EVENTS: usize = 3;

pub(super) struct Bench {
    pub(super) contact: Contact,
    pub(super) scene: SceneFile,
    /// Asks the user to cut the board's power; `false` if there is no one to ask.
    pub(super) cut_power: Box<dyn FnMut() -> bool>,
    /// The wiring of the board that was last connected.
    pub(super) wiring: Wiring,
}

impl Bench {
    pub(super) fn is_simulated(&self) -> bool {
        self.contact.selector == Selector::Sim
    }

    /// Opens the board's port and reads its hello.
    pub(super) fn connect(&mut self) -> Result<(Conversation, BoardInfo)> {
        let device: Box<dyn Device> = match self.is_simulated() {
            true => Box::new(SimulatedDevice::for_trials(&self.scene, TrajectoryKind::Still)?),
            false => Box::new(self.contact.open()?),
        };
        self.met(Conversation::introduced(device)?)
    }

    /// Connects to a board that may take this long to be there.
    pub(super) fn reconnect(&mut self, within: Duration) -> Result<(Conversation, BoardInfo)> {
        let back = self.contact.await_return(None, within)?;
        self.met(back)
    }

    fn met(&mut self, (board, info): (Conversation, BoardInfo)) -> Result<(Conversation, BoardInfo)> {
        self.contact.greeted(info.device);
        self.wiring = Wiring::of(&info.board);
        if info.mismatch.is_some() {
            bail!("{}: update whichever is older", Versions { board: info.protocol });
        }
        Ok((board, info))
    }

    pub(super) fn schedule(&self) -> Result<Schedule> {
        Ok(front_end::configuration(&self.scene)?.schedule)
    }

    /// What the scene predicts with the tool at home.
    pub(super) fn expected(&self) -> Result<Expected> {
        let optics = |tolerance| CompiledScene::compile(&self.scene.scene, Tier::Exact { tolerance });
        let (own, stray) = (optics(OWN_TOLERANCE)?, optics(STRAY_TOLERANCE)?);
        Ok(Expected::of(&own, &stray))
    }
}

/// Relative error of predicted light of a cell's own emitter, and of the others.
const OWN_TOLERANCE: f64 = 1e-4;
const STRAY_TOLERANCE: f64 = 1e-2;

/// Takes `count` scans by `configuration`; the board is dark afterwards.
pub(super) fn sample(board: &mut Conversation, configuration: Configuration, count: usize) -> Result<Sampling> {
    sample_with(board, configuration, Pulse::NONE, count)
}

/// As [`sample`], with pulses at the board's frame output.
pub(super) fn sample_with(
    board: &mut Conversation,
    configuration: Configuration,
    pulse: Pulse,
    count: usize,
) -> Result<Sampling> {
    let wanted = count + FIRST_SCANS;
    let patience = patience(wanted as f64 / configuration.schedule.frame_rate_hz());
    board.configure(configuration)?;
    if pulse != Pulse::NONE {
        board.pulse(pulse)?;
    }
    board.start()?;
    let begun = Instant::now();
    let mut reader = Reader::default();
    let mut segment = Segment::default();
    let mut more = true;
    loop {
        segment.clear();
        board.fill(&mut segment);
        reader.read(&segment.bytes);
        if !more || reader.scans.len() >= wanted || reader.is_stopped || begun.elapsed() > patience {
            break;
        }
        more = board.listen()?;
    }
    board.stop()?;
    let got = reader.scans.len().saturating_sub(FIRST_SCANS);
    reader.finish(count).ok_or_else(|| {
        if reader.is_stopped {
            let events = if reader.events.is_empty() { "nothing".to_owned() } else { reader.events.join("; ") };
            anyhow!("the board stopped by itself after {got} of {count} scans; it said: {events}")
        } else {
            anyhow!("{got} of {count} scans came within {:.0} s", begun.elapsed().as_secs_f64())
        }
    })
}

/// The least settling of `configuration` that the board accepts: it is asked for less, and says so.
pub(super) fn least_settling_ticks(board: &mut Conversation, configuration: &Configuration) -> Result<u32> {
    let mut trial = configuration.clone();
    trial.schedule.settling_ticks = 1;
    match board.configure(trial).map_err(Error::from) {
        Ok(()) => Ok(1),
        Err(error) => match hardware_limit(&error) {
            Some(&HardwareFault::Settling { least_ticks, .. }) => Ok(least_ticks),
            _ => Err(error),
        },
    }
}

/// Whether an error says that two emitters of one slot share a level line.
pub(super) fn is_shared_level(error: &Error) -> bool {
    matches!(hardware_limit(error), Some(HardwareFault::SharedLevel { .. }))
}

/// What the board cannot do, if it has refused a configuration for that.
fn hardware_limit(error: &Error) -> Option<&HardwareFault> {
    match error.downcast_ref() {
        Some(DeviceError::Refused { source: Rejection::Unsuited(limit), .. }) => Some(limit),
        _ => None,
    }
}

/// Reads the scans of the configuration announced last.
#[derive(Default)]
struct Reader {
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    announced: Option<(u16, Schedule, AdcScaling)>,
    scans: Vec<slitpose_protocol::RawScan>,
    edges: Vec<Edge>,
    /// The board was acquiring and says that it is idle.
    is_stopped: bool,
    events: Vec<String>,
}

impl Reader {
    fn read(&mut self, mut bytes: &[u8]) {
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            match (message, &self.announced) {
                (Ok(Message::Hello(hello)), known) => {
                    // A board says hello again when a suspended USB port goes on.
                    let is_new = known.as_ref().is_none_or(|(number, ..)| *number != hello.configuration);
                    if is_new {
                        self.announced = Some((hello.configuration, hello.schedule.clone(), hello.scaling));
                        self.scans.clear();
                    }
                }
                (Ok(Message::Batch(batch)), Some((number, schedule, _))) if batch.configuration == *number => {
                    self.scans.extend(batch.scans(schedule).into_iter().flatten());
                }
                (Ok(Message::Edges(edges)), _) => self.edges.extend(edges.edges),
                (Ok(Message::Status(status)), _) => self.is_stopped = !status.acquiring && !self.scans.is_empty(),
                (Ok(Message::Event(event)), _) if event.severity != Severity::Info && self.events.len() < EVENTS => {
                    self.events.push(event.text.to_owned());
                }
                _ => {}
            }
        }
    }

    /// The scans without the first ones; `None` if there are fewer than `count`.
    fn finish(&self, count: usize) -> Option<Sampling> {
        let (_, schedule, scaling) = self.announced.clone()?;
        let scans = self.scans.get(FIRST_SCANS..).filter(|scans| scans.len() >= count)?.to_vec();
        Some(Sampling { schedule, scaling, scans, edges: self.edges.clone() })
    }
}

// Signals.

const LEVELS: [RangeInclusive<usize>; 2] = [0..=2, 3..=5];

/// The two electrodes of a cell, in the order of its words.
pub(super) const ELECTRODES: [Electrode; 2] = [Electrode::X1, Electrode::X2];

/// The name in the hello of the board whose wiring is known.
const NUCLEO: &str = "NUCLEO-G474RE";

/// Whether pins of a board are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Wiring {
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

    /// `signal` of the wiring table, with pin and contact, `gate of emitter 4 (PC10, CN7-1)`, if the board is the one that
    /// the table describes and has it.
    fn at(self, signal: &str) -> Option<String> {
        let row = pins::rows("signal").find(|row| self == Self::Nucleo && row.name == signal)?;
        Some(format!("{signal} ({}, {})", row.pin, row.contact))
    }

    pub(super) fn named(self, signal: &str) -> String {
        self.at(signal).unwrap_or_else(|| signal.to_owned())
    }

    pub(super) fn electrode(self, cell: usize, electrode: Electrode) -> String {
        let name = match electrode {
            Electrode::X1 => "I_X1",
            Electrode::X2 => "I_X2",
        };
        self.named(&format!("{name} of cell {cell}"))
    }

    pub(super) fn gate(self, emitter: usize) -> String {
        self.named(&format!("gate of emitter {emitter}"))
    }

    /// The level line of an emitter, and all emitters of that line; `None` if that is not known.
    pub(super) fn level_line(self, emitter: usize) -> Option<(String, RangeInclusive<usize>)> {
        let emitters = LEVELS.into_iter().find(|emitters| emitters.contains(&emitter))?;
        let name = self.at(&format!("level line of emitters {} to {}", emitters.start(), emitters.end()))?;
        Some((name, emitters))
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
        let scene = slitpose_head::scene_file::WIDE.read().unwrap();
        let device = SimulatedDevice::for_trials(&scene, TrajectoryKind::Still).unwrap();
        let (_, simulated) = Conversation::introduced(Box::new(device)).unwrap();
        let of = |kind, board: &str| unknown_board(&BoardInfo { kind, board: board.to_owned(), ..simulated.clone() });
        assert_eq!(of(BoardKind::Simulated, "simulated"), None);
        assert_eq!(of(BoardKind::Physical, "NUCLEO-G474RE"), None);
        let other = of(BoardKind::Physical, "SLITPOSE-2").expect("a warning").to_string();
        assert!(other.contains("`SLITPOSE-2`") && other.contains("signals only"), "{other}");
    }
}

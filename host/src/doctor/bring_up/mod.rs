//! The bring-up of a new board: steps in the order in which they can be done on a bench.
//!
//! | file | steps |
//! |---|---|
//! | this one | continuity: contacts and solder bridges of the Nucleo, by the user's multimeter |
//! | `safety` | link and start; supply and temperature; dark after Stop and without a host; settings over a power cut; pulses of the frame output, back at the trigger input |
//! | `dark` | codes without light, emitters with their gates off; noise |
//! | `emitters` | each emitter alone; light of other emitters |
//! | `levels` | current against level; codes on the way |
//! | `settling` | the time that light takes to settle |
//!
//! Each of these files measures first and judges then: what judges is a pure function from measured numbers to
//! findings. `bench` connects the board, takes scans and names signals, `sampling` has their configurations, their statistics, and what
//! the scene predicts. A step opens the port and closes it, so that
//! between steps the board is idle without a host.

mod bench;
mod dark;
mod emitters;
mod levels;
mod safety;
mod sampling;
mod settling;

use std::fmt;
use std::str::FromStr;

use anyhow::Result;
use slitpose_firmware::pcb::pins;
use slitpose_protocol::{Level, Schedule};

use self::bench::{Bench, Wiring};
use super::default_scene;
use crate::device::Contact;
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_head::scene_file::SceneFile;

type Take = fn(&mut Bench) -> Result<Vec<Finding>>;

/// A step, as one of [`Step::ALL`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) preparation: &'static str,
    /// What is expected, with its tolerance and its origin.
    pub(crate) expectation: &'static str,
    /// `None` for what the user measures on an unpowered board.
    take: Option<Take>,
}

impl Step {
    pub(crate) const ALL: [Self; 12] = [
        Self {
            name: "continuity",
            preparation: "NUCLEO-G474RE with all cables off and nothing connected; the multimeter on continuity",
            expectation: "contacts and solder bridges as the firmware's wiring table has them (firmware/wiring.csv); \
                          conducts: below 2 ohm, open: above 1 kohm",
            take: None,
        },
        Self {
            name: "link",
            preparation: "power and data cable; detectors covered; emitters need not be connected",
            expectation: "hello in this program's protocol, frames at the scheduled rate within 5 % of the host's clock, \
                          none lost in 2 s",
            take: Some(safety::link),
        },
        Self {
            name: "supply",
            preparation: "as before; the multimeter on 3.3 V",
            expectation: "3.3 V within 5 % (regulator of the Nucleo), -40 to 85 C (data sheet, suffix 6)",
            take: Some(safety::supply),
        },
        Self {
            name: "dark",
            preparation: "all detectors connected and covered from room light; emitters, if connected, are lit",
            expectation: "each word within 10 codes of the zero code: divider 1.3, amplifiers 2.6, converter 4 \
                          (firmware/README.md, analogue front end); no light from emitters while their gates are off",
            take: Some(dark::zero),
        },
        Self {
            name: "noise",
            preparation: "as before; lids closed, no lamp and no cable moved meanwhile",
            expectation: "rms of one conversion 0.4 to 1.3 times the scene's front end, failed above 2; codes in steps of 1",
            take: Some(dark::noise),
        },
        Self {
            name: "emitters",
            preparation: "all emitters connected; the tool fixed at its home pose; head covered from room light",
            expectation: "each cell sees its own emitter, by both electrodes, at 0.6 to 1.6 times the scene's light at \
                          home (spread of such emitters)",
            take: Some(emitters::take),
        },
        Self {
            name: "levels",
            preparation: "as before; the tool must not move",
            expectation: "light in proportion to the level within 2 % of nominal, from an eighth on (below, the level \
                          buffers are not specified); no code missing or repeated on the way",
            take: Some(levels::take),
        },
        Self {
            name: "settling",
            preparation: "as before; the tool must not move",
            expectation: "settled to 0.3 codes of full scale within 1.1 times the scene's settling time \
                          (firmware/README.md, bandwidth and settling)",
            take: Some(settling::take),
        },
        Self {
            name: "crosstalk",
            preparation: "as before; baffles fitted",
            expectation: "light of another emitter below the scene's prediction plus 1 % of the cell's own: 1 % at the end \
                          of a 12 mm detector moves the spot by 60 um, the detector's own error",
            take: Some(emitters::take_crosstalk),
        },
        Self {
            name: "trigger",
            preparation: "as before; a wire from the frame output PA10 (CN10-33) to the trigger input PC12 (CN7-3), \
                          and no other signal there",
            expectation: "each pulse of the frame output comes back as two edges, the first within its slot",
            take: Some(safety::take_trigger),
        },
        Self {
            name: "safety",
            preparation: "as before; no other program opens the port",
            expectation: "idle after Stop; idle 1 s after the port was closed (serial link: 3 s)",
            take: Some(safety::take),
        },
        Self {
            name: "storage",
            preparation: "as before; be ready to unplug all cables of the board and to plug them in again",
            expectation: "schedule and hash of the scene are back after the power cut",
            take: Some(safety::take_storage),
        },
    ];

    /// Whether the user measures it, before power is applied.
    pub(crate) fn is_by_hand(&self) -> bool {
        self.take.is_none()
    }

    pub(crate) fn number(&self) -> usize {
        1 + Self::ALL.iter().take_while(|step| step.name != self.name).count()
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "step {} of {}, {}", self.number(), Self::ALL.len(), self.name)
    }
}

impl FromStr for Step {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let is_it = |step: &Self| step.name == text || step.number().to_string() == text;
        let (count, names) = (Self::ALL.len(), Self::ALL.map(|step| step.name).join(", "));
        let unknown = || format!("no step is called `{text}`; there are 1 to {count}, or {names}");
        Self::ALL.into_iter().find(is_it).ok_or_else(unknown)
    }
}

/// The continuity check of an unpowered Nucleo with a multimeter, by the wiring table: its measurements in their order. `ask` gives whether it is as the question says; `None` if there is no one to ask.
pub(crate) fn continuity(mut ask: impl FnMut(&str) -> Option<bool>) -> impl Iterator<Item = Finding> {
    pins::rows("check").map(move |check| {
        let text = format!("{}: {}", check.name, check.function);
        match ask(&text) {
            Some(true) => Finding::ok("continuity", text),
            Some(false) => Finding::failed("continuity", format!("{text}, but it is not so"), check.note),
            None => Finding::skipped("continuity", format!("{text}; if not, {}", check.note)),
        }
    })
}

pub(crate) struct BringUp {
    bench: Bench,
    /// The schedule that the board had at first.
    schedule: Schedule,
}

impl BringUp {
    /// Of the board of `contact`, with the scene `given`, else the one the board belongs to, else the default one;
    /// and what there is to say about them. `None` if the board cannot be reached, or belongs to another scene. Where
    /// `cut_power` gives `false`, the board is rebooted instead.
    pub(crate) fn begin(
        contact: Contact,
        given: Option<&SceneFile>,
        cut_power: Box<dyn FnMut() -> bool>,
        findings: &mut Vec<Finding>,
    ) -> Option<Self> {
        let mut bench =
            Bench { contact, scene: given.cloned().or_else(default_scene)?, cut_power, wiring: Wiring::default() };
        match bench.connect() {
            Ok((_, info)) => {
                findings.extend(bench::unknown_board(&info));
                bench.scene = super::link::scene(given, &info, findings)?;
                findings.push(super::link::full_scale(&bench.scene, &info));
                Some(Self { bench, schedule: info.schedule })
            }
            Err(error) => {
                let next_step = "slitpose doctor checks ports and permissions; reset the board";
                findings.push(Finding::failed("link", with_causes(error.as_ref()), next_step));
                None
            }
        }
    }

    pub(crate) fn take(&mut self, step: Step) -> Vec<Finding> {
        step.take.map_or(Ok(Vec::new()), |take| take(&mut self.bench)).unwrap_or_else(|error| {
            vec![Finding::failed(step.name, with_causes(error.as_ref()), "reset the board and take this step again")]
        })
    }

    /// Gives the board the schedule that it had at first, at nominal levels.
    pub(crate) fn restore(mut self) -> Result<(), Finding> {
        let configuration = sampling::at(self.schedule.clone(), Level::NOMINAL);
        let restored = self.bench.connect().and_then(|(mut board, _)| Ok(board.configure(configuration)?));
        restored.map_err(|error| {
            Finding::warning(
                "configuration",
                with_causes(error.as_ref()),
                "reset the board: it starts with its own configuration",
            )
        })
    }
}

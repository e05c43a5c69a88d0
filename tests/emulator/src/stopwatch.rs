//! How many cycles the pose solver takes on the board's core.
//!
//! Runs the image of [`slitpose_stopwatch`] on an emulated board that nothing surrounds, and says
//! to it what a debug probe would say to a real one.

use std::path::{Path, PathBuf};

use slitpose_model::{Effects, Photocurrents, Pose, Scene, Tier};
use slitpose_stopwatch::{Answer, MAILBOX_SYMBOL, Mailbox, Numbers, Request, SLOTS, Solved, State};
use thiserror::Error;

use crate::built;
use crate::cpu::FaultReport;
use crate::image::Image;
use crate::machine::{Machine, Stop};
use crate::memory::{FlashArray, RAM_BASE};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::profile::Profile;
use crate::rig::{OpenError, open_built, read_image};
use crate::world::World;

/// Longest time the image may take for anything. Compiling a scene in software `f64` is the longest.
const PATIENCE_TICKS: Ticks = 10 * TICKS_PER_SECOND;

/// Between two looks at the mailbox while nothing is noted.
const LOOK_TICKS: Ticks = 1_000;

/// The file that `firmware/build --stopwatch` made last.
pub fn stopwatch_image_path() -> PathBuf {
    built::image_path("slitpose-stopwatch")
}

/// Why there are no cycles to tell.
#[derive(Debug, Error)]
pub enum StopwatchError {
    /// There is no image.
    #[error("cannot read {}; make it with: firmware/build --stopwatch", path.display())]
    NoImage {
        /// Where it was looked for.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no program for the board.
    #[error(transparent)]
    Image(OpenError),
    /// It is another program.
    #[error("the image has no symbol {MAILBOX_SYMBOL}; give the one that firmware/build --stopwatch makes")]
    NoMailbox,
    /// A scene that the image cannot be told of.
    #[error("cell {cell} has effects such as a window, which the image does not compute; give a scene without them")]
    Effects {
        /// Number of the cell.
        cell: usize,
    },
    /// The board does not go on.
    #[error("the core is dead: {0}")]
    Fault(FaultReport),
    /// The program met an error of its programmer.
    #[error("the image has panicked; run the same solve on the host to see why")]
    Panicked,
    /// The program does not answer.
    #[error("the image has not answered for {seconds} s of its own time; it is at {pc:#010x}")]
    Silent {
        /// Device time waited.
        seconds: u64,
        /// Where it is.
        pc: u32,
    },
    /// The program understood, and could not.
    #[error("the image refuses: {asked}")]
    Refused {
        /// What it was asked.
        asked: &'static str,
    },
    /// The stack has run into the static variables.
    #[error("stack and variables need {bytes} bytes of RAM, and there are {room}: give the solver less to hold")]
    StackOverflow {
        /// Stack and variables.
        bytes: usize,
        /// From the start of RAM to where the stack begins.
        room: usize,
    },
}

/// A board with a solver.
#[derive(Debug)]
pub struct Stopwatch {
    machine: Machine<Nothing>,
    mailbox: u32,
    /// Where the stack begins.
    stack: u32,
    static_ram_bytes: usize,
    ccm_bytes: usize,
    profile: Option<Profile>,
}

/// A board on a table.
#[derive(Debug)]
struct Nothing;

impl World for Nothing {
    fn drive(&mut self, _: Ticks, _: u8, _: [u16; 2]) {}

    fn sample(&mut self, _: Ticks, _: u8, _: u8) -> u16 {
        0
    }
}

/// Reads the image in `path`, or what `firmware/build --stopwatch` made last.
///
/// # Errors
/// If there is none, or the one made last is older than its sources.
pub fn open_stopwatch_image(path: Option<&Path>) -> Result<Image, StopwatchError> {
    let image = match path {
        Some(path) => read_image(path),
        None => open_built(&stopwatch_image_path(), "firmware/build --stopwatch"),
    };
    image.map_err(|error| match error {
        OpenError::Read { path, source } => StopwatchError::NoImage { path, source },
        error => StopwatchError::Image(error),
    })
}

impl Stopwatch {
    /// Powers a board with `image` and has it make a solver for `scene`.
    ///
    /// # Errors
    /// If the scene has effects, or the image is another one, or cannot.
    pub fn boot(image: &Image, scene: &Scene, tier: Tier) -> Result<Self, StopwatchError> {
        if let Some(cell) = scene.cells.iter().position(|cell| cell.effects != Effects::default()) {
            return Err(StopwatchError::Effects { cell });
        }
        let (_, mailbox) =
            image.symbols().find(|(name, _)| *name == MAILBOX_SYMBOL).ok_or(StopwatchError::NoMailbox)?;
        let mut flash = FlashArray::erased();
        image.load_into(&mut flash);
        let stack = flash.stack_start();
        let mut stopwatch = Self {
            machine: Machine::new(flash, Nothing),
            mailbox: mailbox.address,
            stack,
            static_ram_bytes: image.static_ram_bytes(),
            ccm_bytes: image.ccm_bytes(),
            profile: None,
        };
        stopwatch.wait()?;
        for request in Request::of_scene(scene).chain([Request::Compile(tier)]) {
            if stopwatch.ask(&request)? != Answer::Done {
                return Err(StopwatchError::Refused { asked: "to compile the scene" });
            }
        }
        Ok(stopwatch)
    }

    /// From now on notes where the cycles of the solves go.
    pub fn start_profile(&mut self) {
        self.profile = Some(Profile::default());
    }

    /// Where the cycles have gone since [`Self::start_profile`].
    pub fn take_profile(&mut self) -> Option<Profile> {
        self.profile.take()
    }

    /// One timed solve: near `prior` if there is one, else from nothing.
    ///
    /// # Errors
    /// If the board does not answer.
    pub fn solve(&mut self, readings: &Photocurrents, prior: Option<&Pose>) -> Result<Solved, StopwatchError> {
        match self.ask(&Request::Solve(readings.clone(), prior.copied()))? {
            Answer::Solved(solved) => Ok(solved),
            _ => Err(StopwatchError::Refused { asked: "to solve" }),
        }
    }

    /// RAM that solver and scene need, in bytes: the stack where it was deepest, variables, and code
    /// in CCM SRAM. A board has [`RAM_BYTES`](crate::memory::RAM_BYTES).
    pub fn ram_bytes(&self) -> usize {
        self.stack_and_variables() + self.ccm_bytes
    }

    /// Of these the code in CCM SRAM.
    pub fn ccm_bytes(&self) -> usize {
        self.ccm_bytes
    }

    fn stack_and_variables(&self) -> usize {
        self.stack.saturating_sub(self.machine.cpu.min_sp()) as usize + self.static_ram_bytes
    }

    fn ask(&mut self, request: &Request) -> Result<Answer, StopwatchError> {
        let numbers = request.write();
        self.set_word(Mailbox::COUNT_OFFSET, numbers.len() as u32);
        for (index, number) in (0..).zip(numbers.iter()) {
            let bits = number.to_bits();
            self.set_word(Mailbox::NUMBERS_OFFSET + 8 * index, bits as u32);
            self.set_word(Mailbox::NUMBERS_OFFSET + 8 * index + 4, (bits >> 32) as u32);
        }
        self.set_word(0, State::Asked.word());
        self.wait()?;
        let count = self.word(Mailbox::COUNT_OFFSET).min(SLOTS as u32);
        let numbers: Numbers = (0..count)
            .map(|index| {
                let [low, high] = [0, 4].map(|half| u64::from(self.word(Mailbox::NUMBERS_OFFSET + 8 * index + half)));
                f64::from_bits(low | high << 32)
            })
            .collect();
        Answer::read(&numbers).ok_or(StopwatchError::Refused { asked: "anything at all" })
    }

    /// Lets the image run until it is the host's turn.
    fn wait(&mut self) -> Result<(), StopwatchError> {
        let end = self.machine.now() + PATIENCE_TICKS;
        loop {
            let state = State::of_word(self.word(0));
            let (bytes, room) = (self.stack_and_variables(), self.stack.saturating_sub(RAM_BASE) as usize);
            if bytes > room {
                return Err(StopwatchError::StackOverflow { bytes, room });
            }
            match state {
                State::Waiting => return Ok(()),
                State::Panicked => return Err(StopwatchError::Panicked),
                State::Unknown | State::Asked | State::Timing => {}
            }
            if let Some(fault) = self.machine.cpu.last_fault() {
                return Err(StopwatchError::Fault(*fault));
            }
            let now = self.machine.now();
            if now >= end {
                let seconds = PATIENCE_TICKS / TICKS_PER_SECOND;
                return Err(StopwatchError::Silent { seconds, pc: self.machine.cpu.pc() });
            }
            // A step of one tick is one instruction.
            let (pc, ticks) = (self.machine.cpu.pc(), if self.profile.is_some() { 1 } else { LOOK_TICKS });
            if let Stop::Lockup(fault) = self.machine.run_until(now + ticks) {
                return Err(StopwatchError::Fault(fault));
            }
            if let (Some(profile), State::Timing) = (&mut self.profile, state) {
                profile.add(pc, self.machine.now() - now);
            }
        }
    }

    fn word(&self, offset: u32) -> u32 {
        self.machine.board.ram_word(self.mailbox + offset).expect("the mailbox lies in RAM")
    }

    fn set_word(&mut self, offset: u32, word: u32) {
        self.machine.board.set_ram_word(self.mailbox + offset, word).expect("the mailbox lies in RAM");
    }
}

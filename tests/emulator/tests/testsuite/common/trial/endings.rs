//! What ends the light of a board, and how long it may go on then.

use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::image::Image;
use slitpose_emulator::memory::FLASH_BASE;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::Rig;
use slitpose_emulator::world::World;
use slitpose_protocol::Command;

pub const MS: Ticks = TICKS_PER_SECOND / 1_000;

/// From an event of the supply or a fault to the gates: an exception's entry, some ten instructions from flash, and
/// whatever runs with interrupts off, 250 ticks at most.
pub const AT_ONCE_TICKS: Ticks = 500;

/// What a guard waits that sees that the schedule stands still: less than two slots of the default configuration.
pub const HALTED_TICKS: Ticks = 2 * 5_800;

/// A host that is gone is waited for 500 ms (firmware/README.md, "Emitter safety"). A closed port is known after a
/// request of the bus, a pulled cable after 3 ms without frames (USB 2.0, 7.1.7.6), both at the next poll, 1 ms.
const GONE_TICKS: Ticks = 505 * MS;

/// Supply at which the voltage detector reacts, and below which the brown-out reset holds the device, in volts.
const LOW_V: f64 = 2.8;
const BROWN_OUT_V: f64 = 1.6;
/// The supply as it should be, in volts.
const FULL_V: f64 = 3.3;

/// A way in which the light ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    Stop,
    ClosedPort,
    PulledCable,
    LowSupply,
    BrownOut,
    ResetPin,
    Panic,
    Hang,
    Halt,
    DeadCrystal,
}

impl Ending {
    pub const ALL: [Self; 10] = [
        Self::Stop,
        Self::ClosedPort,
        Self::PulledCable,
        Self::LowSupply,
        Self::BrownOut,
        Self::ResetPin,
        Self::Panic,
        Self::Hang,
        Self::Halt,
        Self::DeadCrystal,
    ];

    /// Whether it can happen: a crystal that has never run cannot stop.
    pub fn is_possible(self, silicon: Faults) -> bool {
        self != Self::DeadCrystal || !silicon.has(Fault::HseDead)
    }

    /// Longest time that the light may go on.
    pub fn most_ticks(self, silicon: Faults) -> Ticks {
        match self {
            // A frame of the bus until the command is there, and a poll.
            Self::Stop if !silicon.has(Fault::UsbHost) => 2 * MS,
            // A command that is lost with its session is said again; a host that does not come back is gone.
            Self::Stop | Self::ClosedPort | Self::PulledCable => GONE_TICKS,
            Self::LowSupply if silicon.has(Fault::PvdSlow) => AT_ONCE_TICKS + MS / 10,
            Self::LowSupply | Self::Panic | Self::DeadCrystal => AT_ONCE_TICKS,
            Self::BrownOut | Self::ResetPin => 0,
            // The watchdog's 100 ms and 2 % of its clock.
            Self::Hang => 102 * MS,
            Self::Halt => HALTED_TICKS,
        }
    }

    /// Lets it happen to a board that runs `image`.
    pub fn happen<W: World>(self, rig: &mut Rig<W>, image: &Image) {
        match self {
            Self::Stop => {
                rig.send(Command::Stop);
            }
            Self::ClosedPort => rig.set_open(false),
            Self::PulledCable => rig.set_cable(false),
            Self::LowSupply => rig.machine().set_supply_v(LOW_V),
            Self::BrownOut => rig.machine().set_supply_v(BROWN_OUT_V),
            Self::ResetPin => rig.machine().pull_reset_pin(),
            Self::Panic => jump(rig, find_function(image, "panic_bounds_check")),
            Self::Hang => hang(rig),
            Self::Halt => {
                let end = rig.now() + 150 * MS;
                rig.machine().halt_until(end);
            }
            Self::DeadCrystal => rig.machine().board.stop_crystal(),
        }
    }

    /// What the host says again until the board has heard it.
    pub fn insist<W: World>(self, rig: &mut Rig<W>) {
        if self == Self::Stop {
            rig.send(Command::Stop);
        }
    }

    /// The cause is gone: supply, port and cable are as they were.
    pub fn pass<W: World>(self, rig: &mut Rig<W>) {
        rig.machine().set_supply_v(FULL_V);
        match self {
            Self::ClosedPort => rig.set_open(true),
            Self::PulledCable => rig.set_cable(true),
            _ => {}
        }
    }
}

/// Lets time pass until the core is awake in thread mode and a gate is on, so that the event that comes next finds the
/// light on.
pub fn until_lit_and_awake<W: World>(rig: &mut Rig<W>) {
    let end = rig.now() + 100 * MS;
    while rig.now() < end {
        let before = rig.machine().cpu.instructions();
        rig.run_until(rig.now() + 1);
        let cpu = &rig.machine().cpu;
        if cpu.instructions() != before && cpu.exception() == 0 && rig.machine().board.gates() != 0 {
            return;
        }
    }
    panic!("never lit and awake");
}

/// Lets the main loop end in a loop of its own, `B .`; interrupts go on.
pub fn hang<W: World>(rig: &mut Rig<W>) {
    let address = find_instruction(rig, 0xE7FE);
    jump(rig, address);
}

/// Sends the core to `address`.
pub fn jump<W: World>(rig: &mut Rig<W>, address: u32) {
    let cpu = &mut rig.machine().cpu;
    let mut state = cpu.state();
    state.r[15] = address;
    cpu.set_state(&state);
}

/// Address of an instruction `half` in the image. It is jumped to, so that where it stands does not matter.
pub fn find_instruction<W: World>(rig: &mut Rig<W>, half: u16) -> u32 {
    let code = rig.machine().board.flash_array().bytes();
    let offset = code.chunks_exact(2).position(|bytes| bytes == half.to_le_bytes());
    FLASH_BASE + 2 * offset.expect("the image has one") as u32
}

/// Address of the function whose mangled name contains `name`.
pub fn find_function(image: &Image, name: &str) -> u32 {
    let mut symbols = image.symbols().filter(|(symbol, _)| symbol.contains(name));
    symbols.next().expect("the image has it").1.address
}

/// When the gates were last lit, by the log since it was last taken, and whether they are now.
pub fn last_light<W: World>(rig: &mut Rig<W>) -> (Option<Ticks>, bool) {
    let edges = rig.machine().board.take_gate_log();
    let is_lit = rig.machine().board.gates() != 0;
    (edges.iter().rev().find(|edge| edge.gates == 0).map(|edge| edge.at), is_lit)
}

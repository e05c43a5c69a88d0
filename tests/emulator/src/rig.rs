//! A board with its image, a head in front of it and a host at its cable: what the command line
//! runs, and what tests drive.

use slitpose::scene_file::SceneFile;
use slitpose::simulator::Trajectory;
use slitpose_model::Tier;
use slitpose_protocol::{Command, MAX_REQUEST_BYTES, Request, encode};

use crate::image::Image;
use crate::machine::{Machine, Stop};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::world::{NoiseSource, OpticsWorld, WorldError};

/// Optics are evaluated to this relative error, which is far below a code of the converters.
const TOLERANCE: f64 = 1e-6;

/// The tier the world is made of.
pub const WORLD_TIER: Tier = Tier::Exact { tolerance: TOLERANCE };

/// Longest time a program may take to its first start of the device clock.
const BOOT_TICKS: Ticks = TICKS_PER_SECOND / 10;

/// A running board and what is around it.
#[derive(Debug)]
pub struct Rig {
    machine: Machine<OpticsWorld>,
    next_number: u16,
}

impl Rig {
    /// Powers a board with `image` in front of the head of `scene`, and lets it start its clock:
    /// the tool's time is that clock's.
    ///
    /// # Errors
    /// If the board cannot be connected to such a head.
    pub fn boot(
        image: &Image,
        scene: &SceneFile,
        trajectory: Trajectory,
        noise: NoiseSource,
    ) -> Result<Self, WorldError> {
        let world = OpticsWorld::new(scene, trajectory, WORLD_TIER, noise)?;
        let mut rig = Self { machine: Machine::new(image.flash(), world), next_number: 0 };
        rig.boot_until_clock();
        Ok(rig)
    }

    fn boot_until_clock(&mut self) {
        while self.machine.board().device_clock().is_none() && self.machine.now() < BOOT_TICKS {
            if self.machine.run_until(self.machine.now() + 100) != Stop::Reached {
                return;
            }
        }
        if let Some(origin) = self.machine.board().device_clock() {
            self.machine.board_mut().world.set_origin(origin);
        }
    }

    /// The board.
    pub fn machine(&mut self) -> &mut Machine<OpticsWorld> {
        &mut self.machine
    }

    /// The present, in ticks since power-on.
    pub fn now(&self) -> Ticks {
        self.machine.now()
    }

    /// Lets `seconds` of device time pass.
    pub fn run_for(&mut self, seconds: f64) -> Stop {
        let end = self.machine.now() + (seconds * TICKS_PER_SECOND as f64) as Ticks;
        self.machine.run_until(end)
    }

    /// Opens or closes the serial port at the host.
    pub fn set_open(&mut self, open: bool) {
        let now = self.machine.now();
        self.machine.board_mut().usb_host.set_dtr(open, now);
    }

    /// Sends bytes by USB.
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        let now = self.machine.now();
        self.machine.board_mut().usb_host.send(bytes, now);
    }

    /// Sends a command by USB; gives its number.
    pub fn send(&mut self, command: Command) -> u16 {
        self.next_number += 1;
        let bytes = request(self.next_number, command);
        self.send_bytes(&bytes);
        self.next_number
    }

    /// What has come by USB since the last call.
    pub fn take_bytes(&mut self) -> Vec<u8> {
        let packets = self.machine.board_mut().usb_host.take_received();
        packets.into_iter().flat_map(|packet| packet.bytes).collect()
    }

    /// What the program or its device side of USB did against their specifications; empty if
    /// all is well.
    pub fn faults(&self) -> Vec<String> {
        let board = self.machine.board();
        let effects = board.effects();
        let broken = effects.violations().iter().map(|violation| {
            format!(
                "at {} ({:#010x}): {:#010x} ← {:#010x}: {}",
                violation.at, violation.pc, violation.address, violation.value, violation.rule
            )
        });
        let unknown = effects
            .unmodelled_accesses()
            .iter()
            .map(|(address, count)| format!("register {address:#010x} is not modelled, {count} accesses"));
        let complaints = board.usb_host.complaints().iter().map(|complaint| format!("USB: {}", complaint.text));
        broken.chain(unknown).chain(complaints).collect()
    }
}

/// The bytes of a command, behind a delimiter that ends whatever came before.
pub fn request(number: u16, command: Command) -> Vec<u8> {
    let mut buffer = [0; MAX_REQUEST_BYTES];
    let packet = encode(&Request { number, command }, &mut buffer).expect("every command fits its limit");
    [&[slitpose_protocol::DELIMITER], packet].concat()
}

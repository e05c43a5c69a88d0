//! A board with its image, a head in front of it and a host at its cable: what the command line
//! runs, and what tests drive.

use std::path::Path;

use anyhow::{Context, Result};
use clap::ValueEnum;
use slitpose_firmware::pose::{HEAD_BYTES, Head};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Trajectory;
use slitpose_protocol::{Command, DELIMITER, HeadPart, MAX_REQUEST_BYTES, Request, encode};

use crate::faults::{Fault, Faults, LOW_SUPPLY_V};
use crate::image::{Image, check_sources, image_path};
use crate::machine::{Machine, Stop};
use crate::memory::FlashArray;
use crate::peripherals::uart::SentByte;
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use crate::usb_host::UsbHost;
use crate::world::{NoiseSource, World};

/// Seed of what the silicon's faults do by chance.
const SEED: u64 = 20_180_718;

/// Longest time a program may take to its first start of the device clock.
const BOOT_TICKS: Ticks = TICKS_PER_SECOND / 10;

/// Reads the image in `path`, or what `firmware/build` made last.
pub fn open_image(path: Option<&Path>) -> Result<Image> {
    path.map_or_else(|| open_built(&image_path("slitpose-board")), read_image)
}

/// Reads the image that solves poses, which `firmware/build` makes beside the default one.
pub fn open_pose_image() -> Result<Image> {
    open_built(&image_path("slitpose-board-pose"))
}

fn open_built(path: &Path) -> Result<Image> {
    let image = read_image(path)?;
    check_sources(path)?;
    Ok(image)
}

fn read_image(path: &Path) -> Result<Image> {
    let name = path.display();
    let file = std::fs::read(path).with_context(|| {
        format!("cannot read the image {name}; make it with firmware/build, or give another with --elf")
    })?;
    Image::from_elf(&file).with_context(|| format!("{name} cannot run on the board"))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Link {
    /// The controller's own USB
    Usb,
    /// The debugger's serial port
    Uart,
}

/// A running board and what is around it.
#[derive(Debug)]
pub struct Rig {
    pub machine: Machine,
    link: Link,
    next_number: u16,
    /// Where the program's stack begins.
    stack_start: u32,
}

impl Rig {
    /// Powers a board with `image` and `faults` in front of the head of `scene`, its host at its USB, and
    /// lets it start its clock: the tool's time is that clock's, and goes on if the board is
    /// reset.
    pub fn boot(
        image: &Image,
        scene: &SceneFile,
        trajectory: Trajectory,
        noise: NoiseSource,
        faults: Faults,
    ) -> Result<Self> {
        let world = World::new(scene, trajectory, noise, faults)?;
        let mut flash = FlashArray::erased();
        image.load_into(&mut flash);
        let stack_start = flash.stack_start();
        let mut rig = Self {
            machine: Machine::new(flash, Some(world)).with_faults(faults, SEED),
            link: Link::Usb,
            next_number: 0,
            stack_start,
        };
        while rig.machine.device_clock_origin().is_none() && rig.now() < BOOT_TICKS {
            if rig.machine.run_until(rig.now() + 100) != Stop::Reached {
                break;
            }
        }
        if faults.has(Fault::LowSupply) {
            rig.machine.set_supply_v(LOW_SUPPLY_V);
        }
        if faults.has(Fault::LostSettings) {
            rig.machine.board.flash.loses_settings = true;
        }
        let origin = rig.machine.device_clock_origin();
        if let (Some(world), Some(origin)) = (&mut rig.machine.board.world, origin) {
            world.set_origin(origin);
        }
        Ok(rig)
    }

    /// The same with its host at another link.
    pub fn with_link(mut self, link: Link) -> Self {
        self.link = link;
        if link == Link::Uart {
            self.set_cable(false);
        }
        self
    }

    pub fn now(&self) -> Ticks {
        self.machine.now()
    }

    /// Lets time pass until tick `end`.
    pub fn run_until(&mut self, end: Ticks) -> Stop {
        self.machine.run_until(end)
    }

    /// Lets `seconds` of device time pass.
    pub fn run_for(&mut self, seconds: f64) -> Stop {
        let end = self.now() + (seconds * TICKS_PER_SECOND as f64) as Ticks;
        self.run_until(end)
    }

    /// Lets the host at the USB cable do something now.
    pub fn host(&mut self, act: impl FnOnce(&mut UsbHost, Ticks)) {
        let board = &mut self.machine.board;
        act(&mut board.usb_host, board.effects.now);
        board.outside_changed();
    }

    /// Opens or closes the serial port at the host. A line without control signals does not notice.
    pub fn set_open(&mut self, open: bool) {
        if self.link == Link::Usb && self.machine.board.usb_host.dtr() != open {
            self.host(|host, now| host.set_dtr(open, now));
        }
    }

    /// Lets the host leave what comes where it is, or fetch it again.
    pub fn stop_reading(&mut self, stop: bool) {
        self.host(|host, now| host.stop_reading(stop, now));
    }

    /// Pulls the USB cable, or plugs it in again.
    pub fn set_cable(&mut self, plugged: bool) {
        self.host(|host, now| if plugged { host.attach(now) } else { host.detach(now) });
    }

    pub fn send_bytes(&mut self, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        let board = &mut self.machine.board;
        match self.link {
            Link::Usb => board.usb_host.send(bytes, board.effects.now),
            Link::Uart => board.lpuart.send(bytes, &board.effects),
        }
        board.outside_changed();
    }

    /// Sends a command; gives its number.
    pub fn send(&mut self, command: Command) -> u16 {
        self.next_number += 1;
        let bytes = request(self.next_number, command);
        self.send_bytes(&bytes);
        self.next_number
    }

    /// Sends a compiled head, as fast as a host that waits for each reply.
    pub fn send_head(&mut self, head: &Head) {
        let mut bytes = [0; HEAD_BYTES];
        let bytes = head.encode(&mut bytes).expect("a head of six cells fits");
        for part in HeadPart::all(bytes) {
            self.send(Command::Head(part));
            self.run_for(1e-3);
        }
    }

    /// What has come since the last call, with the instants at which it was over.
    pub fn take_packets(&mut self) -> Vec<(Ticks, Vec<u8>)> {
        let board = &mut self.machine.board;
        match self.link {
            Link::Usb => board.usb_host.take_received(),
            Link::Uart => board.lpuart.take_sent().into_iter().map(|sent| (sent.at, vec![sent.byte])).collect(),
        }
    }

    /// What has come since the last call.
    pub fn take_bytes(&mut self) -> Vec<u8> {
        self.take_packets().into_iter().flat_map(|(_, bytes)| bytes).collect()
    }

    /// From now on what the board sends to a motor controller is kept.
    pub fn listen_as_controller(&mut self) {
        self.machine.board.usart.listen();
    }

    /// What has come to the motor controller since the last call: each byte with the end of its stop bit.
    pub fn take_controller_bytes(&mut self) -> Vec<SentByte> {
        self.machine.board.usart.take_sent()
    }

    /// Deepest the stack has been since reset, in bytes.
    pub fn stack_bytes(&self) -> u32 {
        self.stack_start.saturating_sub(self.machine.cpu.min_sp())
    }

    /// What the program did against the controller's reference manual or the USB specification,
    /// and registers nobody has modelled; empty if all is well.
    pub fn faults(&self) -> Vec<String> {
        let board = &self.machine.board;
        let broken = board.effects.violations.iter().map(|violation| {
            format!(
                "tick {}, instruction {:#010x}, address {:#010x}, value {:#010x}: {}",
                violation.at, violation.pc, violation.address, violation.value, violation.rule
            )
        });
        let unknown = board
            .effects
            .unmodelled
            .iter()
            .map(|(address, count)| format!("register {address:#010x} is not modelled; {count} accesses"));
        let complaints = board.usb_host.complaints().iter().map(|complaint| format!("USB: {complaint}"));
        broken.chain(unknown).chain(complaints).collect()
    }
}

/// The bytes of a command, behind a delimiter that ends whatever came before.
pub fn request(number: u16, command: Command) -> Vec<u8> {
    let mut buffer = [0; MAX_REQUEST_BYTES];
    let packet = encode(&Request { number, command }, &mut buffer).expect("every command fits its limit");
    [&[DELIMITER], packet].concat()
}

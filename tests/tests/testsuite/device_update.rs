//! New firmware by the boot loader in the MCU, over and over, with cuts of the supply at random instants.

use std::io;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose::device::update::{DfuPort, Firmware, Known, UpdateError, update};
use slitpose_emulator::boot_loader::{BootLoader, Stall};
use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::machine::Stop;
use slitpose_emulator::memory::{BANK_BYTES, FLASH_BASE, FlashArray};
use slitpose_emulator::rig::{Link, Rig, open_image, open_pose_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::{BootTarget, Command, Decoder, Hashes, MAX_MESSAGE_BYTES, Message};

/// The board's USB cable. A bad one changes a bit of the first byte that is read, in blocks of this length.
struct Cable<'m>(BootLoader<'m>, Option<u16>);

fn refused(Stall: Stall) -> io::Error {
    io::ErrorKind::BrokenPipe.into()
}

impl DfuPort for Cable<'_> {
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> io::Result<()> {
        self.0.control_out(request, value, data).map_err(refused)
    }

    fn receive(&mut self, request: u8, value: u16, bytes: u16) -> io::Result<Vec<u8>> {
        let mut read = self.0.control_in(request, value, bytes).map_err(refused)?;
        if self.1 == Some(bytes) {
            read[0] ^= 1;
        }
        Ok(read)
    }
}

/// What an image puts into flash, as a release has it.
fn flash_of(image: &Image) -> Vec<u8> {
    let mut array = FlashArray::erased();
    image.load_into(&mut array);
    let end = u32::from_le_bytes(array.bytes()[0x9f4..0x9f8].try_into().expect("four bytes"));
    array.bytes()[..(end - FLASH_BASE) as usize].to_vec()
}

struct Bench {
    rig: Rig,
}

impl Bench {
    /// The hashes the board says it has stored, if it is running; otherwise it is in its boot loader.
    fn stored(&mut self) -> Option<Hashes> {
        match self.rig.run_for(0.05) {
            Stop::BootLoader => return None,
            stop => assert_eq!(stop, Stop::Reached, "neither firmware nor boot loader"),
        }
        self.rig.take_bytes();
        self.rig.send(Command::Hello);
        self.rig.run_for(0.05);
        let heard = self.rig.take_bytes();
        let (mut decoder, mut rest, mut stored) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &heard[..], None);
        while let Some(message) = decoder.next::<Message>(&mut rest) {
            if let Ok(Message::Hello(hello)) = message {
                stored = Some(hello.hashes);
            }
        }
        Some(stored.expect("firmware says hello"))
    }

    fn enter_boot_loader(&mut self) {
        self.rig.send(Command::Reboot(BootTarget::BootLoader));
        assert_eq!(self.rig.run_for(0.3), Stop::BootLoader);
        // The boot loader takes its vectors from address 0.
        assert_eq!(self.rig.machine.cpu.vectors(), 0);
    }

    /// Updates; the supply fails in operation `cut` on the flash memory, after this share of its time. Gives the operations.
    fn update(&mut self, firmware: &Firmware, cut: Option<(u64, f64)>) -> (u64, Result<(), UpdateError>) {
        let mut boot_loader = BootLoader::new(&mut self.rig.machine);
        boot_loader.cut = cut;
        let mut cable = Cable(boot_loader, None);
        let result = update(&mut cable, firmware, Known::Board, |_| {});
        let operations = cable.0.operations;
        if cut.is_some() {
            self.rig.machine.cut_power();
            self.rig.machine.power_on();
        }
        (operations, result)
    }
}

#[test]
fn a_hundred_updates_with_cuts_of_the_supply_leave_no_board_that_cannot_be_updated() {
    const SEED: u64 = 20_261_129;
    const HASHES: Hashes = Hashes { scene: Some(7), calibration: Some(11) };
    println!("seed {SEED}");
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let images = [open_image(None), open_pose_image()].map(|image| image.expect("firmware/build has made it"));
    let firmware = images.each_ref().map(|image| Firmware::read(&flash_of(image)).expect("firmware"));
    let scene = WIDE.read().expect("shipped");
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, SEED, 10.0);
    let rig = Rig::boot(&images[0], &scene, trajectory, NoiseSource::Off, Faults::default()).expect("a board");
    let mut bench = Bench { rig: rig.with_link(Link::Uart) };
    bench.rig.run_for(0.02);
    bench.rig.send(Command::Store(HASHES));
    bench.rig.run_for(0.1);
    let page_of_settings = |bench: &mut Bench| bench.rig.machine.board.flash.array.bytes()[BANK_BYTES..].to_vec();
    let settings = page_of_settings(&mut bench);
    assert_eq!(bench.stored(), Some(HASHES));

    bench.enter_boot_loader();
    let mut total = [0; 2];
    for (total, firmware) in total.iter_mut().zip(&firmware) {
        let (operations, result) = bench.update(firmware, None);
        result.expect("nothing disturbs it");
        *total = operations;
        assert_eq!(bench.stored(), Some(HASHES));
        bench.enter_boot_loader();
    }
    // Another page of the boot stub, as of a board without one, is replaced; a device that only waits is not touched.
    bench.rig.machine.board.flash.array.load(0x400, &[0]);
    let mut cable = Cable(BootLoader::new(&mut bench.rig.machine), None);
    let result = update(&mut cable, &firmware[0], Known::Waiting, |_| {});
    assert!(matches!(result, Err(UpdateError::Foreign)) && cable.0.operations == 0, "{result:?}");
    let (_, result) = bench.update(&firmware[0], None);
    result.expect("nothing disturbs it");
    assert_eq!(bench.stored(), Some(HASHES));
    bench.enter_boot_loader();
    let (mut waits, mut runs) = (0, 0);
    for round in 0..100 {
        let which = round % 2;
        let at = match round {
            // The first and the last page erased, the header, and the mark at the end.
            0 | 1 => 0,
            2 | 3 => total[which] - 1,
            4 | 5 => total[which] - 2,
            _ => random.random_range(0..total[which]),
        };
        let (_, result) = bench.update(&firmware[which], Some((at, random.random_range(0.0..1.0))));
        assert!(matches!(result, Err(UpdateError::Usb(_))), "round {round}: {result:?}");
        match bench.stored() {
            None => waits += 1,
            // All was written but the reply.
            Some(hashes) => {
                runs += 1;
                assert_eq!(hashes, HASHES);
                bench.enter_boot_loader();
            }
        }
        let (_, result) = bench.update(&firmware[which], None);
        result.unwrap_or_else(|error| panic!("round {round}, cut at {at}: {error}"));
        assert_eq!(bench.stored(), Some(HASHES), "round {round}");
        assert!(bench.rig.machine.board.flash.array.bytes().starts_with(&flash_of(&images[which])));
        bench.enter_boot_loader();
    }
    println!("of {total:?} operations; after a cut {waits} boards wait in their boot loader, {runs} run");
    assert_eq!((waits, runs), (100, 0), "a board runs only what is whole");
    // What reads back otherwise, here the last page, is not started.
    let last_page = (firmware[0].bytes() - 8) % 2_048;
    let mut cable = Cable(BootLoader::new(&mut bench.rig.machine), Some(last_page as u16));
    let result = update(&mut cable, &firmware[0], Known::Waiting, |_| {});
    assert!(matches!(result, Err(UpdateError::Differs { .. })), "{result:?}");
    bench.rig.machine.pull_reset_pin();
    assert_eq!(bench.stored(), None);
    assert!(page_of_settings(&mut bench) == settings, "settings stay");
}

//! The optics around the board, and a record of what the board does to them: every change of its emitter pins and level
//! lines, and every instant at which a converter holds a sample.

use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::world::{OpticsWorld, World};

/// Gates and level codes from `at` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    pub at: Ticks,
    pub gates: u8,
    pub levels: [u16; 2],
}

/// A converter holds the sample of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hold {
    pub at: Ticks,
    pub adc: u8,
    pub channel: u8,
}

/// A world that remembers what the board does to it.
#[derive(Debug)]
pub struct Recorder {
    pub world: OpticsWorld,
    /// Gates when it last forgot.
    before: u8,
    pub drives: Vec<Drive>,
    pub holds: Vec<Hold>,
    pub records_holds: bool,
}

impl Recorder {
    pub fn around(world: OpticsWorld) -> Self {
        Self { world, before: 0, drives: Vec::new(), holds: Vec::new(), records_holds: false }
    }

    pub fn forget(&mut self) {
        self.before = self.drives.last().map_or(self.before, |drive| drive.gates);
        self.drives.clear();
        self.holds.clear();
    }

    /// Changes of the gates since it last forgot, each with its instant.
    pub fn edges(&self) -> Vec<(Ticks, u8)> {
        let mut gates = self.before;
        let changes = self.drives.iter().filter(|drive| std::mem::replace(&mut gates, drive.gates) != drive.gates);
        changes.map(|drive| (drive.at, drive.gates)).collect()
    }
}

impl World for Recorder {
    fn drive(&mut self, at: Ticks, gates: u8, levels: [u16; 2]) {
        self.drives.push(Drive { at, gates, levels });
        self.world.drive(at, gates, levels);
    }

    fn sample(&mut self, at: Ticks, adc: u8, channel: u8) -> u16 {
        if self.records_holds {
            self.holds.push(Hold { at, adc, channel });
        }
        self.world.sample(at, adc, channel)
    }
}

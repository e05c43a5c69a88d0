//! What is around the board: emitters, slits, detectors and the electronics up to the converters.
//!
//! [`World`] puts the head of a scene file in front of the board: the gates and levels that the board drives say which
//! emitters shine, `light` follows the moving tool, and the electronics of the host's simulator settle, add noise and
//! quantise. [`Record`] is what the board does to it.

mod light;

use anyhow::{Result, bail};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use slitpose_head::scene_file::{FrontEnd, SceneFile};
use slitpose_head::simulator::{CellNoise, Electrode, Electronics, Trajectory};
use slitpose_model::Tier;
use slitpose_protocol::AdcScaling;

use crate::faults::{self, Fault, Faults};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use light::{Chain, Illumination, STAGE_S};

/// Of the optics: to a relative error which is far below a code of the converters.
pub const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Cells a board has converter inputs for.
pub const BOARD_CELLS: usize = 6;

/// DAC code at which an emitter has its nominal intensity: the middle of 12 bits.
pub const NOMINAL_LEVEL_CODE: u16 = 2048;

/// Bits of a conversion (RM0440, "ADC main features").
const ADC_BITS: u32 = 12;

/// I_X1 of cells 0 to 5: inputs of ADC1 (PA0, PA1, PC0, PC1, PC2, PC3).
const ADC1_INPUTS: [u8; BOARD_CELLS] = [1, 2, 6, 7, 8, 9];

/// I_X2 of cells 0 to 5: inputs of ADC2 (PA7, PC4, PC5, PB2, PB11, PB15).
const ADC2_INPUTS: [u8; BOARD_CELLS] = [4, 5, 11, 12, 14, 15];

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

/// Every change of emitter pins and level lines, and if asked for every instant at which ADC1 or ADC2 holds a sample.
#[derive(Debug, Default)]
pub struct Record {
    /// Gates when it last forgot.
    before: u8,
    pub drives: Vec<Drive>,
    /// `None`: not asked for; they are 12 MB a second.
    pub holds: Option<Vec<Hold>>,
}

impl Record {
    pub fn forget(&mut self) {
        self.before = self.drives.last().map_or(self.before, |drive| drive.gates);
        self.drives.clear();
        self.holds.iter_mut().for_each(Vec::clear);
    }

    /// Changes of the gates since it last forgot, each with its instant.
    pub fn edges(&self) -> Vec<(Ticks, u8)> {
        let mut gates = self.before;
        let changes = self.drives.iter().filter(|drive| std::mem::replace(&mut gates, drive.gates) != drive.gates);
        changes.map(|drive| (drive.at, drive.gates)).collect()
    }
}

/// Whether detectors and electronics are noisy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseSource {
    /// Shot, Johnson and converter noise as the scene says, drawn from this seed.
    Seeded(u64),
    /// None: each code is the expected one.
    Off,
}

/// The head of a scene around the board, its tool on a trajectory.
#[derive(Debug)]
pub struct World {
    illumination: Illumination,
    electronics: Electronics,
    /// Faults line-detector and slow-detector: the poles before the electronics.
    chain: Option<Chain>,
    /// Until when each cell's low-pass has run.
    settled_to: Vec<Ticks>,
    noise: Option<Noise>,
    zero_current_code: u16,
    faults: Faults,
}

/// Where noise comes from, and what it is at each cell.
#[derive(Debug)]
struct Noise {
    rng: ChaCha8Rng,
    /// At the instant of the last conversion; `None` before the first.
    cells: Vec<Option<(Ticks, CellNoise)>>,
}

impl World {
    /// The head of `file` with `faults` in the dark at tick 0, its tool on `trajectory`.
    pub fn new(file: &SceneFile, trajectory: Trajectory, noise: NoiseSource, faults: Faults) -> Result<Self> {
        let name = &file.name;
        let Some(front_end) = &file.front_end else {
            bail!("scene `{name}` has no [front_end]; add one, or use the shipped scene `wide`");
        };
        let (bits, cells) = (front_end.adc_bits, file.scene.cells.len());
        if bits != ADC_BITS {
            bail!("scene `{name}`: front_end.adc_bits = {bits}, the board's converters have {ADC_BITS}");
        }
        if cells > BOARD_CELLS {
            bail!("scene `{name}` has {cells} cells, the board has inputs for {BOARD_CELLS}");
        }
        let line_s = faults::LINES_S.into_iter().find(|(line, _)| faults.has(*line)).map(|(_, line_s)| line_s);
        let slowness = if faults.has(Fault::SlowFrontEnd) { faults::SLOW_FACTOR } else { 1.0 };
        let stage_s = if line_s.is_some() { STAGE_S } else { front_end.time_constant_s };
        let front_end = FrontEnd { time_constant_s: slowness * stage_s, ..*front_end };
        let electronics = Electronics::new(&file.scene, &front_end);
        Ok(Self {
            illumination: Illumination::new(&file.scene, trajectory, faults)?,
            zero_current_code: electronics.scaling().zero_code.round() as u16,
            electronics,
            chain: line_s.map(Chain::new),
            settled_to: vec![0; cells],
            noise: match noise {
                NoiseSource::Seeded(seed) => {
                    Some(Noise { rng: ChaCha8Rng::seed_from_u64(seed), cells: vec![None; cells] })
                }
                NoiseSource::Off => None,
            },
            faults,
        })
    }

    /// Lets the tool's time be zero at `origin`. Light that was worked out before stays as it is.
    pub fn set_origin(&mut self, origin: Ticks) {
        self.illumination.set_origin(origin);
    }

    /// What a code of the electronics means.
    pub fn scaling(&self) -> AdcScaling {
        self.electronics.scaling()
    }

    /// Brings the low-pass of `cell` to `now`, within one stretch of linear light.
    fn settle(&mut self, cell: usize, now: Ticks) {
        let since = self.settled_to[cell];
        if now > since {
            let (from, to) = (self.illumination.light(cell, since), self.illumination.light(cell, now));
            match &mut self.chain {
                Some(chain) => chain.pass(cell, seconds(now - since), [from, to], &mut self.electronics),
                None => self.electronics.pass(cell, seconds(now - since), from, to),
            }
            self.settled_to[cell] = now;
        }
    }

    fn driven(&self, mut gates: u8, mut level_codes: [u16; 2]) -> (u8, [u16; 2]) {
        if self.faults.has(Fault::StuckLevel) {
            level_codes[faults::LEVEL_LINE] = NOMINAL_LEVEL_CODE;
        }
        if self.faults.has(Fault::LiftedLevel) {
            level_codes[faults::LEVEL_LINE] += faults::LIFTED_CODES;
        }
        if self.faults.has(Fault::StuckGate) {
            gates |= 1 << faults::STUCK_GATE;
        }
        if !self.faults.has(Fault::SwappedGates) {
            return (gates, level_codes);
        }
        let at_driver = |driver: usize| gates >> exchanged(faults::GATES, driver) & 1;
        ((0..BOARD_CELLS).fold(0, |driven, driver| driven | at_driver(driver) << driver), level_codes)
    }

    fn settle_all(&mut self, now: Ticks) {
        for cell in 0..self.settled_to.len() {
            self.settle(cell, now);
        }
    }

    /// Follows the light through all stretches that end before `now`.
    fn follow_light(&mut self, now: Ticks) {
        while self.illumination.end() < now {
            self.settle_all(self.illumination.end());
            self.illumination.go_on();
        }
    }

    /// Emitter gates PC6 to PC11 (bit k: PC(6+k) driven high; a pin that is not a push-pull output
    /// is low, held by its pull-down) and the two level codes (PA4 = DAC1 OUT1 feeds emitters 0 to
    /// 2, PA6 = DAC2 OUT1 feeds emitters 3 to 5) changed at `now`.
    pub fn drive(&mut self, now: Ticks, gates: u8, level_codes: [u16; 2]) {
        self.follow_light(now);
        self.settle_all(now);
        let (gates, level_codes) = self.driven(gates, level_codes);
        let relative = level_codes.map(|code| f64::from(code) / f64::from(NOMINAL_LEVEL_CODE));
        self.illumination.switch(now, gates, relative);
    }

    /// The 12-bit code of one conversion of ADC `adc` (1 or 2), input `channel` (IN number), whose
    /// hold instant is `now`. Both converters of a pair are asked at the same `now`; calls come in
    /// the order of time.
    pub fn sample(&mut self, now: Ticks, adc: u8, channel: u8) -> u16 {
        let Some((cell, electrode)) = input(adc, channel) else {
            // An open input; 0 is also what an electrode gives that is far beyond full scale.
            return 0;
        };
        let cell = match self.faults.has(Fault::SwappedCells) {
            true => exchanged(faults::CELLS, cell),
            false => cell,
        };
        if cell >= self.settled_to.len() {
            return self.zero_current_code;
        }
        self.follow_light(now);
        self.settle(cell, now);
        let has = |fault, place| self.faults.has(fault) && (cell, electrode) == place;
        if has(Fault::OpenElectrode, faults::OPEN) {
            return self.zero_current_code;
        }
        if has(Fault::StuckElectrode, faults::STUCK) {
            return 0;
        }
        let noisiness = if has(Fault::NoisyChannel, faults::NOISY) { faults::NOISE_FACTOR } else { 1.0 };
        match &mut self.noise {
            Some(noise) => {
                let disturbance = noise.at(cell, now, &self.electronics);
                let converter = noisiness * noise.draw();
                self.electronics.convert(cell, electrode, &disturbance, converter)
            }
            None => self.electronics.convert(cell, electrode, &CellNoise::default(), 0.0),
        }
    }
}

impl Noise {
    fn draw(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// The filtered noise of `cell` at `now`: the same for both electrodes of a pair.
    fn at(&mut self, cell: usize, now: Ticks, electronics: &Electronics) -> CellNoise {
        let Self { rng, cells } = self;
        let draw = || StandardNormal.sample(rng);
        let (before, keep) = match cells[cell] {
            Some((then, noise)) if then == now => return noise,
            Some((then, noise)) => (noise, electronics.decay(seconds(now - then))),
            None => (CellNoise::default(), 0.0),
        };
        let noise = electronics.noise(cell, &before, keep, draw);
        cells[cell] = Some((now, noise));
        noise
    }
}

fn exchanged(pair: [usize; 2], index: usize) -> usize {
    match pair {
        [first, second] if index == first => second,
        [first, second] if index == second => first,
        _ => index,
    }
}

/// Which electrode an input of a converter belongs to.
fn input(adc: u8, channel: u8) -> Option<(usize, Electrode)> {
    let (inputs, electrode) = match adc {
        1 => (ADC1_INPUTS, Electrode::X1),
        2 => (ADC2_INPUTS, Electrode::X2),
        _ => return None,
    };
    inputs.iter().position(|&wired| wired == channel).map(|cell| (cell, electrode))
}

fn seconds(ticks: Ticks) -> f64 {
    ticks as f64 / TICKS_PER_SECOND as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;
    use slitpose_head::simulator::TrajectoryKind;

    const NOMINAL: [u16; 2] = [NOMINAL_LEVEL_CODE; 2];

    #[test]
    fn inputs_without_detector_are_dark_and_open_ones_at_zero() {
        let mut file = WIDE.read().unwrap();
        file.scene.cells.truncate(2);
        let still = Trajectory::of_kind(TrajectoryKind::Still, 0, 0.0);
        let mut world = World::new(&file, still, NoiseSource::Seeded(1), Faults::default()).unwrap();
        world.drive(0, 0b111_111, NOMINAL);
        assert_eq!(world.sample(1_000, 2, ADC2_INPUTS[5]), world.scaling().zero_code as u16);
        assert_eq!(world.sample(1_000, 1, 3), 0);
    }
}

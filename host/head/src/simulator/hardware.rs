//! The firmware's hardware trait, implemented by a simulated tool, optics and electronics.

use std::collections::VecDeque;
use std::sync::Arc;

use heapless::Vec;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use slitpose_firmware::settings::Settings;
use slitpose_firmware::{Acquisition, Health, Indicator, ScanError, Storage, StorageError, System};
use slitpose_model::{MAX_CELLS, Pair, Pose};
use slitpose_protocol::{BootTarget, Configuration, Edge, HardwareFault, Level, Pulse, RawScan, Schedule, Truth};

use super::Light;
use super::electronics::Electronics;
use super::trajectory::Trajectory;
use crate::faults::{LightFaults, WordFaults, WordScale};

const HEALTH: Health = Health { supply_v: 3.3, temperature_k: 298.15, cpu_load_permille: 0 };

/// Words in the ring of a converter, as on the board: see `RING_WORDS` in its firmware.
const RING_WORDS: u64 = 2048;

/// Simulated emitters, slits, detectors and converters of one head.
#[derive(Debug)]
pub(crate) struct SimulatedHardware {
    optics: Arc<dyn Light>,
    trajectory: Trajectory,
    electronics: Electronics,
    rng: ChaCha8Rng,
    /// Ticks since the last reset: time passes as this is raised.
    pub(super) now_ticks: u64,
    pub(super) tick_hz: u32,
    pub(super) run: Option<Run>,
    next_sequence: u64,
    /// The true poses at the scans since this was last emptied.
    pub(super) truths: VecDeque<Truth>,
    /// Ticks before the last reset.
    earlier_ticks: u64,
    /// What the next scan comes to grief by.
    trouble: Option<ScanError>,
    light_faults: Option<Box<LightFaults>>,
    word_faults: Option<Box<WordFaults>>,
    /// Ticks from one edge at the trigger input to the next; zero: there is none.
    pub(super) edge_ticks: u64,
    edges: u64,
}

#[derive(Debug)]
pub(super) struct Run {
    configuration: Configuration,
    pub(super) next_frame_ticks: u64,
}

impl SimulatedHardware {
    pub(super) fn new(
        optics: Arc<dyn Light>,
        trajectory: Trajectory,
        electronics: Electronics,
        tick_hz: u32,
        seed: u64,
    ) -> Self {
        Self {
            optics,
            trajectory,
            electronics,
            rng: ChaCha8Rng::seed_from_u64(seed),
            now_ticks: 0,
            tick_hz,
            run: None,
            next_sequence: 0,
            truths: VecDeque::new(),
            earlier_ticks: 0,
            trouble: None,
            light_faults: None,
            word_faults: None,
            edge_ticks: 0,
            edges: 0,
        }
    }

    /// As after a reset: dark, with counters from zero. The tool moves on, and so do faults of the head.
    pub(crate) fn reset(&mut self) -> Self {
        let (trajectory, electronics) = (self.trajectory.clone(), self.electronics.clone());
        Self {
            rng: self.rng.clone(),
            earlier_ticks: self.earlier_ticks + self.now_ticks,
            light_faults: self.light_faults.take(),
            word_faults: self.word_faults.take(),
            edge_ticks: self.edge_ticks,
            ..Self::new(Arc::clone(&self.optics), trajectory, electronics, self.tick_hz, 0)
        }
    }

    pub(crate) fn inject(&mut self, light: Option<LightFaults>, words: Option<WordFaults>) {
        (self.light_faults, self.word_faults) = (light.map(Box::new), words.map(Box::new));
    }

    /// Overwrites the next `scans` before they can be collected.
    pub(crate) fn overrun(&mut self, scans: u64) {
        if let Some(run) = &mut self.run {
            self.next_sequence += scans;
            run.next_frame_ticks += scans * u64::from(run.configuration.schedule.frame_ticks);
            self.trouble = Some(ScanError::Overrun);
        }
    }

    /// Lets the converters fail at the next scan.
    pub(crate) fn fail(&mut self) {
        self.trouble = self.run.as_ref().map(|_| ScanError::Fault(HardwareFault::Converters));
    }

    fn pose_at(&self, ticks: f64) -> Pose {
        self.trajectory.pose((self.earlier_ticks as f64 + ticks) / f64::from(self.tick_hz))
    }

    /// Photocurrents of `cell` at `ticks` from its own emitter in `slot` and from the other emitters of that
    /// slot through its slit.
    fn light(&self, configuration: &Configuration, cell: usize, slot: usize, ticks: f64) -> Pair<f64> {
        let emitters = configuration.schedule.slots[slot].emitters();
        let lit = emitters.map(|emitter| (emitter, configuration.levels[emitter].relative()));
        let mut lit: Vec<_, MAX_CELLS> = lit.collect();
        let pose = self.pose_at(ticks);
        let Some(faults) = &self.light_faults else { return self.optics.photocurrents(cell, &lit, &pose) };
        lit.retain(|(emitter, _)| !faults.is_dead(*emitter));
        let light = faults.moved(cell, &lit, &pose).unwrap_or_else(|| self.optics.photocurrents(cell, &lit, &pose));
        faults.warmed(cell, light)
    }

    /// Runs one frame through optics and electronics.
    fn expose(&mut self, configuration: &Configuration, frame_ticks: u64, scan: &mut RawScan) {
        let schedule = &configuration.schedule;
        let tick_s = f64::from(self.tick_hz).recip();
        let slot_ticks = f64::from(schedule.slot_ticks);
        let conversion_ticks = f64::from(schedule.conversion_ticks);
        if let Some(faults) = &mut self.light_faults {
            faults.begin(frame_ticks, self.tick_hz);
        }
        for cell in 0..usize::from(schedule.cells) {
            let dark =
                self.light_faults.as_ref().map_or(Pair::default(), |faults| faults.warmed(cell, Pair::default()));
            for slot in 0..schedule.slots.len() {
                let start = frame_ticks as f64 + slot as f64 * slot_ticks;
                let end = start + slot_ticks;
                // Within a slot the tool moves micrometres: light is linear in time.
                let (first_light, last_light) = if schedule.slots[slot].is_dark() {
                    (dark, dark)
                } else {
                    (self.light(configuration, cell, slot, start), self.light(configuration, cell, slot, end))
                };
                let light = |ticks: f64| {
                    let share = (ticks - start) / slot_ticks;
                    let between = |a: f64, b: f64| a + share * (b - a);
                    Pair {
                        i_x1_a: between(first_light.i_x1_a, last_light.i_x1_a),
                        i_x2_a: between(first_light.i_x2_a, last_light.i_x2_a),
                    }
                };
                let is_lit = schedule.lit_slot(cell) == Some(slot);
                let sampled = is_lit || schedule.dark_slot() == Some(slot);
                let mut passed = start;
                if sampled && let Some(first) = schedule.first_sample_ticks(slot, cell) {
                    let first = frame_ticks as f64 + first as f64;
                    self.electronics.pass(cell, (first - start) * tick_s, first_light, light(first));
                    let word = self.electronics.sample(
                        cell,
                        schedule.oversampling,
                        |conversion| light(first + f64::from(conversion) * conversion_ticks),
                        &mut self.rng,
                    );
                    if is_lit {
                        scan.lit_mut()[cell] = word;
                    } else if let Some(words) = scan.dark_mut() {
                        words[cell] = word;
                    }
                    passed = first + f64::from(schedule.oversampling - 1) * conversion_ticks;
                }
                self.electronics.pass(cell, (end - passed) * tick_s, light(passed), last_light);
            }
            let idle = f64::from(schedule.frame_ticks) - schedule.slots.len() as f64 * slot_ticks;
            self.electronics.pass(cell, idle * tick_s, dark, dark);
        }
    }
}

impl Acquisition for SimulatedHardware {
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault> {
        let (cells, channels) = (configuration.schedule.cells, self.optics.cell_count() as u8);
        if cells == channels { Ok(()) } else { Err(HardwareFault::Channels { cells, channels }) }
    }

    /// Simulated emitters accept every level, independently.
    fn limit_levels(&self, _: &Schedule, _: &mut [Level]) {}

    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault> {
        (self.run, self.trouble) = (None, None);
        let Some(configuration) = configuration else {
            return Ok(());
        };
        self.check(configuration)?;
        self.run = Some(Run { configuration: configuration.clone(), next_frame_ticks: self.now_ticks });
        Ok(())
    }

    fn set_pulse(&mut self, _: Pulse, _: &Schedule) -> Result<(), HardwareFault> {
        Ok(())
    }

    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError> {
        let Some(mut run) = self.run.take() else {
            return Ok(false);
        };
        if let Some(trouble) = self.trouble.take() {
            // Converters that fail leave the emitters dark.
            self.run = (trouble == ScanError::Overrun).then_some(run);
            return Err(trouble);
        }
        let schedule = &run.configuration.schedule;
        let period = u64::from(schedule.frame_ticks);
        let ring = (RING_WORDS / (schedule.words_per_scan() as u64).max(1)).max(2);
        let waiting = self.now_ticks.saturating_sub(run.next_frame_ticks) / period;
        if waiting > ring {
            // The ring goes on from where it is; half of it has not been overwritten when the words are looked at.
            let lost = waiting - ring / 2;
            self.next_sequence += lost;
            run.next_frame_ticks += lost * period;
            self.run = Some(run);
            return Err(ScanError::Overrun);
        }
        let finished = run.next_frame_ticks + period <= self.now_ticks;
        if finished {
            scan.sequence = self.next_sequence;
            scan.tick = run.next_frame_ticks;
            scan.levels_mut().copy_from_slice(&run.configuration.levels);
            self.expose(&run.configuration, run.next_frame_ticks, scan);
            if let Some(faults) = &mut self.word_faults {
                let schedule = &run.configuration.schedule;
                let (scaling, oversampling) = (self.electronics.scaling(), schedule.oversampling);
                faults.apply(scan, &WordScale { scaling, oversampling, tick_hz: self.tick_hz });
            }
            let reference = run.configuration.schedule.reference_ticks();
            let pose = self.pose_at(run.next_frame_ticks as f64 + reference);
            self.truths.push_back(Truth {
                sequence: self.next_sequence,
                translation_m: pose.translation_m.to_array(),
                rotation_xyzw: pose.rotation.to_array(),
            });
            self.next_sequence += 1;
            run.next_frame_ticks += period;
        }
        self.run = Some(run);
        Ok(finished)
    }
}

/// A simulated board stores nothing beyond its lifetime.
impl Storage for SimulatedHardware {
    fn store(&mut self, _: Option<&Settings>, _: &[u8]) {}

    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        Some(Ok(()))
    }
}

impl System for SimulatedHardware {
    fn now_ticks(&mut self) -> u64 {
        self.now_ticks
    }

    /// A square wave.
    fn next_edge(&mut self) -> Option<Edge> {
        let tick = (self.edges + 1) * self.edge_ticks;
        if self.edge_ticks == 0 || tick > self.now_ticks {
            return None;
        }
        self.edges += 1;
        Some(Edge::new(tick, self.edges % 2 == 1))
    }

    fn housekeeping(&mut self, _: Indicator) -> Health {
        let warmer_k = self.light_faults.as_ref().map_or(0.0, |faults| faults.warmer_k());
        Health { temperature_k: HEALTH.temperature_k + warmer_k as f32, ..HEALTH }
    }

    fn reboot(&mut self, _: BootTarget) {}
}

//! The words that a frame should have, from optics, schedule and scaling alone.

use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Trajectory;
use slitpose_model::{CompiledScene, Tier};
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

/// Ticks from one frame to the next in the default configuration.
pub const FRAME_TICKS: u64 = 42_500;

/// Furthest a mean code may be from the model's. Each conversion is rounded to a whole code, so
/// their mean is off by up to ½ when all four fall to one side. The rest is how far the emulated
/// light is from the optics at the instant: it is linear within 35 µs (0.01 code), and what reaches
/// a cell from the emitter of another is taken to 1e-3.
pub const TOLERANCE_CODES: f64 = 0.5 + 0.02;

/// What words should be, from optics, schedule and scaling alone.
pub struct Model {
    own: CompiledScene<f64>,
    stray: CompiledScene<f64>,
    trajectory: Trajectory,
    schedule: Schedule,
    scaling: AdcScaling,
    time_constant_ticks: f64,
    half_dark_a: Vec<f64>,
}

/// A mean code of I_X1 and of I_X2.
pub type Codes = [f64; 2];

impl Model {
    pub fn new(file: &SceneFile, trajectory: Trajectory) -> Self {
        let plan = |tolerance| CompiledScene::compile(&file.scene, Tier::Exact { tolerance }).expect("shipped");
        let schedule = default_configuration().schedule;
        let tau_s = file.front_end.expect("the default has one").time_constant_s;
        Self {
            own: plan(1e-6),
            stray: plan(1e-3),
            trajectory,
            scaling: default_scaling(),
            time_constant_ticks: tau_s * f64::from(schedule.tick_hz),
            half_dark_a: file.scene.cells.iter().map(|cell| 0.5 * cell.detector.dark_current_a).collect(),
            schedule,
        }
    }

    /// Photocurrents of `cell` from the emitters of `slot` with the tool where it is at `tick`.
    fn light(&self, cell: usize, slot: usize, tick: f64) -> [f64; 2] {
        let pose = self.trajectory.pose(tick / f64::from(self.schedule.tick_hz));
        self.schedule.slots[slot].emitters().fold([0.0; 2], |sum, emitter| {
            let plan = if emitter == cell { &self.own } else { &self.stray };
            let pair = plan.crosstalk(cell, emitter, &pose);
            [sum[0] + pair.i_x1_a, sum[1] + pair.i_x2_a]
        })
    }

    /// The mean code of the conversions of `cell` in `slot` of the frame that starts at `tick`.
    ///
    /// x after an edge the low-pass shows the light of τ ago, less exp(−x/τ) of it, and exp(−x/τ)
    /// of what the slot before had left. That is exact for light that changes linearly, but for
    /// the change in the vanishing part; what its curvature adds, the tool's acceleration of
    /// 40 m/s² for τ² = 2 µs², is 0.1 nm.
    fn codes(&self, cell: usize, slot: usize, tick: u64) -> Codes {
        let Schedule { slot_ticks, conversion_ticks, oversampling, .. } = self.schedule;
        let tau = self.time_constant_ticks;
        let start = tick as f64 + slot as f64 * f64::from(slot_ticks);
        let first = tick as f64 + self.schedule.first_sample_ticks(slot, cell).expect("in the schedule") as f64;
        // Ahead of slot 0 it has been dark for long.
        let before = if slot > 0 { self.light(cell, slot - 1, start - tau) } else { [0.0; 2] };
        let mut mean = [0.0; 2];
        for conversion in 0..oversampling {
            let at = first + f64::from(conversion * conversion_ticks as u16);
            let rest = (-(at - start) / tau).exp();
            let light = self.light(cell, slot, at - tau);
            for electrode in 0..2 {
                let current = light[electrode] * (1.0 - rest) + before[electrode] * rest + self.half_dark_a[cell];
                let code = self.scaling.zero_code + current / self.scaling.amperes_per_code;
                mean[electrode] += code / f64::from(oversampling);
            }
        }
        mean
    }

    /// Mean codes of a frame that starts at `tick`: lit and dark, cell by cell.
    pub fn frame(&self, tick: u64) -> [Vec<Codes>; 2] {
        let dark = self.schedule.dark_slot().expect("the default has one");
        let cells = || 0..usize::from(self.schedule.cells);
        let lit = |cell| self.schedule.lit_slot(cell).expect("every cell is lit");
        [
            cells().map(|cell| self.codes(cell, lit(cell), tick)).collect(),
            cells().map(|cell| self.codes(cell, dark, tick)).collect(),
        ]
    }
}

/// Largest difference between the mean codes of a scan and `expected`.
pub fn difference(scan: &RawScan, expected: &[Vec<Codes>; 2]) -> f64 {
    let oversampling = 4.0;
    let words = [scan.lit(), scan.dark().expect("dark words")];
    let pairs = words.iter().zip(expected).flat_map(|(words, expected)| words.iter().zip(expected));
    pairs
        .flat_map(|(words, codes)| words.iter().zip(codes))
        .map(|(&word, code)| (f64::from(word) / oversampling - code).abs())
        .fold(0.0, f64::max)
}

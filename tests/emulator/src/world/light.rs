//! Light on the detectors from the emitters that shine now, while the tool moves.
//!
//! Time is cut into stretches. At both ends of a stretch the optics are evaluated, between them
//! light is linear in time; each switching of an emitter begins a new stretch, so edges stay sharp.

use slitpose_head::simulator::Trajectory;
use slitpose_model::{CompiledScene, Pair, Pose, Scene, SceneError, Tier};

use super::BOARD_CELLS;
use crate::faults::{BAFFLE, BAFFLE_SHARE, DEAD, Fault, Faults, WEAK, WEAK_STRENGTH};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};

/// Length of a stretch: 35 µs, a little above one lighting slot of the default schedule. At 0.5 m/s
/// the tool moves 17 µm in it, and light bends by less than a hundredth of a converter step.
const STRETCH_TICKS: Ticks = 5_950;

/// Relative error allowed to light that reaches a cell from the emitters of other cells. It is faint
/// and falls at a glancing angle, where integration is slow; this is less than a thousandth of a
/// converter step.
const STRAY_TOLERANCE: f64 = 1e-3;

/// Emitters 0 to 2 have the first level, 3 to 5 the second.
const EMITTERS_PER_LEVEL: usize = 3;

/// The optics at one instant, as far as they have been asked for.
#[derive(Clone, Copy, Debug)]
struct Knot {
    at: Ticks,
    pose: Pose,
    /// Bit k: the light of emitter k is known.
    known: u8,
    /// Light of each emitter on each cell, at nominal intensity.
    by_emitter: [[Pair<f64>; BOARD_CELLS]; BOARD_CELLS],
    /// Light of all that shine, at their levels.
    sum: [Pair<f64>; BOARD_CELLS],
}

/// Light on all cells as a function of time.
#[derive(Debug)]
pub(super) struct Illumination {
    /// For each emitter on its own cell.
    plan: CompiledScene<f64>,
    /// For each emitter on the other cells.
    stray: CompiledScene<f64>,
    faults: Faults,
    trajectory: Trajectory,
    origin: Ticks,
    /// Bit k: emitter k shines.
    lit: u8,
    levels: [f64; 2],
    /// The ends of the present stretch; they mean nothing in the dark.
    from: Knot,
    to: Knot,
}

impl Illumination {
    pub(super) fn new(scene: &Scene, trajectory: Trajectory, tier: Tier, faults: Faults) -> Result<Self, SceneError> {
        let stray = match tier {
            Tier::Exact { tolerance } => Tier::Exact { tolerance: tolerance.max(STRAY_TOLERANCE) },
            Tier::Paper => Tier::Paper,
        };
        let (plan, stray) = (CompiledScene::compile(scene, tier)?, CompiledScene::compile(scene, stray)?);
        let dark = [Pair::default(); BOARD_CELLS];
        let nowhere = Knot { at: 0, pose: Pose::HOME, known: 0, by_emitter: [dark; BOARD_CELLS], sum: dark };
        Ok(Self { plan, stray, faults, trajectory, origin: 0, lit: 0, levels: [0.0; 2], from: nowhere, to: nowhere })
    }

    pub(super) fn set_origin(&mut self, origin: Ticks) {
        self.origin = origin;
    }

    /// Until when the present stretch is linear.
    pub(super) fn end(&self) -> Ticks {
        if self.lit == 0 { Ticks::MAX } else { self.to.at }
    }

    /// Light on `cell` at `at`, which lies in the present stretch.
    pub(super) fn light(&self, cell: usize, at: Ticks) -> Pair<f64> {
        if self.lit == 0 {
            return Pair::default();
        }
        let share = (at - self.from.at) as f64 / STRETCH_TICKS as f64;
        let between = |from: f64, to: f64| from + share * (to - from);
        let (from, to) = (&self.from.sum[cell], &self.to.sum[cell]);
        Pair { i_x1_a: between(from.i_x1_a, to.i_x1_a), i_x2_a: between(from.i_x2_a, to.i_x2_a) }
    }

    /// Goes on to the stretch that follows the present one.
    pub(super) fn go_on(&mut self) {
        self.from = self.to;
        self.to = self.knot(self.from.at + STRETCH_TICKS);
        self.evaluate();
    }

    /// From `now` on, emitters shine by `gates`, with `levels` relative to nominal.
    pub(super) fn switch(&mut self, now: Ticks, gates: u8, levels: [f64; 2]) {
        let shines = |emitter: &usize| gates & (1 << emitter) != 0 && levels[emitter / EMITTERS_PER_LEVEL] > 0.0;
        self.lit = (0..self.plan.cell_count()).filter(shines).fold(0, |lit, emitter| lit | 1 << emitter);
        self.levels = levels;
        if self.lit == 0 {
            return;
        }
        let present = self.from.at <= now && now < self.to.at;
        let known = self.lit & !(self.from.known & self.to.known) == 0;
        // What begins now takes further emitters without a new stretch.
        if !(present && (known || self.from.at == now)) {
            self.from = self.knot(now);
            self.to = self.knot(now + STRETCH_TICKS);
        }
        self.evaluate();
    }

    fn knot(&self, at: Ticks) -> Knot {
        let time_s = (at as f64 - self.origin as f64) / TICKS_PER_SECOND as f64;
        Knot { at, pose: self.trajectory.pose(time_s), known: 0, ..self.to }
    }

    /// Asks the optics for what is missing at both ends, and adds up.
    fn evaluate(&mut self) {
        for knot in [&mut self.from, &mut self.to] {
            knot.sum = [Pair::default(); BOARD_CELLS];
            for emitter in (0..self.plan.cell_count()).filter(|emitter| self.lit & (1 << emitter) != 0) {
                let light = &mut knot.by_emitter[emitter];
                if knot.known & (1 << emitter) == 0 {
                    for cell in 0..self.plan.cell_count() {
                        let plan = if cell == emitter { &self.plan } else { &self.stray };
                        light[cell] = plan.crosstalk(cell, emitter, &knot.pose);
                    }
                    plant(self.faults, emitter, light);
                    knot.known |= 1 << emitter;
                }
                let level = self.levels[emitter / EMITTERS_PER_LEVEL];
                for (sum, pair) in knot.sum.iter_mut().zip(light) {
                    sum.i_x1_a += level * pair.i_x1_a;
                    sum.i_x2_a += level * pair.i_x2_a;
                }
            }
        }
    }
}

/// Changes the `light` of `emitter` on all cells as faults do.
fn plant(faults: Faults, emitter: usize, light: &mut [Pair<f64>; BOARD_CELLS]) {
    let add = |to: Pair<f64>, share: f64, of: Pair<f64>| Pair {
        i_x1_a: to.i_x1_a + share * of.i_x1_a,
        i_x2_a: to.i_x2_a + share * of.i_x2_a,
    };
    let strength = match emitter {
        DEAD if faults.has(Fault::DeadEmitter) => 0.0,
        WEAK if faults.has(Fault::WeakEmitter) => WEAK_STRENGTH,
        _ => 1.0,
    };
    if strength < 1.0 {
        light.iter_mut().for_each(|pair| *pair = add(Pair::default(), strength, *pair));
    }
    if faults.has(Fault::MissingBaffle) && BAFFLE.contains(&emitter) {
        let [first, second] = BAFFLE;
        let other = if emitter == first { second } else { first };
        light[other] = add(light[other], BAFFLE_SHARE, light[emitter]);
    }
}

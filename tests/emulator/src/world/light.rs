//! Light on the detectors from the emitters that shine now, while the tool moves.
//!
//! Time is cut into stretches. At both ends of a stretch the optics are evaluated, between them
//! light is linear in time; each switching of an emitter begins a new stretch, so edges stay sharp.
//!
//! # On its way to the stage
//! Light on its way to the stage, with more than one pole: the detector as a resistive line held at both ends, the
//! emitter, the amplifier's second pole, and the filter at the pin (`firmware/README.md`, bandwidth and settling).
//!
//! The line has N sections of R/N and N − 1 nodes of C/N. Its modes sin(nπk/N) decay by
//! τ_n = RC/(4·N²·sin²(nπ/2N)) (a discrete heat equation). Light at x excites mode n by sin(nπx), and mode n gives
//! the electrodes sin(nπ/N)·(1, −(−1)ⁿ)/(2N·sin²(nπ/2N)). Mode and poles in cascade are a sum of first-order low-passes
//! with the weights τ_i^(m−1)/∏(τ_i − τ_j), m of them, each exact for light that changes linearly.

use super::{BOARD_CELLS, TIER};
use crate::faults::{BAFFLE, BAFFLE_SHARE, DEAD, Fault, Faults, WEAK, WEAK_STRENGTH};
use crate::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_head::simulator::{Electronics, Trajectory};
use slitpose_model::{CompiledScene, Pair, Pose, Scene, SceneError, Tier};
use std::array::from_fn;
use std::f64::consts::PI;

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
    pub(super) fn new(scene: &Scene, trajectory: Trajectory, faults: Faults) -> Result<Self, SceneError> {
        let stray = Tier::Exact { tolerance: STRAY_TOLERANCE };
        let (plan, stray) = (CompiledScene::compile(scene, TIER)?, CompiledScene::compile(scene, stray)?);
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

const SECTIONS: usize = 40;
/// The modes that take time; the others, faster than a hundredth of the slowest, are taken as settled at once.
const MODES: usize = 12;

/// R_f · C_f of the stage, 324 kΩ · 3.3 pF, seconds: the pole of the electronics behind this chain.
pub(super) const STAGE_S: f64 = 1.07e-6;

/// Emitter, second pole of the amplifier with 51 pF at its input, and 220 Ω with 475 pF; seconds.
const POLES_S: [f64; 3] = [0.36e-6, 0.13e-6, 0.10e-6];

/// Low-passes of a cell: the modes of its line, and the poles for each electrode.
const LOW_PASSES: usize = MODES + 2 * POLES_S.len();
type LowPasses = [f64; LOW_PASSES];

/// What leaves the chain is taken as linear for this long, seconds; in the dark, where nothing is sampled for long, for
/// longer.
const STEP_S: f64 = 0.4e-6;
const MAX_STEPS: f64 = 1_000.0;

/// A low-pass this close to what drives it has settled, amperes: 1e-3 codes.
const SETTLED_A: f64 = 2.5e-12;

#[derive(Debug)]
pub(super) struct Chain {
    time_constants_s: LowPasses,
    /// Of each mode: its part in the electrodes' currents.
    parts: [[f64; MODES]; 2],
    /// Weights of the modes in their cascades, of the poles alone, and of each pole behind each mode, less that alone.
    mode_weights: [f64; MODES],
    pole_weights: [f64; POLES_S.len()],
    delayed_weights: [[f64; MODES]; POLES_S.len()],
    cells: [LowPasses; BOARD_CELLS],
    /// The light in which a cell's chain has settled.
    settled: [Option<Pair<f64>>; BOARD_CELLS],
}

/// The weight of the first of `time_constants` in their cascade.
fn weight(first: f64, others: impl Iterator<Item = f64>) -> f64 {
    others.map(|other| first / (first - other)).product()
}

impl Chain {
    /// Detectors whose slowest mode has `line_s`, R·C/π².
    pub(super) fn new(line_s: f64) -> Self {
        let half_angle = |mode: usize| ((mode + 1) as f64 * PI / (2 * SECTIONS) as f64).sin().powi(2);
        let slowest = PI * PI / (4 * SECTIONS * SECTIONS) as f64;
        let time_constants_s = from_fn(|k| match k.checked_sub(MODES) {
            None => line_s * slowest / half_angle(k),
            Some(pole) => POLES_S[pole / 2],
        });
        let part =
            |mode: usize| ((mode + 1) as f64 * PI / SECTIONS as f64).sin() / (2.0 * SECTIONS as f64 * half_angle(mode));
        let parts = [from_fn(part), from_fn(|mode| if mode % 2 == 0 { part(mode) } else { -part(mode) })];
        let of_pole = |own: f64| weight(own, POLES_S.into_iter().filter(|&other| other != own));
        let behind = |own: f64, mode_s: f64| of_pole(own) * (own / (own - mode_s) - 1.0);
        Self {
            time_constants_s,
            parts,
            mode_weights: from_fn(|mode| weight(time_constants_s[mode], POLES_S.into_iter())),
            pole_weights: POLES_S.map(of_pole),
            delayed_weights: POLES_S.map(|own| from_fn(|mode| behind(own, time_constants_s[mode]))),
            cells: [[0.0; LOW_PASSES]; BOARD_CELLS],
            settled: [Some(Pair::default()); BOARD_CELLS],
        }
    }

    /// What drives the low-passes of a cell in `light`, their weights included.
    fn drives(&self, light: Pair<f64>) -> LowPasses {
        let total = light.total_a();
        let place = if total > 0.0 { light.i_x2_a / total } else { 0.0 };
        let modes: [f64; MODES] = from_fn(|mode| total * ((mode + 1) as f64 * PI * place).sin());
        from_fn(|k| {
            let Some(pole) = k.checked_sub(MODES) else { return modes[k] * self.mode_weights[k] };
            let (pole, electrode) = (pole / 2, pole % 2);
            // What these modes do not delay: the faster ones, and what lies between two nodes.
            let direct = [light.i_x1_a, light.i_x2_a][electrode] * self.pole_weights[pole];
            let parts = self.parts[electrode].iter().zip(&modes).zip(&self.delayed_weights[pole]);
            parts.fold(direct, |sum, ((part, mode), delayed)| sum + part * mode * delayed)
        })
    }

    /// The currents that leave the chain of `cell`.
    fn currents(&self, cell: usize) -> Pair<f64> {
        let (modes, poles) = self.cells[cell].split_at(MODES);
        let [i_x1_a, i_x2_a] = from_fn(|electrode| {
            let line: f64 = self.parts[electrode].iter().zip(modes).map(|(part, mode)| part * mode).sum();
            line + poles.iter().skip(electrode).step_by(2).sum::<f64>()
        });
        Pair { i_x1_a, i_x2_a }
    }

    /// Lets `duration_s` pass for `cell` with light that changes linearly, and passes it on to `electronics`.
    pub(super) fn pass(
        &mut self,
        cell: usize,
        duration_s: f64,
        [from, to]: [Pair<f64>; 2],
        electronics: &mut Electronics,
    ) {
        let mut before = self.currents(cell);
        if from == to && self.settled[cell] == Some(to) {
            electronics.pass(cell, duration_s, before, before);
            return;
        }
        let light = (from == to).then_some(to);
        let steps = (duration_s / STEP_S).ceil().clamp(1.0, MAX_STEPS);
        let step_s = duration_s / steps;
        let [from, to] = [from, to].map(|light| self.drives(light));
        let keeps = self.time_constants_s.map(|time_constant_s| (-step_s / time_constant_s).exp());
        for step in 0..steps as u32 {
            for (k, state) in self.cells[cell].iter_mut().enumerate() {
                let change = (to[k] - from[k]) / steps;
                let start = from[k] + f64::from(step) * change;
                let lag = change * self.time_constants_s[k] / step_s;
                *state = start + change - lag + (*state - start + lag) * keeps[k];
            }
            let after = self.currents(cell);
            electronics.pass(cell, step_s, before, after);
            before = after;
        }
        let has_settled = self.cells[cell].iter().zip(&to).all(|(state, drive)| (state - drive).abs() < SETTLED_A);
        self.settled[cell] = light.filter(|_| has_settled);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;

    /// Against 40 resistors and 39 capacitors, and poles one after another, in Euler steps of 0.2 ns.
    #[test]
    fn a_step_of_light_is_that_of_resistors_capacitors_and_poles() {
        let (file, line_s) = (WIDE.read().unwrap(), 1.0e-6);
        let light = Pair { i_x1_a: 4e-6, i_x2_a: 1e-6 };
        let step_s = 2e-10;
        // R = 1, so that node voltages times N are currents; C follows from R·C = π²·line.
        let rate = step_s * (SECTIONS * SECTIONS) as f64 / (PI * PI * line_s);
        let (mut nodes, mut poles) = ([0.0; SECTIONS + 1], [[0.0; 2]; POLES_S.len()]);
        let mut chain = Chain::new(line_s);
        let mut electronics = Electronics::new(&file.scene, &file.front_end.unwrap());
        let mut worst = 0.0_f64;
        for step in 1..=75_000 {
            let old = nodes;
            for k in 1..SECTIONS {
                let source = if k == SECTIONS / 5 { light.total_a() / SECTIONS as f64 } else { 0.0 };
                nodes[k] += rate * (old[k - 1] - 2.0 * old[k] + old[k + 1] + source);
            }
            let mut input = [nodes[1], nodes[SECTIONS - 1]].map(|node| node * SECTIONS as f64);
            for (pole, time_constant_s) in poles.iter_mut().zip(POLES_S) {
                for (state, input) in pole.iter_mut().zip(&mut input) {
                    *state += step_s / time_constant_s * (*input - *state);
                    *input = *state;
                }
            }
            if step % 1_000 == 0 {
                chain.pass(0, 1_000.0 * step_s, [light; 2], &mut electronics);
                let Pair { i_x1_a, i_x2_a } = chain.currents(0);
                worst = worst.max((i_x1_a - input[0]).abs()).max((i_x2_a - input[1]).abs());
            }
        }
        println!("off by at most {:.1e} of the light", worst / light.total_a());
        assert!(worst < 1e-3 * light.total_a(), "{worst:e} A");
        let Pair { i_x1_a, i_x2_a } = chain.currents(0);
        assert!((i_x1_a - light.i_x1_a).abs() < 1e-5 * light.i_x1_a && (i_x2_a / light.i_x2_a - 1.0).abs() < 1e-5);
    }
}

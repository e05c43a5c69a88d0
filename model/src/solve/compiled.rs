//! A scene compiled for the solver: optics, planes, weights, limits and gates of each cell.

use heapless::Vec;

use crate::entries::Scalar;
use crate::plan::{CompiledScene, Optics, Tier};
use crate::pose::{Pose, Rigid, Transform};
use crate::scalar::{Linear3, Number};
use crate::scene::{Cell, MAX_CELLS, Scene};

use super::home::home;
use super::outcome::{Directions, Outcome, Solution};
use super::planes::{self, PlaneCell, jacobian_change_rate};
use super::readings::{Limits, Photocurrents, Sorted};
use super::weights::{CellNoise, chi2_gate, redundancy};

/// Cells whose currents, two each, tell the six coordinates of a pose.
pub const MIN_CELLS: usize = 3;

/// Cells that tell the light level beside the pose.
pub const LEVEL_CELLS: usize = 5;

#[derive(Clone, Debug)]
pub struct Compiled<S: Number, P = CompiledScene<S>> {
    pub plan: P,
    pub planes: Vec<PlaneCell<S>, MAX_CELLS>,
    pub noise: Vec<CellNoise<S>, MAX_CELLS>,
    pub limits: Vec<Limits<S>, MAX_CELLS>,
    /// Largest χ² that noise explains, by the number of cells used.
    pub gates: [S; MAX_CELLS + 1],
    /// Empty: all cells are exposed at the reference instant.
    pub offsets_s: Vec<S, MAX_CELLS>,
    pub length_scale_m: S,
    /// Where the tool is before anything is known of it: [`super::home`].
    pub home: Rigid<S>,
    /// Relative change of the derivatives per unit of a scaled step.
    pub jacobian_change_rate: S,
    /// Whether poses of this head may have mirror images although all cells see light.
    pub has_images: bool,
    /// What is known beforehand of the common light level: the inverse of its relative variance; `None`: all. See
    /// [`Self::level_information`].
    pub level_information: Option<S>,
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// Of `scene` and its `plan`, the cells exposed at the reference instant.
    #[inline(never)]
    pub fn of(scene: &Scene, tier: Tier, plan: P) -> Self {
        let rounding = 16.0 * S::epsilon().as_f64();
        let relative_error = match tier {
            Tier::Paper => rounding,
            Tier::Exact { tolerance } => tolerance.max(rounding),
        };
        let (cells, home, length_scale_m) = (scene.cells.iter(), home(scene), S::of(scene.length_scale_m()));
        let planes: Vec<_, MAX_CELLS> =
            cells.clone().map(|cell| PlaneCell::compile(cell, &home, tier == Tier::Paper)).collect();
        let limits = cells.map(|cell @ Cell { detector, .. }| Limits {
            // Stray light without a spot is as faint as none.
            faint_a: S::of(detector.faint_a + cell.stray_a()),
            saturation_a: detector.saturation_a.map_or(S::infinity(), |limit| S::of(limit - detector.dark_current_a)),
            most_share: S::infinity(),
        });
        let level_sigma = scene.uncertainty.light_level_relative;
        let mut compiled = Self {
            noise: (0..scene.cells.len()).map(|cell| CellNoise::compile(scene, cell, relative_error)).collect(),
            limits: limits.collect(),
            length_scale_m,
            home: Rigid::of(&home),
            jacobian_change_rate: jacobian_change_rate(&planes, length_scale_m),
            planes,
            level_information: (level_sigma > 0.0).then(|| S::of((level_sigma * level_sigma).recip())),
            ..Self::without_cells(plan)
        };
        compiled.set_gates();
        compiled
    }
}

impl<S: Scalar> Compiled<S> {
    /// The readings that the head gives with the tool at rest at `pose`, without noise.
    pub fn seen_at(&self, pose: &Pose) -> Sorted<S> {
        let pairs = (0..self.plan.cell_count()).map(|cell| self.plan.photocurrents(cell, pose));
        Sorted::of(&Photocurrents::of_pairs(pairs), &self.limits)
    }
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    #[inline(always)]
    pub fn without_cells(plan: P) -> Self {
        Self {
            plan,
            planes: Vec::new(),
            noise: Vec::new(),
            limits: Vec::new(),
            gates: [S::zero(); MAX_CELLS + 1],
            offsets_s: Vec::new(),
            length_scale_m: S::one(),
            home: Rigid::home(),
            jacobian_change_rate: S::zero(),
            has_images: false,
            level_information: None,
        }
    }

    /// What is known beforehand of the common light level of a frame in which `cells` cells count: of fewer than
    /// [`LEVEL_CELLS`] it is taken for what it was, for it would take most of what they tell.
    #[inline(always)]
    pub fn level_information(&self, cells: usize) -> Option<S> {
        if P::FINDS_LIGHT_LEVEL { self.level_information.filter(|_| cells >= LEVEL_CELLS) } else { None }
    }

    pub fn take_light_level_for_known(&mut self) {
        self.level_information = None;
        self.set_gates();
    }

    fn set_gates(&mut self) {
        self.gates = core::array::from_fn(|cells| S::of(chi2_gate(self.redundancy(cells))));
    }

    /// Data of so many cells, less the unknowns.
    pub fn redundancy(&self, cells: usize) -> usize {
        redundancy(cells, self.level_information(cells).is_some())
    }

    pub fn on_planes(&self, sorted: &Sorted<S>) -> Transform<S> {
        self.onto_planes(sorted, self.home.to_transform())
    }

    /// `start` moved to where the emitters lie in the planes of their light.
    pub fn onto_planes(&self, sorted: &Sorted<S>, start: Transform<S>) -> Transform<S> {
        planes::pose_on_planes(&self.planes, &sorted.usable, start, self.length_scale_m)
    }

    /// The longest time between a cell's exposure and the reference instant.
    pub fn duration_s(&self) -> S {
        self.offsets_s.iter().fold(S::zero(), |longest, offset| longest.max(offset.abs()))
    }

    /// Whether the tool's acceleration within a frame matters: see [`Optics::BENDS_FROM_S`].
    pub fn allows_for_bends(&self) -> bool {
        self.duration_s() >= S::of(P::BENDS_FROM_S)
    }

    /// Six unknowns need [`MIN_CELLS`].
    pub fn too_few(&self, sorted: &Sorted<S>) -> Option<Solution<S>> {
        if sorted.usable.len() >= MIN_CELLS {
            return None;
        }
        let outcome = if sorted.usable.len() + sorted.faint.count() >= MIN_CELLS {
            Outcome::TooDark
        } else {
            Outcome::Unobservable(Directions::all())
        };
        Some(Solution::without_pose(outcome, sorted.used))
    }

    /// A displacement (metres, radians) in σ of a solution's pose, squared; infinite without a pose.
    pub fn squared_sigmas(&self, solution: &Solution<S>, [shift, turn]: [S::Vec3; 2]) -> S {
        let shift = shift * self.length_scale_m.recip();
        let scaled = [shift.x(), shift.y(), shift.z(), turn.x(), turn.y(), turn.z()];
        solution.factor.as_ref().map_or(S::infinity(), |factor| {
            let length = factor.length(&scaled);
            length * length
        })
    }
}

//! A solver small enough for a microcontroller, made where there is room.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::plan::{BOARD_CELLS, CompactCell, CompactPlan, Plan, Tier};
use crate::pose::Pose;
use crate::scalar::Scalar;
use crate::scene::{MAX_CELLS, Scene, SceneError};

use super::compiled::Compiled;
use super::outcome::Solution;
use super::planes::PlaneCell;
use super::readings::{Limits, Photocurrents};
use super::solver::Solver;
use super::starts;
use super::tracker::Tracker;
use super::weights::CellNoise;

/// Relative error of the currents that the rule may have: a fiftieth of what noise does to them in a frame at 4 kHz.
const TOLERANCE: f64 = 2e-5;

/// Of the currents that it is measured by.
const TRUE_TOLERANCE: f64 = 1e-9;

/// Poses of the reach at which it is measured, and home.
const LOOKS: usize = 64;

/// Why a head cannot be held by a microcontroller.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CompactError {
    /// It cannot be held by anything.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It has too many cells.
    #[error("{cells} cells, and the board has {most}: leave cells out")]
    Cells {
        /// Of the scene.
        cells: usize,
        /// That fit.
        most: usize,
    },
    /// A cell is of a kind that has no place there.
    #[error("cell {cell} has what the board does not compute, {what}: solve on the host, or leave it out")]
    Kind {
        /// Number of the cell.
        cell: usize,
        /// What it has.
        what: &'static str,
    },
    /// The light on a spot is too uneven for the rule.
    #[error("the spots are too wide or too near for the board: its sums would err by {error:.1e} of the light")]
    Spots {
        /// Relative error of a current.
        error: f64,
    },
}

/// A compact solver but for its cells, to be stored or sent.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactFrame<S: Scalar> {
    gates: [S; MAX_CELLS + 1],
    has_offsets: bool,
    length_scale_m: S,
    jacobian_change_rate: S,
    has_images: bool,
}

/// One cell of a compact solver.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactPart<S: Scalar> {
    optics: CompactCell<S>,
    plane: PlaneCell<S>,
    noise: CellNoise<S>,
    limits: Limits<S>,
    offset_s: S,
}

impl<S: Scalar> Solver<S, CompactPlan<S>> {
    /// A solver for `scene` in the exact tier, with one short rule for the light of all spots, whose currents are right to
    /// 2·10⁻⁵ at poses spread over 4 mm and 17° about home. For cells exposed at the reference instant.
    ///
    /// # Errors
    /// If the scene is impossible, has more than [`BOARD_CELLS`] cells, or a cell that is not a slit parallel to its detector before
    /// an emitter of the profile cosⁿγ.
    pub fn compact(scene: &Scene) -> Result<Self, CompactError> {
        if scene.cells.len() > BOARD_CELLS {
            return Err(CompactError::Cells { cells: scene.cells.len(), most: BOARD_CELLS });
        }
        let truth = Plan::<f64>::compile(scene, Tier::Exact { tolerance: TRUE_TOLERANCE })?;
        if let Some((cell, what)) = truth.not_compact() {
            return Err(CompactError::Kind { cell, what });
        }
        let error = CompactPlan::<f64>::of(&truth).map_or(f64::INFINITY, |plan| worst_error(&plan, &truth));
        if error > TOLERANCE {
            return Err(CompactError::Spots { error });
        }
        let Solver { compiled, max_steps } = Solver::<S>::new(scene, Tier::Exact { tolerance: TOLERANCE })?;
        let Some(plan) = CompactPlan::of(&compiled.plan) else { return Err(CompactError::Spots { error }) };
        Ok(Self { compiled: compiled.with_plan(plan), max_steps })
    }

    /// Without cells: it finds no pose.
    #[inline(always)]
    #[must_use]
    pub fn without_cells() -> Self {
        let plan = CompactPlan { cells: Vec::new() };
        Self { compiled: Compiled::without_cells(plan), max_steps: None }
    }

    /// What the solver holds besides its cells.
    pub fn frame(&self) -> CompactFrame<S> {
        let Compiled { gates, offsets_s, length_scale_m, jacobian_change_rate, has_images, .. } = &self.compiled;
        CompactFrame {
            gates: *gates,
            has_offsets: !offsets_s.is_empty(),
            length_scale_m: *length_scale_m,
            jacobian_change_rate: *jacobian_change_rate,
            has_images: *has_images,
        }
    }

    /// What it holds of each cell, in order.
    pub fn parts(&self) -> impl Iterator<Item = CompactPart<S>> + '_ {
        let Compiled { plan, planes, noise, limits, offsets_s, .. } = &self.compiled;
        (0..plan.cells.len()).map(move |cell| CompactPart {
            optics: plan.cells[cell].clone(),
            plane: planes[cell],
            noise: noise[cell],
            limits: limits[cell],
            offset_s: offsets_s.get(cell).copied().unwrap_or_default(),
        })
    }

    /// Begins anew, in place, with the `frame` of another solver: cells follow by [`Self::push`].
    pub fn begin(&mut self, frame: &CompactFrame<S>) {
        let compiled = &mut self.compiled;
        compiled.plan.cells.clear();
        compiled.planes.clear();
        compiled.noise.clear();
        compiled.limits.clear();
        compiled.offsets_s.clear();
        compiled.gates = frame.gates;
        compiled.length_scale_m = frame.length_scale_m;
        compiled.jacobian_change_rate = frame.jacobian_change_rate;
        compiled.has_images = frame.has_images;
    }

    /// Appends a cell of another solver with the same `frame`; `false`, and nothing changed, if there is no room.
    #[must_use]
    pub fn push(&mut self, frame: &CompactFrame<S>, part: &CompactPart<S>) -> bool {
        let compiled = &mut self.compiled;
        if compiled.plan.cells.push(part.optics.clone()).is_err() {
            return false;
        }
        // These have room for as many cells as any scene has.
        let _ = compiled.planes.push(part.plane);
        let _ = compiled.noise.push(part.noise);
        let _ = compiled.limits.push(part.limits);
        if frame.has_offsets {
            let _ = compiled.offsets_s.push(part.offset_s);
        }
        true
    }
}

/// The tracker of a board.
pub type BoardTracker = Tracker<f32, CompactPlan<f32>>;

/// See [`Tracker::neglecting_motion`]: too small by 2 % at most.
const NEGLIGIBLE_MOTION: f64 = 0.15;

impl BoardTracker {
    /// Without cells and frames: see [`Tracker::solver_mut`] and [`Tracker::restart`].
    #[inline(always)]
    pub fn without_cells() -> Self {
        Self::new(Solver::without_cells(), 1.0).neglecting_motion(NEGLIGIBLE_MOTION)
    }

    /// The solution of [`Tracker::track`], made here: generic code is compiled by its caller's profile, which is for size
    /// on a board.
    #[inline(never)]
    pub fn track_on_board(&mut self, frame: u64, readings: &Photocurrents<f32>) -> Solution<f32> {
        let mut solution = self.advance(frame, readings);
        solution.own_up();
        solution
    }
}

/// The greatest relative error of a current of `plan`, over the reach of a head.
fn worst_error(plan: &CompactPlan<f64>, truth: &Plan<f64>) -> f64 {
    let poses = core::iter::once(Pose::HOME).chain((0..LOOKS).map(|index| starts::spread::<f64>(index).to_pose()));
    poses.fold(0.0, |worst: f64, pose| {
        let found = plan.currents_at(&pose);
        found.iter().enumerate().fold(worst, |worst, (cell, found)| {
            let expected = truth.photocurrents(cell, &pose);
            let total = expected.i_x1_a + expected.i_x2_a;
            let off = (found[0] - expected.i_x1_a).abs().max((found[1] - expected.i_x2_a).abs());
            // No light at all is no light on both sides.
            if off == 0.0 { worst } else { worst.max(off / total) }
        })
    })
}

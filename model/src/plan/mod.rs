//! A scene compiled for evaluation: each cell's response to a pose, and its derivatives.

#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
mod cells;
mod compact;
mod compile;
pub mod evaluate;
mod imperfect;
mod optics;

#[cfg(feature = "lanes")]
extern crate alloc;

use core::fmt::Debug;

use heapless::Vec;

use crate::aperture::Aperture;
use crate::effects::counts_on;
use crate::entries::Scalar;
use crate::exact::{MAX_EVALUATIONS, Orders, Rules};
use crate::pose::{Pose, Transform};
use crate::profile::CompiledProfile;
use crate::response::{Pair, Response, Status};
use crate::scalar::Number;
use crate::scene::{Scene, SceneError};
use crate::solve::{MotionPrior, Photocurrents, Solution, Solver, Start};

#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
pub use cells::CellsInLanes;
pub use compact::CompactCell;
pub use compact::{BOARD_CELLS, CompactPlan};
use imperfect::Imperfect;
pub use optics::Instant;
use optics::{Receiver, Source};

/// How the optics of a cell are evaluated.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let [paper, exact] = [Tier::Paper, Tier::Exact { tolerance: 1e-6 }].map(|tier| {
///     let plan = CompiledScene::<f64>::compile(&scene, tier).expect("it can be built");
///     plan.photocurrents(0, &Pose::HOME).total_a()
/// });
/// assert!((paper / exact - 1.0).abs() < 0.02 && paper != exact);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tier {
    /// Equations (3) to (5) of De La Cruz et al. 2018 as printed: the spot as one plate, its geometric
    /// centre as X_A, one γ for the whole beam. They are for slits on the base; of any other
    /// [`Opening`](crate::Opening) it takes integrals to 1e-6.
    Paper,
    /// Intensity integrated over the spot, the power-weighted centroid as X_A.
    Exact {
        /// Relative error allowed in the integrals.
        tolerance: f64,
    },
}

/// The cells of a plan: in place, or with the feature `lanes` on the heap, where copies share them. A compiled scene of 120 kB
/// would otherwise be moved over the stacks of a host's threads, and copied with each tracker.
#[cfg(not(feature = "lanes"))]
type CompiledCells<S> = Vec<CompiledCell<S>, { crate::scene::MAX_CELLS }>;
#[cfg(feature = "lanes")]
type CompiledCells<S> = alloc::sync::Arc<[CompiledCell<S>]>;

/// Compiles the cells of `scene` where they stay.
#[cfg(not(feature = "lanes"))]
fn fill<S: Number>(cells: &mut CompiledCells<S>, scene: &Scene, tier: Tier) -> Result<(), SceneError> {
    // A scene has no more cells than there is room for.
    compile::cells(scene, tier, |cell| drop(cells.push(cell)))
}
#[cfg(feature = "lanes")]
fn fill<S: Number>(cells: &mut CompiledCells<S>, scene: &Scene, tier: Tier) -> Result<(), SceneError> {
    let mut list = alloc::vec::Vec::with_capacity(scene.cells.len());
    compile::cells(scene, tier, |cell| list.push(cell))?;
    *cells = list.into();
    Ok(())
}

/// A scene compiled for one tier and one number type. Fixed size and no heap, except with the feature `lanes`.
///
/// ```
/// # let scene: slitpose_model::Scene = include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/ring.rs"));
/// // `scene` has six cells in a ring, as in the example of this crate.
/// use slitpose_model::*;
/// let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 })?;
/// let at_home = plan.photocurrents(0, &Pose::HOME);
/// let nearer = Pose { translation_m: glam::DVec3::X * 1e-3, ..Pose::HOME };
/// assert!(plan.photocurrents(0, &nearer).total_a() > at_home.total_a());
/// # Ok::<(), SceneError>(())
/// ```
#[derive(Clone, Debug)]
pub struct CompiledScene<S: Scalar> {
    cells: CompiledCells<S>,
    is_paper: bool,
    /// `None` in the paper tier, unless an opening asks for integrals.
    rules: Option<Rules<S>>,
    lanes: S::CellsInLanes,
}

/// Cells of a plan in as many lanes as the processor has: what each gives alone, bit for bit.
pub trait CellsAtOnce<S: Scalar>: Clone + Debug + Send + Sync + 'static {
    /// In no lanes.
    const ALONE: Self;

    /// Those of `plan`; in no lanes if they are not of one kind, or not of the exact tier, or there are none.
    fn of(_plan: &CompiledScene<S>) -> Self {
        Self::ALONE
    }

    /// Passes what is found of each of the `wanted` cells to `sink`, in order; `None`: it must be evaluated alone.
    /// `SLOPES`: with derivatives.
    #[inline(always)]
    fn each<const SLOPES: bool>(
        &self,
        plan: &CompiledScene<S>,
        _instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, Option<CellTerms<S>>),
    ) {
        (0..plan.cell_count()).filter(|&cell| wanted(cell)).for_each(|cell| sink(cell, None));
    }
}

/// No lanes: of `f32`, and of `f64` without the feature `lanes`.
#[derive(Clone, Debug)]
pub struct NoLanes;

impl<S: Scalar> CellsAtOnce<S> for NoLanes {
    const ALONE: Self = Self;
}

/// The derivatives of a cell's two currents with respect to a perturbation of the pose in the base
/// frame, in the order (δt, δθ): A/m and A/rad.
pub type CurrentsJacobian<S> = [[S; 6]; 2];

#[derive(Clone, Debug)]
pub struct CompiledCell<S: Number> {
    receiver: Receiver<S>,
    aperture: Aperture<S>,
    /// What the cell does beyond an ideal one, if anything: its light then passes this, not the aperture.
    imperfect: Option<Imperfect<S>>,
    emitter: CompiledEmitter<S>,
    saturation: Option<S>,
    faint: S,
}

/// The part of a cell that is mounted on the tool.
#[derive(Clone, Debug)]
pub struct CompiledEmitter<S: Number> {
    source: Source<S>,
    profile: CompiledProfile<S>,
    /// `None` in the paper tier, unless the cell's opening asks for integrals.
    orders: Option<Orders<S>>,
}

/// A cell's currents and derivatives at a pose, for the solver.
#[derive(Clone, Copy, Debug)]
pub struct CellTerms<S> {
    pub(crate) status: Status,
    /// Photocurrents without dark current, amperes.
    pub(crate) pair: [S; 2],
    pub(crate) jacobian: CurrentsJacobian<S>,
    /// How far the spot may change, metres on the detector, before the derivatives jump; zero if
    /// unknown.
    pub(crate) slack_m: S,
    /// How far the emitter may move, metres, before derivatives change by a hundredth at a wall of a thick mask; infinite
    /// if there is none, or if it counts in `slack_m`.
    pub(crate) wall_m: S,
}

impl<S: Number> CellTerms<S> {
    fn dark(status: Status) -> Self {
        let nothing = S::zero();
        Self { status, pair: [nothing; 2], jacobian: [[nothing; 6]; 2], slack_m: nothing, wall_m: S::infinity() }
    }
}

/// How near to a minimum, and at what cost.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// Bound on the distance that may remain, in σ of the pose: tens of times too cautious, so that a part of a tenth of
    /// that remains.
    pub(crate) sigmas: f64,
    /// Evaluations within which it is reached, unless the tool jumped or a cell lies.
    pub(crate) work: usize,
}

/// What a solver asks of the optics of a head.
pub trait Optics<S: Number>: Sized {
    /// Whether solutions tell what checked them: see [`crate::Solution::unnoticed_sigmas`].
    const TELLS_RELIABILITY: bool;

    /// Whether the common light level is an unknown of each frame: see [`crate::Uncertainty::light_level_relative`].
    const FINDS_LIGHT_LEVEL: bool;

    /// Cells below which mirror images of a pose are searched for on any head, unless the tool was followed to where it is.
    const UNIQUE_FROM: usize;

    /// What is done for a minimum where the tool is expected.
    const NEAR: Near;
    /// The same of frames that are [`Self::UNHURRIED_S`] apart or more.
    const NEAR_UNHURRIED: Near;
    /// Distance of two frames, seconds, from which on there is time for a second step in each.
    const UNHURRIED_S: f64;
    /// Whether a frame has so little work that the others of a cell that is left out take more than one.
    const HAS_SMALL_FRAMES: bool;
    /// Whether a frame that contradicts the expected motion is first taken for another motion, and only then for a cell
    /// that lies, which costs more to find.
    const DOUBTS_MOTION_FIRST: bool;
    /// Frames from one look at a cell that is left out to the next.
    const LOOKS_AGAIN_AFTER: u64;
    /// Whether steps cross the walls of thick masks: see [`CellTerms`].
    const CROSSES_WALLS: bool;
    /// The tool's acceleration within a frame is allowed for where a cell is exposed so long before or after the reference
    /// instant, seconds.
    const BENDS_FROM_S: f64;

    /// [`Solver::solve`].
    #[inline(always)]
    fn solve(
        solver: &Solver<S, Self>,
        readings: &Photocurrents<S>,
        start: Start<'_>,
        motion: &MotionPrior,
    ) -> Solution<S> {
        solver.solve_here(readings, start, motion)
    }

    /// Number of cells.
    fn cell_count(&self) -> usize;

    /// From the tool's origin to the emitter of cell `cell`, or to where the light of a slit on the tool lands at home:
    /// the spot moves with that point of the tool. Base frame, metres.
    fn arm(&self, cell: usize, base_from_tool: &Transform<S>) -> S::Vec3;

    /// Passes the terms of all `wanted` cells, at their exposures and in order, to `sink`. It may
    /// receive other cells, too.
    fn linearise_all(
        &self,
        instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        sink: impl FnMut(usize, &CellTerms<S>),
    );

    /// Passes the photocurrents of all `wanted` cells, at their exposures and in order, to `sink`. It
    /// may receive other cells, too.
    fn currents_all(&self, instant: &Instant<'_, S>, wanted: impl Fn(usize) -> bool, sink: impl FnMut(usize, [S; 2]));
}

impl<S: Scalar> CompiledScene<S> {
    /// Most evaluations of the profile for one cell's currents at one pose. Their derivatives take up to
    /// the same number for the spot's area, and again for its sides.
    pub const MAX_EVALUATIONS: usize = MAX_EVALUATIONS;

    /// Checks `scene` and compiles it for evaluation in `tier`.
    ///
    /// # Errors
    /// The first impossible value, with its place in the scene. Values that are possible but
    /// useless (a slit of zero width, an emitter behind the slit) compile; the status shows their effect.
    pub fn compile(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        S::compile(scene, tier)
    }

    #[inline(always)]
    pub(crate) fn compile_here(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        let cells = CompiledCells::<S>::default();
        let mut plan = Self { cells, is_paper: tier == Tier::Paper, rules: None, lanes: S::CellsInLanes::ALONE };
        fill(&mut plan.cells, scene, tier)?;
        let integrates = plan.cells.iter().any(|cell| cell.emitter.orders.is_some());
        plan.rules = integrates.then(Rules::new);
        plan.lanes = S::CellsInLanes::of(&plan);
        Ok(plan)
    }

    /// Whether the light of `emitter` is to be counted on the detector of `cell`.
    fn has_emitter(&self, cell: usize, emitter: usize) -> bool {
        let other = self.cells[emitter].imperfect.as_ref().and_then(|effects| effects.other_axis);
        emitter == cell || counts_on(emitter, other, cell)
    }

    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// The full response of cell `cell` with the tool at `pose`.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn respond(&self, cell: usize, pose: &Pose) -> Response<S> {
        S::respond(self, cell, pose)
    }

    /// The photocurrents of cell `cell` without dark current, amperes: I_X − I_D/2 for each electrode,
    /// as measured when a dark sample is subtracted. Zero without a spot.
    ///
    /// Full precision as long as the current over responsivity and axial intensity (steradians) is a normal
    /// number, above 2·10⁻³⁰⁸ in `f64` and 1·10⁻³⁸ in `f32`; below that, the precision of a subnormal number.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn photocurrents(&self, cell: usize, pose: &Pose) -> Pair<S> {
        S::photocurrents(self, cell, pose)
    }

    /// The status, the currents of [`Self::photocurrents`], and their analytic derivatives.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn linearise(&self, cell: usize, pose: &Pose) -> (Status, Pair<S>, CurrentsJacobian<S>) {
        let CellTerms { status, pair: [i_x1_a, i_x2_a], jacobian, .. } = S::linearise(self, cell, pose);
        (status, Pair { i_x1_a, i_x2_a }, jacobian)
    }

    /// Corners of the spot of cell `cell`, in order around it, in the cell's x and y (metres).
    /// Empty without a spot.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn spot_outline_m(&self, cell: usize, pose: &Pose) -> Vec<[S; 2], 16> {
        S::spot_outline_m(self, cell, pose)
    }

    /// The photocurrents of cell `cell` without dark current, amperes, while the emitters `lit` shine through its slit,
    /// each at its level relative to nominal, and no others. Stray light and the curves of the converters, which are
    /// those of a lit cell, count only if the cell's own emitter is among them.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    pub fn photocurrents_of(&self, cell: usize, lit: impl IntoIterator<Item = (usize, S)>, pose: &Pose) -> Pair<S> {
        S::photocurrents_of(self, cell, &mut lit.into_iter(), pose)
    }

    /// [`Self::photocurrents_of`] one emitter at its nominal level.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    pub fn crosstalk(&self, cell: usize, emitter: usize, pose: &Pose) -> Pair<S> {
        self.photocurrents_of(cell, [(emitter, S::one())], pose)
    }

    /// Emitters that are lit with that of cell `cell`, bit j for emitter j: those of
    /// [`Effects::lit_together`](crate::Effects::lit_together), whose light [`Self::photocurrents`] contain.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn lit_together(&self, cell: usize) -> u16 {
        self.cells[cell].imperfect.as_ref().map_or(0, |effects| effects.lit_together)
    }
}

impl<S: Scalar> Optics<S> for CompiledScene<S> {
    const TELLS_RELIABILITY: bool = true;
    const FINDS_LIGHT_LEVEL: bool = true;
    // With six lit cells no pose but the truth keeps all of them lit, if their planes fix a pose.
    const UNIQUE_FROM: usize = 6;
    const NEAR: Near = Near { sigmas: 0.8, work: 6 };
    const NEAR_UNHURRIED: Near = Self::NEAR;
    const UNHURRIED_S: f64 = f64::INFINITY;
    const HAS_SMALL_FRAMES: bool = false;
    const DOUBTS_MOTION_FIRST: bool = false;
    const LOOKS_AGAIN_AFTER: u64 = 1;
    const CROSSES_WALLS: bool = false;
    const BENDS_FROM_S: f64 = 0.0;

    #[inline(always)]
    fn solve(solver: &Solver<S>, readings: &Photocurrents<S>, start: Start<'_>, motion: &MotionPrior) -> Solution<S> {
        S::solve(solver, readings, start, motion)
    }

    fn cell_count(&self) -> usize {
        self.cells.len()
    }

    fn arm(&self, cell: usize, base_from_tool: &Transform<S>) -> S::Vec3 {
        let cell = &self.cells[cell];
        let landing = cell.imperfect.as_ref().and_then(Imperfect::landing);
        base_from_tool.rotate(landing.unwrap_or(cell.emitter.source.position))
    }

    #[inline(always)]
    fn linearise_all(
        &self,
        instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, &CellTerms<S>),
    ) {
        self.lanes.each::<true>(self, instant, wanted, |cell, found| {
            let terms = found.unwrap_or_else(|| evaluate::linearise(self, cell, &instant.pose_of(cell)));
            sink(cell, &terms);
        });
    }

    #[inline(always)]
    fn currents_all(
        &self,
        instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, [S; 2]),
    ) {
        self.lanes.each::<false>(self, instant, wanted, |cell, found| {
            let pair = found.map_or_else(
                || {
                    let Pair { i_x1_a, i_x2_a } = evaluate::photocurrents(self, cell, &instant.pose_of(cell));
                    [i_x1_a, i_x2_a]
                },
                |terms| terms.pair,
            );
            sink(cell, pair);
        });
    }
}

#[cfg(test)]
mod tests;

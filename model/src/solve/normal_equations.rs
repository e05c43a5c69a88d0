//! The whitened residuals, their Jacobian, and the normal equations of Gauss and Newton.
//!
//! With r the residuals of all currents divided by their noise ([`super::weights`]) and J their derivatives by the
//! pose, χ² = rᵀr and a step s solves JᵀJ·s = Jᵀr (Gauss 1809; Björck, Numerical Methods for Least Squares
//! Problems, 1996, section 9.2). JᵀJ is the Fisher information: its inverse is the covariance.
//!
//! Unknowns are (δt/ℓ, δθ), ℓ the length scale: translations are counted in units of the emitters' distance
//! from the tool's origin, so that the matrix mixes like with like. The light level is one more unknown, which
//! [`super::level`] eliminates; a tool that moves within the frame adds six, which [`super::twist`] does.

// heapless clears the memory of a new vector; here that would take as long as the algebra.
use arrayvec::ArrayVec;

use crate::entries::Scalar;
use crate::plan::{BOARD_CELLS, CellTerms, Instant, Optics};
use crate::pose::{Pose, Transform};
use crate::scalar::Number;
use crate::scene::MAX_CELLS;

use super::algebra::{Factor, Matrix6, Vector6, add_outer, dot, mirror};
use super::compiled::{Compiled, MIN_CELLS};
use super::level::Level;
use super::readings::{Sorted, Usable};
use super::step::SAFE_ROUNDINGS;
use super::twist::{Elimination, Motion, Prior};
use super::weights::{CellNoise, ResidualSums, Row, Whitener};

/// Distance from a guiding plane that counts as one σ.
const GUIDE_M: f64 = 20e-6;

/// Most guiding planes: more than three fix a pose.
const MAX_GUIDES: usize = 4;

pub struct Problem<'a, S: Number, P> {
    pub head: &'a Compiled<S, P>,
    pub sorted: &'a Sorted<S>,
    pub motion: Motion<S>,
    /// The weights of the readings.
    pub whiteners: Whiteners<S>,
}

pub type Whiteners<S> = ArrayVec<Whitener<S>, MAX_CELLS>;

/// Memory and budget of the minimisations of one frame: the rows of the last linearisation, with the residuals
/// of the last evaluation.
#[derive(Debug)]
pub struct Workspace<S: Number> {
    /// Of each usable reading, in order, two each.
    pub rows: ArrayVec<[Row<S>; 2], MAX_CELLS>,
    /// Index of a reading whose cell has no spot at the pose, and the row of its plane.
    pub plane_rows: ArrayVec<(usize, Row<S>), MAX_GUIDES>,
    /// Weights at the last linearisation of cells whose parts may be displaced.
    pub displaced: ArrayVec<Whitener<S>, MAX_CELLS>,
    /// The readings' slacks: see [`crate::plan::CellTerms`].
    pub slacks_m: ArrayVec<S, MAX_CELLS>,
    /// The readings' distances from walls, if steps cross them: on a board.
    pub walls_m: ArrayVec<S, BOARD_CELLS>,
    /// `None`: the light level is known.
    pub level: Option<Level<S>>,
    pub elimination: Elimination<S>,
    /// Evaluations of all cells that may still be made: see [`Self::with_work`].
    pub work: usize,
    /// Whether there is time for [`Optics::NEAR_UNHURRIED`].
    pub is_unhurried: bool,
    pub evaluations: usize,
}

impl<S: Number> Workspace<S> {
    /// Empty, without a limit to the work.
    #[inline(always)]
    pub fn new() -> Self {
        Self::with_work(usize::MAX)
    }

    /// With a budget of `work` evaluations of all cells, with or without derivatives: the cost of a solve,
    /// whatever the processor. Minimisations end when the budget is used up; one under way makes three more
    /// evaluations at most.
    #[inline(always)]
    pub fn with_work(work: usize) -> Self {
        Self {
            work,
            is_unhurried: false,
            evaluations: 0,
            rows: ArrayVec::new(),
            plane_rows: ArrayVec::new(),
            displaced: ArrayVec::new(),
            slacks_m: ArrayVec::new(),
            walls_m: ArrayVec::new(),
            level: None,
            elimination: Elimination::new(),
        }
    }

    #[inline(always)]
    fn count(&mut self) {
        self.work = self.work.saturating_sub(1);
        self.evaluations += 1;
    }
}

/// The weights of `readings`. A function of its own, because a board has room for it in its fast memory, and not for what
/// calls it.
#[inline(never)]
fn whiteners<S: Number>(noise: &[CellNoise<S>], readings: &[Usable<S>]) -> Whiteners<S> {
    readings.iter().map(|reading| noise[reading.cell].whitener(reading.pair)).collect()
}

/// χ² = rᵀr, the information JᵀJ and Jᵀr at a pose, light level and twist eliminated.
#[derive(Clone, Copy, Debug)]
pub struct NormalEquations<S> {
    pub chi2: S,
    pub information: Matrix6<S>,
    /// Jᵀr: minus half the gradient of χ².
    pub gradient: Vector6<S>,
    /// Whether marginalising the light level left enough digits to solve with.
    pub is_safe: bool,
    /// The diagonal of the information that went with the light level.
    level_part: Vector6<S>,
}

impl<S: Number> NormalEquations<S> {
    /// An estimate, low by √6 at most, of the norm of J: the most that a step of unit length changes the
    /// whitened currents, with what the light level could explain.
    pub fn steepness(&self) -> S {
        (0..6).fold(S::zero(), |most, i| most.max(self.information[i][i] + self.level_part[i])).root()
    }

    pub fn times(&self, step: &Vector6<S>) -> Vector6<S> {
        self.information.map(|row| dot(&row, step))
    }

    /// χ² after a step, by the linearisation.
    pub fn chi2_after(&self, step: &Vector6<S>) -> S {
        self.chi2 - S::two() * dot(&self.gradient, step) + self.along(step)
    }

    /// The length of a step in σ, squared.
    pub fn along(&self, step: &Vector6<S>) -> S {
        dot(step, &self.times(step))
    }
}

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// The problem that readings pose.
    pub fn problem<'a>(&'a self, sorted: &'a Sorted<S>, motion: &Prior<S>) -> Problem<'a, S, P> {
        let motion = Motion::new(motion, self.duration_s(), self.length_scale_m);
        Problem { head: self, sorted, motion, whiteners: whiteners(&self.noise, &sorted.usable) }
    }
}

impl<S: Scalar> Compiled<S> {
    /// The factor of the information of all cells with light at `pose`, the tool at rest.
    pub fn factor_at(&self, pose: &Pose) -> Option<Factor<S>> {
        let sorted = self.seen_at(pose);
        if sorted.usable.len() < MIN_CELLS {
            return None;
        }
        let (problem, workspace) = (self.problem(&sorted, &Prior::at_rest()), &mut Workspace::new());
        let at = problem.linearise(&Transform::of(pose), workspace);
        problem.factor(&at, workspace)
    }
}

impl<S: Number, P: Optics<S>> Problem<'_, S, P> {
    pub fn instant<'b>(&'b self, pose: &'b Transform<S>) -> Instant<'b, S> {
        Instant { pose, twist: self.motion.twist, bend: self.motion.bend, offsets_s: &self.head.offsets_s }
    }

    /// The light level of the last linearisation; `None`: it is known.
    #[inline(always)]
    pub fn level<'w>(&self, workspace: &'w Workspace<S>) -> Option<&'w Level<S>> {
        if P::FINDS_LIGHT_LEVEL { workspace.level.as_ref() } else { None }
    }

    /// What is known beforehand of the light level; `None`: all.
    #[inline(always)]
    pub fn level_information(&self) -> Option<S> {
        self.head.level_information(self.sorted.usable.len())
    }

    fn wants(&self, cell: usize) -> bool {
        self.sorted.usable.iter().any(|reading| reading.cell == cell)
    }

    /// Exposure of a reading's cell in units of the motion's duration.
    #[inline(always)]
    pub fn share(&self, reading: &Usable<S>) -> S {
        self.head.offsets_s.get(reading.cell).map_or(S::zero(), |&offset| offset / self.motion.duration)
    }

    /// Whether the bend is to be eliminated.
    #[inline(always)]
    pub fn has_bend(&self) -> bool {
        self.motion.bend_prior.is_some()
    }

    /// The currents above dark that all cells deliver with the tool at `pose` at the reference
    /// instant.
    pub fn predicted(&self, pose: &Transform<S>) -> heapless::Vec<[S; 2], MAX_CELLS> {
        let mut currents = heapless::Vec::new();
        self.head.plan.currents_all(
            &self.instant(pose),
            |_| true,
            |_, pair| {
                // As many as there are cells.
                let _ = currents.push(pair);
            },
        );
        currents
    }

    /// With weights for a pose that is far off: see [`CellNoise::coarse`].
    pub fn coarse(&self) -> Self {
        let whitener = |reading: &Usable<S>| {
            let length = self.head.planes[reading.cell].detector_length_m();
            self.head.noise[reading.cell].coarse(length).whitener(reading.pair)
        };
        Self { whiteners: self.sorted.usable.iter().map(whitener).collect(), ..*self }
    }

    /// The largest χ² that noise explains.
    pub fn gate(&self) -> S {
        self.head.gates[self.sorted.usable.len()]
    }

    /// χ² and the normal equations at `pose`.
    pub fn linearise(&self, pose: &Transform<S>, workspace: &mut Workspace<S>) -> NormalEquations<S> {
        workspace.count();
        let Workspace { rows: all_rows, plane_rows, displaced, slacks_m, walls_m, level, elimination, .. } = workspace;
        slacks_m.clear();
        walls_m.clear();
        displaced.clear();
        all_rows.clear();
        plane_rows.clear();
        let mut information = [[S::zero(); 6]; 6];
        let is_twist_known = self.motion.prior.is_none();
        elimination.begin(&self.motion);
        *level = self.level_information().map(Level::of_prior);
        self.head.plan.linearise_all(
            &self.instant(pose),
            |cell| self.wants(cell),
            |cell, terms| {
                // Readings come in the order of their cells, as terms do.
                let index = all_rows.len();
                let Some(reading) = self.sorted.usable.get(index).filter(|reading| reading.cell == cell) else {
                    return;
                };
                slacks_m.push(terms.slack_m);
                if P::CROSSES_WALLS {
                    walls_m.push(terms.wall_m);
                }
                let variance = self.head.noise[cell].displacement;
                let looser;
                let whitener = if variance > S::zero() {
                    looser = self.whiteners[index].displaced(&terms.jacobian, variance);
                    displaced.push(looser);
                    &looser
                } else {
                    &self.whiteners[index]
                };
                let rows = self.rows(reading, terms, whitener);
                let own = [&rows[0].by_pose, &rows[1].by_pose];
                add_outer(&mut information, own, own);
                if let Some(level) = level.as_mut().filter(|_| P::FINDS_LIGHT_LEVEL) {
                    self.add_level(level, &rows, reading);
                }
                if !is_twist_known {
                    elimination.add(self.share(reading), &rows);
                }
                if !terms.status.has_spot() {
                    let guide = self.guide_into(&mut information, reading, pose);
                    if !is_twist_known {
                        elimination.add(self.share(reading), &[guide]);
                    }
                    // A plane beyond the most that guide is not missed.
                    let _ = plane_rows.try_push((index, guide));
                }
                // As many as readings.
                all_rows.push(rows);
            },
        );
        mirror(&mut information);
        let sums = self.residual_sums(workspace);
        let Workspace { level, elimination, .. } = workspace;
        self.marginalised(information, sums, level.as_mut(), elimination)
    }

    /// The normal equations of rows with this `information` and these `sums`, without the `level` and the motion.
    #[inline(always)]
    pub fn marginalised(
        &self,
        information: Matrix6<S>,
        mut sums: ResidualSums<S>,
        level: Option<&mut Level<S>>,
        elimination: &mut Elimination<S>,
    ) -> NormalEquations<S> {
        let level_part = [S::zero(); 6];
        let mut normal =
            NormalEquations { chi2: sums.chi2, information, gradient: sums.by_pose, is_safe: true, level_part };
        let level = level.filter(|_| P::FINDS_LIGHT_LEVEL).map(|level| {
            self.marginalise(level, &mut normal, &mut sums);
            &*level
        });
        if self.motion.prior.is_some() {
            (normal.chi2, normal.gradient) = elimination.eliminate(&self.motion, level, &mut normal.information, &sums);
        }
        normal
    }

    #[inline(never)]
    fn marginalise(&self, level: &mut Level<S>, normal: &mut NormalEquations<S>, sums: &mut ResidualSums<S>) {
        let threshold = S::of(SAFE_ROUNDINGS) * S::epsilon();
        (normal.level_part, normal.is_safe) = level.marginalise(&mut normal.information, sums, threshold);
        self.take_level(level, sums);
        (normal.chi2, normal.gradient) = (sums.chi2, sums.by_pose);
    }

    /// Adds the `rows` of a reading to the sums of a light level that is not known.
    #[inline]
    pub fn add_level(&self, level: &mut Level<S>, rows: &[Row<S>; 2], reading: &Usable<S>) {
        if self.motion.prior.is_some() {
            level.add_moving(rows, self.share(reading));
        } else {
            level.add(rows);
        }
    }

    /// Marginalises the light level of the `sums` over all rows.
    #[inline]
    fn take_level(&self, level: &Level<S>, sums: &mut ResidualSums<S>) {
        if self.motion.prior.is_some() {
            level.take_from_motion_sums(sums);
        }
        level.take_from_sums(sums);
    }

    /// The rows of a reading whose cell has these `terms`.
    #[inline(always)]
    pub fn rows(&self, reading: &Usable<S>, terms: &CellTerms<S>, whitener: &Whitener<S>) -> [Row<S>; 2] {
        // Translations are counted in units of the length scale.
        let scaled_whitener = whitener.scaled(self.head.length_scale_m);
        let residual = whitener.apply([reading.pair[0] - terms.pair[0], reading.pair[1] - terms.pair[1]]);
        let mut rows = residual.map(|residual| Row { by_pose: [S::zero(); 6], by_level: S::zero(), residual });
        if self.level_information().is_some() {
            [rows[0].by_level, rows[1].by_level] = whitener.apply(terms.pair);
        }
        for axis in 0..6 {
            let whitener = if axis < 3 { &scaled_whitener } else { whitener };
            let column = whitener.apply(terms.jacobian.map(|row| row[axis]));
            rows[0].by_pose[axis] = column[0];
            rows[1].by_pose[axis] = column[1];
        }
        rows
    }

    /// Adds a [`Self::guide`] to the information.
    #[cold]
    #[inline(never)]
    fn guide_into(&self, information: &mut Matrix6<S>, reading: &Usable<S>, pose: &Transform<S>) -> Row<S> {
        let guide = self.guide(reading, pose);
        add_outer(information, [&guide.by_pose], [&guide.by_pose]);
        guide
    }

    /// The row of a cell that saw light and should see none at `pose`: its currents have no derivatives
    /// there, but its plane leads back.
    #[inline(never)]
    fn guide(&self, reading: &Usable<S>, pose: &Transform<S>) -> Row<S> {
        let (row, distance) = self.head.planes[reading.cell].row(reading, pose, self.head.length_scale_m);
        Row {
            by_pose: row.map(|value| value * self.head.length_scale_m / S::of(GUIDE_M)),
            by_level: S::zero(),
            residual: -distance / S::of(GUIDE_M),
        }
    }

    /// χ² and gradients of the residuals in `workspace`.
    #[inline]
    pub fn residual_sums(&self, workspace: &Workspace<S>) -> ResidualSums<S> {
        let mut sums = ResidualSums::none();
        for (reading, rows) in self.sorted.usable.iter().zip(&workspace.rows) {
            sums.add(rows, self.share(reading), self.has_bend());
        }
        if !workspace.plane_rows.is_empty() {
            self.add_planes(&mut sums, workspace);
        }
        sums
    }

    #[cold]
    #[inline(never)]
    fn add_planes(&self, sums: &mut ResidualSums<S>, workspace: &Workspace<S>) {
        for (index, row) in &workspace.plane_rows {
            sums.add(core::slice::from_ref(row), self.share(&self.sorted.usable[*index]), self.has_bend());
        }
    }

    /// The whitened residuals at `pose`, in the order of the readings: with an unknown light level, (I + s²·c·cᵀ)^(−½) times
    /// those at the nominal one.
    pub fn whitened(&self, pose: &Transform<S>, workspace: &mut Workspace<S>) -> ArrayVec<[S; 2], MAX_CELLS> {
        workspace.count();
        let currents = self.predicted(pose);
        let of = |(reading, whitener): (&Usable<S>, &Whitener<S>)| {
            let [first, second] = currents[reading.cell];
            whitener.apply([reading.pair[0] - first, reading.pair[1] - second])
        };
        let mut residuals: ArrayVec<[S; 2], MAX_CELLS> =
            self.sorted.usable.iter().zip(&self.whiteners).map(of).collect();
        if let Some(prior) = self.level_information() {
            let (information, along) = self.level_sums(&currents, prior);
            // (I + s²·c·cᵀ)^(−½) = I − c·cᵀ/(√D·(√D + s⁻¹)).
            let root = information.root();
            let share = along / (root * (root + prior.root()));
            for (residual, (reading, of)) in residuals.iter_mut().zip(self.sorted.usable.iter().zip(&self.whiteners)) {
                let [first, second] = of.apply(currents[reading.cell]);
                residual[0] -= share * first;
                residual[1] -= share * second;
            }
        }
        residuals
    }

    /// By what factor all light is brighter than the head's scene says, if the tool is where the cells deliver `currents`.
    pub fn light_level(&self, currents: &[[S; 2]]) -> S {
        self.level_information().map_or(S::one(), |prior| {
            let (information, along) = self.level_sums(currents, prior);
            S::one() + along / information
        })
    }

    /// D and cᵀr of the readings where the cells deliver `currents`: see [`super::level`].
    #[inline(never)]
    fn level_sums(&self, currents: &[[S; 2]], prior: S) -> (S, S) {
        let (mut information, mut along) = (prior, S::zero());
        for (reading, of) in self.sorted.usable.iter().zip(&self.whiteners) {
            let [expected, measured] = [of.apply(currents[reading.cell]), of.apply(reading.pair)];
            for (c, measured) in expected.into_iter().zip(measured) {
                information += c * c;
                along += c * (measured - c);
            }
        }
        (information, along)
    }

    /// χ² and gradient at `pose`, with the Jacobian of the last linearisation.
    pub fn reevaluate(&self, pose: &Transform<S>, workspace: &mut Workspace<S>) -> (S, Vector6<S>) {
        let mut index = 0;
        workspace.count();
        self.head.plan.currents_all(
            &self.instant(pose),
            |cell| self.wants(cell),
            |cell, currents| {
                let Some(reading) = self.sorted.usable.get(index).filter(|reading| reading.cell == cell) else {
                    return;
                };
                let residual = [reading.pair[0] - currents[0], reading.pair[1] - currents[1]];
                let whitener = workspace.displaced.get(index).unwrap_or(&self.whiteners[index]);
                for (row, residual) in workspace.rows[index].iter_mut().zip(whitener.apply(residual)) {
                    row.residual = residual;
                }
                index += 1;
            },
        );
        for (index, row) in &mut workspace.plane_rows {
            row.residual = self.guide(&self.sorted.usable[*index], pose).residual;
        }
        let mut sums = self.residual_sums(workspace);
        if let Some(level) = self.level(workspace) {
            self.take_level(level, &mut sums);
        }
        workspace.elimination.apply(&sums)
    }
}

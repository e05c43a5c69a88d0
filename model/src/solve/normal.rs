//! χ² and its expansion at a pose: whitened rows, their normal equations, and the elimination of
//! what is not known of the tool's motion.
//!
//! Unknowns are (δt/arm, δθ): translations counted in units of the emitters' distance from the
//! tool's origin, so that the normal matrix mixes like with like. A cell exposed τ after the
//! reference instant sees the pose advanced by τ·twist; of a twist known only with a variance the
//! deviation w is six more unknowns with a prior. With A the rows of one cell,
//!
//! M₀ = ΣAᵀA, M₁ = Στ·AᵀA, M₂ = Στ²·AᵀA, K = M₂ + P⁻¹, information = M₀ − M₁·K⁻¹·M₁
//!
//! and likewise for the gradient and χ²: the twist is marginalised exactly, with the correlation
//! between cells that it brings.

// heapless clears the room of a new vector; here that would take as long as the algebra.
use arrayvec::ArrayVec;

use crate::plan::{Instant, Plan};
use crate::pose::Transform;
use crate::real::Real;
use crate::scalar::Scalar;
use crate::scene::MAX_CELLS;

use super::algebra::{Factor, Matrix6, Triangle, Vector6, dot, square};
use super::planes::PlaneCell;
use super::readings::Usable;
use super::weights::{CellNoise, Whitener};

/// How firmly a plane guides: its distance is worth one σ per so much.
const GUIDE_M: f64 = 20e-6;

/// Largest motion of a spot's side per motion of its emitter, with room for turns of long arms.
const MOST_MAGNIFICATION: f64 = 10.0;

/// Most planes that guide: more than three fix a pose.
const MAX_GUIDES: usize = 4;

/// Least ratio of a pivot to its diagonal element, in units of rounding, for which normal equations
/// are trusted: half of the digits and some are left.
const SAFE_ROUNDINGS: f64 = 1e4;

/// Largest information a prior on the twist can have: it is then known.
const KNOWN: f64 = 1e30;

/// Motion of the tool within a frame, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion<S: Scalar> {
    pub(super) linear: S::Vec3,
    pub(super) angular: S::Vec3,
    /// The largest |τ|, seconds; zero if all cells are exposed at one instant.
    pub(super) duration: S,
    /// P⁻¹ of (linear, angular) in units of arm/duration and 1/duration; `None`: the twist is known.
    pub(super) prior: Option<[S; 2]>,
}

impl<S: Scalar> Motion<S> {
    /// With the standard deviations of a twist, m/s and rad/s.
    pub(super) fn new(
        linear: S::Vec3,
        angular: S::Vec3,
        [sigma_linear, sigma_angular]: [f64; 2],
        offsets_s: &[S],
        arm: S,
    ) -> Self {
        let duration = offsets_s.iter().fold(S::zero(), |longest, offset| longest.max(offset.abs()));
        let information = |sigma: f64, unit: S| {
            let share = S::of(sigma) * duration / unit;
            (share * share).recip().min(S::of(KNOWN))
        };
        let unknown = duration > S::zero() && (sigma_linear > 0.0 || sigma_angular > 0.0);
        let prior = unknown.then(|| [information(sigma_linear, arm), information(sigma_angular, S::one())]);
        Self { linear, angular, duration, prior }
    }
}

/// What does not change during one refinement.
pub(super) struct Problem<'a, S: Scalar> {
    pub(super) plan: &'a Plan<S>,
    pub(super) planes: &'a [PlaneCell<S>],
    pub(super) noise: &'a [CellNoise<S>],
    /// Exposure of each cell relative to the reference instant, seconds; empty: all at it.
    pub(super) offsets_s: &'a [S],
    pub(super) readings: &'a [Usable<S>],
    pub(super) motion: Motion<S>,
    pub(super) arm: S,
    /// Relative change of the derivatives per unit of a scaled step.
    pub(super) bend: S,
}

/// One whitening per usable reading.
pub(super) type Whiteners<S> = ArrayVec<Whitener<S>, MAX_CELLS>;

/// A whitened datum: derivatives by the scaled pose, residual.
#[derive(Clone, Copy, Debug)]
struct Row<S> {
    by_pose: Vector6<S>,
    residual: S,
}

/// The rows of the last expansion, and of the residuals since.
#[derive(Debug)]
pub(super) struct Workspace<S: Scalar> {
    /// Of each usable reading, in order, two each.
    rows: ArrayVec<[Row<S>; 2], MAX_CELLS>,
    /// Readings whose cell has no spot: their plane is a third row.
    guided: ArrayVec<(usize, Row<S>), MAX_GUIDES>,
    /// Of readings of cells whose parts may be displaced: their weights at the last expansion.
    displaced: ArrayVec<Whitener<S>, MAX_CELLS>,
    /// The least of the readings' slacks: see [`crate::plan::CellTerms`].
    slack_m: S,
    /// M₁ and M₂, where the twist is not known.
    twist_moments: [Matrix6<S>; 2],
    elimination: Option<Elimination<S>>,
    /// Evaluations of all cells that may still be made: see [`Self::with_work`].
    pub(super) work: usize,
    /// Evaluations made.
    pub(super) evaluations: usize,
}

impl<S: Scalar> Workspace<S> {
    /// Nothing in it yet, and no limit to the work.
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self::with_work(usize::MAX)
    }

    /// For at most `work` evaluations of all cells, with or without derivatives: what a solve costs,
    /// whatever the processor. Refinements end when it is used up; one that has begun makes three
    /// more at most.
    #[inline(always)]
    pub(super) fn with_work(work: usize) -> Self {
        Self {
            work,
            evaluations: 0,
            rows: ArrayVec::new(),
            guided: ArrayVec::new(),
            displaced: ArrayVec::new(),
            slack_m: S::zero(),
            twist_moments: [[[S::zero(); 6]; 6]; 2],
            elimination: None,
        }
    }

    /// One more evaluation.
    #[inline(always)]
    fn count(&mut self) {
        self.work = self.work.saturating_sub(1);
        self.evaluations += 1;
    }
}

/// Cost and its expansion at a pose, the twist eliminated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expansion<S> {
    pub(super) chi2: S,
    pub(super) information: Matrix6<S>,
    pub(super) descent: Vector6<S>,
}

/// What takes the twist out of gradient and χ².
#[derive(Clone, Copy, Debug)]
struct Elimination<S> {
    /// L of K = L·Lᵀ.
    factor: Factor<S>,
    /// Columns of L⁻¹·M₁.
    mixed: Matrix6<S>,
}

/// A step of Gauss and Newton.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step<S> {
    pub(super) factor: Factor<S>,
    pub(super) step: Vector6<S>,
    /// By how much χ² falls along it if derivatives stay.
    pub(super) gain: S,
    /// Whether it is from the rows: then the factor alone solves nothing to its digits.
    pub(super) by_rows: bool,
}

/// Gradient moments and χ² of residuals.
#[derive(Clone, Copy)]
struct Gradient<S> {
    chi2: S,
    by_pose: Vector6<S>,
    by_twist: Vector6<S>,
}

impl<S: Scalar> Gradient<S> {
    /// Adds what `rows` of one reading say.
    #[inline(always)]
    fn add(&mut self, rows: &[Row<S>], share: S) {
        let mut own = [S::zero(); 6];
        for row in rows {
            self.chi2 += row.residual * row.residual;
            for i in 0..6 {
                own[i] += row.by_pose[i] * row.residual;
            }
        }
        for i in 0..6 {
            self.by_pose[i] += own[i];
            self.by_twist[i] += share * own[i];
        }
    }
}

impl<S: Scalar> Expansion<S> {
    /// The most that a step of unit length does to the whitened currents, to a factor of √6.
    pub(super) fn steepness(&self) -> S {
        (0..6).fold(S::zero(), |most, i| most.max(self.information[i][i])).square_root()
    }

    /// The information times a step.
    pub(super) fn times(&self, step: &Vector6<S>) -> Vector6<S> {
        self.information.map(|row| dot(&row, step))
    }

    /// χ² after a step if derivatives stay.
    pub(super) fn chi2_after(&self, step: &Vector6<S>) -> S {
        self.chi2 - S::two() * dot(&self.descent, step) + self.along(step)
    }

    /// The length of a step in σ, squared.
    pub(super) fn along(&self, step: &Vector6<S>) -> S {
        dot(step, &self.times(step))
    }
}

impl<S: Scalar> Elimination<S> {
    /// Takes the twist out of an expansion.
    #[inline(never)]
    fn reduce(&self, expansion: &mut Expansion<S>, gradient: &Gradient<S>) {
        for i in 0..6 {
            for j in 0..6 {
                for k in 0..6 {
                    let known = self.mixed[i][k] * self.mixed[j][k];
                    expansion.information[i][j] -= known;
                }
            }
        }
        (expansion.chi2, expansion.descent) = self.apply(gradient);
    }

    fn apply(&self, gradient: &Gradient<S>) -> (S, Vector6<S>) {
        let twist = self.factor.forward(&gradient.by_twist);
        let mut descent = gradient.by_pose;
        for i in 0..6 {
            for k in 0..6 {
                let known = self.mixed[i][k] * twist[k];
                descent[i] -= known;
            }
        }
        (twist.iter().fold(gradient.chi2, |chi2, &value| chi2 - value * value).max(S::zero()), descent)
    }
}

impl<S: Scalar> Problem<'_, S> {
    fn instant<'b>(&'b self, pose: &'b Transform<S>) -> Instant<'b, S> {
        Instant { pose, linear: self.motion.linear, angular: self.motion.angular, offsets_s: self.offsets_s }
    }

    fn wants(&self, cell: usize) -> bool {
        self.readings.iter().any(|reading| reading.cell == cell)
    }

    /// Exposure of a reading's cell in units of the motion's duration.
    #[inline(always)]
    fn share(&self, reading: &Usable<S>) -> S {
        self.offsets_s.get(reading.cell).map_or(S::zero(), |&offset| offset / self.motion.duration)
    }

    /// The currents above dark that all cells deliver with the tool at `pose` at the reference
    /// instant.
    pub(super) fn predicted(&self, pose: &Transform<S>) -> heapless::Vec<[S; 2], MAX_CELLS> {
        let mut currents = heapless::Vec::new();
        self.plan.currents_all(
            &self.instant(pose),
            |_| true,
            |_, pair| {
                // As many as there are cells.
                let _ = currents.push(pair);
            },
        );
        currents
    }

    /// The weights of the readings.
    pub(super) fn whiteners(&self) -> Whiteners<S> {
        self.readings.iter().map(|reading| self.noise[reading.cell].whitener(reading.pair)).collect()
    }

    /// Weights for the way from far off.
    pub(super) fn coarse_whiteners(&self) -> Whiteners<S> {
        self.readings
            .iter()
            .map(|reading| {
                let length = self.planes[reading.cell].detector_length_m();
                self.noise[reading.cell].coarse(length).whitener(reading.pair)
            })
            .collect()
    }

    /// χ² and its expansion at `pose`.
    pub(super) fn expand(
        &self,
        pose: &Transform<S>,
        whiteners: &Whiteners<S>,
        room: &mut Workspace<S>,
    ) -> Expansion<S> {
        room.count();
        let Workspace { rows: all_rows, guided, displaced, slack_m, twist_moments, .. } = room;
        *slack_m = S::infinity();
        displaced.clear();
        all_rows.clear();
        guided.clear();
        let mut information = [[S::zero(); 6]; 6];
        let knows_twist = self.motion.prior.is_none();
        if !knows_twist {
            *twist_moments = [information; 2];
        }
        self.plan.linearise_all(
            &self.instant(pose),
            |cell| self.wants(cell),
            |cell, terms| {
                // Readings come in the order of their cells, as terms do.
                let index = all_rows.len();
                let Some(reading) = self.readings.get(index).filter(|reading| reading.cell == cell) else {
                    return;
                };
                *slack_m = slack_m.min(terms.slack_m);
                let variance = self.noise[cell].displacement;
                let looser;
                let whitener = if variance > S::zero() {
                    looser = whiteners[index].displaced(&terms.jacobian, variance);
                    displaced.push(looser);
                    &looser
                } else {
                    &whiteners[index]
                };
                // Translations are counted in units of the arm.
                let whitener_in_arms = whitener.scaled(self.arm);
                let residual = whitener.apply([reading.pair[0] - terms.pair[0], reading.pair[1] - terms.pair[1]]);
                let mut rows = residual.map(|residual| Row { by_pose: [S::zero(); 6], residual });
                for axis in 0..6 {
                    let whitener = if axis < 3 { &whitener_in_arms } else { whitener };
                    let column = whitener.apply(terms.jacobian.map(|row| row[axis]));
                    rows[0].by_pose[axis] = column[0];
                    rows[1].by_pose[axis] = column[1];
                }
                let own = [&rows[0].by_pose, &rows[1].by_pose];
                add_outer(&mut information, own, own);
                if !knows_twist {
                    self.add_twist(twist_moments, reading, &rows);
                }
                if !terms.status.has_spot() {
                    let guide = self.guide(reading, pose);
                    add_outer(&mut information, [&guide.by_pose], [&guide.by_pose]);
                    if !knows_twist {
                        self.add_twist(twist_moments, reading, &[guide]);
                    }
                    // One that does not fit only shows the way less.
                    let _ = guided.try_push((index, guide));
                }
                // As many as readings.
                all_rows.push(rows);
            },
        );
        mirror(&mut information);
        let gradient = self.gradient(room);
        let mut expansion = Expansion { chi2: gradient.chi2, information, descent: gradient.by_pose };
        room.elimination = None;
        if !knows_twist {
            room.elimination = self.elimination(&mut room.twist_moments);
            if let Some(elimination) = &room.elimination {
                elimination.reduce(&mut expansion, &gradient);
            }
        }
        expansion
    }

    /// The χ² that the last expansion promises at the minimum without reading `index`; `None` if that
    /// leaves a direction free.
    #[inline(never)]
    pub(super) fn least_chi2_without(&self, index: usize, room: &Workspace<S>) -> Option<S> {
        let zero = [[S::zero(); 6]; 6];
        let (mut information, mut moments) = (zero, [zero; 2]);
        let mut sum = Gradient { chi2: S::zero(), by_pose: [S::zero(); 6], by_twist: [S::zero(); 6] };
        let of_readings = room.rows.iter().enumerate().map(|(reading, rows)| (reading, rows.as_slice()));
        let of_guides = room.guided.iter().map(|(reading, row)| (*reading, core::slice::from_ref(row)));
        for (reading, rows) in of_readings.chain(of_guides).filter(|(reading, _)| *reading != index) {
            let reading = &self.readings[reading];
            for row in rows {
                add_outer(&mut information, [&row.by_pose], [&row.by_pose]);
                self.add_twist(&mut moments, reading, &[*row]);
            }
            sum.add(rows, self.share(reading));
        }
        mirror(&mut information);
        let mut expansion = Expansion { chi2: sum.chi2, information, descent: sum.by_pose };
        if let Some(elimination) = self.elimination(&mut moments) {
            elimination.reduce(&mut expansion, &sum);
        }
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        let factor = Factor::of_matrix(&expansion.information, S::zero(), safe)?;
        Some(expansion.chi2 - square(&factor.forward(&expansion.descent)))
    }

    /// What `rows` of one reading add to M₁ and M₂.
    #[inline(never)]
    fn add_twist<const N: usize>(&self, moments: &mut [Matrix6<S>; 2], reading: &Usable<S>, rows: &[Row<S>; N]) {
        let share = self.share(reading);
        let own = rows.each_ref().map(|row| &row.by_pose);
        let mut weight = share;
        for moment in moments {
            let weighted = own.map(|row| row.map(|value| weight * value));
            add_outer(moment, weighted.each_ref(), own);
            weight *= share;
        }
    }

    #[inline(never)]
    fn elimination(&self, [mixed, twist]: &mut [Matrix6<S>; 2]) -> Option<Elimination<S>> {
        let prior = self.motion.prior?;
        mirror(mixed);
        // Of a symmetric matrix its factor takes the lower half.
        for (i, row) in twist.iter_mut().enumerate() {
            row[i] += prior[i / 3];
        }
        // Positive definite: the prior sees to that.
        let factor = Factor::of_matrix(twist, S::zero(), S::zero())?;
        Some(Elimination { mixed: mixed.map(|column| factor.forward(&column)), factor })
    }

    /// A cell that saw light and should see none at `pose` has no slope to descend on: its plane
    /// shows the way.
    fn guide(&self, reading: &Usable<S>, pose: &Transform<S>) -> Row<S> {
        let (row, distance) = self.planes[reading.cell].row(reading, pose, self.arm);
        Row { by_pose: row.map(|value| value * self.arm / S::of(GUIDE_M)), residual: -distance / S::of(GUIDE_M) }
    }

    /// The moments of the residuals in `room`.
    #[inline]
    fn gradient(&self, room: &Workspace<S>) -> Gradient<S> {
        let mut sum = Gradient { chi2: S::zero(), by_pose: [S::zero(); 6], by_twist: [S::zero(); 6] };
        for (reading, rows) in self.readings.iter().zip(&room.rows) {
            sum.add(rows, self.share(reading));
        }
        for (index, row) in &room.guided {
            sum.add(core::slice::from_ref(row), self.share(&self.readings[*index]));
        }
        sum
    }

    /// The whitened residuals at `pose`, in the order of the readings.
    pub(super) fn whitened(
        &self,
        pose: &Transform<S>,
        whiteners: &Whiteners<S>,
        room: &mut Workspace<S>,
    ) -> ArrayVec<[S; 2], MAX_CELLS> {
        room.count();
        let currents = self.predicted(pose);
        let of = |(reading, whitener): (&Usable<S>, &Whitener<S>)| {
            let [first, second] = currents[reading.cell];
            whitener.apply([reading.pair[0] - first, reading.pair[1] - second])
        };
        self.readings.iter().zip(whiteners).map(of).collect()
    }

    /// χ² and descent at `pose` with the derivatives of the last expansion, which was not far away.
    pub(super) fn revisit(
        &self,
        pose: &Transform<S>,
        whiteners: &Whiteners<S>,
        room: &mut Workspace<S>,
    ) -> (S, Vector6<S>) {
        let mut index = 0;
        room.count();
        self.plan.currents_all(
            &self.instant(pose),
            |cell| self.wants(cell),
            |cell, currents| {
                let Some(reading) = self.readings.get(index).filter(|reading| reading.cell == cell) else {
                    return;
                };
                let residual = [reading.pair[0] - currents[0], reading.pair[1] - currents[1]];
                let whitener = room.displaced.get(index).unwrap_or(&whiteners[index]);
                for (row, residual) in room.rows[index].iter_mut().zip(whitener.apply(residual)) {
                    row.residual = residual;
                }
                index += 1;
            },
        );
        for (index, row) in &mut room.guided {
            row.residual = self.guide(&self.readings[*index], pose).residual;
        }
        let gradient = self.gradient(room);
        match &room.elimination {
            Some(elimination) => elimination.apply(&gradient),
            None => (gradient.chi2, gradient.by_pose),
        }
    }

    /// Factor and Gauss–Newton step of an expansion; `None` if it is singular to the precision of its
    /// numbers.
    #[inline]
    pub(super) fn step(&self, at: &Expansion<S>, damping: S, room: &Workspace<S>) -> Option<Step<S>> {
        let safe = S::of(SAFE_ROUNDINGS) * S::epsilon();
        match Factor::of_matrix(&at.information, damping, safe) {
            Some(factor) => {
                let half_way = factor.forward(&at.descent);
                Some(Step { step: factor.backward(&half_way), gain: square(&half_way), factor, by_rows: false })
            }
            None if damping > S::zero() => None,
            None => Some(self.step_by_rows(room)),
        }
    }

    /// The step from the rows themselves: slow, but right for any condition number that the number
    /// type resolves.
    #[cold]
    fn step_by_rows(&self, room: &Workspace<S>) -> Step<S> {
        let mut triangle = Triangle::<S, 12>::new();
        if let Some(prior) = self.motion.prior {
            for i in 0..6 {
                let mut row = [S::zero(); 12];
                row[i] = prior[i / 3].sqrt();
                triangle.add(row, S::zero());
            }
        }
        let mut add = |row: &Row<S>, share: S| {
            let twist = if self.motion.prior.is_some() { share } else { S::zero() };
            triangle.add(
                core::array::from_fn(|i| if i < 6 { row.by_pose[i] * twist } else { row.by_pose[i - 6] }),
                row.residual,
            );
        };
        for (reading, rows) in self.readings.iter().zip(&room.rows) {
            rows.iter().for_each(|row| add(row, self.share(reading)));
        }
        for (index, row) in &room.guided {
            add(row, self.share(&self.readings[*index]));
        }
        let (factor, half_way) = triangle.last_six();
        Step { step: factor.backward(&half_way), gain: square(&half_way), factor, by_rows: true }
    }

    /// The factor of an expansion alone.
    #[cold]
    #[inline(never)]
    pub(super) fn factor(&self, at: &Expansion<S>, room: &Workspace<S>) -> Option<Factor<S>> {
        self.step(at, S::zero(), room).map(|next| next.factor)
    }

    /// Whether a step of this `length` moves no spot of the last expansion so far that derivatives jump.
    pub(super) fn is_smooth(&self, length: S, room: &Workspace<S>) -> bool {
        room.slack_m > S::of(MOST_MAGNIFICATION) * length * self.arm
    }

    /// The least share of an error in one cell's currents that stays visible in its residuals, over
    /// all cells: the smaller eigenvalue of I − A·C·Aᵀ, A the cell's rows and C = (L·Lᵀ)⁻¹. The rest
    /// of the error goes into the pose.
    pub(super) fn least_visible(&self, factor: &Factor<S>, room: &Workspace<S>) -> S {
        room.rows.iter().fold(S::one(), |least, rows| {
            let [u, v] = [0, 1].map(|k| factor.forward(&rows[k].by_pose));
            let (uu, vv, uv) = (square(&u), square(&v), dot(&u, &v));
            let half_difference = S::half() * (uu - vv);
            let radius = (half_difference * half_difference + uv * uv).square_root();
            least.min(S::one() - S::half() * (uu + vv) - radius)
        })
    }
}

/// Whether a processor does a whole square sooner than its lower half: with more than one lane.
const fn adds_squares<S: Scalar>() -> bool {
    <S::Lanes as Real>::LANES > 1
}

/// Adds Σ left·rightᵀ, which is symmetric: at least its lower half.
#[inline(always)]
fn add_outer<S: Scalar, const N: usize>(matrix: &mut Matrix6<S>, left: [&Vector6<S>; N], right: [&Vector6<S>; N]) {
    for i in 0..6 {
        let end = if adds_squares::<S>() { 6 } else { i + 1 };
        for j in 0..end {
            let mut sum = matrix[i][j];
            for k in 0..N {
                sum += left[k][i] * right[k][j];
            }
            matrix[i][j] = sum;
        }
    }
}

/// Completes what [`add_outer`] has added up.
#[inline(always)]
fn mirror<S: Scalar>(matrix: &mut Matrix6<S>) {
    if !adds_squares::<S>() {
        for i in 0..6 {
            for j in i + 1..6 {
                matrix[i][j] = matrix[j][i];
            }
        }
    }
}

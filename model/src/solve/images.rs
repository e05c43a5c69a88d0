//! Other poses that deliver nearly the same currents: mirror images, and the twins of three cells.
//!
//! The position of its light puts an emitter on a plane, and its current says how far off the slit's
//! middle it is along the slit, but not on which side. Where the planes alone fix the pose there is one
//! answer. Where they do not, an image has some emitters on the other side.
//!
//! Six currents for six unknowns fold the space of poses: on both sides of a fold lie poses with the
//! same currents, which move towards each other and vanish where a tool meets it. Near a fold the
//! currents hardly change along one direction v, and bend: a step of s along it changes the whitened
//! currents by j·s + ½c·s², so that the twin of a pose lies at s = −2j/c.

use arrayvec::ArrayVec;

use crate::entries::Scalar;
use crate::plan::{CompiledScene, Optics};
use crate::pose::{Pose, Transform};
use crate::scalar::{Linear3, Number};
use crate::scene::MAX_CELLS;

use super::accept::{ALIKE, DISTINCT_SIGMAS, Fit, is_singular, sigmas_between};
use super::algebra::{Factor, Matrix6, square};
use super::compiled::Compiled;
use super::home::spread;
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::{Problem, Workspace};
use super::outcome::Solution;
use super::planes::{PlaneCell, settle};
use super::readings::{Sorted, Usable};
use super::twist::Prior;

/// Rough approaches that are remembered, so that none is refined twice.
const REMEMBERED: usize = 15;

/// Displacement, in σ of a rough approach, up to which two approaches have led to one place.
const SAME_SIGMAS: f64 = 0.3;

pub struct Seen<S: Number> {
    places: ArrayVec<Transform<S>, REMEMBERED>,
    pub again: usize,
}

impl<S: Number> Seen<S> {
    pub fn new() -> Self {
        Self { places: ArrayVec::new(), again: 0 }
    }

    /// Whether `approach` has led where another has before; it is remembered.
    pub fn has(&mut self, approach: &Minimum<S>, length_scale_m: S) -> bool {
        let is_known = self.places.iter().any(|before| {
            approach.factor.as_ref().is_some_and(|factor| {
                sigmas_between(factor, before, &approach.pose, length_scale_m) <= S::of(SAME_SIGMAS)
            })
        });
        if is_known {
            self.again += 1;
        } else {
            // One that does not fit only makes for more work.
            let _ = self.places.try_push(approach.pose);
        }
        is_known
    }
}

/// The best pose so far, and the best of those that are not the same.
#[derive(Clone, Copy, Debug)]
pub struct Minima<S: Number> {
    pub best: Option<(Minimum<S>, Fit)>,
    rival: Option<(Minimum<S>, Fit)>,
    length_scale_m: S,
}

impl<S: Number> Minima<S> {
    pub fn new(length_scale_m: S) -> Self {
        Self { best: None, rival: None, length_scale_m }
    }

    pub fn add(&mut self, minimum: Minimum<S>, fit: Fit) {
        let is_better = |other: &Option<(Minimum<S>, Fit)>| {
            other.is_none_or(|(other, other_fit)| fit > other_fit || fit == other_fit && minimum.chi2 < other.chi2)
        };
        let is_new = self.best.is_none_or(|(best, _)| are_distinct(&best, &minimum, self.length_scale_m));
        if is_better(&self.best) {
            if is_new {
                self.rival = self.best;
            }
            self.best = Some((minimum, fit));
        } else if is_new && is_better(&self.rival) {
            self.rival = Some((minimum, fit));
        }
    }

    /// Adds the minima that are reached from `places`, in so many steps.
    pub fn add_near<P: Optics<S>>(
        &mut self,
        places: [Option<Transform<S>>; 2],
        problem: &Problem<'_, S, P>,
        stopping: Stopping<S>,
        workspace: &mut Workspace<S>,
    ) -> usize {
        let minima = places.into_iter().flatten().map(|place| {
            let minimum = problem.minimise(place, stopping, workspace);
            self.add(minimum, problem.fit(&minimum));
            minimum.iterations
        });
        minima.sum()
    }

    pub fn places(&self) -> [Option<Transform<S>>; 2] {
        [self.best, self.rival].map(|found| found.map(|(minimum, _)| minimum.pose))
    }

    /// Whether the data leave directions free at the best pose.
    pub fn is_singular(&self) -> bool {
        self.best.is_some_and(|(best, _)| best.factor.as_ref().is_none_or(is_singular))
    }

    pub fn best_fit(&self) -> Fit {
        self.best.map_or(Fit::None, |(_, fit)| fit)
    }

    /// Whether two poses fit alike, and no third can be so much better that neither counts.
    pub fn are_alike(&self) -> bool {
        match (self.best, self.rival) {
            (Some((best, fit)), Some((rival, rival_fit))) => {
                fit != Fit::None && rival_fit == fit && rival.chi2 - best.chi2 < S::of(ALIKE)
            }
            _ => false,
        }
    }

    /// Whether the best pose fits as noise makes likely.
    pub fn is_likely(&self, gate: S) -> bool {
        self.best.is_some_and(|(best, _)| is_likely(best.chi2, gate))
    }

    pub fn cannot_be_beaten(&self) -> bool {
        self.best.is_some_and(|(best, fit)| fit == Fit::Full && best.chi2 < S::of(ALIKE))
    }
}

/// Share of the χ² that noise explains beyond which a pose is looked for that fits better: one in 5000 honest scans of six
/// cells has more.
const HARDLY_NOISE: f64 = 0.5;

/// Whether noise makes a χ² likely.
#[inline(always)]
pub fn is_likely<S: Number>(chi2: S, gate: S) -> bool {
    chi2 <= S::of(HARDLY_NOISE) * gate
}

/// Whether two poses differ by more than the data of either allow.
pub fn are_distinct<S: Number>(a: &Minimum<S>, b: &Minimum<S>, length_scale_m: S) -> bool {
    [a, b].iter().any(|by| {
        by.factor.as_ref().is_none_or(|factor| {
            let sigmas = sigmas_between(factor, &a.pose, &b.pose, length_scale_m);
            sigmas.is_nan() || sigmas > S::of(DISTINCT_SIGMAS)
        })
    })
}

/// Steps along the softest direction, both ways, each twice as long as the one before.
pub const SOFT_STEPS: usize = 10;

/// The first of them, in radians or its equivalent in translation.
const SOFT_STEP: f64 = 0.03;

/// Least singular value of the planes' derivatives at which they fix a pose: directions of planes and
/// turns are counted in units of one, so that a head of six cells has some 1.4 if its planes are spread
/// evenly.
const FIXED: f64 = 0.1;

/// χ² of an image in noise-free data up to which a head counts as one that has images: between the
/// poses that are looked at, where an image runs into its pose, χ² falls to nothing. Rings of six rolled
/// alike have at most 2e4, alternately by 0.1 rad more and less 7e4; of 24 random heads the least had
/// 3.5e4 and the others 1e5 and more, or none.
const NEAR: f64 = 3e4;

/// Poses of the reach at which the planes are looked at when a scene is compiled, and home.
const LOOKS: usize = 32;

/// Steps that put three emitters on their other sides.
const STEPS: usize = 4;

/// Patterns of sides of three emitters, other than the one that is known.
const PATTERNS: usize = 7;

/// Most images that [`images`] gives: of two sets of three emitters.
pub const IMAGES: usize = 2 * PATTERNS;

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// `minimum` moved along the direction that its data hold least: one of [`SOFT_STEPS`].
    pub fn softened(&self, minimum: &Minimum<S>, index: usize) -> Option<Transform<S>> {
        let (_, direction) = minimum.factor.as_ref()?.singular()[0];
        let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let length = S::of(sign * SOFT_STEP * f64::from(1_u32 << (index / 2)));
        let [shift, turn] = [0, 3].map(|i| S::Vec3::new(direction[i], direction[i + 1], direction[i + 2]));
        Some(minimum.pose.moved(shift * (length * self.length_scale_m), turn * length))
    }
}

impl<S: Scalar> Compiled<S> {
    /// Whether there are images of poses over the reach of the head with as many cells lit as tell a
    /// pose apart from images, if the planes fix it.
    pub fn may_have_images(&self) -> bool {
        let home = self.home.to_transform();
        core::iter::once(home).chain((0..LOOKS).map(|index| spread(&home, index))).any(|pose| {
            let sorted = self.seen_at(&pose.to_pose());
            sorted.usable.len() >= <CompiledScene<S> as Optics<S>>::UNIQUE_FROM
                && self.firmness_of_planes(&sorted, &pose) < S::of(FIXED)
                && self.has_image_near(&sorted, &pose)
        })
    }

    /// How firmly the planes of the readings fix `pose`: the least singular value of their derivatives.
    fn firmness_of_planes(&self, sorted: &Sorted<S>, pose: &Transform<S>) -> S {
        let mut matrix: Matrix6<S> = [[S::zero(); 6]; 6];
        for reading in &sorted.usable {
            let (row, _) = self.planes[reading.cell].row(reading, pose, self.length_scale_m);
            for i in 0..6 {
                for j in 0..6 {
                    matrix[i][j] += row[i] * row[j];
                }
            }
        }
        let factor = Factor::of_matrix(&matrix, S::zero(), S::epsilon());
        factor.map_or(S::zero(), |factor| factor.singular()[0].0)
    }

    /// Whether `pose`, which the readings are of, has an image that fits them nearly as well.
    fn has_image_near(&self, sorted: &Sorted<S>, pose: &Transform<S>) -> bool {
        let problem = self.problem(sorted, &Prior::at_rest());
        let workspace = &mut Workspace::new();
        let here = problem.minimise(*pose, Stopping::rough(), workspace);
        (0..SOFT_STEPS)
            .map(|index| self.softened(&here, index))
            .chain((0..IMAGES).map(|index| image(&self.planes, &sorted.usable, pose, self.length_scale_m, index)))
            .flatten()
            .any(|start| {
                let there = problem.minimise(start, Stopping::rough(), workspace);
                there.converged && there.chi2 < S::of(NEAR) && are_distinct(&here, &there, self.length_scale_m)
            })
    }
}

/// Three of the `readings` whose emitters are not in `taken` and span the largest triangle.
fn widest<S: Number>(cells: &[PlaneCell<S>], readings: &[Usable<S>], taken: &[usize]) -> Option<[usize; 3]> {
    let numbers = readings.iter().map(|reading| reading.cell).filter(|cell| !taken.contains(cell));
    let free: ArrayVec<(usize, S::Vec3), MAX_CELLS> =
        numbers.filter_map(|cell| Some((cell, cells.get(cell)?.emitter_tool()))).collect();
    let mut best = None;
    let mut most = S::zero();
    for (n, &(i, a)) in free.iter().enumerate() {
        for (m, &(j, b)) in free.iter().enumerate().skip(n + 1) {
            for &(k, c) in free.iter().skip(m + 1) {
                let area = (b - a).cross(c - a).length();
                if area > most {
                    (best, most) = (Some([i, j, k]), area);
                }
            }
        }
    }
    best
}

/// Where a mirror image of `pose` may be, `index` below [`IMAGES`]: some of three emitters on their
/// other sides. `None` if there are not so many cells.
pub fn image<S: Number>(
    cells: &[PlaneCell<S>],
    readings: &[Usable<S>],
    pose: &Transform<S>,
    length_scale_m: S,
    index: usize,
) -> Option<Transform<S>> {
    let mut three = widest(cells, readings, &[])?;
    if index >= PATTERNS {
        three = widest(cells, readings, &three)?;
    }
    // All of them first: a head that is its own mirror image.
    let pattern = PATTERNS - index % PATTERNS;
    let mut places = three.map(|cell| (cell, cells[cell].sides(pose)));
    places
        .iter_mut()
        .enumerate()
        .filter(|(i, _)| pattern & 1 << i == 0)
        .for_each(|(_, (_, sides))| sides[1] = sides[0]);
    let axes =
        [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].map(|(x, y, z)| S::Vec3::new(S::of(x), S::of(y), S::of(z)));
    let (places, axes) = (&places, &axes);
    Some(settle(*pose, length_scale_m, STEPS, |pose| {
        places.iter().flat_map(move |(cell, [_, beyond])| {
            axes.iter().map(move |axis| {
                let (row, distance) = cells[*cell].row_from(*beyond, *axis, &pose, length_scale_m);
                (row, distance, S::one())
            })
        })
    }))
}

/// How far the currents are probed along the direction they hold least, in σ of the pose there.
const PROBE_SIGMAS: f64 = 2.0;

/// The furthest that is, in radians or its equivalent in translation: of a fold σ is as large as you like, and
/// beyond some hundredths the currents bend by more than a square.
const MAX_PROBE: f64 = 0.01;

/// A twin further than this, in σ of the pose along that direction, is told apart by any motion.
const FAR_SIGMAS: f64 = 60.0;

/// Steps of an inverse iteration: each leaves less of the other directions by the square of a ratio
/// of condition numbers, which is large near a fold.
const INVERSE_STEPS: usize = 3;

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// Whether a solution without redundancy has a near twin of which `is_expected` holds, too.
    pub fn has_twin(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        solution: &Solution<S>,
        is_expected: impl Fn(&Pose) -> bool,
        workspace: &mut Workspace<S>,
    ) -> bool {
        solution.redundancy == 0
            && self.twin(sorted, motion, solution, workspace).is_some_and(|twin| is_expected(&twin.to_pose()))
    }

    /// The twin of a solution without redundancy, if it is near and explains the currents as well. So
    /// near that the currents do not tell the two apart, it is where it is expected.
    fn twin(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        solution: &Solution<S>,
        workspace: &mut Workspace<S>,
    ) -> Option<Transform<S>> {
        let pose = Transform::of(&solution.estimate?.pose);
        let factor = solution.factor.as_ref()?;
        let mut loose = [S::one(); 6];
        for _ in 0..INVERSE_STEPS {
            let next = factor.backward(&factor.forward(&loose));
            let scale = square(&next).root().recip();
            loose = next.map(|value| value * scale);
        }
        let sigma = factor.length(&loose).recip();
        let problem = self.problem(sorted, motion);
        let here = problem.whitened(&pose, workspace);
        let along = |share: S| loose.map(|value| value * (share * sigma));
        let probe = S::of(PROBE_SIGMAS).min(S::of(MAX_PROBE) / sigma);
        let [there, back] =
            [probe, -probe].map(|share| problem.whitened(&problem.moved(&pose, &along(share)), workspace));
        // (j·probe)² and j·c·probe³, both by what one σ along v does.
        let (mut slope, mut bend) = (S::zero(), S::zero());
        for ((here, there), back) in here.iter().zip(&there).zip(&back) {
            for k in 0..2 {
                let first = S::half() * (there[k] - back[k]);
                slope += first * first;
                bend += first * (there[k] + back[k] - S::two() * here[k]);
            }
        }
        let distance = -S::two() * probe * slope / bend;
        // Written so that NaN is far.
        let is_near = distance.abs() <= S::of(FAR_SIGMAS);
        if !is_near {
            return None;
        }
        let twin = problem.moved(&pose, &along(distance));
        if distance.abs() <= S::of(DISTINCT_SIGMAS) {
            return Some(twin);
        }
        let twin = problem.minimise(twin, Stopping::near(), workspace);
        let own = Minimum { pose, chi2: solution.chi2, factor: solution.factor, iterations: 0, converged: true };
        let [own, its] = [&own, &twin].map(|minimum| problem.fit(minimum));
        let is_another = sigmas_between(factor, &pose, &twin.pose, self.length_scale_m) > S::of(DISTINCT_SIGMAS);
        (is_another && its != Fit::None && its >= own).then_some(twin.pose)
    }
}

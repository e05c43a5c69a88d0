//! Poses by the million: many frames of one head, a frame per SIMD lane.
//!
//! Nearly all frames take the same course: planes (or an expected pose), a few undamped steps, covariance. [`lanes`]
//! takes it for as many frames at once as the processor has lanes, with the operations of a single solve in their order:
//! so each frame has the bits that it has alone, on any machine. A frame that needs anything else — damping, a
//! search, the far side of a kink, another factorisation — leaves the lanes and is solved alone, from the start.

mod condition;
mod lanes;
mod minimum;

use crate::plan::Optics;
use crate::pose::Pose;
use crate::scene::MAX_CELLS;
use crate::width::{Instructions, Lanes, Task, Width};

use super::accept::unscaled;
use super::cold_start::DOUBTED;
use super::compiled::{Compiled, MotionPrior};
use super::levenberg_marquardt::Stopping;
use super::outcome::{Cells, Estimate, Outcome, Solution};
use super::readings::{Photocurrents, Sorted};
use super::solver::{Solver, Start};

use lanes::Course;
use minimum::{Frames, Minima};

/// Where the solves of a batch start: see [`Start`].
#[derive(Clone, Copy, Debug)]
pub enum Starts<'a> {
    /// Anywhere.
    Cold,
    /// Each at its expected pose.
    Near(&'a [Pose]),
}

impl<'a> Starts<'a> {
    fn of(&self, frame: usize) -> Start<'a> {
        match self {
            Self::Cold => Start::Cold,
            Self::Near(poses) => Start::Near(&poses[frame]),
        }
    }
}

/// Solves many frames of one head.
///
/// Solutions are those of [`Solver::solve`], bit for bit. How many times as fast they come depends on the processor's
/// lanes and on the head. Its frames are solved at once if it has six cells or more, all exposed at one instant, with masks
/// parallel to their detectors and emitters whose profiles are powers of the cosine, up to the fourth in the exact tier and
/// the sixth in the paper tier; if its poses have no mirror images; and if neither steps are limited
/// ([`Solver::with_max_steps`]) nor places uncertain ([`Uncertainty`](crate::Uncertainty)). Frames of other heads are
/// solved one by one.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    solver: &'a Solver<f64>,
    width: Width,
    /// Whether frames of this head can be solved at once.
    has_lanes: bool,
}

impl<'a> Batch<'a> {
    /// In the widest lanes that the processor has.
    #[must_use]
    pub fn new(solver: &'a Solver<f64>) -> Self {
        Self::with_width(solver, Width::widest())
    }

    /// In lanes of one width.
    #[must_use]
    pub fn with_width(solver: &'a Solver<f64>, width: Width) -> Self {
        let head = &solver.compiled;
        let has_lanes = head.plan.has_lanes()
            && head.plan.cell_count() >= <crate::plan::CompiledScene<f64> as Optics<f64>>::UNIQUE_FROM
            && !head.has_images
            && head.offsets_s.is_empty()
            && solver.max_steps.is_none()
            && head.noise.iter().all(|noise| noise.displacement <= 0.0);
        Self { solver, width, has_lanes }
    }

    /// Passes the number and the solution of each of `frames` to `sink`, in order.
    ///
    /// # Panics
    /// If there are fewer starts than frames.
    pub fn solve(
        &self,
        frames: &[Photocurrents],
        starts: Starts<'_>,
        motion: &MotionPrior,
        mut sink: impl FnMut(usize, Solution),
    ) {
        if let Starts::Near(poses) = starts {
            assert!(poses.len() >= frames.len(), "{} starts of {} frames", poses.len(), frames.len());
        }
        let alone = |frame: usize| self.solver.solve(&frames[frame], starts.of(frame), motion);
        if !self.has_lanes {
            return (0..frames.len()).for_each(|frame| sink(frame, alone(frame)));
        }
        let group = self.width.lanes();
        let (mut gathered, mut minima) = (Frames::empty(), Minima::empty());
        for first in (0..frames.len()).step_by(group) {
            let end = frames.len().min(first + group);
            self.gather(&frames[first..end], first, starts, &mut gathered);
            self.at_once(&gathered, starts, &mut minima);
            for (lane, frame) in (first..end).enumerate() {
                if gathered.is_present[lane] && minima.is_found[lane] {
                    sink(frame, self.solution(&minima, lane));
                } else {
                    sink(frame, alone(frame));
                }
            }
        }
    }

    /// Passes the number and the condition number of each of `solutions`, see [`Solution::condition`], to `sink`, in
    /// order.
    pub fn conditions(&self, solutions: &[Solution], mut sink: impl FnMut(usize, Option<f64>)) {
        for (group, solutions) in solutions.chunks(self.width.lanes()).enumerate() {
            let conditions = condition::of_group(self.width, solutions);
            for (lane, (solution, condition)) in solutions.iter().zip(conditions).enumerate() {
                sink(group * self.width.lanes() + lane, solution.factor.as_ref().map(|_| condition));
            }
        }
    }

    /// Puts `frames`, of which the first is number `first`, into lanes, if all their cells count.
    fn gather(&self, frames: &[Photocurrents], first: usize, starts: Starts<'_>, gathered: &mut Frames) {
        let head = &self.solver.compiled;
        gathered.clear();
        for (lane, readings) in frames.iter().enumerate() {
            let sorted = Sorted::of(readings, &head.limits);
            if sorted.usable.len() == head.plan.cell_count() {
                let start = match starts {
                    Starts::Cold => Pose::HOME,
                    Starts::Near(poses) => poses[first + lane],
                };
                gathered.set(lane, &sorted, &start);
            }
        }
    }

    /// The minima of `frames`, as far as they take the common course.
    fn at_once(&self, frames: &Frames, starts: Starts<'_>, minima: &mut Minima) {
        let head = &self.solver.compiled;
        let gate = head.gates[head.plan.cell_count()];
        let course = match starts {
            Starts::Cold => Course {
                is_cold: true,
                stopping: Stopping::exact(),
                most_chi2: gate,
                doubted_chi2: Some(DOUBTED * gate),
            },
            Starts::Near(_) => {
                let near = <crate::plan::CompiledScene<f64> as Optics<f64>>::NEAR.sigmas;
                let stopping = Stopping { tolerance_sigmas: near, ..Stopping::near() };
                Course { is_cold: false, stopping, most_chi2: gate, doubted_chi2: None }
            }
        };
        self.width.run(Minimise { head, frames, course, minima });
    }

    /// What [`super::accept`] concludes from the minimum in `lane`.
    #[inline(always)]
    fn solution(&self, minima: &Minima, lane: usize) -> Solution {
        let head = &self.solver.compiled;
        let cells = head.plan.cell_count();
        let rigid = minima.rigid(lane);
        Solution {
            outcome: Outcome::Converged,
            estimate: Some(Estimate {
                pose: rigid.to_pose(),
                covariance: unscaled(&minima.inverse(lane), head.length_scale_m),
            }),
            chi2: minima.chi2[lane],
            redundancy: head.redundancy(cells),
            iterations: minima.iterations[lane] as usize,
            evaluations: minima.evaluations[lane] as usize,
            cells_used: Cells::from_bits(u16::MAX >> (MAX_CELLS - cells)),
            excluded: Cells::default(),
            unnoticed_sigmas: super::accept::unnoticed_sigmas(
                head.gates[cells],
                head.redundancy(cells),
                minima.least_visible[lane],
            ),
            factor: Some(minima.factor(lane)),
            rigid,
        }
    }
}

/// The common course of some frames.
struct Minimise<'a> {
    head: &'a Compiled<f64>,
    frames: &'a Frames,
    course: Course,
    minima: &'a mut Minima,
}

impl Task for Minimise<'_> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        let Self { head, frames, course, minima } = self;
        let like = Lanes::zero(instructions);
        if head.plan.is_exact() {
            lanes::minimise::<_, true>(head, frames, course, like, minima);
        } else {
            lanes::minimise::<_, false>(head, frames, course, like, minima);
        }
    }
}

//! From photocurrents to a pose.
//!
//! Positions first, currents after: [`planes`] finds a start from home by the ratios alone, which
//! converges everywhere; [`refine`] descends from there on all currents, weighted by their noise.
//! χ² and the cells that saw no light tell a true solution from a mirror image; the information
//! matrix tells what the data leave open.

mod algebra;
mod observability;
mod outcome;
mod planes;
mod readings;
mod refine;
mod track;
mod weights;

use heapless::Vec;

use crate::plan::{Plan, Tier};
use crate::pose::{Pose, Transform, Twist};
use crate::response::Pair;
use crate::scalar::{Scalar, Vector3};
use crate::scene::{MAX_CELLS, Scene, SceneError};

pub use outcome::{AXES, Cells, Directions, Estimate, Outcome, Solution, Weakness};
pub use readings::{Photocurrents, Reading};
pub use track::Tracker;
pub use weights::{BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C};

use planes::PlaneCell;
use readings::{Limits, Sorted};
use refine::{Motion, Problem, Refined};
use weights::{CellNoise, TwistVariance};

/// Steps of one refinement before it is given up.
const MAX_ITERATIONS: usize = 40;

/// Probability of a larger χ² by chance at which a fit is doubted: 1e-9, six one-sided σ.
const GATE_SIGMAS: f64 = 6.0;

/// Cells below which mirror images are searched for, unless the tool was followed to where it is.
/// With six lit cells none but the truth keeps all of them lit.
const UNIQUE_FROM: usize = 6;

/// Starts after which mirror images count as searched for.
const IMAGE_STARTS: usize = 25;

/// Further starts, spread over the reach of a head, for data that nothing has fitted.
const SPREAD_STARTS: usize = 48;

/// How far the further starts of the search lie apart: half the reach of a head.
const SEARCH_ROTATION_RAD: f64 = 0.3;
const SEARCH_TRANSLATION_M: f64 = 3e-3;

/// Two poses this many σ apart are two poses.
const DISTINCT_SIGMAS: f64 = 6.0;

/// A residual this large a share of a cell's current is no misfit but another place. Gains that
/// calibration has not settled stay well below.
const ELSEWHERE: f64 = 0.1;

/// How far a solve goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// The pose on the planes that the positions of the light give: no currents, no weights.
    Planes,
    /// At most so many steps of refinement on the currents.
    Steps(usize),
    /// To the minimum.
    #[default]
    Full,
}

/// Estimates poses from the photocurrents of one scene.
///
/// Holds the compiled scene and no state: every solve is a function of its arguments.
#[derive(Clone, Debug)]
pub struct Solver<S: Scalar> {
    plan: Plan<S>,
    planes: Vec<PlaneCell<S>, MAX_CELLS>,
    noise: Vec<CellNoise<S>, MAX_CELLS>,
    limits: Vec<Limits, MAX_CELLS>,
    exposure: Vec<S, MAX_CELLS>,
    arm: S,
    effort: Effort,
    /// Directions that the head cannot tell at home, with all cells lit: mirror images of every
    /// other pose fit as well, so that it has no pose to give anywhere.
    blind: Option<Directions>,
}

/// How well a pose explains the data, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fit {
    /// χ² is more than the noise explains.
    None,
    /// The cells that see light fit, but another should see some, too.
    LitOnly,
    /// All cells agree.
    Full,
}

/// What is known beforehand of the tool's motion within a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionPrior {
    /// The twist that carries each cell's exposure to the reference instant.
    pub twist: Twist,
    /// Standard deviation of its linear part, per axis, m/s.
    pub linear_sigma_m_per_s: f64,
    /// Standard deviation of its angular part, per axis, rad/s.
    pub angular_sigma_rad_per_s: f64,
}

impl<S: Scalar> Solver<S> {
    /// For cells that are all exposed at the reference instant.
    ///
    /// # Errors
    /// Those of [`Plan::compile`].
    pub fn new(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        let plan = Plan::compile(scene, tier)?;
        let rounding = 16.0 * S::epsilon().as_f64();
        let relative_error = match tier {
            Tier::Paper => rounding,
            Tier::Exact { tolerance } => tolerance.max(rounding),
        };
        let cells = scene.cells.iter();
        let square_arm: f64 = cells.clone().map(|cell| cell.emitter.position_tool_m.length_squared()).sum();
        let arm_m = libm::sqrt(square_arm / scene.cells.len() as f64);
        let mut solver = Self {
            planes: cells.clone().map(|cell| PlaneCell::compile(cell, tier == Tier::Paper)).collect(),
            noise: (0..scene.cells.len()).map(|cell| CellNoise::compile(scene, cell, relative_error)).collect(),
            limits: cells
                .map(|cell| Limits {
                    faint_a: cell.detector.faint_a,
                    saturation_a: cell.detector.saturation_a,
                    dark_a: cell.detector.dark_current_a,
                })
                .collect(),
            exposure: scene.cells.iter().map(|_| S::zero()).collect(),
            // A lone emitter at the tool's origin has no arm: any length scale serves.
            arm: S::of(if arm_m > 0.0 { arm_m } else { 0.01 }),
            plan,
            effort: Effort::Full,
            blind: None,
        };
        solver.blind = solver.blind_at_home();
        Ok(solver)
    }

    /// The directions that the currents of a head leave free at home; `None` if there is none, or
    /// if fewer than three cells see light there.
    fn blind_at_home(&self) -> Option<Directions> {
        let home = Photocurrents::of_pairs((0..self.plan.cell_count()).map(|cell| {
            let pair = self.plan.photocurrents(cell, &Pose::HOME);
            Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
        }));
        let sorted = Sorted::of(&home, &self.limits);
        if sorted.usable.len() < 3 {
            return None;
        }
        let problem = self.problem(&sorted, &MotionPrior::default());
        let pose = Transform::of(&Pose::HOME);
        let at = problem.expand(&pose, &problem.whiteners(&pose));
        observability::free_directions(&at.information)
    }

    /// With cell k exposed `offsets_s[k]` seconds after the reference instant.
    ///
    /// # Panics
    /// If there are fewer offsets than cells.
    #[must_use]
    pub fn with_exposures(mut self, offsets_s: &[f64]) -> Self {
        for (exposure, &offset) in self.exposure.iter_mut().zip(&offsets_s[..self.plan.cell_count()]) {
            *exposure = S::of(offset);
        }
        self
    }

    /// Stops after `effort`: for those who weigh error against time. A pose that is not at its
    /// minimum is [`Weakness::Unfinished`].
    #[must_use]
    pub fn with_effort(mut self, effort: Effort) -> Self {
        self.effort = effort;
        self
    }

    /// The Cramér–Rao bound at `pose`: the least covariance that an unbiased estimate from one frame
    /// of this scene's photocurrents can have, the tool at rest and all cells with light used.
    /// m², m·rad, rad²; `None` where the data leave a direction free.
    pub fn bound(&self, pose: &Pose) -> Option<[[f64; 6]; 6]> {
        let currents = Photocurrents::of_pairs((0..self.plan.cell_count()).map(|cell| {
            let pair = self.plan.photocurrents(cell, pose);
            Pair { i_x1_a: pair.i_x1_a.as_f64(), i_x2_a: pair.i_x2_a.as_f64() }
        }));
        let sorted = Sorted::of(&currents, &self.limits);
        if sorted.usable.len() < 3 {
            return None;
        }
        let problem = self.problem(&sorted, &MotionPrior::default());
        let pose = Transform::of(pose);
        observability::covariance(&problem.expand(&pose, &problem.whiteners(&pose)).information, self.arm)
    }

    /// The compiled scene.
    pub fn plan(&self) -> &Plan<S> {
        &self.plan
    }

    /// The pose from `readings` alone, the tool at rest.
    pub fn solve(&self, readings: &Photocurrents) -> Solution {
        self.solve_moving(readings, &MotionPrior::default())
    }

    /// The pose from `readings`, with no idea where the tool is but some of how it moves.
    pub fn solve_moving(&self, readings: &Photocurrents, motion: &MotionPrior) -> Solution {
        let sorted = Sorted::of(readings, &self.limits);
        if let Some(solution) = self.too_few(&sorted) {
            return solution;
        }
        let problem = self.problem(&sorted, motion);
        if self.effort == Effort::Full {
            return self.search(&sorted, &problem);
        }
        let start = planes::pose_on_planes(&self.planes, &sorted.usable, Transform::of(&Pose::HOME), self.arm);
        self.unfinished(&sorted, &problem, start)
    }

    /// As far as the effort goes from `start`, and no word on whether the data fit.
    fn unfinished(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, start: Transform<S>) -> Solution {
        let whiteners = problem.whiteners(&start);
        let refined = match self.effort {
            Effort::Planes => problem.refine(start, &whiteners, 0),
            Effort::Steps(steps) => problem.refine(start, &whiteners, steps),
            Effort::Full => problem.refine(start, &whiteners, MAX_ITERATIONS),
        };
        let mut solution = self.conclude(sorted, &refined, refined.iterations, true);
        if solution.outcome.has_pose() && !refined.converged {
            solution.outcome = Outcome::Degraded(Weakness::Unfinished);
        }
        solution
    }

    /// The pose from `readings` near `prior`. Falls back to the search from home if the data do
    /// not fit there.
    pub fn solve_near(&self, readings: &Photocurrents, prior: &Pose, motion: &MotionPrior) -> Solution {
        let sorted = Sorted::of(readings, &self.limits);
        if let Some(solution) = self.too_few(&sorted) {
            return solution;
        }
        let problem = self.problem(&sorted, motion);
        let start = Transform::of(prior);
        if self.effort != Effort::Full {
            return self.unfinished(&sorted, &problem, start);
        }
        let whiteners = problem.whiteners(&start);
        let refined = problem.refine(start, &whiteners, MAX_ITERATIONS);
        if self.fit(&sorted, &problem, &refined) != Fit::None {
            return self.conclude(&sorted, &refined, refined.iterations, true);
        }
        let mut solution = self.search(&sorted, &problem);
        solution.iterations += refined.iterations;
        solution
    }

    fn problem<'a>(&'a self, sorted: &'a Sorted<S>, motion: &MotionPrior) -> Problem<'a, S> {
        let square = |sigma: f64| S::of(sigma * sigma);
        Problem {
            plan: &self.plan,
            planes: &self.planes,
            noise: &self.noise,
            exposure: &self.exposure,
            readings: &sorted.usable,
            motion: Motion {
                linear: S::Vec3::of(motion.twist.linear_m_per_s),
                angular: S::Vec3::of(motion.twist.angular_rad_per_s),
                variance: TwistVariance {
                    linear: square(motion.linear_sigma_m_per_s),
                    angular: square(motion.angular_sigma_rad_per_s),
                },
            },
            arm: self.arm,
        }
    }

    /// Six unknowns need three cells.
    fn too_few(&self, sorted: &Sorted<S>) -> Option<Solution> {
        if sorted.usable.len() >= 3 {
            return None;
        }
        let outcome = if sorted.usable.len() + sorted.faint.count() >= 3 {
            Outcome::TooDark
        } else {
            Outcome::Unobservable(Directions::all())
        };
        Some(Solution::without_pose(outcome, sorted.used))
    }

    /// Cold start: home first, then turned and shifted starts until the data fit.
    fn search(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>) -> Solution {
        let mut iterations = 0;
        let mut best: Option<(Refined<S>, Fit)> = None;
        let need_all = sorted.usable.len() < UNIQUE_FROM;
        let on_planes = planes::pose_on_planes(&self.planes, &sorted.usable, Transform::of(&Pose::HOME), self.arm);
        for (tried, start) in starts(on_planes).enumerate() {
            let refined = self.refine_from(problem, start, tried > 0);
            iterations += refined.iterations;
            let fit = self.fit(sorted, problem, &refined);
            match &best {
                Some((before, Fit::Full)) if fit == Fit::Full => {
                    if observability::distinct(&before.at.information, &before.pose, &refined.pose, self.arm) {
                        let mut solution = Solution::without_pose(Outcome::Ambiguous, sorted.used);
                        solution.iterations = iterations;
                        return solution;
                    }
                }
                Some((before, best_fit)) if (fit, before.at.chi2) > (*best_fit, refined.at.chi2) => {
                    best = Some((refined, fit));
                }
                None => best = Some((refined, fit)),
                Some(_) => {}
            }
            let observable = || observability::free_directions(&refined.at.information).is_none();
            let searched = tried >= IMAGE_STARTS && best.is_some_and(|(_, fit)| fit == Fit::Full);
            if searched || fit == Fit::Full && (!need_all || !observable()) {
                break;
            }
        }
        match best {
            Some((refined, Fit::Full)) => self.conclude(sorted, &refined, iterations, true),
            // The cells with light agree on a pose where others should see some, too: those fail.
            Some((refined, Fit::LitOnly)) if redundancy(sorted.usable.len()) > 0 => {
                self.conclude(sorted, &refined, iterations, true)
            }
            // A misfit is shown only where redundancy tells it from a mirror image.
            Some((refined, Fit::None)) if !need_all && !self.is_elsewhere(problem, &refined) => {
                self.conclude(sorted, &refined, iterations, false)
            }
            _ => {
                let mut solution = Solution::without_pose(Outcome::Diverged, sorted.used);
                solution.iterations = iterations;
                solution
            }
        }
    }

    /// A minimum of χ² reached from `start`; `far`: the start is no estimate but a guess.
    fn refine_from(&self, problem: &Problem<'_, S>, start: Transform<S>, far: bool) -> Refined<S> {
        let mut steps = 0;
        let mut refine = |from: Transform<S>, whiteners| {
            let mut refined = problem.refine(from, &whiteners, MAX_ITERATIONS);
            steps += refined.iterations;
            refined.iterations = steps;
            refined
        };
        let start = if far { refine(start, problem.coarse_whiteners()).pose } else { start };
        let refined = refine(start, problem.whiteners(&start));
        // Weights that depend on the pose are known only now.
        if problem.weights_vary() { refine(refined.pose, problem.whiteners(&refined.pose)) } else { refined }
    }

    /// How well `refined` explains the data: χ² by the noise, and no light where none was seen.
    fn fit(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, refined: &Refined<S>) -> Fit {
        let gate = chi2_gate(redundancy(sorted.usable.len()));
        if !refined.converged || refined.at.chi2.as_f64() > gate {
            Fit::None
        } else if self.is_dark_where_dark(sorted, problem, refined) {
            Fit::Full
        } else {
            Fit::LitOnly
        }
    }

    /// Whether cells that were found without light are without light at the pose, too.
    fn is_dark_where_dark(&self, sorted: &Sorted<S>, problem: &Problem<'_, S>, refined: &Refined<S>) -> bool {
        (0..self.plan.cell_count())
            .filter(|&cell| sorted.faint.contains(cell))
            .all(|cell| problem.predicted(cell, &refined.pose).total_a().as_f64() < 2.0 * self.limits[cell].faint_a)
    }

    /// Whether the best pose found is too far from the data to call it one.
    fn is_elsewhere(&self, problem: &Problem<'_, S>, refined: &Refined<S>) -> bool {
        !refined.converged
            || problem.readings.iter().any(|reading| {
                let predicted = problem.predicted(reading.cell, &refined.pose);
                let [first, second] = reading.pair;
                let off = (first - predicted.i_x1_a).abs().max((second - predicted.i_x2_a).abs());
                off > S::of(ELSEWHERE) * (first + second)
            })
    }

    fn conclude(&self, sorted: &Sorted<S>, refined: &Refined<S>, iterations: usize, fits: bool) -> Solution {
        let mut solution = Solution {
            chi2: refined.at.chi2.as_f64(),
            redundancy: redundancy(sorted.usable.len()),
            iterations,
            information: Some(refined.at.information.map(|row| row.map(S::as_f64))),
            ..Solution::without_pose(Outcome::Diverged, sorted.used)
        };
        if let Some(blind) = self.blind {
            solution.outcome = Outcome::Unobservable(blind);
            return solution;
        }
        let Some(covariance) = observability::covariance(&refined.at.information, self.arm) else {
            let free = observability::free_directions(&refined.at.information).unwrap_or_default();
            solution.outcome = Outcome::Unobservable(free);
            return solution;
        };
        let pose = refined.pose.to_pose();
        if !pose.is_finite() {
            return solution;
        }
        solution.outcome = if !fits {
            Outcome::Degraded(Weakness::Misfit)
        } else if sorted.usable.len() < self.plan.cell_count() {
            Outcome::Degraded(Weakness::FewerCells)
        } else {
            Outcome::Converged
        };
        solution.estimate = Some(Estimate { pose, covariance });
        solution
    }
}

/// Two currents a cell, less six unknowns.
fn redundancy(cells: usize) -> usize {
    (2 * cells).saturating_sub(6)
}

/// The χ² that `freedom` degrees of freedom exceed with probability 1e-9 (Wilson and Hilferty
/// 1931). Without redundancy a fit is exact, but for noise that leads past a fold of the currents:
/// counted as one degree.
fn chi2_gate(freedom: usize) -> f64 {
    let k = freedom.max(1) as f64;
    let spread = 2.0 / (9.0 * k);
    let root = 1.0 - spread + GATE_SIGMAS * libm::sqrt(spread);
    k * root * root * root
}

/// The pose on the planes; then, where clipped spots have led the planes astray, home and its
/// surroundings; then the surroundings of the pose on the planes.
fn starts<S: Scalar>(on_planes: Transform<S>) -> impl Iterator<Item = Transform<S>> {
    // A turn about one axis and a shift along the next, both ways.
    let around = |i: usize| {
        let mut turn = [0.0; 3];
        let mut shift = [0.0; 3];
        let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        turn[i / 2 % 3] = sign * SEARCH_ROTATION_RAD;
        shift[(i / 2 + 1) % 3] = sign * SEARCH_TRANSLATION_M * if i < 6 { 1.0 } else { -1.0 };
        (S::Vec3::of(shift.into()), S::Vec3::of(turn.into()))
    };
    let home = Transform::of(&Pose::HOME);
    let of = move |centre: Transform<S>| {
        (0..12).map(move |i| {
            let (shift, turn) = around(i);
            centre.moved(shift, turn)
        })
    };
    // The generalised golden ratio in six dimensions fills a box evenly (Roberts 2018): powers of
    // the inverse of the root of x⁷ = x + 1.
    let spread = (1..=SPREAD_STARTS).map(move |n| {
        let mut share = 1.0;
        let coordinates: [f64; 6] = core::array::from_fn(|_| {
            share *= 0.898_653_712_628_699;
            let position = n as f64 * share;
            2.0 * (position - libm::floor(position)) - 1.0
        });
        let [tx, ty, tz, rx, ry, rz] = coordinates;
        let (shift, turn) = (glam::DVec3::new(tx, ty, tz), glam::DVec3::new(rx, ry, rz));
        home.moved(S::Vec3::of(shift * 4.0 / 3.0 * SEARCH_TRANSLATION_M), S::Vec3::of(turn * SEARCH_ROTATION_RAD))
    });
    [on_planes, home].into_iter().chain(of(home)).chain(of(on_planes)).chain(spread)
}

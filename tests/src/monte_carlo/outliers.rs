//! One cell answers for another pose than the others: no pose may come of it that looks sound.

use std::fmt;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use slitpose_model::{MotionPrior, Outcome, Pair, Photocurrents, Plan, Pose, Reading, Scene, Solver, Start, Tier};

use super::data::{Disturbance, lit_count, measured, pairs};
use super::layout::Table;
use super::subsets::thin_out;
use super::tally::{Case, Tally, Verdict, WRONG_SIGMAS, list};
use super::trials::Trials;
use super::{HALF_DEG, HALF_MM};
use crate::poses::{one_in_box, pose};
use crate::statistics::{Matrix6, cholesky, forward};

/// What the cells do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Conduct {
    /// All of them answer for the pose.
    Honest,
    /// So do five; the sixth is missing.
    OneMissing,
    /// One answers for another pose of the box, at least so many σ off.
    OtherPose {
        /// Least Mahalanobis norm of the difference of its pair, by its own covariance.
        least_sigmas: f64,
    },
    /// One is off towards another pose of the box, but only so far: log-uniform within this range.
    Small {
        /// Least Mahalanobis norm.
        least_sigmas: f64,
        /// Largest.
        most_sigmas: f64,
    },
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Report {
    conduct: Conduct,
    trials: Trials,
    tier: Tier,
    /// Outcomes.
    pub tally: Tally,
    /// Wrong poses that are called converged.
    pub unflagged: Vec<Case>,
    /// Honest data without a right pose.
    pub failures: Vec<Case>,
    /// Outliers by the χ² they leave at least: how many there were, and how many passed unflagged.
    by_least_chi2: Vec<(f64, usize, usize)>,
}

/// Bands of [`least_chi2`], each up to this. 33 and 54: what noise alone exceeds with probability
/// 1e-5 and 1e-9 on six degrees of freedom.
const BANDS: [f64; 5] = [10.0, 33.0, 54.0, 100.0, f64::INFINITY];

/// Solves for random poses of the box at which no cell is faint, with the scene's noise.
///
/// # Panics
/// If the scene cannot be compiled.
pub fn study(scene: &Scene, tier: Tier, conduct: Conduct, trials: Trials) -> Report {
    let solver = Solver::<f64>::new(scene, tier).unwrap_or_else(|error| panic!("{error}"));
    let disturbance = Disturbance::of(scene);
    let cases = trials.run(|trial, rng| {
        let lit_pose = |rng: &mut ChaCha8Rng| {
            loop {
                let row = one_in_box(rng, HALF_MM, HALF_DEG);
                let pairs = pairs(solver.plan(), &pose(row));
                if lit_count(scene, &pairs) == scene.cells.len() {
                    return (row, pairs);
                }
            }
        };
        let (row, pairs) = lit_pose(rng);
        let mut readings = measured(&disturbance, &pairs, rng);
        let (least_sigmas, most_sigmas) = match conduct {
            Conduct::Honest => {
                return Case::new(trial, row, solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST));
            }
            Conduct::OneMissing => {
                thin_out(&mut readings, scene.cells.len() - 1, rng);
                return Case::new(trial, row, solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST));
            }
            Conduct::OtherPose { least_sigmas } => (least_sigmas, None),
            Conduct::Small { least_sigmas, most_sigmas } => (least_sigmas, Some(most_sigmas)),
        };
        let outlier = rng.random_range(0..scene.cells.len());
        let (error, whitened) = loop {
            let elsewhere = lit_pose(rng).1[outlier];
            let difference = [elsewhere.i_x1_a - pairs[outlier].i_x1_a, elsewhere.i_x2_a - pairs[outlier].i_x2_a];
            let whitened = disturbance.whiten(outlier, pairs[outlier], difference);
            let sigmas = length(&whitened);
            if sigmas >= least_sigmas {
                let share = most_sigmas.map_or(1.0, |most| {
                    (least_sigmas.ln() + rng.random_range(0.0..1.0) * (most / least_sigmas).ln()).exp() / sigmas
                });
                break (difference.map(|value| value * share), whitened.map(|value| value * share));
            }
        };
        add(&mut readings, outlier, error);
        let mut case = Case::new(trial, row, solver.solve(&readings, Start::Cold, &MotionPrior::AT_REST));
        case.error_sigmas = length(&whitened);
        case.least_chi2 = least_chi2(solver.plan(), &disturbance, &pose(row), outlier, whitened);
        case
    });
    let is_wrong = |case: &&Case| case.by_sigmas() == Verdict::Wrong;
    let honest = matches!(conduct, Conduct::Honest | Conduct::OneMissing);
    let in_band = |(i, &most): (usize, &f64)| {
        let least = if i == 0 { 0.0 } else { BANDS[i - 1] };
        let band = cases.iter().filter(|case| (least..most).contains(&case.least_chi2));
        (most, band.clone().count(), band.filter(is_wrong).filter(|case| is_unflagged(case)).count())
    };
    Report {
        conduct,
        trials,
        tier,
        by_least_chi2: if honest { Vec::new() } else { BANDS.iter().enumerate().map(in_band).collect() },
        tally: Tally::of(&cases, Case::by_sigmas),
        unflagged: cases.iter().filter(is_wrong).filter(|case| is_unflagged(case)).copied().collect(),
        failures: cases.iter().filter(|case| honest && is_wrong(case)).copied().collect(),
    }
}

fn is_unflagged(case: &Case) -> bool {
    case.solution.outcome == Outcome::Converged
}

fn length(v: &[f64; 2]) -> f64 {
    v[0].hypot(v[1])
}

fn add(readings: &mut Photocurrents, cell: usize, difference: [f64; 2]) {
    if let Reading::Light(Pair { i_x1_a, i_x2_a }) = &mut readings.cells[cell] {
        *i_x1_a += difference[0];
        *i_x2_a += difference[1];
    }
}

/// The χ² that the whitened error `error` of cell `outlier` leaves when the pose follows it as well as
/// it can: |b|² − |L⁻¹Jᵀb|² with LLᵀ = JᵀJ, J the whitened Jacobian of all cells.
///
/// This is what any estimator has to tell the error by, as long as the optics are linear over the
/// error of the pose.
fn least_chi2(plan: &Plan<f64>, disturbance: &Disturbance, pose: &Pose, outlier: usize, error: [f64; 2]) -> f64 {
    // Millimetres go with tenths of radians on arms of 10 mm.
    const SCALE: [f64; 6] = [0.01, 0.01, 0.01, 1.0, 1.0, 1.0];
    let mut information: Matrix6 = Default::default();
    let mut pull = [0.0; 6];
    for cell in 0..plan.cell_count() {
        let (_, pair, jacobian) = plan.linearise(cell, pose);
        let columns: [[f64; 2]; 6] = std::array::from_fn(|axis| {
            disturbance.whiten(cell, pair, [jacobian[0][axis], jacobian[1][axis]]).map(|value| value * SCALE[axis])
        });
        for i in 0..6 {
            for j in 0..6 {
                information[i][j] += columns[i][0] * columns[j][0] + columns[i][1] * columns[j][1];
            }
            if cell == outlier {
                pull[i] = columns[i][0] * error[0] + columns[i][1] * error[1];
            }
        }
    }
    let followed: f64 = forward(&cholesky(&information), &pull).iter().map(|value| value * value).sum();
    error[0] * error[0] + error[1] * error[1] - followed
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { conduct, trials: Trials { count, seed }, tier, .. } = self;
        writeln!(f, "outliers, {conduct:?}, {tier:?}, ±{HALF_MM} mm ±{HALF_DEG}°, all cells lit, noise of the scene")?;
        writeln!(f, "  {count} poses, seed {seed}; wrong: beyond {WRONG_SIGMAS} σ")?;
        write!(f, "{}", self.tally)?;
        if !self.by_least_chi2.is_empty() {
            let mut table = Table::new(&["least χ² up to", "outliers", "unflagged"]);
            for (most, outliers, unflagged) in &self.by_least_chi2 {
                table.row([most.to_string(), outliers.to_string(), unflagged.to_string()]);
            }
            write!(f, "{table}")?;
        }
        list(f, "honest data without a right pose", &self.failures)?;
        list(f, "wrong and unflagged", &self.unflagged)
    }
}

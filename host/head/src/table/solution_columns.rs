//! The columns that hold a solution:
//! `status,tx_mm,…,rz_rad,sigma_tx_mm,…,sigma_rz_rad,condition,chi2,iterations,cells_used`, and what no other program relies on.

use slitpose_model::{Outcome, Solution};

/// Names of a solution's columns; see [`SolutionRow`].
pub const SOLUTION_COLUMNS: [&str; 21] = [
    "status",
    "tx_mm",
    "ty_mm",
    "tz_mm",
    "rx_rad",
    "ry_rad",
    "rz_rad",
    "sigma_tx_mm",
    "sigma_ty_mm",
    "sigma_tz_mm",
    "sigma_rx_rad",
    "sigma_ry_rad",
    "sigma_rz_rad",
    "condition",
    "chi2",
    "iterations",
    "cells_used",
    "free_directions",
    "excluded_cells",
    "verified",
    "reason",
];

/// A solution in the units of tables.
#[derive(Clone, Debug)]
pub struct SolutionRow {
    /// The word for its outcome.
    pub status: &'static str,
    /// Pose, standard deviations, condition and χ²; without pose empty.
    pub numbers: [Option<f64>; 14],
    /// Refinement steps.
    pub iterations: usize,
    /// How many cells entered.
    pub cells_used: usize,
    /// Coordinates an unobservable pose leaves open, joined by `;`.
    pub free_directions: String,
    /// Cells that contradict all others, joined by `;`.
    pub excluded_cells: String,
    /// How well redundancy checked the pose: `well`, `weakly` or `not`.
    pub verified: &'static str,
    /// Why a pose is degraded; of others empty.
    pub reason: &'static str,
}

impl SolutionRow {
    /// The row of a solution.
    pub fn of(solution: &Solution) -> Self {
        Self::with_condition(solution, solution.condition())
    }

    /// The row of a solution whose condition number is known.
    pub fn with_condition(solution: &Solution, condition: Option<f64>) -> Self {
        let mut numbers = [None; 14];
        if let Some(estimate) = &solution.estimate {
            let (t, r) = (estimate.pose.translation_m * 1e3, estimate.pose.rotation_rad());
            let sigma = estimate.sigma();
            let scale = |axis: usize| if axis < 3 { 1e3 } else { 1.0 };
            for (axis, value) in [t.x, t.y, t.z, r.x, r.y, r.z].into_iter().enumerate() {
                numbers[axis] = Some(value);
                numbers[6 + axis] = Some(sigma[axis] * scale(axis));
            }
        }
        let finite = |value: &f64| value.is_finite();
        numbers[12] = condition.filter(finite);
        numbers[13] = Some(solution.chi2).filter(finite);
        let free_directions = match solution.outcome {
            Outcome::Unobservable(directions) => directions.to_string(),
            _ => String::new(),
        };
        Self {
            status: solution.outcome.as_str(),
            numbers,
            iterations: solution.iterations,
            cells_used: solution.cells_used.count(),
            free_directions,
            excluded_cells: solution.excluded.to_string(),
            verified: solution.verified().as_str(),
            reason: match solution.outcome {
                Outcome::Degraded(reason) => reason.as_str(),
                _ => "",
            },
        }
    }
}

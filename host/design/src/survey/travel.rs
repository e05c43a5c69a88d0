//! How far the tool moves along one axis before the first cell is no longer lit, or faint.

use std::f64::consts::PI;

use serde::Serialize;
use slitpose_model::{Plan, Pose, Status};

use super::sample::{AXES, axis_motion};

/// Steps of the search outward from home: finer than any gap between two lit regions.
const STEP_M: f64 = 0.1e-3;
const STEP_RAD: f64 = 0.5 * PI / 180.0;

/// Where the search gives up: no head of this kind is as large.
const FARTHEST_M: f64 = 0.1;
const FARTHEST_RAD: f64 = PI;

/// Halvings of a step: to a millionth of it.
const BISECTIONS: usize = 20;

/// Pure motion from home along one axis.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Travel {
    /// `tx` … `rz`.
    pub axis: &'static str,
    /// Towards the negative end.
    pub negative: End,
    /// Towards the positive end.
    pub positive: End,
}

/// Where a motion ends, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct End {
    /// Signed motion from home, metres or radians; zero if a cell is not usable even at home.
    pub at: f64,
    /// The first cell that is no longer usable; `None` if the search ended before.
    pub cell: Option<usize>,
    /// What that cell becomes: a status other than `lit`, or `faint`.
    pub becomes: Option<&'static str>,
}

pub(super) fn along_axes(plan: &Plan<f64>) -> Vec<Travel> {
    let travel =
        |(number, axis)| Travel { axis, negative: farthest(plan, number, -1.0), positive: farthest(plan, number, 1.0) };
    AXES.into_iter().enumerate().map(travel).collect()
}

fn farthest(plan: &Plan<f64>, axis: usize, sign: f64) -> End {
    let (step, limit) = if axis < 3 { (STEP_M, FARTHEST_M) } else { (STEP_RAD, FARTHEST_RAD) };
    let failure = |amount: f64| first_unusable(plan, &axis_motion(axis, sign * amount));
    let steps = (limit / step).round() as usize;
    let Some(first_bad) = (0..=steps).find(|index| failure(*index as f64 * step).is_some()) else {
        return End { at: sign * limit, cell: None, becomes: None };
    };
    let (mut good, mut bad) = ((first_bad as f64 - 1.0).max(0.0) * step, first_bad as f64 * step);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (good + bad);
        if failure(middle).is_some() { bad = middle } else { good = middle }
    }
    let (cell, becomes) = failure(bad).unzip();
    End { at: sign * good, cell, becomes }
}

fn first_unusable(plan: &Plan<f64>, pose: &Pose) -> Option<(usize, &'static str)> {
    (0..plan.cell_count()).find_map(|cell| {
        let response = plan.respond(cell, pose);
        match response.status {
            Status::Lit if response.flags.faint => Some((cell, "faint")),
            Status::Lit => None,
            status => Some((cell, status.as_str())),
        }
    })
}

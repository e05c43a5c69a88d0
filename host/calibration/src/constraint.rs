//! What the poses of a group have in common, as residuals.
//!
//! Each kind has unknowns of its own, shared by its rows:
//! * an instrument with frames of its own: base_from_reference and tool_from_marker, as translation and rotation vector;
//! * a pivot: the point in the tool and in the base;
//! * a stage: the pose at step zero, and the vector of travel per metre of step;
//! * a rest: the pose.

use glam::DVec3;
use slitpose_model::Pose;

use crate::data::{Constraint, Knowledge, Row, compose, inverse, pose_of};

pub(crate) const RESIDUALS: usize = 7;

/// Number of unknowns of a group, in SI units.
pub(crate) fn unknowns(constraint: Constraint) -> usize {
    match constraint {
        Constraint::Known | Constraint::Free => 0,
        Constraint::KnownInOwnFrames => 12,
        Constraint::Pivot | Constraint::Rest => 6,
        Constraint::Stage => 9,
    }
}

/// Scale of an unknown of a group: what makes the normal equations well conditioned, metres or radians.
pub(crate) fn scale(constraint: Constraint, unknown: usize) -> f64 {
    match constraint {
        Constraint::Stage if unknown >= 6 => 1e-2,
        Constraint::Pivot => 1e-4,
        _ if unknown % 6 < 3 => 1e-4,
        _ => 1e-2,
    }
}

/// How little is known of an unknown beforehand, in its scale.
pub(crate) const VAGUE: f64 = 1e6;

/// Residuals of one row, normalised by the standard deviations of lengths and angles; those that are not used are zero.
pub(crate) fn residuals(
    constraint: Constraint,
    [length, angle]: [f64; 2],
    row: &Row,
    unknowns: &[f64],
    pose: &Pose,
) -> [f64; RESIDUALS] {
    let mut out = [0.0; RESIDUALS];
    let mut put = |from: usize, vector: DVec3, sigma: f64| {
        out[from..from + 3].copy_from_slice(&(vector / sigma).to_array());
    };
    match constraint {
        Constraint::Known => {
            let Some(report) = row.reported() else { return out };
            let (t, r) = pose.displacement_from(&report);
            put(0, t, length);
            put(3, r, angle);
        }
        Constraint::KnownInOwnFrames => {
            let Some(report) = row.reported() else { return out };
            let [base_from_reference, tool_from_marker] = [pose_of(&unknowns[..6]), pose_of(&unknowns[6..12])];
            let expected = compose(&compose(&inverse(&base_from_reference), pose), &tool_from_marker);
            let (t, r) = expected.displacement_from(&report);
            put(0, t, length);
            put(3, r, angle);
        }
        Constraint::Pivot => {
            let [in_tool, in_base] = [0, 3].map(|k| DVec3::from_slice(&unknowns[k..k + 3]));
            put(0, pose.rotation * in_tool + pose.translation_m - in_base, length);
        }
        Constraint::Stage => {
            let Knowledge::Step(step_m) = row.knowledge else { return out };
            let start = pose_of(&unknowns[..6]);
            let direction = DVec3::from_slice(&unknowns[6..9]);
            let (t, r) = pose.displacement_from(&start);
            put(0, t - direction * step_m, length);
            put(3, r, angle);
            // The steps are true to scale; ten times better than anything else that is known of them.
            out[6] = (direction.length() - 1.0) / 1e-5;
        }
        Constraint::Rest => {
            let (t, r) = pose.displacement_from(&pose_of(&unknowns[..6]));
            put(0, t, length);
            put(3, r, angle);
        }
        Constraint::Free => {}
    }
    out
}

/// Derivatives of [`residuals`] by the pose (δt, δθ), and by the unknowns.
pub(crate) fn derivatives(
    constraint: Constraint,
    sigmas: [f64; 2],
    row: &Row,
    unknowns: &[f64],
    pose: &Pose,
) -> ([[f64; 6]; RESIDUALS], Vec<[f64; RESIDUALS]>) {
    // Differences: residuals are smooth, and linear over a micrometre to ten digits.
    const STEP: f64 = 1e-6;
    let slope = |after: [f64; RESIDUALS], before: [f64; RESIDUALS]| {
        std::array::from_fn::<f64, RESIDUALS, _>(|k| (after[k] - before[k]) / (2.0 * STEP))
    };
    let mut by_pose = [[0.0; 6]; RESIDUALS];
    for axis in 0..6 {
        let moved = |step: f64| {
            let mut by = [DVec3::ZERO; 2];
            by[axis / 3][axis % 3] = step;
            residuals(constraint, sigmas, row, unknowns, &pose.perturbed(by[0], by[1]))
        };
        for (of_pose, value) in by_pose.iter_mut().zip(slope(moved(STEP), moved(-STEP))) {
            of_pose[axis] = value;
        }
    }
    let by_unknowns = (0..unknowns.len()).map(|k| {
        let moved = |step: f64| {
            let mut changed = unknowns.to_vec();
            changed[k] += step;
            residuals(constraint, sigmas, row, &changed, pose)
        };
        slope(moved(STEP), moved(-STEP))
    });
    (by_pose, by_unknowns.collect())
}

#[cfg(test)]
mod tests {
    use slitpose_model::rotation_exp;

    use super::*;

    const SIGMAS: [f64; 2] = [1e-6, 1e-5];

    fn left(constraint: Constraint, knowledge: Knowledge, unknowns: &[f64], pose: &Pose) -> f64 {
        let residuals = residuals(constraint, SIGMAS, &Row { knowledge, ..Row::default() }, unknowns, pose);
        residuals.iter().fold(0.0, |most, value| value.abs().max(most))
    }

    #[test]
    fn a_tool_that_turns_about_its_tip_keeps_a_pivot() {
        let (tip, cone) = (DVec3::new(2e-3, -1e-3, -80e-3), DVec3::new(0.5e-3, 0.2e-3, -79e-3));
        let unknowns = [tip.to_array(), cone.to_array()].concat();
        for turn in [DVec3::ZERO, DVec3::new(0.2, -0.1, 0.7)] {
            let rotation = rotation_exp(turn);
            let pose = Pose { rotation, translation_m: cone - rotation * tip };
            assert!(left(Constraint::Pivot, Knowledge::Nothing, &unknowns, &pose) < 1e-8);
            let slipped = Pose { translation_m: pose.translation_m + DVec3::Y * 3e-6, ..pose };
            assert!((left(Constraint::Pivot, Knowledge::Nothing, &unknowns, &slipped) - 3.0).abs() < 1e-8);
        }
    }

    #[test]
    fn a_tool_that_moves_along_a_line_keeps_a_stage() {
        let (start, line) = ([1e-3, 2e-3, -1e-3, 0.1, -0.2, 0.05], DVec3::new(0.6, 0.0, -0.8));
        let unknowns = [start.as_slice(), &line.to_array()].concat();
        let at = |way_m: f64| Pose { translation_m: pose_of(&start).translation_m + line * way_m, ..pose_of(&start) };
        for step_m in [0.0, 2e-3, -1e-3] {
            assert!(left(Constraint::Stage, Knowledge::Step(step_m), &unknowns, &at(step_m)) < 1e-8);
        }
        // One micrometre too far along the line: 0.8 σ along z. Steps are true: a line longer than one is none.
        assert!((left(Constraint::Stage, Knowledge::Step(1e-3), &unknowns, &at(1.001e-3)) - 0.8).abs() < 1e-6);
        let longer = [start.as_slice(), &(line * 1.0001).to_array()].concat();
        assert!(left(Constraint::Stage, Knowledge::Step(0.0), &longer, &at(0.0)) > 9.0);
    }
}

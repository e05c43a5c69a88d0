//! What the tolerance of each kind of part costs in poses, before calibration and after it: the linear prediction.

use nalgebra::{DMatrix, DVector};
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{ModelError, Pose};

use crate::adjust::USUAL_ERROR;
use crate::data::{Constraint, Data, Knowledge, Row};
use crate::head::uncalibrated;
use crate::normal::Normal;
use crate::pose_error::{POSES, spread};
use crate::state::sensitivities;
use crate::state::{State, Weights};
use crate::{CalibrateError, Quantity, prior};

/// The known poses of a calibration.
#[derive(Clone, Copy, Debug)]
pub struct KnownPoses {
    /// How many, spread over the workspace.
    pub count: usize,
    /// Standard deviations of the instrument: metres, radians.
    pub instrument: [f64; 2],
    /// Frames averaged at each.
    pub frames: f64,
}

/// Errors of poses, root mean square over the workspace: metres, radians.
pub type PoseRms = [f64; 2];

/// What one kind of part costs.
#[derive(Clone, Debug, PartialEq)]
pub struct PartCost {
    /// What deviates, in words.
    pub part: &'static str,
    /// Its key in `[tolerance]`.
    pub key: &'static str,
    /// Its share of the errors of poses by the uncalibrated head.
    pub before: PoseRms,
    /// By how much the calibrated head would err less if the part were known: the root of the difference of squares.
    pub after: PoseRms,
}

/// What tolerances cost.
#[derive(Clone, Debug, PartialEq)]
pub struct PartCosts {
    /// The kinds of parts, the dearest before calibration first.
    pub parts: Vec<PartCost>,
    /// All together, before calibration.
    pub before: PoseRms,
    /// And after it.
    pub after: PoseRms,
}

/// What the tolerances of `file` cost, whose `noise` of a single frame is that of its scene; calibrated at `known` poses.
///
/// To first order around the scene.
pub fn part_costs(file: &SceneFile, known: KnownPoses) -> Result<PartCosts, CalibrateError> {
    let nominal = &file.scene;
    let parameters = prior::parameters(file)?;
    if parameters.entries.is_empty() {
        return Err(CalibrateError::NothingOpen);
    }
    let count = parameters.entries.len();
    let state_with = |errors: Vec<ModelError>, data: &Data| {
        State::new(nominal, parameters.clone(), data, data.rows.iter().filter_map(Row::reported).collect(), errors)
    };

    let rough = uncalibrated(file)?;
    let errors = rough.cells.iter().map(|cell| cell.effects.model_error).collect();
    let before = state_with(errors, &Data::default());
    let diagonal = |counts: &dyn Fn(Quantity) -> bool| {
        let value = |k: usize| if counts(parameters.entries[k].quantity) { 1.0 } else { 0.0 };
        DMatrix::from_diagonal(&DVector::from_iterator(count, (0..count).map(value)))
    };

    let mut data = Data::default();
    let at: Vec<Pose> = file.workspace.poses(known.count).collect();
    let cells = sensitivities(nominal, &parameters, &at, true)?;
    let row = |(number, pose)| Row {
        id: String::new(),
        readings: cells.iter().map(|cell| cell.pairs[number]).collect(),
        frames: known.frames,
        time_s: None,
        knowledge: Knowledge::Reported(pose),
    };
    data.add("", Constraint::Known, known.instrument, at.iter().copied().enumerate().map(row).collect());
    let after = state_with(vec![USUAL_ERROR; nominal.cells.len()], &data);
    let information = DMatrix::identity(count, count);
    let normal = Normal::assemble(&data, &after, cells, &Weights::equal(&data), &information);
    // Covariance of all others if those of one kind are known.
    let without = |known: &dyn Fn(Quantity) -> bool| -> Result<DMatrix<f64>, CalibrateError> {
        let mut matrix = normal.matrix.clone();
        for k in (0..count).filter(|&k| known(parameters.entries[k].quantity)) {
            matrix.row_mut(k).fill(0.0);
            matrix.column_mut(k).fill(0.0);
            matrix[(k, k)] = f64::MAX.sqrt();
        }
        Ok(matrix.cholesky().ok_or(CalibrateError::Singular)?.inverse())
    };

    let mut kinds: Vec<(&str, &str)> = Vec::new();
    for entry in &parameters.entries {
        if !kinds.contains(&entry.quantity.kind().0.part) {
            kinds.push(entry.quantity.kind().0.part);
        }
    }
    let mut spreads = [vec![diagonal(&|_| true)], vec![without(&|_| false)?]];
    for kind in &kinds {
        spreads[0].push(diagonal(&|quantity| quantity.kind().0.part == *kind));
        spreads[1].push(without(&|quantity| quantity.kind().0.part == *kind)?);
    }
    let poses: Vec<Pose> = file.workspace.poses(POSES).collect();
    let cells = sensitivities(nominal, &parameters, &poses, true)?;
    let [of_before, of_after] =
        [(&before, &spreads[0]), (&after, &spreads[1])].map(|(state, spreads)| spread(state, &cells, &poses, spreads));
    let difference =
        |all: PoseRms, rest: PoseRms| [0, 1].map(|k| (all[k] * all[k] - rest[k] * rest[k]).max(0.0).sqrt());
    let mut parts: Vec<PartCost> = kinds
        .into_iter()
        .zip(of_before[1..].iter().zip(&of_after[1..]))
        .map(|((part, key), (before, rest))| PartCost {
            part,
            key,
            before: *before,
            after: difference(of_after[0], *rest),
        })
        .collect();
    parts.sort_by(|a, b| b.before[0].total_cmp(&a.before[0]));
    Ok(PartCosts { parts, before: of_before[0], after: of_after[0] })
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::{Tolerance, WIDE};

    use super::*;

    const KNOWN: KnownPoses = KnownPoses { count: 60, instrument: [2e-6, 20e-6], frames: 16.0 };

    #[test]
    fn a_tolerance_costs_in_proportion_and_nothing_if_it_is_zero() {
        let file = WIDE.read().expect("a scene");
        let with = |tolerance: Tolerance| {
            part_costs(&SceneFile { tolerance: Some(tolerance), ..file.clone() }, KNOWN).expect("costs")
        };
        let costs = with(Tolerance::default());
        // Parts are independent: squares add up.
        for axis in 0..2 {
            let sum: f64 = costs.parts.iter().map(|part| part.before[axis].powi(2)).sum();
            assert!((sum / costs.before[axis].powi(2) - 1.0).abs() < 1e-9);
        }
        // Calibration is worth its while, for each kind of part.
        assert!(costs.after[0] < 0.02 * costs.before[0], "{costs:?}");
        assert!(costs.parts.iter().all(|part| part.after[0] < costs.after[0]), "{costs:?}");
        let stiff = with(Tolerance { angle_rad: 0.0, ..Tolerance::default() });
        assert!(costs.parts.iter().any(|part| part.key == "angle_deg"));
        assert!(stiff.parts.iter().all(|part| part.key != "angle_deg"));
        assert!(stiff.before[0] < costs.before[0] && stiff.after[0] < costs.after[0]);
        let known = Tolerance {
            position_m: 0.0,
            angle_rad: 0.0,
            slit_width_m: 0.0,
            emitter_angle_rad: 0.0,
            emitter_gain_relative: 0.0,
            electrode_gain_relative: 0.0,
            profile_relative: 0.0,
            nonlinearity_m: 0.0,
            window_m: 0.0,
            stray_relative: 0.0,
        };
        let all_known = SceneFile { tolerance: Some(known), ..file.clone() };
        assert!(matches!(part_costs(&all_known, KNOWN), Err(CalibrateError::NothingOpen)));
    }
}

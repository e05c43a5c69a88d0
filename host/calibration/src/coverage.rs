//! Which part of the workspace the known poses cover, and the error to expect outside of it.

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::Deserialize;
use slitpose_head::scene_file::Workspace;
use slitpose_head::table::POSE_COLUMNS;
use slitpose_model::{Pose, Scene, SceneError};

use crate::data::{Data, values_of};
use crate::pose_error::{POSES, spread};
use crate::state::{State, Weights, sensitivities};

/// Share of the workspace, along one of its axes, below which poses do not speak for the whole.
const COVERED: f64 = 0.6;

/// The box that the known poses span.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
pub struct Coverage {
    /// Least translations and rotation vectors, metres and radians.
    pub lower: [f64; 6],
    /// Greatest ones.
    pub upper: [f64; 6],
    /// Share of the workspace's volume.
    pub share: f64,
    /// Expected error of translations in the rest of the workspace by the parameters alone, root mean square of the
    /// distance, metres; `None`: there is no rest.
    pub outside_m: Option<f64>,
    /// The same of rotations, radians.
    pub outside_rad: Option<f64>,
}

/// Of the six coordinates of [`values_of`].
pub(crate) fn half_extents(workspace: &Workspace) -> [f64; 6] {
    let ([x, y, z], [a, b, c]) = (workspace.half_extent_m.to_array(), workspace.half_extent_rad.to_array());
    [x, y, z, a, b, c]
}

impl Coverage {
    /// Of the poses that were known and no outliers; `None`: there are none. `covariance` is that of the unknowns.
    pub(crate) fn of(
        nominal: &Scene,
        data: &Data,
        state: &State,
        weights: &Weights,
        covariance: &DMatrix<f64>,
        workspace: &Workspace,
    ) -> Result<Option<Self>, SceneError> {
        let is_known = |row: &usize| weights.poses[*row] == 1.0 && data.rows[*row].reported().is_some();
        let values = (0..data.rows.len()).filter(is_known).map(|row| values_of(&state.poses[row]));
        let bounds = values.map(|values| [values, values]).reduce(|[lower, upper], [value, _]| {
            [0, 1].map(|k| std::array::from_fn(|axis| [f64::min, f64::max][k]([lower, upper][k][axis], value[axis])))
        });
        let Some([lower, upper]) = bounds else { return Ok(None) };
        let mut found = Self { lower, upper, share: 1.0, outside_m: None, outside_rad: None };
        found.share = found.shares(workspace).into_iter().product();
        let outside: Vec<Pose> = workspace.poses(POSES).filter(|pose| !found.contains(pose)).collect();
        let cells = sensitivities(nominal, &state.parameters, &outside, true)?;
        let count = state.parameters.entries.len();
        let of_parameters = covariance.view((0, 0), (count, count)).clone_owned();
        if let [[metres, radians]] = spread(state, &cells, &outside, &[of_parameters])[..]
            && metres > 0.0
        {
            (found.outside_m, found.outside_rad) = (Some(metres), Some(radians));
        }
        Ok(Some(found))
    }

    fn contains(&self, pose: &Pose) -> bool {
        let values = values_of(pose);
        (0..6).all(|axis| (self.lower[axis]..=self.upper[axis]).contains(&values[axis]))
    }

    /// Of each axis of the workspace.
    fn shares(&self, workspace: &Workspace) -> [f64; 6] {
        let half = half_extents(workspace);
        std::array::from_fn(|axis| {
            let [lower, upper] = [self.lower[axis], self.upper[axis]].map(|end| end.clamp(-half[axis], half[axis]));
            if half[axis] > 0.0 { 0.5 * (upper - lower) / half[axis] } else { 1.0 }
        })
    }

    /// A sentence for users, if poses are missing somewhere.
    pub(crate) fn remark(&self, workspace: &Workspace) -> Option<String> {
        let few = self.shares(workspace).into_iter().enumerate().filter(|(_, share)| *share < COVERED);
        let few: Vec<String> =
            few.map(|(axis, share)| format!("{} {:.0} %", POSE_COLUMNS[axis], 100.0 * share)).collect();
        let expected = match (self.outside_m, self.outside_rad) {
            (Some(metres), Some(radians)) => {
                format!("expect {:.0} µm and {:.2} mrad rms outside it", metres * 1e6, radians * 1e3)
            }
            _ => "outside it errors are greater".to_owned(),
        };
        (!few.is_empty()).then(|| {
            format!(
                "the poses cover only a part of the workspace ({}; {:.2} % of its volume): the error of poses left out \
                 holds within that part, {expected}; add poses farther out",
                few.join(", "),
                100.0 * self.share
            )
        })
    }
}

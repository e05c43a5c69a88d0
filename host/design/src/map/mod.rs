//! How accurate a head is, and where: `slitpose scene map`.
//!
//! [`Outlook`] says what a single frame is worth at a pose; [`Map::of`] asks it all over the workspace: poses spread evenly, and
//! planes through home, each with the worst of what lies behind and before it. [`tolerances`] says what parts that are off
//! cost, [`Schedules`] what the schedule does.

mod outlook;
mod schedule;

use std::sync::Mutex;

pub use outlook::{NoiseOf, Outlook, View};
pub use schedule::{Candidate, Schedules};
use slitpose_calibration::{CalibrateError, Head, KnownPoses, PartCosts, half_extents, part_costs, pose_of, values_of};
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_head::threads::{lock, on_all_cores};
use slitpose_model::{Pose, SceneError};

use crate::report::frame_scene;

/// How finely a workspace is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Fineness {
    /// Poses spread over the workspace.
    pub samples: usize,
    /// Points along each side of a plane; zero: no planes.
    pub side: usize,
    /// Poses behind each point of a plane, besides that in the plane, of which the worst counts.
    pub behind: usize,
}

impl Default for Fineness {
    fn default() -> Self {
        Self { samples: 20_000, side: 33, behind: 24 }
    }
}

/// Poses at which each cell is dark in turn.
const DARK_POSES: usize = 500;

impl Fineness {
    /// How many poses are looked at in all.
    pub fn poses(&self) -> usize {
        self.samples + PLANES.len() * self.side * self.side * (1 + self.behind)
    }
}

/// A workspace as single frames see it.
#[derive(Clone, Debug)]
pub struct Map {
    /// Where the noise of a frame comes from.
    pub noise: NoiseOf,
    /// Frames per second; `None` without front end.
    pub frame_rate_hz: Option<f64>,
    /// With the tool at home.
    pub home: View,
    /// Poses spread evenly, and what a single frame is worth there.
    pub samples: Vec<(Pose, View)>,
    /// Of each cell, some of the poses while it is dark.
    pub one_dark: Vec<Vec<View>>,
    /// Planes through home.
    pub planes: Vec<Plane>,
    /// See [`Fineness::behind`].
    pub behind: usize,
}

impl Map {
    /// Looks at the workspace of `head`, on all cores; `progress` is called for each pose, [`Fineness::poses`] in all.
    pub fn of(head: Head, fineness: Fineness, progress: impl FnMut() + Send) -> Result<Self, SceneError> {
        let workspace = head.file.workspace;
        let outlook = Outlook::of(head)?;
        let progress = Mutex::new(progress);
        let view = |pose: &Pose| {
            let view = outlook.at(pose);
            lock(&progress)();
            view
        };
        let poses: Vec<Pose> = workspace.poses(fineness.samples).collect();
        let with_dark =
            |cell| on_all_cores(&poses[..poses.len().min(DARK_POSES)], |pose| outlook.at_without(pose, Some(cell)));
        Ok(Self {
            noise: outlook.noise,
            frame_rate_hz: outlook.frame_rate_hz,
            home: outlook.at(&Pose::HOME),
            samples: on_all_cores(&poses, |pose| (*pose, view(pose))),
            one_dark: (0..outlook.cells()).map(with_dark).collect(),
            planes: (PLANES.into_iter().filter(|_| fineness.side > 0))
                .map(|axes| Plane::of(axes, &workspace, fineness, view))
                .collect(),
            behind: fineness.behind,
        })
    }

    /// How many cells the head has.
    pub fn cells(&self) -> usize {
        self.one_dark.len()
    }

    /// Of all poses, `value` at the share `quantile` of them, ascending; what has no value is last, and infinite.
    pub fn quantile(&self, quantile: f64, value: impl Fn(&View) -> Option<f64>) -> f64 {
        self.quantiles([quantile], value)[0]
    }

    /// [`Self::quantile`] of several.
    pub fn quantiles<const N: usize>(&self, quantiles: [f64; N], value: impl Fn(&View) -> Option<f64>) -> [f64; N] {
        quantiles_of(self.samples.iter().map(|(_, view)| view), quantiles, value)
    }

    /// The greatest median of `value` while one cell is dark, and that cell; `None` without cells.
    pub fn worst_dark(&self, value: impl Fn(&View) -> Option<f64>) -> Option<(usize, f64)> {
        let median = |views: &Vec<View>| quantiles_of(views.iter(), [0.5], &value)[0];
        self.one_dark.iter().map(median).enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Share of the poses for which `holds`.
    pub fn share(&self, holds: impl Fn(&View) -> bool) -> f64 {
        self.samples.iter().filter(|(_, view)| holds(view)).count() as f64 / self.samples.len() as f64
    }

    /// The pose where `value` is greatest, and that value; what has none does not count.
    pub fn worst(&self, value: impl Fn(&View) -> Option<f64>) -> Option<(Pose, f64)> {
        let found = self.samples.iter().filter_map(|(pose, view)| Some((*pose, value(view)?)));
        found.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// By what a standard deviation of single frames is to be multiplied for the density of white noise, one-sided, per
    /// √Hz: noise of variance σ² fills the band up to half the frame rate evenly. `None` without front end.
    pub fn per_root_hz(&self) -> Option<f64> {
        self.frame_rate_hz.map(per_root_hz)
    }
}

fn per_root_hz(frame_rate_hz: f64) -> f64 {
    (2.0 / frame_rate_hz).sqrt()
}

/// Of `views`, values at shares of them, ascending; what has no value is last, and infinite.
pub(crate) fn quantiles_of<'a, const N: usize>(
    views: impl Iterator<Item = &'a View>,
    quantiles: [f64; N],
    value: impl Fn(&View) -> Option<f64>,
) -> [f64; N] {
    let mut values: Vec<f64> = views.map(|view| value(view).unwrap_or(f64::INFINITY)).collect();
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    quantiles.map(|share| values.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN))
}

/// The planes: pairs of (tx, ty, tz, rx, ry, rz).
pub(super) const PLANES: [[usize; 2]; 6] = [[0, 1], [0, 2], [1, 2], [3, 4], [3, 5], [4, 5]];

/// Poses of which two coordinates vary, the others zero.
#[derive(Clone, Debug)]
pub struct Plane {
    /// The two coordinates, in the order (t, θ).
    pub axes: [usize; 2],
    /// Half extents along both, metres or radians.
    pub extents: [f64; 2],
    /// Points along each side.
    pub side: usize,
    /// Row by row; the first coordinate varies fastest.
    pub points: Vec<PlanePoint>,
}

/// One point of a plane.
#[derive(Clone, Copy, Debug)]
pub struct PlanePoint {
    /// Both coordinates, metres or radians.
    pub at: [f64; 2],
    /// In the plane.
    pub view: View,
    /// The greatest standard deviation of the position over poses with these two coordinates, metres; infinite if there
    /// is one at which a frame gives no pose.
    pub worst_m: f64,
    /// The same of the rotation, radians.
    pub worst_rad: f64,
    /// The fewest cells whose whole spot is on the detector.
    pub least_lit: usize,
}

impl Plane {
    pub(super) fn of(
        axes: [usize; 2],
        workspace: &Workspace,
        fineness: Fineness,
        view: impl Fn(&Pose) -> View + Sync,
    ) -> Self {
        let extents = axes.map(|axis| half_extents(workspace)[axis]);
        let behind: Vec<Pose> = workspace.poses(fineness.behind).collect();
        let last = fineness.side.saturating_sub(1).max(1) as f64;
        let along = |k: usize, extent: f64| extent * (2.0 * k as f64 / last - 1.0);
        let places = (0..fineness.side).flat_map(|row| (0..fineness.side).map(move |column| [column, row]));
        let places: Vec<[usize; 2]> = places.collect();
        let points = on_all_cores(&places, |&[column, row]| {
            let at = [along(column, extents[0]), along(row, extents[1])];
            let here = |pose: &Pose| {
                let mut coordinates = values_of(pose);
                for (axis, value) in axes.into_iter().zip(at) {
                    coordinates[axis] = value;
                }
                view(&pose_of(&coordinates))
            };
            let view = here(&Pose::HOME);
            let views: Vec<View> = behind.iter().map(here).chain([view]).collect();
            let most = |of: fn(&View) -> Option<f64>| {
                views.iter().map(|view| of(view).unwrap_or(f64::INFINITY)).fold(0.0, f64::max)
            };
            let least_lit = views.iter().map(|view| view.lit).fold(view.lit, usize::min);
            PlanePoint { at, view, worst_m: most(View::sigma_m), worst_rad: most(View::sigma_rad), least_lit }
        });
        Self { axes, extents, side: fineness.side, points }
    }
}

/// How heads are calibrated: at a hundred poses by an instrument as good as a coordinate measuring machine.
pub(crate) const KNOWN: KnownPoses = KnownPoses { count: 100, instrument: [2e-6, 20e-6], frames: 16.0 };

/// What the tolerances of `file` cost, by kind of part and to first order.
pub fn tolerances(file: &SceneFile) -> Result<PartCosts, CalibrateError> {
    let (scene, _) = frame_scene(file);
    part_costs(&SceneFile { scene, ..file.clone() }, KNOWN)
}

#[cfg(test)]
mod tests;

//! Every cell over a sample of the workspace: statistics of its light, and what its integrals take for a solver.

use serde::Serialize;
use slitpose_calibration::pose_of;
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_head::threads::on_all_cores;
use slitpose_model::{CompiledScene, Pose, Response, SceneError, Status, Tier};

use super::serialize_pose;

/// Poses of a piece: bounds memory.
const POSES: usize = 1024;

/// Does `work` on all of `poses`, on all cores, and hands what comes of it to `take` in their order. `progress` gets the number
/// of poses of each piece that is done.
pub(super) fn over<R: Send>(
    mut poses: impl Iterator<Item = Pose>,
    mut progress: impl FnMut(usize),
    work: impl Fn(&Pose) -> R + Sync,
    mut take: impl FnMut(&Pose, R),
) {
    loop {
        let piece: Vec<Pose> = poses.by_ref().take(POSES).collect();
        if piece.is_empty() {
            return;
        }
        piece.iter().zip(on_all_cores(&piece, &work)).for_each(|(pose, found)| take(pose, found));
        progress(piece.len());
    }
}

/// The six axes of motion from home, in the order (t, θ).
pub(crate) const AXES: [&str; 6] = ["tx", "ty", "tz", "rx", "ry", "rz"];

/// The pose after a pure motion from home along one of [`AXES`], in metres or radians.
///
/// # Panics
/// If `axis` is not below 6.
pub(crate) fn axis_motion(axis: usize, amount: f64) -> Pose {
    let mut motion = [0.0; 6];
    motion[axis] = amount;
    pose_of(&motion)
}

/// The workspace as the cells see it. Shares are of the sampled poses, 0 to 1.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Coverage {
    pub samples: usize,
    /// Share of poses with at least k cells lit, at index k.
    pub at_least_lit: Vec<f64>,
    pub cells: Vec<CellCoverage>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct CellCoverage {
    pub cell: usize,
    /// Share of poses with the whole spot on the active area.
    pub lit: f64,
    /// Share with the spot cut along x.
    pub clipped: f64,
    /// Share without spot.
    pub dark: f64,
    /// Share with the emitter at or behind the slit.
    pub behind: f64,
    /// Share with I_O above the detector's saturation.
    pub saturated: f64,
    /// Share that has a spot, but a faint one.
    pub faint: f64,
    /// Share with an electrode current above the front end's full scale.
    pub over_scale: f64,
    /// Least and most I_O over the poses with a spot; `None` if there is none.
    pub i_o_range_a: Option<[f64; 2]>,
    pub most_electrode_a: f64,
    #[serde(serialize_with = "serialize_pose")]
    pub most_electrode_at: Pose,
}

impl CellCoverage {
    fn new(cell: usize) -> Self {
        Self {
            cell,
            lit: 0.0,
            clipped: 0.0,
            dark: 0.0,
            behind: 0.0,
            saturated: 0.0,
            faint: 0.0,
            over_scale: 0.0,
            i_o_range_a: None,
            most_electrode_a: 0.0,
            most_electrode_at: Pose::HOME,
        }
    }

    fn add(&mut self, pose: &Pose, response: &Response<f64>, full_scale_a: Option<f64>) {
        match response.status {
            Status::Lit => self.lit += 1.0,
            Status::Clipped => self.clipped += 1.0,
            Status::Dark => self.dark += 1.0,
            Status::Behind => self.behind += 1.0,
        }
        let electrode_a = response.currents.i_x1_a.max(response.currents.i_x2_a);
        if electrode_a > self.most_electrode_a {
            (self.most_electrode_a, self.most_electrode_at) = (electrode_a, *pose);
        }
        if full_scale_a.is_some_and(|full_scale_a| electrode_a > full_scale_a) {
            self.over_scale += 1.0;
        }
        if response.flags.saturated {
            self.saturated += 1.0;
        }
        if !response.status.has_spot() {
            return;
        }
        if response.flags.faint {
            self.faint += 1.0;
        }
        let [least, most] = self.i_o_range_a.unwrap_or([f64::INFINITY, 0.0]);
        self.i_o_range_a = Some([least.min(response.i_o_a), most.max(response.i_o_a)]);
    }

    fn divide_by(&mut self, samples: f64) {
        for count in [
            &mut self.lit,
            &mut self.clipped,
            &mut self.dark,
            &mut self.behind,
            &mut self.saturated,
            &mut self.faint,
            &mut self.over_scale,
        ] {
            *count /= samples;
        }
    }
}

impl Coverage {
    pub(super) fn of(
        plan: &CompiledScene<f64>,
        workspace: &Workspace,
        samples: usize,
        full_scale_a: Option<f64>,
        progress: impl FnMut(usize),
    ) -> Self {
        let mut cells: Vec<CellCoverage> = (0..plan.cell_count()).map(CellCoverage::new).collect();
        // Poses with so many cells lit.
        let mut lit = vec![0; plan.cell_count() + 1];
        let respond = |pose: &Pose| (0..plan.cell_count()).map(|cell| plan.respond(cell, pose)).collect::<Vec<_>>();
        over(workspace.poses(samples), progress, respond, |pose, responses| {
            lit[responses.iter().filter(|response| response.status == Status::Lit).count()] += 1;
            cells.iter_mut().zip(&responses).for_each(|(cell, response)| cell.add(pose, response, full_scale_a));
        });
        cells.iter_mut().for_each(|cell| cell.divide_by(samples as f64));
        let at_least = |least| lit[least..].iter().sum::<usize>() as f64 / samples as f64;
        Self { samples, at_least_lit: (0..lit.len()).map(at_least).collect(), cells }
    }
}

/// What `solve`, `run`, `replay` and `simulate` ask for unless told otherwise.
const TOLERANCE: f64 = 1e-6;

/// Poses evaluated: the dearest of them is not far from the dearest of all.
const MAX_SAMPLES: usize = 200;

/// One cell's integrals at the tolerance of solving.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct CellCost {
    pub cell: usize,
    pub tolerance: f64,
    /// Most values of the emission profile for one pair of currents.
    pub most_evaluations: usize,
    /// The greatest error reached: the tolerance, unless the limit of work came first; infinite, in JSON null, if no
    /// light was found by then where there may be some.
    pub relative_error: f64,
}

/// How many poses are looked at, of `samples` of the workspace.
pub(super) fn poses_of(samples: usize) -> usize {
    samples.min(MAX_SAMPLES)
}

/// The costs of all cells over some of `samples` poses of the workspace.
pub(super) fn of_cells(
    file: &SceneFile,
    samples: usize,
    progress: impl FnMut(usize),
) -> Result<Vec<CellCost>, SceneError> {
    let tolerance = TOLERANCE;
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance })?;
    let cost = |cell| CellCost { cell, tolerance, most_evaluations: 0, relative_error: tolerance };
    let mut costs: Vec<_> = (0..plan.cell_count()).map(cost).collect();
    let integrate =
        |pose: &Pose| (0..plan.cell_count()).map(|cell| plan.respond(cell, pose).integration).collect::<Vec<_>>();
    over(file.workspace.poses(poses_of(samples)), progress, integrate, |_, integrations| {
        for (cost, integration) in costs.iter_mut().zip(integrations) {
            let Some(integration) = integration else { continue };
            cost.most_evaluations = cost.most_evaluations.max(integration.evaluations);
            cost.relative_error = cost.relative_error.max(integration.relative_error);
        }
    });
    Ok(costs)
}

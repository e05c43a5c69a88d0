//! Every cell over a sample of the workspace: statistics of its light, and what its integrals take for a solver.

use std::convert::Infallible;

use glam::DVec3;
use serde::Serialize;
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_head::threads::{cores, in_order};
use slitpose_model::{CompiledScene, Pose, Response, SceneError, Status, Tier};

use super::serialize_pose;

/// Poses that a core takes at a time.
const POSES: usize = 256;

/// What is known of the poses that were looked at.
pub(super) trait Tally: Clone + Send + Sync {
    /// Adds a pose, looked at with the optics of `plan`.
    fn add(&mut self, plan: &CompiledScene<f64>, pose: &Pose);

    /// Adds the poses of `later`, which come after those of `self`.
    fn merge(&mut self, later: Self);
}

impl<T: Tally> Tally for Vec<T> {
    fn add(&mut self, plan: &CompiledScene<f64>, pose: &Pose) {
        self.iter_mut().for_each(|tally| tally.add(plan, pose));
    }

    fn merge(&mut self, later: Self) {
        self.iter_mut().zip(later).for_each(|(tally, later)| tally.merge(later));
    }
}

/// What `none` becomes with all of `poses`, on all cores, the same however many they are. `progress` gets the number of
/// poses of each piece that is done.
pub(super) fn over<T: Tally>(
    plan: &CompiledScene<f64>,
    none: &T,
    mut poses: impl Iterator<Item = Pose>,
    mut progress: impl FnMut(usize),
) -> T {
    let mut all = none.clone();
    let next = || {
        Ok::<_, Infallible>(Some(poses.by_ref().take(POSES).collect()).filter(|piece: &Vec<Pose>| !piece.is_empty()))
    };
    let work = |piece: Vec<Pose>| {
        let mut tally = none.clone();
        piece.iter().for_each(|pose| tally.add(plan, pose));
        (tally, piece.len())
    };
    let Ok(()) = in_order(cores(), next, work, |(tally, count)| {
        all.merge(tally);
        progress(count);
        Ok(())
    });
    all
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
    let [tx, ty, tz, rx, ry, rz] = motion;
    Pose::from_vectors(DVec3::new(tx, ty, tz), DVec3::new(rx, ry, rz))
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

    /// Adds the counts of other poses.
    fn merge(&mut self, mut later: Self) {
        for (count, further) in self.counts().into_iter().zip(later.counts()) {
            *count += *further;
        }
        if later.most_electrode_a > self.most_electrode_a {
            (self.most_electrode_a, self.most_electrode_at) = (later.most_electrode_a, later.most_electrode_at);
        }
        self.i_o_range_a = match (self.i_o_range_a, later.i_o_range_a) {
            (Some([least, most]), Some([lower, upper])) => Some([least.min(lower), most.max(upper)]),
            (range, None) | (None, range) => range,
        };
    }

    fn counts(&mut self) -> [&mut f64; 7] {
        [
            &mut self.lit,
            &mut self.clipped,
            &mut self.dark,
            &mut self.behind,
            &mut self.saturated,
            &mut self.faint,
            &mut self.over_scale,
        ]
    }

    fn divide_by(&mut self, samples: f64) {
        self.counts().into_iter().for_each(|count| *count /= samples);
    }
}

#[derive(Clone)]
struct Counts {
    full_scale_a: Option<f64>,
    cells: Vec<CellCoverage>,
    /// Of the poses with so many cells lit.
    lit: Vec<usize>,
}

impl Tally for Counts {
    fn add(&mut self, plan: &CompiledScene<f64>, pose: &Pose) {
        let mut lit = 0;
        for (number, cell) in self.cells.iter_mut().enumerate() {
            let response = plan.respond(number, pose);
            lit += usize::from(response.status == Status::Lit);
            cell.add(pose, &response, self.full_scale_a);
        }
        self.lit[lit] += 1;
    }

    fn merge(&mut self, later: Self) {
        self.cells.iter_mut().zip(later.cells).for_each(|(cell, later)| cell.merge(later));
        self.lit.iter_mut().zip(later.lit).for_each(|(count, later)| *count += later);
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
        let none = Counts {
            full_scale_a,
            cells: (0..plan.cell_count()).map(CellCoverage::new).collect(),
            lit: vec![0; plan.cell_count() + 1],
        };
        let Counts { mut cells, lit, .. } = over(plan, &none, workspace.poses(samples), progress);
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

impl Tally for CellCost {
    fn add(&mut self, plan: &CompiledScene<f64>, pose: &Pose) {
        if let Some(integration) = plan.respond(self.cell, pose).integration {
            self.raise(integration.evaluations, integration.relative_error);
        }
    }

    fn merge(&mut self, later: Self) {
        self.raise(later.most_evaluations, later.relative_error);
    }
}

impl CellCost {
    fn raise(&mut self, evaluations: usize, relative_error: f64) {
        self.most_evaluations = self.most_evaluations.max(evaluations);
        self.relative_error = self.relative_error.max(relative_error);
    }
}

/// The costs of all cells over some of `samples` poses of the workspace.
pub(super) fn of_cells(
    file: &SceneFile,
    samples: usize,
    progress: impl FnMut(usize),
) -> Result<Vec<CellCost>, SceneError> {
    let tolerance = TOLERANCE;
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance })?;
    let costs: Vec<_> = (0..plan.cell_count())
        .map(|cell| CellCost { cell, tolerance, most_evaluations: 0, relative_error: tolerance })
        .collect();
    Ok(over(&plan, &costs, file.workspace.poses(poses_of(samples)), progress))
}

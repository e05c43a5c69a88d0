//! Statistics of every cell over a sample of the workspace.

use serde::Serialize;
use slitpose_model::{Plan, Pose, Response, Status};

use slitpose_head::scene_file::Workspace;

use super::serialize_pose;

/// The workspace as the cells see it. Shares are of the sampled poses, 0 to 1.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Coverage {
    /// How many poses were sampled.
    pub samples: usize,
    /// Share of poses with at least k cells lit, at index k.
    pub at_least_lit: Vec<f64>,
    /// Each cell.
    pub cells: Vec<CellCoverage>,
}

/// One cell over the workspace.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct CellCoverage {
    /// Number of the cell.
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
    /// The largest current of one electrode.
    pub most_electrode_a: f64,
    /// Where that is.
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

    /// Counts one pose.
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

    /// Turns counts into shares.
    fn divide_by(&mut self, samples: f64) {
        let counts = [&mut self.lit, &mut self.clipped, &mut self.dark, &mut self.behind];
        let lights = [&mut self.saturated, &mut self.faint, &mut self.over_scale];
        counts.into_iter().chain(lights).for_each(|count| *count /= samples);
    }
}

impl Coverage {
    pub(super) fn of(
        plan: &Plan<f64>,
        workspace: &Workspace,
        samples: usize,
        full_scale_a: Option<f64>,
        progress: &mut impl FnMut(),
    ) -> Self {
        let mut cells: Vec<_> = (0..plan.cell_count()).map(CellCoverage::new).collect();
        let mut lit_counts = vec![0_usize; plan.cell_count() + 1];
        for pose in workspace.poses(samples) {
            let mut lit = 0;
            for (number, cell) in cells.iter_mut().enumerate() {
                let response = plan.respond(number, &pose);
                lit += usize::from(response.status == Status::Lit);
                cell.add(&pose, &response, full_scale_a);
            }
            lit_counts[lit] += 1;
            progress();
        }
        cells.iter_mut().for_each(|cell| cell.divide_by(samples as f64));
        let at_least = |least| lit_counts[least..].iter().sum::<usize>() as f64 / samples as f64;
        Self { samples, at_least_lit: (0..lit_counts.len()).map(at_least).collect(), cells }
    }
}

//! The head at home: each cell, how far the tool moves from there, and what it shows before it is calibrated. The head over a
//! sample of the workspace: statistics of each cell's light, what its integrals take for a solver, and light
//! from other emitters: those that are lit with its own, and those of the slot before, whose light the front end has not
//! forgotten; and how the slots fill the frame.

use std::f64::consts::PI;

use serde::Serialize;
use slitpose_calibration::{pose_of, uncalibrated};
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_head::threads::on_all_cores;
use slitpose_model::{
    Cell, CompiledScene, MotionPrior, Pose, Response, Scene, SceneError, Solver, Start, Status, Tier,
};

use super::{SOLVING_TOLERANCE, serialize_pose};
use crate::report::currents;

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

/// Geometry and light of a cell at home.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct CellAtHome {
    pub cell: usize,
    /// Geometry of the spot.
    pub status: &'static str,
    pub flags: String,
    /// d_A: height of the emitter above the detector.
    pub emitter_distance_m: f64,
    /// d_B: height of the slit above the detector.
    pub slit_distance_m: f64,
    /// Position of the light; `None` without spot.
    pub x_a_m: Option<f64>,
    /// Angle between the emitter's axis and the beam; `None` without spot.
    pub gamma_rad: Option<f64>,
    pub solid_angle_sr: f64,
    pub i_o_a: f64,
}

pub(super) fn at_home(scene: &Scene, plan: &CompiledScene<f64>) -> Vec<CellAtHome> {
    let describe = |(number, cell): (usize, &Cell)| {
        let response = plan.respond(number, &Pose::HOME);
        let above_detector = cell.emitter.position_tool_m - cell.detector.centre_base_m;
        CellAtHome {
            cell: number,
            status: response.status.as_str(),
            flags: response.flags.to_string(),
            emitter_distance_m: above_detector.dot(cell.detector.normal_base),
            slit_distance_m: cell.slit.distance_m,
            x_a_m: response.x_a_m,
            gamma_rad: response.gamma_rad,
            solid_angle_sr: response.solid_angle_sr,
            i_o_a: response.i_o_a,
        }
    };
    scene.cells.iter().enumerate().map(describe).collect()
}

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
    pub negative: End,
    pub positive: End,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct End {
    /// Signed motion from home, metres or radians; zero if a cell is not usable even at home.
    pub at: f64,
    /// The first cell that is no longer usable; `None` if the search ended before.
    pub cell: Option<usize>,
    /// What that cell becomes: a status other than `lit`, or `faint`.
    pub becomes: Option<&'static str>,
}

pub(super) fn along_axes(plan: &CompiledScene<f64>) -> Vec<Travel> {
    let travel =
        |(number, axis)| Travel { axis, negative: farthest(plan, number, -1.0), positive: farthest(plan, number, 1.0) };
    AXES.into_iter().enumerate().map(travel).collect()
}

fn farthest(plan: &CompiledScene<f64>, axis: usize, sign: f64) -> End {
    let (step, limit) = if axis < 3 { (STEP_M, FARTHEST_M) } else { (STEP_RAD, FARTHEST_RAD) };
    let failure = |amount: f64| {
        let motion: [f64; 6] = std::array::from_fn(|k| if k == axis { sign * amount } else { 0.0 });
        first_unusable(plan, &pose_of(&motion))
    };
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

fn first_unusable(plan: &CompiledScene<f64>, pose: &Pose) -> Option<(usize, &'static str)> {
    (0..plan.cell_count()).find_map(|cell| {
        let response = plan.respond(cell, pose);
        match response.status {
            Status::Lit if response.flags.faint => Some((cell, "faint")),
            Status::Lit => None,
            status => Some((cell, status.as_str())),
        }
    })
}

/// Poses of the workspace that are tried.
const TRIED: usize = 16;

/// Share of poses of the workspace whose currents, by `plan`, lead to a pose by the head's tolerances, which are the default
/// ones where the scene states none.
pub(super) fn told(file: &SceneFile, plan: &CompiledScene<f64>) -> Result<f64, SceneError> {
    let solver = Solver::<f64>::new(&uncalibrated(file)?, Tier::Exact { tolerance: SOLVING_TOLERANCE })?;
    let is_told =
        |pose: &Pose| solver.solve(&currents(plan, pose), Start::Cold, &MotionPrior::AT_REST).estimate.is_some();
    Ok(file.workspace.poses(TRIED).filter(is_told).count() as f64 / TRIED as f64)
}

/// The workspace as the cells see it. Shares are of the sampled poses, 0 to 1.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Coverage {
    pub samples: usize,
    /// Share of poses with at least k cells lit, at index k.
    pub at_least_lit: Vec<f64>,
    pub cells: Vec<CellCoverage>,
}

#[derive(Clone, Debug, Default, Serialize)]
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
        let of_cell = |cell| CellCoverage { cell, ..CellCoverage::default() };
        let mut cells: Vec<CellCoverage> = (0..plan.cell_count()).map(of_cell).collect();
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
    plan: &CompiledScene<f64>,
    workspace: &Workspace,
    samples: usize,
    progress: impl FnMut(usize),
) -> Vec<CellCost> {
    let tolerance = SOLVING_TOLERANCE;
    let cost = |cell| CellCost { cell, tolerance, most_evaluations: 0, relative_error: tolerance };
    let mut costs: Vec<_> = (0..plan.cell_count()).map(cost).collect();
    let integrate =
        |pose: &Pose| (0..plan.cell_count()).map(|cell| plan.respond(cell, pose).integration).collect::<Vec<_>>();
    over(workspace.poses(poses_of(samples)), progress, integrate, |_, integrations| {
        for (cost, integration) in costs.iter_mut().zip(integrations) {
            let Some(integration) = integration else { continue };
            cost.most_evaluations = cost.most_evaluations.max(integration.evaluations);
            cost.relative_error = cost.relative_error.max(integration.relative_error);
        }
    });
    costs
}

/// Cross-talk below this share stays under what gains are known to (1e-3).
pub(super) const CROSSTALK_LIMIT: f64 = 1e-3;

/// The worst cross-talk of one lighting slot over the workspace.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct SlotCrosstalk {
    pub slot: usize,
    pub emitters: Vec<usize>,
    /// Largest current from the others, as a share of the cell's own photocurrent.
    pub share: f64,
    /// The cell that receives it.
    pub cell: usize,
    #[serde(serialize_with = "serialize_pose")]
    pub at: Pose,
}

/// Cross-talk within each slot of several emitters, and from the slot before each slot where a front end is slow enough
/// for it to count.
pub(super) fn of_slots(
    file: &SceneFile,
    plan: &CompiledScene<f64>,
    samples: usize,
    progress: impl FnMut(usize),
) -> (Vec<SlotCrosstalk>, Vec<SlotCrosstalk>) {
    let slots = &file.lighting.slots;
    // Slot, the emitters whose light counts in it, and as which share of it.
    let together = (0..slots.len()).filter(|&slot| slots[slot].len() > 1).map(|slot| (slot, &slots[slot], 1.0));
    let mut sources: Vec<(usize, &Vec<usize>, f64)> = together.collect();
    let count = sources.len();
    let before = |slot: usize| &slots[(slot + slots.len() - 1) % slots.len()];
    let carried = (0..slots.len()).map(|slot| (slot, before(slot), share_carried_into(file, slot)));
    // Less than this is too little even of neighbours that are as bright as a cell's own light.
    let counts = |(slot, others, weight): &(usize, &Vec<usize>, f64)| {
        *weight > CROSSTALK_LIMIT && !slots[*slot].is_empty() && !others.is_empty()
    };
    sources.extend(carried.filter(counts));
    let none = |&(slot, ..): &(usize, &Vec<usize>, f64)| {
        let emitters = slots[slot].clone();
        SlotCrosstalk {
            slot,
            share: 0.0,
            cell: emitters.first().copied().unwrap_or_default(),
            at: Pose::HOME,
            emitters,
        }
    };
    let mut found: Vec<SlotCrosstalk> = sources.iter().map(none).collect();
    let worst = |pose: &Pose| {
        let of = |&(slot, others, weight): &(usize, &Vec<usize>, f64)| {
            let shares = slots[slot].iter().map(|&cell| (weight * share_of_others(plan, cell, others, pose), cell));
            shares.fold((0.0, 0), |most, it| if it.0 > most.0 { it } else { most })
        };
        sources.iter().map(of).collect::<Vec<_>>()
    };
    over(file.workspace.poses(samples), progress, worst, |pose, worst| {
        for (slot, (share, cell)) in found.iter_mut().zip(worst).filter(|(slot, (share, _))| *share > slot.share) {
            (slot.share, slot.cell, slot.at) = (share, cell, *pose);
        }
    });
    let carried = found.split_off(count);
    (found, carried)
}

/// Share of a current of the slot before that is in the words of `slot`: exp(−t/τ), in the mean of its conversions.
/// The first slot follows the last one of the frame before, and the rest of that frame.
fn share_carried_into(file: &SceneFile, slot: usize) -> f64 {
    let Some(front_end) = file.front_end else { return 0.0 };
    let slot_s = front_end.slot_duration_s(file.scene.cells.len());
    let idle_s = front_end.frame_period_s() - file.lighting.slots.len() as f64 * slot_s;
    let off_s = front_end.settling_s + if slot == 0 { idle_s.max(0.0) } else { 0.0 };
    let count = front_end.oversampling;
    let at_s = (0..count).map(|conversion| off_s + f64::from(conversion) * front_end.conversion_s);
    at_s.map(|at_s| (-at_s / front_end.time_constant_s).exp()).sum::<f64>() / f64::from(count)
}

/// Zero where the cell's own signal is no measurement anyway: not lit, or faint.
pub(crate) fn share_of_others(plan: &CompiledScene<f64>, cell: usize, emitters: &[usize], pose: &Pose) -> f64 {
    let own = plan.respond(cell, pose);
    if own.status != Status::Lit || own.flags.faint {
        return 0.0;
    }
    let others = emitters.iter().filter(|emitter| **emitter != cell);
    let from_others: f64 = others.map(|emitter| plan.crosstalk(cell, *emitter, pose).total_a()).sum();
    from_others / plan.crosstalk(cell, cell, pose).total_a()
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Timing {
    /// Lighting slots in a frame, the dark one included.
    pub slots: usize,
    pub slot_s: f64,
    pub busy_s: f64,
    pub frame_s: f64,
}

impl Timing {
    pub(super) fn of(file: &SceneFile) -> Option<Self> {
        let front_end = file.front_end?;
        let slot_s = front_end.slot_duration_s(file.scene.cells.len());
        let slots = file.lighting.slots.len();
        Some(Self { slots, slot_s, busy_s: slots as f64 * slot_s, frame_s: front_end.frame_period_s() })
    }
}

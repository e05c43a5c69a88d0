//! Light on a cell from other emitters that are lit with its own.

use serde::Serialize;
use slitpose_model::{Plan, Pose, Status};

use slitpose_head::scene_file::SceneFile;

use super::sample::{self, Tally};
use super::serialize_pose;

/// The worst cross-talk of one lighting slot over the workspace.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct SlotCrosstalk {
    /// Number of the slot.
    pub slot: usize,
    /// The emitters it lights.
    pub emitters: Vec<usize>,
    /// Largest current from the others, as a share of the cell's own photocurrent.
    pub share: f64,
    /// The cell that receives it.
    pub cell: usize,
    /// Where.
    #[serde(serialize_with = "serialize_pose")]
    pub at: Pose,
}

impl Tally for SlotCrosstalk {
    fn add(&mut self, plan: &Plan<f64>, pose: &Pose) {
        for &cell in &self.emitters {
            let share = share_of_others(plan, cell, &self.emitters, pose);
            if share > self.share {
                (self.share, self.cell, self.at) = (share, cell, *pose);
            }
        }
    }

    fn merge(&mut self, later: Self) {
        if later.share > self.share {
            *self = later;
        }
    }
}

pub(super) fn of_slots(
    file: &SceneFile,
    plan: &Plan<f64>,
    samples: usize,
    progress: impl FnMut(usize),
) -> Vec<SlotCrosstalk> {
    let slots: Vec<_> = file
        .lighting
        .slots
        .iter()
        .enumerate()
        .filter(|(_, emitters)| emitters.len() > 1)
        .map(|(slot, emitters)| SlotCrosstalk {
            slot,
            emitters: emitters.clone(),
            share: 0.0,
            cell: emitters[0],
            at: Pose::HOME,
        })
        .collect();
    sample::over(plan, &slots, file.workspace.poses(samples), progress)
}

/// Zero where the cell's own signal is no measurement anyway: not lit, or faint.
pub(crate) fn share_of_others(plan: &Plan<f64>, cell: usize, emitters: &[usize], pose: &Pose) -> f64 {
    let own = plan.respond(cell, pose);
    if own.status != Status::Lit || own.flags.faint {
        return 0.0;
    }
    let others = emitters.iter().filter(|emitter| **emitter != cell);
    let from_others: f64 = others.map(|emitter| plan.crosstalk(cell, *emitter, pose).total_a()).sum();
    from_others / plan.crosstalk(cell, cell, pose).total_a()
}

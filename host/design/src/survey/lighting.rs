//! Light on a cell from other emitters: those that are lit with its own, and those of the slot before, whose light the
//! front end has not forgotten; and how the slots fill the frame.

use serde::Serialize;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{CompiledScene, Pose, Status};

use super::{coverage, serialize_pose};

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
    coverage::over(file.workspace.poses(samples), progress, worst, |pose, worst| {
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

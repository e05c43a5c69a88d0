//! What a designer should look at, each with its number and a remedy.

use serde::{Serialize, Serializer};
use slitpose_model::{Pose, Status};
use thiserror::Error;

use slitpose_head::scene_file::{SceneFile, SceneFileError};

use super::cost::CellCost;
use super::coverage::CellCoverage;
use super::{End, Survey};

/// Cross-talk below this share stays under what gains are known to (1e-3).
const CROSSTALK_LIMIT: f64 = 1e-3;

/// Values of a profile that six cells may take in the three to five evaluations of a solve, at some 25 ns each
/// with derivatives, and leave it within 100 µs.
const MOST_EVALUATIONS: usize = 150;

/// How much looser a tolerance is proposed.
const LOOSER: f64 = 100.0;

/// A finding that does not make the scene unusable.
#[derive(Debug, Error)]
pub enum Warning {
    /// A cell does not work at home.
    #[error("cell {cell} is {status} at home; move its emitter, slit or detector into line")]
    NotLitAtHome {
        /// The cell.
        cell: usize,
        /// Its status.
        status: &'static str,
    },
    /// The tool leaves a cell's range inside the workspace.
    #[error(
        "cell {cell} is {becomes} beyond {axis} {}, inside the workspace ({}); \
         shrink the workspace, or lower slit.distance_mm to reach farther",
        extent(axis, *at), extent(axis, *half_extent)
    )]
    ShortTravel {
        /// The axis.
        axis: &'static str,
        /// Where the cell stops being lit, metres or radians.
        at: f64,
        /// How far the workspace reaches on that side, metres or radians.
        half_extent: f64,
        /// The cell.
        cell: usize,
        /// What it becomes.
        becomes: &'static str,
    },
    /// Some of the workspace is not seen by every cell.
    #[error(
        "all {cells} cells are lit in {:.2} % of the workspace only; shrink the workspace, or lower slit.distance_mm",
        100.0 * share
    )]
    PartlyLit {
        /// How many cells.
        cells: usize,
        /// Share of poses with all lit.
        share: f64,
    },
    /// A current beyond the converter.
    #[error(
        "cell {cell} gives {:.2} µA on one electrode at {}, more than front_end.full_scale_a = {:.2} µA \
         ({:.2} % of the workspace); raise the full scale or lower the emitter's intensity",
        most_a * 1e6, describe(at), full_scale_a * 1e6, 100.0 * share
    )]
    OverScale {
        /// The cell.
        cell: usize,
        /// The largest electrode current.
        most_a: f64,
        /// Where.
        at: Pose,
        /// The converter's limit.
        full_scale_a: f64,
        /// Share of poses above it.
        share: f64,
    },
    /// A current beyond the detector.
    #[error(
        "the detector of cell {cell} saturates in {:.2} % of the workspace (I_O up to {:.1} µA, more than its saturation_a); \
         lower the emitter's intensity or narrow the slit",
        100.0 * share, most_a * 1e6
    )]
    Saturated {
        /// The cell.
        cell: usize,
        /// Share of poses.
        share: f64,
        /// The largest total current.
        most_a: f64,
    },
    /// Too little light.
    #[error(
        "cell {cell} is faint in {:.2} % of the workspace (I_O down to {:.1} nA); \
         raise the emitter's intensity or widen the slit",
        100.0 * share, least_a * 1e9
    )]
    Faint {
        /// The cell.
        cell: usize,
        /// Share of poses.
        share: f64,
        /// The least total current with a spot.
        least_a: f64,
    },
    /// Emitters of one slot disturb each other.
    #[error(
        "in lighting slot {slot}, cell {cell} gets {:.2} % of its own signal from other emitters at {}; \
         light them in different slots",
        100.0 * share, describe(at)
    )]
    Crosstalk {
        /// The slot.
        slot: usize,
        /// The cell.
        cell: usize,
        /// Share of its own signal.
        share: f64,
        /// Where.
        at: Pose,
    },
    /// Integrals that take long.
    #[error(
        "cell {} takes up to {} values of its emission profile for one pair of currents at tolerance {:.0e} \
         (an ordinary cell: 9), so that solving may fall behind; a wider or smoother profile or a smaller spot \
         takes fewer, or solve with --tolerance {:.0e} or --tier paper",
        cost.cell, cost.most_evaluations, cost.tolerance, LOOSER * cost.tolerance
    )]
    Costly {
        /// What is taken.
        cost: CellCost,
    },
    /// Integrals that meet the limit of work.
    #[error(
        "cell {}: the exact tier reaches {:.1e} of I_O where tolerance {:.0e} is asked for: {} values of the emission \
         profile, the limit, do not suffice; give the profile fewer bends or make the spot smaller",
        cost.cell, cost.relative_error, cost.tolerance, cost.most_evaluations
    )]
    Inexact {
        /// What is reached.
        cost: CellCost,
    },
    /// A pose that the head cannot tell.
    #[error(
        "at home the currents leave {directions} free: poses there are `unobservable`; \
         turn every other detector about its normal, by 90° against its neighbours"
    )]
    SingularAtHome {
        /// Names of the coordinates, joined by `;`.
        directions: String,
    },
    /// Other poses with nearly the same currents.
    #[error(
        "poses of the head `{name}` have mirror images with nearly the same currents: a start from nothing is slow \
         and says `ambiguous` where two fit alike; turn every other detector about its normal, by 90° against its \
         neighbours"
    )]
    MirrorImages {
        /// The scene's name.
        name: String,
    },
    /// Nothing to subtract ambient light with.
    #[error("no lighting slot is dark, so ambient light and offsets stay in the currents; add [] to lighting.slots")]
    NoDarkSlot,
    /// Gains are said to be open, but only those that both electrodes of a cell share.
    #[error(
        "uncertainty.emitter_gain_relative leaves open what both electrodes of a cell share; each electrode's own gain \
         counts as known, yet 1 % of it moves a spot by up to {:.0} µm, and hardly a pose would tell; \
         set electrode_gain_relative unless it is calibrated",
        moved_m * 1e6
    )]
    ElectrodeGainsTakenAsKnown {
        /// By how much one percent of both gains moves a spot, metres.
        moved_m: f64,
    },
    /// The schedule is longer than the frame.
    #[error(transparent)]
    SlotsDoNotFit(#[from] SceneFileError),
}

impl Serialize for Warning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

pub(super) fn find(file: &SceneFile, survey: &Survey) -> Vec<Warning> {
    let mut warnings: Vec<_> = survey
        .home
        .iter()
        .filter(|cell| cell.status != Status::Lit.as_str())
        .map(|cell| Warning::NotLitAtHome { cell: cell.cell, status: cell.status })
        .collect();
    if warnings.is_empty() {
        warnings.extend(short_travels(survey));
    }
    if !survey.free_at_home.is_empty() {
        warnings.push(Warning::SingularAtHome { directions: survey.free_at_home.clone() });
    }
    if survey.mirror_images {
        warnings.push(Warning::MirrorImages { name: survey.name.clone() });
    }
    let cells = survey.home.len();
    let share = survey.coverage.at_least_lit[cells];
    if share < 1.0 {
        warnings.push(Warning::PartlyLit { cells, share });
    }
    for cell in &survey.coverage.cells {
        warnings.extend(light_of(file, cell));
    }
    warnings.extend(survey.cost.iter().filter_map(|&cost| {
        if cost.relative_error > cost.tolerance {
            Some(Warning::Inexact { cost })
        } else {
            (cost.most_evaluations > MOST_EVALUATIONS).then_some(Warning::Costly { cost })
        }
    }));
    let loud = survey.crosstalk.iter().filter(|slot| slot.share > CROSSTALK_LIMIT);
    warnings.extend(loud.map(|entry| Warning::Crosstalk {
        slot: entry.slot,
        cell: entry.cell,
        share: entry.share,
        at: entry.at,
    }));
    if file.lighting.dark_slot().is_none() {
        warnings.push(Warning::NoDarkSlot);
    }
    let open = &file.scene.uncertainty;
    if open.emitter_gain_relative > 0.0 && open.electrode_gain_relative == 0.0 {
        // X_A = Lx/2·(I_X2 − I_X1)/I_O: of a spot in the middle Lx/4 per relative gain of either.
        let length_m = file.scene.cells.iter().map(|cell| cell.detector.length_m).fold(0.0, f64::max);
        warnings.push(Warning::ElectrodeGainsTakenAsKnown { moved_m: 0.25 * length_m * 0.01 * 2f64.sqrt() });
    }
    if let Err(error) = file.require_slots_fit() {
        warnings.push(error.into());
    }
    warnings
}

fn short_travels(survey: &Survey) -> impl Iterator<Item = Warning> {
    let (metres, radians) = (survey.workspace.half_extent_m, survey.workspace.half_extent_rad);
    survey.travel.iter().zip(metres.into_iter().chain(radians)).flat_map(|(travel, extent)| {
        let warn = move |end: End| {
            let (cell, becomes) = (end.cell?, end.becomes?);
            let half_extent = extent.copysign(end.at);
            let short = end.at.abs() < extent;
            short.then_some(Warning::ShortTravel { axis: travel.axis, at: end.at, half_extent, cell, becomes })
        };
        [travel.negative, travel.positive].into_iter().filter_map(warn)
    })
}

fn light_of(file: &SceneFile, cell: &CellCoverage) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let [least_a, most_a] = cell.i_o_range_a.unwrap_or_default();
    if let (Some(front_end), true) = (file.front_end, cell.over_scale > 0.0) {
        warnings.push(Warning::OverScale {
            cell: cell.cell,
            most_a: cell.most_electrode_a,
            at: cell.most_electrode_at,
            full_scale_a: front_end.full_scale_a,
            share: cell.over_scale,
        });
    }
    if cell.saturated > 0.0 {
        warnings.push(Warning::Saturated { cell: cell.cell, share: cell.saturated, most_a });
    }
    if cell.faint > 0.0 {
        warnings.push(Warning::Faint { cell: cell.cell, share: cell.faint, least_a });
    }
    warnings
}

fn extent(axis: &str, amount: f64) -> String {
    if axis.starts_with('t') { format!("{:+.2} mm", amount * 1e3) } else { format!("{:+.1}°", amount.to_degrees()) }
}

fn describe(pose: &Pose) -> String {
    let (t, r) = (pose.translation_m * 1e3, pose.rotation_rad());
    let degrees = [r.x, r.y, r.z].map(f64::to_degrees);
    format!("({:+.2}, {:+.2}, {:+.2}) mm, ({:+.1}, {:+.1}, {:+.1})°", t.x, t.y, t.z, degrees[0], degrees[1], degrees[2])
}

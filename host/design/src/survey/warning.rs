//! Warnings for the designer, each with its number and a remedy.

use slitpose_calibration::half_extents;
use slitpose_head::causes::with_causes;
use slitpose_head::finding::{Finding, Grade};
use slitpose_head::front_end::{TimingError, board_configuration};
use slitpose_head::scene_file::{FrontEnd, SceneFile};
use slitpose_model::{MIN_CELLS, Status};

use super::coverage::{CROSSTALK_LIMIT, CellCost, CellCoverage, SlotCrosstalk};
use super::{AXES, End, Survey, pose_text};

/// σ of a single frame at home over the workspace's half extent: beyond this a pose is hardly told.
const VAGUE: f64 = 0.1;

/// Share of poses that an uncalibrated head should tell: its user sees something, and can calibrate it by free motion.
const TOLD_UNCALIBRATED: f64 = 0.5;

/// Values of a profile that six cells may take in the three to five evaluations of a solve, at some 25 ns each
/// with derivatives, and leave it within 100 µs.
const MAX_EVALUATIONS: usize = 150;

/// A hand that goes to and fro over 5 mm at up to 0.5 m/s.
const FAST_HAND_M_PER_S2: f64 = 100.0;

/// How much looser a tolerance is proposed.
const LOOSER: f64 = 100.0;

/// Remedy for free directions and mirror images.
const TURN_DETECTORS: &str = "turn every other detector about its normal, by 90° against its neighbours";

/// Warnings only: none of these makes a scene unusable.
pub(super) fn find(file: &SceneFile, survey: &Survey) -> Vec<Finding> {
    let dark_at_home = survey.home.iter().filter(|cell| cell.status != Status::Lit.as_str());
    let mut warnings: Vec<_> = dark_at_home
        .map(|home| {
            let text = format!("{} at home", home.status);
            Finding::warning(cell(home.cell), text, "move its emitter, slit or detector into line")
        })
        .collect();
    if warnings.is_empty() {
        warnings.extend(short_travels(survey));
    }
    if !survey.free_at_home.is_empty() {
        let text = format!("the currents leave {} free: poses there are `unobservable`", survey.free_at_home);
        warnings.push(Finding::warning("home", text, TURN_DETECTORS));
    }
    warnings.extend(vague_at_home(survey));
    if survey.mirror_images {
        let text = format!(
            "poses of the head `{}` have mirror images with nearly the same currents: a cold start is slow, and says \
             `ambiguous` where two fit alike",
            survey.name
        );
        warnings.push(Finding::warning("scene", text, TURN_DETECTORS));
    }
    let cells = survey.home.len();
    if cells < MIN_CELLS {
        let text = format!("six coordinates take {MIN_CELLS} cells, it has {cells}: every pose is `unobservable`");
        warnings.push(Finding::warning("scene", text, "add cells"));
    }
    if survey.sigma_at_home.is_some() && survey.told_uncalibrated < TOLD_UNCALIBRATED {
        let text = format!(
            "before it is calibrated, with parts within their tolerances, a frame tells {:.0} % of its poses",
            100.0 * survey.told_uncalibrated
        );
        let next_step =
            "add cells, or calibrate it by an instrument's poses in the frames of the scene (calibrate --known)";
        warnings.push(Finding::warning("tolerances", text, next_step));
    }
    let share = survey.coverage.at_least_lit[cells];
    if share < 1.0 {
        let text = format!("all {cells} cells are lit in {:.2} % of it only", 100.0 * share);
        warnings.push(Finding::warning("workspace", text, "shrink the workspace, or lower slit.distance_mm"));
    }
    warnings.extend(of_light(file, &survey.coverage.cells));
    warnings.extend(survey.cost.iter().filter_map(of_cost));
    warnings.extend(survey.crosstalk.iter().filter(|slot| slot.share > CROSSTALK_LIMIT).map(of_crosstalk));
    warnings.extend(file.front_end.and_then(|front_end| of_carried(survey, &front_end)));
    if file.lighting.dark_slot().is_none() {
        let text = "no lighting slot is dark, so ambient light and offsets stay in the currents";
        warnings.push(Finding::warning("lighting", text, "add [] to lighting.slots"));
    }
    warnings.extend(of_uncertainty(file));
    warnings.extend(of_exposures(file, survey.sigma_at_home));
    warnings.extend(of_front_end(file));
    warnings
}

fn of_front_end(file: &SceneFile) -> Option<Finding> {
    file.front_end?;
    let text = match board_configuration(file).err()? {
        TimingError::Slots(error) => error.to_string(),
        error => format!("no board can run it: {}", with_causes(&error)),
    };
    Some(Finding::new(Grade::Warning, "front end", text))
}

/// The axis that noise leaves open most, if it leaves more than a tenth of the workspace.
fn vague_at_home(survey: &Survey) -> Option<Finding> {
    let sigma = survey.sigma_at_home?;
    let axes = AXES.into_iter().zip(sigma).zip(half_extents(&survey.workspace));
    let share = |sigma: f64, half_extent: f64| if half_extent > 0.0 { sigma / half_extent } else { 0.0 };
    let ((axis, sigma), half_extent) =
        axes.max_by(|((_, a), of), ((_, b), of_b)| share(*a, *of).total_cmp(&share(*b, *of_b)))?;
    (share(sigma, half_extent) > VAGUE).then(|| {
        let text = format!(
            "noise moves {axis} of a single frame by {} (1 σ), in a workspace of ±{}",
            extent(axis, sigma).trim_start_matches('+'),
            extent(axis, half_extent).trim_start_matches('+')
        );
        let next_step = "raise slit.distance_mm, so that spots move farther, or the emitter's intensity";
        Finding::warning("home", text, next_step)
    })
}

/// Where the tool leaves a cell's range inside the workspace.
fn short_travels(survey: &Survey) -> impl Iterator<Item = Finding> {
    survey.travel.iter().zip(half_extents(&survey.workspace)).flat_map(|(travel, half_extent)| {
        let warn = move |end: End| {
            let (number, becomes, axis) = (end.cell?, end.becomes?, travel.axis);
            if end.at.abs() >= half_extent {
                return None;
            }
            let [at, half_extent] = [end.at, half_extent.copysign(end.at)].map(|amount| extent(axis, amount));
            let text = format!("{becomes} beyond {axis} {at}, inside the workspace ({half_extent})");
            let next_step = "shrink the workspace, or lower slit.distance_mm to reach farther";
            Some(Finding::warning(cell(number), text, next_step))
        };
        [travel.negative, travel.positive].into_iter().filter_map(warn)
    })
}

/// Currents beyond the converter or the detector, or too small: of all cells that have them, with the worst one.
fn of_light(file: &SceneFile, cells: &[CellCoverage]) -> Vec<Finding> {
    let i_o_range_a = |cell: &CellCoverage| cell.i_o_range_a.unwrap_or_default();
    let over_scale = file.front_end.and_then(|front_end| {
        let (which, worst, share) = worst_of(cells, |cell| cell.over_scale, |cell| cell.most_electrode_a)?;
        let text = format!(
            "{:.2} µA on one electrode{} at {}, more than front_end.full_scale_a = {:.2} µA ({share})",
            worst.most_electrode_a * 1e6,
            of(worst, &which),
            pose_text(&worst.most_electrode_at),
            front_end.full_scale_a * 1e6,
        );
        Some(Finding::warning(which, text, "raise the full scale or lower the emitter's intensity"))
    });
    let saturated = worst_of(cells, |cell| cell.saturated, |cell| i_o_range_a(cell)[1]).map(|(which, worst, share)| {
        let text = format!(
            "the detector saturates in {share} (I_O{} up to {:.1} µA, more than its saturation_a)",
            of(worst, &which),
            i_o_range_a(worst)[1] * 1e6
        );
        Finding::warning(which, text, "lower the emitter's intensity or narrow the slit")
    });
    let faint = worst_of(cells, |cell| cell.faint, |cell| -i_o_range_a(cell)[0]).map(|(which, worst, share)| {
        let least_na = i_o_range_a(worst)[0] * 1e9;
        let text = format!("faint in {share} (I_O{} down to {least_na:.1} nA)", of(worst, &which));
        Finding::warning(which, text, "raise the emitter's intensity or widen the slit")
    });
    [over_scale, saturated, faint].into_iter().flatten().collect()
}

/// The cells with a `share` of the workspace, the one of them that is worst by `badness`, and the greatest share in words;
/// `None` if no cell has any.
fn worst_of(
    cells: &[CellCoverage],
    share: fn(&CellCoverage) -> f64,
    badness: impl Fn(&CellCoverage) -> f64,
) -> Option<(String, &CellCoverage, String)> {
    let found: Vec<_> = cells.iter().filter(|cell| share(cell) > 0.0).collect();
    let worst = *found.iter().max_by(|a, b| badness(a).total_cmp(&badness(b)))?;
    let percent = 100.0 * found.iter().map(|cell| share(cell)).fold(0.0, f64::max);
    let (which, up_to) = match found.as_slice() {
        [only] => (cell(only.cell), ""),
        _ if found.len() == cells.len() => ("all cells".to_owned(), "up to "),
        _ => (format!("{} of {} cells", found.len(), cells.len()), "up to "),
    };
    Some((which, worst, format!("{up_to}{percent:.2} % of the workspace")))
}

/// Which cell it is, unless the finding is on this one.
fn of(worst: &CellCoverage, which: &str) -> String {
    let name = cell(worst.cell);
    if name == which { String::new() } else { format!(" of {name}") }
}

/// Integrals that meet the limit of work, or take long.
fn of_cost(cost: &CellCost) -> Option<Finding> {
    let CellCost { most_evaluations, tolerance, relative_error, .. } = *cost;
    if relative_error > tolerance {
        let text = format!(
            "the exact tier reaches {relative_error:.1e} of I_O where tolerance {tolerance:.0e} is asked for: \
             {most_evaluations} values of the emission profile, the limit, do not suffice"
        );
        let next_step = "give the profile fewer bends or make the spot smaller";
        return Some(Finding::warning(cell(cost.cell), text, next_step));
    }
    (most_evaluations > MAX_EVALUATIONS).then(|| {
        let text = format!(
            "up to {most_evaluations} values of its emission profile for one pair of currents at tolerance \
             {tolerance:.0e} (an ordinary cell: 9), so that solving may fall behind"
        );
        let next_step = format!(
            "take a wider or filter profile or a smaller spot, or solve with --tolerance {:.0e} or --tier paper",
            LOOSER * tolerance
        );
        Finding::warning(cell(cost.cell), text, next_step)
    })
}

fn of_crosstalk(slot: &SlotCrosstalk) -> Finding {
    let text = format!(
        "cell {} gets {:.2} % of its own signal from other emitters at {}",
        slot.cell,
        100.0 * slot.share,
        pose_text(&slot.at)
    );
    Finding::warning(format!("slot {}", slot.slot), text, "light them in different slots")
}

/// Light of the slot before, where it is worst.
fn of_carried(survey: &Survey, front_end: &FrontEnd) -> Option<Finding> {
    let worst = survey.carried.iter().max_by(|a, b| a.share.total_cmp(&b.share))?;
    (worst.share > CROSSTALK_LIMIT).then(|| {
        let text = format!(
            "cell {} gets {:.2} % of its own signal at {} from emitters of the slot before: settling_s is {:.1} time \
             constants",
            worst.cell,
            100.0 * worst.share,
            pose_text(&worst.at),
            front_end.settling_s / front_end.time_constant_s,
        );
        let settled_s = front_end.settling_s + front_end.time_constant_s * (worst.share / CROSSTALK_LIMIT).ln();
        let next_step = format!("raise front_end.settling_s to {:.1} µs", settled_s * 1e6);
        Finding::warning(format!("slot {}", worst.slot), text, next_step)
    })
}

/// Exposures so far apart that the tool does not move steadily over them. The instant of a frame is their mean: a constant
/// velocity leaves the pose of it alone, an acceleration a shifts it by a/2 times their mean square. A tracker that can predict the
/// tool allows for it, one that cannot has to find it in the currents, too.
fn of_exposures(file: &SceneFile, sigma_at_home: Option<[f64; 6]>) -> Option<Finding> {
    let schedule = board_configuration(file).ok()?.schedule;
    let from_instant = |ticks: f64| (ticks - schedule.reference_ticks()) / f64::from(schedule.tick_hz);
    let exposures = (0..file.scene.cells.len()).filter_map(|cell| schedule.lit_sample_ticks(cell));
    let exposures_s: Vec<f64> = exposures.map(from_instant).collect();
    let mean_square = exposures_s.iter().map(|at| at * at).sum::<f64>() / exposures_s.len().max(1) as f64;
    let shift_m = 0.5 * FAST_HAND_M_PER_S2 * mean_square;
    let sigma_m = sigma_at_home?[..3].iter().copied().fold(0.0, f64::max);
    (shift_m > sigma_m).then(|| {
        let [first, last] = [f64::min, f64::max].map(|most| exposures_s.iter().copied().fold(0.0, most));
        let text = format!(
            "the cells of a frame are exposed within {:.0} µs: an acceleration of {FAST_HAND_M_PER_S2} m/s², that of a fast \
             hand, bends the motion by {:.1} µm, where noise leaves {:.1} µm (1 σ): σ of a tool that moves fast is larger",
            1e6 * (last - first),
            1e6 * shift_m,
            1e6 * sigma_m
        );
        let next_step = "light more emitters together, or lower front_end.oversampling or settling_s";
        Finding::warning("front end", text, next_step)
    })
}

/// Gains that the scene leaves open, but only those that both electrodes of a cell share.
fn of_uncertainty(file: &SceneFile) -> Option<Finding> {
    let open = &file.scene.uncertainty;
    if open.emitter_gain_relative <= 0.0 || open.electrode_gain_relative != 0.0 {
        return None;
    }
    // X_A = Lx/2·(I_X2 − I_X1)/I_O: of a spot in the middle Lx/4 per relative gain of either.
    let length_m = file.scene.cells.iter().map(|cell| cell.detector.length_m).fold(0.0, f64::max);
    let text = format!(
        "emitter_gain_relative leaves open what both electrodes of a cell share; each electrode's own gain counts as \
         known, yet 1 % of it moves a spot by up to {:.0} µm, and hardly a pose would show it",
        0.25 * length_m * 0.01 * 2f64.sqrt() * 1e6
    );
    Some(Finding::warning("uncertainty", text, "set electrode_gain_relative unless it is calibrated"))
}

fn cell(number: usize) -> String {
    format!("cell {number}")
}

fn extent(axis: &str, amount: f64) -> String {
    if axis.starts_with('t') { format!("{:+.2} mm", amount * 1e3) } else { format!("{:+.1}°", amount.to_degrees()) }
}

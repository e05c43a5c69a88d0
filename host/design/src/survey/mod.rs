//! What a scene can do, before the head is built: the answers of `slitpose scene check`.
//!
//! [`Survey::of`] evaluates the optics at home, over a sample of the workspace and along the six
//! axes, and derives warnings. All numbers are SI and are serialised as they stand.

mod coverage;
mod warning;

use std::fmt::{self, Write};

use serde::{Serialize, Serializer};
use slitpose_model::{CompiledScene, Pose, SceneError, Solver, Tier};

use slitpose_head::finding::Finding;
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::{SceneFile, Workspace};

use crate::map::{NoiseOf, Outlook};
pub(crate) use coverage::{AXES, share_of_others};
use coverage::{CellAtHome, CellCost, Coverage, End, SlotCrosstalk, Timing, Travel};

/// Relative error of the integrals. A designer's decision turns on percents.
const TOLERANCE: f64 = 1e-4;

/// The same where poses are solved for: that of `solve` and `run`.
const SOLVING_TOLERANCE: f64 = 1e-6;

/// The result of `slitpose scene check`.
#[derive(Debug, Serialize)]
pub struct Survey {
    /// The scene's name.
    pub name: String,
    /// Path or shipped name it came from.
    pub origin: String,
    /// Hash of the scene file, 16 hexadecimal digits.
    pub hash: String,
    #[serde(serialize_with = "serialize_workspace")]
    pub(crate) workspace: Workspace,
    pub(crate) home: Vec<CellAtHome>,
    /// Which noise that is by which a pose is told.
    #[serde(skip)]
    pub(crate) noise: NoiseOf,
    /// Standard deviations that one frame gives the pose at home, metres and radians; `None` if it gives none.
    pub(crate) sigma_at_home: Option<[f64; 6]>,
    pub(crate) coverage: Coverage,
    /// How far the tool moves along each axis with every cell lit and not faint.
    pub(crate) travel: Vec<Travel>,
    /// The cost of each cell's integrals for a solver, over some of the workspace.
    pub(crate) cost: Vec<CellCost>,
    /// Cross-talk of every lighting slot with more than one emitter.
    pub(crate) crosstalk: Vec<SlotCrosstalk>,
    /// Light of the slot before, of every slot into which the front end carries more than a thousandth of it.
    pub(crate) carried: Vec<SlotCrosstalk>,
    /// Duration of slots and frame; `None` without front end.
    pub(crate) timing: Option<Timing>,
    /// Coordinates that the currents leave free at home, joined by `;`; empty if there are none.
    pub free_at_home: String,
    /// Share of poses that a frame tells although parts are only known within their tolerances.
    pub(crate) told_uncalibrated: f64,
    /// Whether poses have mirror images with nearly the same currents although all cells see light.
    pub mirror_images: bool,
    /// Warnings for the designer.
    #[serde(serialize_with = "serialize_lines")]
    pub warnings: Vec<Finding>,
}

impl Survey {
    /// Surveys a scene, with `samples` poses spread over its workspace. `progress` gets how many more poses
    /// were evaluated, [`Self::poses_of`] in all.
    pub fn of(file: &SceneFile, samples: usize, mut progress: impl FnMut(usize)) -> Result<Self, SceneError> {
        let tier = Tier::Exact { tolerance: TOLERANCE };
        let plan = CompiledScene::<f64>::compile(&file.scene, tier)?;
        let solver = Solver::<f64>::new(&file.scene, Tier::Exact { tolerance: SOLVING_TOLERANCE })?;
        let (crosstalk, carried) = coverage::of_slots(file, &plan, samples, &mut progress);
        let full_scale_a = file.front_end.map(|front_end| front_end.full_scale_a);
        let outlook = Outlook::of(file.clone().into())?;
        let mut survey = Self {
            name: file.name.clone(),
            origin: file.origin.clone(),
            hash: format!("{:016x}", file.hash),
            workspace: file.workspace,
            home: coverage::at_home(&file.scene, &plan),
            noise: outlook.noise,
            sigma_at_home: outlook.at(&Pose::HOME).sigma,
            coverage: Coverage::of(&plan, &file.workspace, samples, full_scale_a, &mut progress),
            travel: coverage::along_axes(&plan),
            cost: coverage::of_cells(solver.plan(), &file.workspace, samples, &mut progress),
            crosstalk,
            carried,
            timing: Timing::of(file),
            free_at_home: solver.free_directions(&Pose::HOME).map(|free| free.to_string()).unwrap_or_default(),
            told_uncalibrated: coverage::told(file, &plan)?,
            mirror_images: solver.has_mirror_images(),
            warnings: Vec::new(),
        };
        survey.warnings = warning::find(file, &survey);
        Ok(survey)
    }

    /// How many poses a survey with `samples` poses evaluates: all of them for coverage and for cross-talk, some for
    /// the cost.
    pub fn poses_of(samples: usize) -> usize {
        2 * samples + coverage::poses_of(samples)
    }

    /// The survey as a text for people, in millimetres, degrees and microamperes.
    pub fn report(&self) -> String {
        let mut text = String::new();
        for section in [write_head, write_home, write_coverage, write_travel, write_lighting, write_warnings] {
            // Writing to a String cannot fail.
            let _ = section(self, &mut text);
        }
        text
    }
}

/// A workspace in millimetres and degrees.
pub(crate) fn workspace_text(workspace: &Workspace) -> String {
    let [tx, ty, tz] = workspace.half_extent_m.to_array().map(|extent| rounded(extent * 1e3));
    let [rx, ry, rz] = workspace.half_extent_rad.to_array().map(|extent| rounded(extent.to_degrees()));
    format!("±({tx}, {ty}, {tz}) mm, ±({rx}, {ry}, {rz})°")
}

/// To a millionth; adding zero turns −0 into 0.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6 + 0.0
}

/// A pose in millimetres and degrees.
pub(crate) fn pose_text(pose: &Pose) -> String {
    let (t, r) = (pose.translation_m * 1e3, (pose.rotation_rad()).to_array().map(f64::to_degrees));
    format!("({:+.2}, {:+.2}, {:+.2}) mm, ({:+.1}, {:+.1}, {:+.1})°", t.x, t.y, t.z, r[0], r[1], r[2])
}

fn serialize_lines<S: Serializer>(findings: &[Finding], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(findings.iter().map(Finding::to_string))
}

/// A pose as `translation_m` and `rotation_rad` (rotation vector).
fn serialize_pose<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map([
        ("translation_m", pose.translation_m.to_array()),
        ("rotation_rad", pose.rotation_rad().to_array()),
    ])
}

fn serialize_workspace<S: Serializer>(workspace: &Workspace, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map([
        ("half_extent_m", workspace.half_extent_m.to_array()),
        ("half_extent_rad", workspace.half_extent_rad.to_array()),
    ])
}

fn write_head(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "{}: {} (hash {})", printable(&survey.origin), survey.name, survey.hash)?;
    writeln!(text, "workspace {}", workspace_text(&survey.workspace))
}

fn write_home(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nAt home")?;
    writeln!(text, "  cell  status   d_A/mm  d_B/mm  X_A/mm    γ/°  Ω/msr  I_O/µA  flags")?;
    for cell in &survey.home {
        writeln!(
            text,
            "  {:>4}  {:<7} {:>7.3} {:>7.3} {:>7} {:>6} {:>6.3} {:>7.4}  {}",
            cell.cell,
            cell.status,
            cell.emitter_distance_m * 1e3,
            cell.slit_distance_m * 1e3,
            optional(cell.x_a_m.map(|x_a| x_a * 1e3), 3),
            optional(cell.gamma_rad.map(f64::to_degrees), 1),
            cell.solid_angle_sr * 1e3,
            cell.i_o_a * 1e6,
            cell.flags
        )?;
    }
    let reading = survey.noise.reading();
    let Some(sigma) = survey.sigma_at_home else { return writeln!(text, "  {reading} gives no pose") };
    let [x, y, z, rx, ry, rz] = sigma.map(|sigma| sigma * 1e6);
    writeln!(
        text,
        "  {reading} gives the pose within ({x:.3}, {y:.3}, {z:.3}) µm, ({rx:.1}, {ry:.1}, {rz:.1}) µrad (1 σ)"
    )
}

fn write_coverage(survey: &Survey, text: &mut String) -> fmt::Result {
    let coverage = &survey.coverage;
    writeln!(text, "\nOver the workspace ({} poses)", coverage.samples)?;
    writeln!(
        text,
        "  cell   lit/%  clipped/%  dark/%  behind/%  faint/%  saturated/%  overscale/%     I_O/µA     electrode/µA"
    )?;
    for cell in &coverage.cells {
        let percent = |share: f64| 100.0 * share;
        let range =
            cell.i_o_range_a.map_or("-".to_owned(), |[least, most]| format!("{:.3} … {:.3}", least * 1e6, most * 1e6));
        writeln!(
            text,
            "  {:>4} {:>7.2} {:>10.2} {:>7.2} {:>9.2} {:>8.2} {:>12.2} {:>12.2}  {range:>15}  up to {:.3}",
            cell.cell,
            percent(cell.lit),
            percent(cell.clipped),
            percent(cell.dark),
            percent(cell.behind),
            percent(cell.faint),
            percent(cell.saturated),
            percent(cell.over_scale),
            cell.most_electrode_a * 1e6
        )?;
    }
    writeln!(text, "  saturated: the detector, above its saturation_a; overscale: an electrode above full_scale_a")?;
    let cells = coverage.cells.len();
    write!(text, "  all {cells} lit in {:.2} %", 100.0 * coverage.at_least_lit[cells])?;
    for least in (1..cells).rev() {
        write!(text, ", ≥ {least} in {:.2} %", 100.0 * coverage.at_least_lit[least])?;
        if coverage.at_least_lit[least] >= 1.0 {
            break;
        }
    }
    writeln!(text)
}

fn write_travel(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nPure motion from home with every cell lit and not faint")?;
    for travel in &survey.travel {
        let reason = |end: &End| match (end.cell, end.becomes) {
            (Some(cell), Some(becomes)) => format!("cell {cell} {becomes}"),
            _ => "end of search".to_owned(),
        };
        writeln!(
            text,
            "  {}  {} … {}  ({}; {})",
            travel.axis,
            amount(travel, travel.negative.at),
            amount(travel, travel.positive.at),
            reason(&travel.negative),
            reason(&travel.positive)
        )?;
    }
    Ok(())
}

fn amount(travel: &Travel, amount: f64) -> String {
    match travel.axis.starts_with('t') {
        true => format!("{:+8.3} mm", amount * 1e3),
        false => format!("{:+8.2}°  ", amount.to_degrees()),
    }
}

fn write_lighting(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nLighting")?;
    for slot in &survey.crosstalk {
        let emitters: Vec<_> = slot.emitters.iter().map(ToString::to_string).collect();
        let share = match slot.share {
            0.0 => "no cross-talk".to_owned(),
            share => format!("cross-talk up to {:.3} % (cell {})", 100.0 * share, slot.cell),
        };
        writeln!(text, "  slot {}: emitters {}, {share}", slot.slot, emitters.join(", "))?;
    }
    if survey.crosstalk.is_empty() {
        writeln!(text, "  one emitter at a time: no cross-talk")?;
    }
    match survey.timing {
        Some(timing) => writeln!(
            text,
            "  {} slots of {:.1} µs: {:.1} µs of a {:.1} µs frame ({:.0} %)",
            timing.slots,
            timing.slot_s * 1e6,
            timing.busy_s * 1e6,
            timing.frame_s * 1e6,
            100.0 * timing.busy_s / timing.frame_s
        ),
        None => writeln!(text, "  no [front_end]: timing and full scale not checked"),
    }
}

fn write_warnings(survey: &Survey, text: &mut String) -> fmt::Result {
    if survey.warnings.is_empty() {
        return writeln!(text, "\nNo warnings.");
    }
    writeln!(text, "\nWarnings")?;
    for warning in &survey.warnings {
        writeln!(text, "{warning:#}")?;
    }
    Ok(())
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{:.digits$}", rounded(value)))
}

#[cfg(test)]
mod tests;

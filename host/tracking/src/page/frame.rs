//! What the page shows of a board: the geometry of its head, and one moment of it.

use glam::DVec3;
use serde_json::{Value, json};
use slitpose_calibration::{Basis, Head};
use slitpose_design::map::{NoiseOf, Outlook};
use slitpose_design::{MaskFrame, mask_half_extents_m};
use slitpose_model::{
    Cell, CompiledScene, Detector, Opening, Pair, Photocurrents, Pose, Reading, SceneError, Solution, Status, Tier,
    TwistEstimate,
};

use super::bins::{Bin, Binner, Bins, MAX_FINE};
use super::message::{Plane, Refusal};
use crate::clock::HostInstant;
use crate::columns::{NO_TWIST, no_twist};
use crate::frame::View;
use crate::pipeline::{Record, reason};

/// Relative error of the integrals: a page shows three digits.
const TIER: Tier = Tier::Exact { tolerance: 1e-3 };

/// Light counts as missed where the model expects this many times the faint limit, as in the health of cells.
const MISSED_FROM: f64 = 2.0;

/// What frames need to know of a head.
pub struct Optics {
    plan: CompiledScene<f64>,
    cells: Vec<Cell>,
}

impl Optics {
    /// Of `head`.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn of(head: &Head) -> Result<Self, SceneError> {
        let scene = &head.file.scene;
        Ok(Self { plan: CompiledScene::compile(scene, TIER)?, cells: scene.cells.to_vec() })
    }

    /// Frame `n` of a board. Translations are exact to a nanometre, and numbers that are only looked at are rounded further:
    /// texts are half as long.
    pub fn frame(&self, board: usize, n: u64, sample: &Sample) -> Value {
        let Sample { record, photocurrents, scans, poses, bins } = sample;
        let seen = record.solution.estimate.as_ref();
        // Where the tool is in front of the head, whatever frame its pose is given in.
        let in_base = |pose: &Pose| record.view.map_or(*pose, |view| view.base_from_tool(pose));
        let base = seen.map(|estimate| in_base(&estimate.pose));
        let mut frame = self.solved(board, n, &record.solution, base.as_ref(), photocurrents);
        let own = json!({
            "seq": record.sequence,
            "time_s": record.device_time_s,
            "frame": record.view.map(View::name),
            "base": record.view.map(|view| {
                json!({ "tool": base.as_ref().map(place), "truth": record.truth.as_ref().map(in_base).as_ref().map(place),
                    "cov_t": seen.map(|estimate| position_covariance(&view.covariance_in_base(estimate))) })
            }),
            "twist": record.twist.ok().map(|TwistEstimate { twist, .. }| {
                let [v, w] = [twist.linear_m_per_s, twist.angular_rad_per_s];
                [v.x, v.y, v.z, w.x, w.y, w.z].map(rounded)
            }),
            "no_twist": Some(NO_TWIST[no_twist(&record.twist)]).filter(|word| !word.is_empty()),
            "light_level": record.light_level.map(|level| (level * 1e5).round() / 1e5),
            "truth": record.truth.as_ref().map(place),
            "simulated": record.simulated,
            "filtered": record.filtered.map(|filtered| {
                let mut place = place(&filtered.estimate.pose);
                place["lag_s"] = filtered.lag_s.into();
                place
            }),
            "scans": scans,
            "poses": poses,
            "fine": bins.fine.iter().filter(|_| bins.fine.len() < MAX_FINE).map(Bin::numbers).collect::<Vec<_>>(),
            "coarse": bins.coarse.iter().map(Bin::numbers).collect::<Vec<_>>(),
        });
        if let (Value::Object(frame), Value::Object(own)) = (&mut frame, own) {
            frame.extend(own);
        }
        frame
    }

    /// `base`: the pose of the tool in front of the head.
    fn solved(
        &self,
        board: usize,
        n: u64,
        solution: &Solution,
        base: Option<&Pose>,
        photocurrents: &Photocurrents,
    ) -> Value {
        let estimate = solution.estimate.as_ref();
        let place = estimate.map(|estimate| place(&estimate.pose)).unwrap_or_default();
        let cells = self.cells.iter().zip(&photocurrents.cells).enumerate();
        json!({
            "kind": "frame",
            "board": board,
            // Since the start of the server.
            "n": n,
            "seq": n,
            "time_s": 0.0,
            "status": solution.outcome.as_str(),
            "reason": reason(&solution.outcome),
            "t_m": place["t_m"],
            "q_xyzw": place["q_xyzw"],
            "sigma": estimate.map(|estimate| estimate.sigma().map(rounded)),
            "cov_t": estimate.map(|estimate| position_covariance(&estimate.covariance)),
            "twist": null,
            "chi2": rounded(solution.chi2),
            "redundancy": solution.redundancy,
            "verified": solution.verified().as_str(),
            "truth": null,
            "simulated": true,
            "filtered": null,
            "cells": cells
                .map(|(number, (cell, reading))| self.cell(number, &cell.detector, reading, solution, base))
                .collect::<Vec<_>>(),
            "scans": 1,
            "poses": u32::from(estimate.is_some()),
            "fine": [],
            "coarse": [],
        })
    }

    fn cell(
        &self,
        cell: usize,
        detector: &Detector,
        reading: &Reading,
        solution: &Solution,
        base: Option<&Pose>,
    ) -> Value {
        let mut state = Vec::new();
        let mut push = |holds: bool, word| state.extend(holds.then_some(word));
        push(solution.cells_used.contains(cell), "used");
        push(solution.excluded.contains(cell), "excluded");
        push(*reading == Reading::Saturated, "saturated");
        push(*reading == Reading::Missing, "missing");
        let pair = match reading {
            Reading::Light(pair) => Some(pair),
            Reading::Saturated | Reading::Missing => None,
        };
        let is_faint = pair.is_some_and(|pair| pair.total_a() < detector.faint_a);
        push(is_faint, "faint");
        let mut expected_x_m = None;
        let mut spot_m = None;
        if let Some(pose) = base {
            let response = self.plan.respond(cell, pose);
            push(response.status == Status::Clipped, "clipped");
            push(response.status == Status::Dark, "dark");
            push(response.status == Status::Behind, "behind");
            let expected_a = response.i_o_a - detector.dark_current_a;
            push(is_faint && expected_a >= MISSED_FROM * detector.faint_a, "missed");
            expected_x_m = response.x_a_m.map(rounded);
            let outline = self.plan.spot_outline_m(cell, pose);
            let ends = outline.iter().map(|[x_m, _]| rounded(*x_m));
            spot_m = ends.fold(None, |range: Option<[f64; 2]>, x_m| {
                Some(range.map_or([x_m; 2], |[least, most]| [least.min(x_m), most.max(x_m)]))
            });
        }
        json!({
            "i_a": pair.map(|pair| [pair.i_x1_a, pair.i_x2_a].map(rounded)),
            // The light's position by them, by the model, and the ends of the spot by the model.
            "x_m": pair.filter(|_| !is_faint).map(|pair| rounded(0.5 * detector.length_m * imbalance(pair))),
            "expected_x_m": expected_x_m,
            "spot_m": spot_m,
            "state": state,
        })
    }
}

/// (I_X2 − I_X1)/(I_X1 + I_X2): equation (1) of De La Cruz et al. 2018, solved for X_A.
fn imbalance(pair: &Pair<f64>) -> f64 {
    (pair.i_x2_a - pair.i_x1_a) / pair.total_a()
}

/// Of the position: xx, xy, xz, yy, yz, zz.
fn position_covariance(c: &[[f64; 6]; 6]) -> [f64; 6] {
    [c[0][0], c[0][1], c[0][2], c[1][1], c[1][2], c[2][2]].map(rounded)
}

fn place(pose: &Pose) -> Value {
    json!({
        "t_m": pose.translation_m.to_array().map(nanometres),
        "q_xyzw": pose.rotation.to_array().map(nanometres),
    })
}

fn nanometres(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

/// `value` to four digits; zero and numbers that are none as they are.
fn rounded(value: f64) -> f64 {
    let scale = 10_f64.powi((3.0 - value.abs().log10().floor()) as i32);
    let rounded = (value * scale).round() / scale;
    if rounded.is_finite() { rounded } else { value }
}

/// Samples per second of the host's clock for pages: as often as they are drawn, which is most of a page's work. Plots have
/// all scans in bins.
pub const FRAMES_HZ: u64 = 30;

/// The newest pose of a board, and the bins that are complete since the sample before.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The newest scan, solved.
    pub record: Record,
    /// Its photocurrents.
    pub photocurrents: Photocurrents,
    /// Scans since the sample before.
    pub scans: u32,
    /// Scans of these that had a pose.
    pub poses: u32,
    /// Bins that are complete since the sample before.
    pub bins: Bins,
}

impl Sample {
    /// The pose of the newest scan; `None` if it has none.
    pub fn pose(&self) -> Option<Pose> {
        self.record.solution.estimate.map(|estimate| estimate.pose)
    }
}

/// Makes the samples of one board. Never blocks.
#[derive(Debug, Default)]
pub struct Sampler {
    due_ns: u64,
    binner: Binner,
    /// The next one, whose photocurrents come at last.
    sample: Option<Sample>,
}

impl Sampler {
    /// Counts a solved scan in.
    pub fn add(&mut self, record: &Record) {
        let (photocurrents, bins) = (Photocurrents::default(), Bins::default());
        let begin = || Sample { record: *record, photocurrents, scans: 0, poses: 0, bins };
        let sample = self.sample.get_or_insert_with(begin);
        sample.record = *record;
        sample.scans += 1;
        sample.poses += u32::from(record.solution.estimate.is_some());
        self.binner.add(record, &mut sample.bins);
    }

    /// Sends a sample to `taker` if one is due; `photocurrents` are those of the scan added last. The taker never
    /// blocks, and returns `false` if it has no time.
    pub fn send(
        &mut self,
        photocurrents: Option<&Photocurrents>,
        now: HostInstant,
        taker: impl FnOnce(&Sample) -> bool,
    ) {
        if now.monotonic_ns < self.due_ns {
            return;
        }
        let (Some(sample), Some(photocurrents)) = (&mut self.sample, photocurrents) else { return };
        sample.photocurrents.clone_from(photocurrents);
        // A sample that is not taken in time is part of the next one.
        if taker(sample) {
            self.sample = None;
        }
        let period_ns = 1_000_000_000 / FRAMES_HZ;
        self.due_ns = (self.due_ns + period_ns).max(now.monotonic_ns + period_ns / 2);
    }
}

// The head.

/// A head, as board `number`. Detectors and masks are in frame base, metres; emitters, and masks that ride, in frame tool.
pub fn head_message(number: usize, head: &Head) -> String {
    let file = &head.file;
    let full_scale_a = file.front_end.map(|front_end| front_end.full_scale_a);
    let cells = file.scene.cells.iter().enumerate().map(|(cell, parts)| cell_parts(cell, parts, full_scale_a));
    let message = json!({
        "kind": "head",
        "board": number,
        "scene": file.name,
        "calibrated": matches!(head.basis, Basis::Calibration(_)),
        "workspace": {
            "half_extent_m": file.workspace.half_extent_m.to_array(),
            "half_extent_rad": file.workspace.half_extent_rad.to_array(),
        },
        "cells": cells.collect::<Vec<_>>(),
    });
    message.to_string()
}

fn cell_parts(number: usize, cell: &Cell, full_scale_a: Option<f64>) -> Value {
    let (detector, emitter, slit) = (&cell.detector, &cell.emitter, &cell.slit);
    let (x, z) = (detector.x_axis_base, detector.normal_base);
    let mask = MaskFrame::at_home(cell);
    let kind = match cell.opening() {
        Opening::Slit | Opening::RidingSlit => "slit",
        Opening::Pinhole => "pinhole",
        Opening::Lens { .. } => "lens",
    };
    json!({
        "detector": {
            "centre_m": detector.centre_base_m.to_array(),
            "x": x.to_array(),
            "y": z.cross(x).to_array(),
            "z": z.to_array(),
            "length_m": detector.length_m,
            "width_m": detector.width_m,
            "full_scale_a": full_scale_a,
            "faint_a": detector.faint_a,
        },
        "mask": {
            "centre_m": mask.centre.to_array(),
            "x": mask.axes[0].to_array(),
            "y": mask.axes[1].to_array(),
            "half_m": mask_half_extents_m(cell).to_array(),
            "rides": cell.opening() == Opening::RidingSlit,
        },
        "opening": { "kind": kind, "half_m": [0.5 * slit.width_m, 0.5 * slit.length_m] },
        "emitter": { "position_m": emitter.position_tool_m.to_array(), "axis": emitter.axis_tool.to_array() },
        "second_axis_of": cell.other_axis().filter(|_| cell.is_second_axis(number)),
    })
}

/// A scene without a board, whose tool is placed by hand.
pub struct SceneView {
    outlook: Outlook,
    optics: Optics,
}

/// Places of a map along each axis.
pub const MAP_POINTS: usize = 33;

/// No dragged tool is farther from home than this, metres and radians: beyond it all cells are dark.
const FARTHEST: f64 = 10.0;

impl SceneView {
    /// Of `head`.
    ///
    /// # Errors
    /// A scene that cannot be computed.
    pub fn of(head: &Head) -> Result<Self, SceneError> {
        Ok(Self { outlook: Outlook::of(head.clone())?, optics: Optics::of(head)? })
    }

    /// The message with frame `n`: the tool is at rest at translation `t_m`, metres, and rotation vector `r_rad`; accuracy is
    /// the Cramér–Rao bound, and absent where the scene states no noise.
    ///
    /// # Errors
    /// A place that is farther from home than any tool.
    pub fn frame(&self, n: u64, t_m: [f64; 3], r_rad: [f64; 3]) -> Result<String, Refusal> {
        let pose = placed(t_m, r_rad)?;
        let (readings, solution) = self.outlook.frame_at(&pose);
        let base = solution.estimate.map(|estimate| estimate.pose);
        let mut frame = self.optics.solved(0, n, &solution, base.as_ref(), &readings);
        if self.outlook.noise == NoiseOf::Nothing {
            (frame["sigma"], frame["cov_t"]) = (Value::Null, Value::Null);
        }
        Ok(frame.to_string())
    }

    /// The message with the accuracy over `plane`, through the tool at translation `t_m`, metres, and rotation vector `r_rad`:
    /// at [`MAP_POINTS`] places along each axis, row by row from the least coordinates on, the Cramér–Rao bound of the position
    /// (all three axes together), metres; `null` where a frame gives no pose, or the scene states no noise.
    ///
    /// # Errors
    /// A place that is farther from home than any tool.
    pub fn map(&self, plane: Plane, t_m: [f64; 3], r_rad: [f64; 3]) -> Result<Value, Refusal> {
        let mut pose = placed(t_m, r_rad)?;
        let [across, up] = match plane {
            Plane::Xy => [0, 1],
            Plane::Xz => [0, 2],
            Plane::Yz => [1, 2],
        };
        let half_m = self.outlook.head().file.workspace.half_extent_m;
        let at = |axis: usize, index: usize| half_m[axis] * (2.0 * index as f64 / (MAP_POINTS - 1) as f64 - 1.0);
        let has_noise = self.outlook.noise != NoiseOf::Nothing;
        let mut sigma_m = Vec::with_capacity(MAP_POINTS * MAP_POINTS);
        for row in 0..MAP_POINTS {
            for column in 0..MAP_POINTS {
                (pose.translation_m[across], pose.translation_m[up]) = (at(across, column), at(up, row));
                sigma_m.push(has_noise.then(|| self.outlook.at(&pose).sigma_m()).flatten().map(rounded));
            }
        }
        let half_m = [half_m[across], half_m[up]];
        Ok(json!({"kind": "map", "plane": plane, "half_m": half_m, "points": MAP_POINTS, "sigma_m": sigma_m}))
    }
}

/// The pose of a tool that is dragged there.
fn placed(t_m: [f64; 3], r_rad: [f64; 3]) -> Result<Pose, Refusal> {
    for (key, values) in [("t_m", t_m), ("r_rad", r_rad)] {
        if let Some(value) = values.into_iter().find(|value| value.abs() > FARTHEST) {
            return Err(Refusal::Value { key, value, hint: "metres and radians within the workspace" });
        }
    }
    Ok(Pose::from_vectors(DVec3::from_array(t_m), DVec3::from_array(r_rad)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_to_four_digits() {
        for (value, expected) in
            [(1.234_56e-6, 1.235e-6), (-98_765.4, -98_770.0), (0.0, 0.0), (5e-324, 5e-324), (9.999_96, 10.0)]
        {
            assert_eq!(rounded(value), expected, "{value}");
        }
        assert!(rounded(f64::NAN).is_nan());
        assert_eq!(rounded(f64::INFINITY), f64::INFINITY);
    }
}

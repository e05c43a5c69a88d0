//! How good a candidate is.

use glam::{DVec2, DVec3};
use slitpose_calibration::{half_extents, pose_of, values_of};
use slitpose_head::front_end::configuration;
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_model::{Cell, CompiledScene, Opening, Pose, SceneError, Status, Tier};

use crate::map::{Outlook, View, quantiles_of};
use crate::plot::MaskFrame;
use crate::survey::share_of_others;

use super::{Excess, Limit, Limits, note, violation};

/// Which σ is to be least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Demand {
    /// The median of the workspace.
    Median,
    /// The worst of the workspace.
    Worst,
}

/// What a search wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Median or worst.
    pub demand: Demand,
    /// The point of the tool whose position counts, from the tool's centre: metres. Rotation errors move it.
    pub lever_m: f64,
}

/// How far a housing reaches beyond the active area at each end, metres.
const HOUSING_M: f64 = 1e-3;

/// What passing a limit by one millimetre, or by a factor e, costs in ln σ: more than can be won by it (an exact penalty;
/// Zangwill 1967), and not much more, for steep walls stop simplexes.
const PENALTY: f64 = 3.0;

/// What passing limits at all costs: of two heads that are worth the same, the one that keeps them is better.
const NOT_KEPT: f64 = 0.01;

/// Poses at which spots and distances are looked at, and what a search has found; σ and currents of each candidate, and
/// cross-talk, which takes long, at fewer.
const POSES: usize = 4000;
const SIGMA_POSES: usize = 256;
const CROSSTALK_POSES: usize = 32;

/// Poses at which what was found is judged: those of `slitpose scene check`.
const CHECKED: usize = 20_000;

/// What spots miss at least where too many of those poses are not lit, as drawings round.
const MIN_MISSED_MM: f64 = 0.01;

/// What is learnt of currents is kept with a little to spare, so that rounding to the digits of a drawing does not pass it.
const LEARNT_MARGIN: f64 = 0.999;

/// The worst pose is climbed to from so many of those that are looked at, of a candidate and of what was found, in so many
/// rounds: between them a head may be singular.
const CLIMBS: [usize; 2] = [3, 16];
const CLIMB_ROUNDS: usize = 8;

/// Its first step, as a share of the workspace's half extents.
const CLIMB_STEP: f64 = 0.2;

/// What a candidate is worth.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// Standard deviation of the position of the point that counts, a single frame, metres.
    pub sigma_m: f64,
    /// The limits that are not kept.
    pub excesses: Vec<Excess>,
}

impl Score {
    pub(super) fn cost(&self) -> f64 {
        let kept = if self.excesses.is_empty() { 0.0 } else { NOT_KEPT + PENALTY * violation(&self.excesses) };
        kept + if self.sigma_m.is_finite() { self.sigma_m.ln() } else { 0.0 }
    }
}

/// Judges the candidates for one workspace.
#[derive(Clone, Debug)]
pub struct Judge {
    goal: Goal,
    limits: Limits,
    workspace: Workspace,
    poses: Vec<Pose>,
    corners: Vec<Pose>,
    /// Poses at which heads that were found were worse than at the first [`SIGMA_POSES`].
    learnt: Vec<Pose>,
    /// Full scale that is to be kept at the first poses, as a share, for it to be kept at all.
    full_scale: f64,
    /// By how much of the projection of [`missed_mm`] spots are to stay on their detectors, for them to be lit, metres.
    spare_m: f64,
}

impl Judge {
    /// By `goal`, within `limits`, over `workspace`.
    pub fn new(workspace: &Workspace, goal: Goal, limits: Limits) -> Self {
        let (poses, corners) = (workspace.poses(POSES).collect(), workspace.corners().collect());
        Self { goal, limits, workspace: *workspace, poses, corners, learnt: Vec::new(), full_scale: 1.0, spare_m: 0.0 }
    }

    /// What `file` is worth, at all poses.
    pub fn score(&self, file: &SceneFile) -> Result<Score, SceneError> {
        let mut score = self.score_at(file, &self.poses, &self.learnt, CLIMBS[1], [1.0, 0.0])?;
        if score.excesses.is_empty()
            && self.lit(file)?.filter(|is_lit| !is_lit).count() as f64 > (1.0 - self.limits.lit) * CHECKED as f64
        {
            note(&mut score.excesses, Limit::Lit, MIN_MISSED_MM, MIN_MISSED_MM);
        }
        Ok(score)
    }

    /// Whether all cells are lit, at each pose of `slitpose scene check`.
    fn lit(&self, file: &SceneFile) -> Result<impl Iterator<Item = bool> + use<>, SceneError> {
        let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper)?;
        let is_lit =
            move |pose: &Pose| (0..plan.cell_count()).all(|cell| plan.respond(cell, pose).status == Status::Lit);
        Ok(self.workspace.poses(CHECKED).map(move |pose| is_lit(&pose)))
    }

    /// The same of a candidate, at few poses.
    pub(super) fn estimate(&self, file: &SceneFile) -> Result<Score, SceneError> {
        self.score_at(file, &self.poses[..SIGMA_POSES], &self.learnt, CLIMBS[0], [self.full_scale, self.spare_m])
    }

    /// Lets further estimates see what is wrong with `file` at poses they would not have looked at.
    pub(super) fn learn(&mut self, file: &SceneFile) -> Result<(), SceneError> {
        let outlook = Outlook::of(file.clone().into())?;
        let views: Vec<View> = self.poses.iter().map(|pose| outlook.at(pose)).collect();
        let [all, few] = [&views[..], &views[..SIGMA_POSES]].map(|views| self.margin(views));
        self.full_scale *= LEARNT_MARGIN * (all / few).min(1.0);
        let checked = margins_m(file, self.workspace.poses(CHECKED)).zip(self.lit(file)?);
        let checked = checked.map(|(m, is_lit)| if is_lit { m.max(0.0) } else { m.min(-1e-3 * MIN_MISSED_MM) });
        let [few, all] = [margins_m(file, self.poses.iter().copied()).collect(), checked.collect()]
            .map(|margins| self.limits.counted_m(margins));
        self.spare_m += (few - all).max(0.0);
        if self.goal.demand == Demand::Worst {
            let worst: Vec<_> = self.worst(&outlook, self.poses.iter().zip(&views), CLIMBS[1]).collect();
            self.learnt.extend(worst.into_iter().map(|(_, pose)| pose));
        }
        Ok(())
    }

    /// The greatest σ near the worst `starts` of these poses, metres, and where it is.
    fn worst<'a>(
        &'a self,
        outlook: &'a Outlook,
        views: impl Iterator<Item = (&'a Pose, &'a View)>,
        starts: usize,
    ) -> impl Iterator<Item = (f64, Pose)> + 'a {
        let of = |view: &View| sigma_m(view, &self.goal).unwrap_or(f64::INFINITY);
        let mut order: Vec<(f64, Pose)> = views.map(|(pose, view)| (of(view), *pose)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        order.truncate(starts);
        order.into_iter().map(move |start| self.climb(outlook, start))
    }

    /// Uphill within the workspace, one coordinate at a time.
    fn climb(&self, outlook: &Outlook, (mut sigma, pose): (f64, Pose)) -> (f64, Pose) {
        let extents = half_extents(&self.workspace);
        let mut axes = values_of(&pose);
        let mut step = CLIMB_STEP;
        for _ in 0..CLIMB_ROUNDS {
            let before = sigma;
            for (k, sign) in (0..6).flat_map(|k| [(k, 1.0), (k, -1.0)]) {
                let (from, extent) = (axes[k], extents[k]);
                axes[k] = (from + sign * step * extent).clamp(-extent, extent);
                let found = sigma_m(&outlook.at(&pose_of(&axes)), &self.goal).unwrap_or(f64::INFINITY);
                if found > sigma {
                    sigma = found;
                } else {
                    axes[k] = from;
                }
            }
            if sigma == before {
                step *= 0.5;
            }
        }
        (sigma, pose_of(&axes))
    }

    /// Full scale over the largest current of the share of views that are to be within it.
    fn margin(&self, views: &[View]) -> f64 {
        let mut margins: Vec<f64> = views.iter().map(|view| view.full_scale).collect();
        margins.sort_by(f64::total_cmp);
        margins[index(margins.len(), 1.0 - self.limits.in_scale)]
    }

    /// By σ and currents at `near` and σ also at `further`, the worst by so many climbs from there.
    fn score_at(
        &self,
        file: &SceneFile,
        near: &[Pose],
        further: &[Pose],
        climbs: usize,
        [full_scale, spare_m]: [f64; 2],
    ) -> Result<Score, SceneError> {
        let Self { goal, limits, poses, corners, .. } = self;
        let outlook = Outlook::of(file.clone().into())?;
        let views: Vec<View> = near.iter().chain(further).map(|pose| outlook.at(pose)).collect();
        let sigma_m = match goal.demand {
            Demand::Median => quantiles_of(views.iter(), [0.5], |view| sigma_m(view, goal))[0],
            Demand::Worst => {
                let worst = self.worst(&outlook, near.iter().chain(further).zip(&views), climbs);
                worst.map(|(sigma_m, _)| sigma_m).fold(0.0, f64::max)
            }
        };
        let mut excesses = Vec::new();
        distances(file, poses, limits, &mut excesses);
        let missed_mm = missed_mm(file, poses, limits, spare_m);
        note(&mut excesses, Limit::Lit, missed_mm, missed_mm);
        if !sigma_m.is_finite() {
            let without = views.iter().filter(|view| view.sigma.is_none()).count() as f64 / views.len() as f64;
            note(&mut excesses, Limit::Pose, 10.0 + without, without);
        }
        if file.front_end.is_some() {
            if configuration(file).is_err() {
                note(&mut excesses, Limit::Board, 1.0, 1.0);
            }
            let margin = self.margin(&views[..near.len()]) * full_scale;
            note(&mut excesses, Limit::InScale, 1.0 - margin, 1.0 / margin);
        }
        for slot in file.lighting.slots.iter().filter(|slot| slot.len() > 1) {
            for &cell in slot {
                let share = |pose: &Pose| share_of_others(outlook.plan(), cell, slot, pose);
                let most = poses.iter().take(CROSSTALK_POSES).chain(corners).map(share).fold(0.0, f64::max);
                let by = most / limits.crosstalk;
                note(&mut excesses, Limit::Crosstalk, by.ln(), by);
            }
        }
        Ok(Score { sigma_m, excesses })
    }
}

/// The place of the `share` smallest of so many sorted values.
fn index(count: usize, share: f64) -> usize {
    ((count as f64 * share) as usize).min(count - 1)
}

/// σ of a point at the end of the lever, root mean square over all directions of it. A rotation about the lever does not
/// move it, and what translation and rotation share averages out.
fn sigma_m(view: &View, goal: &Goal) -> Option<f64> {
    let (m, rad) = view.sigma_m().zip(view.sigma_rad())?;
    Some(m.hypot((2.0_f64 / 3.0).sqrt() * goal.lever_m * rad))
}

/// By how far spots miss their detectors, in millimetres: that of the share of poses that may.
///
/// Of the central projection of the opening's edges along x (thin mask), drawn together by a lens, so that it is a smooth
/// function of all dimensions.
fn missed_mm(file: &SceneFile, poses: &[Pose], limits: &Limits, spare_m: f64) -> f64 {
    let margins = margins_m(file, poses.iter().copied()).collect();
    ((spare_m - limits.counted_m(margins)) * 1e3).clamp(0.0, 10.0)
}

impl Limits {
    /// The margin that all but the share of poses that may miss have.
    fn counted_m(&self, mut margins_m: Vec<f64>) -> f64 {
        margins_m.sort_by(f64::total_cmp);
        margins_m[index(margins_m.len(), 1.0 - self.lit)]
    }
}

/// By how far the spot nearest to an end of its detector stays on it at each pose, metres.
fn margins_m(file: &SceneFile, poses: impl Iterator<Item = Pose>) -> impl Iterator<Item = f64> {
    let masks: Vec<(&Cell, MaskFrame)> = file.scene.cells.iter().map(|cell| (cell, MaskFrame::at_home(cell))).collect();
    poses.map(move |pose| masks.iter().map(|(cell, home)| margin_m(cell, home, &pose)).fold(f64::INFINITY, f64::min))
}

fn margin_m(cell: &Cell, home: &MaskFrame, pose: &Pose) -> f64 {
    let (detector, slit) = (&cell.detector, &cell.slit);
    let (x_axis, z_axis) = (detector.x_axis_base, detector.normal_base);
    let in_cell = |v: DVec3| DVec3::new(v.dot(x_axis), v.dot(z_axis.cross(x_axis)), v.dot(z_axis));
    let emitter = pose.rotation * cell.emitter.position_tool_m + pose.translation_m;
    let e = in_cell(emitter - detector.centre_base_m);
    let mask = home.carried(cell, pose);
    let ends = [-0.5, 0.5].map(|side| in_cell(mask.at(DVec2::new(side * slit.width_m, 0.0)) - detector.centre_base_m));
    let above_m = ends.map(|end| e.z - end.z).into_iter().fold(f64::INFINITY, f64::min);
    if above_m <= 0.0 {
        return above_m - detector.length_m;
    }
    // A long edge lands where its plane through the emitter meets the detector's middle line, the end of a hole alone.
    let is_hole = cell.opening().is_hole();
    let along = if is_hole { DVec3::Y } else { in_cell(mask.at(DVec2::Y) - mask.at(DVec2::ZERO)) };
    let [low_m, high_m] = ends.map(|end| {
        let normal = (end - e).cross(along);
        normal.dot(e) / normal.x
    });
    let shrunk = match cell.opening() {
        Opening::Lens { focal_length_m } => 1.0 - slit.distance_m * (e.z - slit.distance_m) / (focal_length_m * e.z),
        _ => 1.0,
    };
    0.5 * (detector.length_m - (low_m + high_m).abs() - (high_m - low_m).abs() * shrunk.abs())
}

/// Notes parts that are too near to each other, or too far out.
fn distances(file: &SceneFile, poses: &[Pose], limits: &Limits, excesses: &mut Vec<Excess>) {
    let cells = &file.scene.cells;
    let mut lacking = |limit, found_m: f64, wanted_m: f64| {
        let by_mm = ((wanted_m - found_m) * 1e3).clamp(0.0, 100.0);
        note(excesses, limit, by_mm, by_mm);
    };
    // From what rides on the tool to what stands before it.
    let above = |cell: &Cell, pose: &Pose| {
        let height = |place: DVec3| (place - cell.detector.centre_base_m).dot(cell.detector.normal_base);
        if cell.opening() == Opening::RidingSlit {
            return height(MaskFrame::of(cell, pose).at(DVec2::ZERO));
        }
        height(pose.rotation * cell.emitter.position_tool_m + pose.translation_m) - cell.slit.distance_m
    };
    let nearest =
        poses.iter().flat_map(|pose| cells.iter().map(move |cell| above(cell, pose))).fold(f64::INFINITY, f64::min);
    lacking(Limit::Clearance, nearest, limits.clearance_m);
    for (number, cell) in cells.iter().enumerate() {
        for end in ends(cell) {
            lacking(Limit::Radius, limits.radius_m, end.truncate().length());
        }
        for (of_other, other) in cells[..number].iter().enumerate() {
            if cell.other_axis() == Some(of_other) {
                continue;
            }
            lacking(Limit::DetectorPitch, apart_m(ends(cell), ends(other)), limits.detector_pitch_m);
            let emitters = cell.emitter.position_tool_m.distance(other.emitter.position_tool_m);
            lacking(Limit::EmitterPitch, emitters, limits.emitter_pitch_m);
        }
    }
}

fn ends(cell: &Cell) -> [DVec3; 2] {
    let half = cell.detector.x_axis_base * (0.5 * cell.detector.length_m + HOUSING_M);
    [cell.detector.centre_base_m - half, cell.detector.centre_base_m + half]
}

/// Least distance of two segments, given by their ends.
fn apart_m([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> f64 {
    // Ericson 2005, Real-Time Collision Detection, 5.1.9.
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, uv, vv, uw, vw) = (u.dot(u), u.dot(v), v.dot(v), u.dot(w), v.dot(w));
    let determinant = uu * vv - uv * uv;
    let s = if determinant > 1e-12 * uu * vv { ((uv * vw - vv * uw) / determinant).clamp(0.0, 1.0) } else { 0.0 };
    let t = ((uv * s + vw) / vv).clamp(0.0, 1.0);
    let s = ((uv * t - uw) / uu).clamp(0.0, 1.0);
    (a + u * s).distance(c + v * t)
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::{BASE, MAGLEV, SPACEMOUSE};
    use slitpose_model::{CompiledScene, Status, Tier};

    use super::*;

    /// The projection against the model's own spots: wholly on the detector, or not.
    #[test]
    fn spots_are_on_their_detectors_where_the_model_has_them() {
        for shipped in [BASE, SPACEMOUSE, MAGLEV] {
            let file = shipped.read().expect("a scene");
            let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).expect("a head");
            // Far enough for spots to run off.
            let far = Workspace {
                half_extent_m: 2.0 * file.workspace.half_extent_m,
                half_extent_rad: 2.0 * file.workspace.half_extent_rad,
            };
            let poses = if shipped.name == BASE.name { file.workspace.poses(500) } else { far.poses(500) };
            let (mut lit, mut not) = (0, 0);
            for pose in poses {
                for (number, cell) in file.scene.cells.iter().enumerate() {
                    let margin_m = |cell: &Cell| margin_m(cell, &MaskFrame::at_home(cell), &pose);
                    let margin = margin_m(cell);
                    // The corners of a long slit reach a little farther than its middle. A light that misses a
                    // detector across says nothing of its ends.
                    let across = cell.other_axis().map_or(1.0, |other| margin_m(&file.scene.cells[other]));
                    let tolerance = if cell.opening() == Opening::RidingSlit { 0.4e-3 } else { 0.1e-3 };
                    let status = plan.respond(number, &pose).status;
                    // Past the end of a slit that rides there is no light at all.
                    let is_past = cell.opening() == Opening::RidingSlit && status == Status::Dark;
                    if margin.abs() > tolerance && across > tolerance && !is_past {
                        assert_eq!(margin > 0.0, status == Status::Lit, "{} {number}: {margin} {pose:?}", shipped.name);
                        if margin > 0.0 { lit += 1 } else { not += 1 }
                    }
                }
            }
            assert!(lit > 500 && not > 50, "{}: {lit} lit, {not} not", shipped.name);
        }
    }

    /// Both axes of a detector are one part, and a mask that rides must clear the detector, not its emitter.
    #[test]
    fn shipped_heads_with_other_openings_keep_all_limits() {
        for shipped in [SPACEMOUSE, MAGLEV] {
            let file = shipped.read().expect("a scene");
            let goal = Goal { demand: Demand::Median, lever_m: 10e-3 };
            let score = Judge::new(&file.workspace, goal, Limits::default()).score(&file).expect("a score");
            assert!(score.excesses.is_empty(), "{}: {:?}", shipped.name, score.excesses);
        }
    }

    #[test]
    fn segments_are_as_far_apart_as_their_nearest_points() {
        let (x, y) = ([-DVec3::X, DVec3::X], [-DVec3::Y + DVec3::Z, DVec3::Y + DVec3::Z]);
        assert!((apart_m(x, y) - 1.0).abs() < 1e-12, "crossing above each other");
        let beyond = [DVec3::X * 3.0, DVec3::X * 5.0];
        assert!((apart_m(x, beyond) - 2.0).abs() < 1e-12, "on one line");
        let beside = [DVec3::new(-5.0, 3.0, 0.0), DVec3::new(5.0, 3.0, 0.0)];
        assert!((apart_m(x, beside) - 3.0).abs() < 1e-12, "parallel");
    }
}

//! What frame rate, oversampling and lighting slots do to accuracy.

use slitpose_calibration::Head;
use slitpose_head::front_end::{TimingError, configuration};
use slitpose_head::scene_file::{FrontEnd, Lighting, SceneFile};
use slitpose_model::{CompiledScene, SceneError, Tier};

use super::{Outlook, View, per_root_hz, quantiles_of};
use crate::DesignError;
use crate::survey::share_of_others;

/// Conversions in a word that the board's converters add up.
const OVERSAMPLING: [u32; 5] = [1, 2, 4, 8, 16];

/// Frame rates beside the one asked for, in units of it.
const OTHER_RATES: [f64; 4] = [0.25, 0.5, 2.0, 4.0];

/// Poses at which accuracy and cross-talk are looked at.
const POSES: usize = 200;

/// Cross-talk above this share asks for slots of their own: gains are known to about that.
const MAX_CROSSTALK: f64 = 1e-3;

/// Relative difference of σ that counts for nothing.
const EQUAL: f64 = 0.01;

/// A schedule that a board can run.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Emitters of each slot.
    pub slots: Vec<Vec<usize>>,
    /// Conversions in a word.
    pub oversampling: u32,
    /// Share of the frame that the slots take.
    pub busy: f64,
    /// Standard deviation of the position of a single frame, median over the workspace, metres; infinite without pose.
    pub sigma_m: f64,
    /// The same of the rotation, radians.
    pub sigma_rad: f64,
}

impl Candidate {
    /// See [`super::Map::per_root_hz`].
    pub fn per_root_hz(&self) -> f64 {
        per_root_hz(self.frame_rate_hz)
    }
}

/// Schedules for one head.
#[derive(Clone, Debug)]
pub struct Schedules {
    /// At the wanted rate, the least σ first.
    pub at_rate: Vec<Candidate>,
    /// The best at other rates, ascending.
    pub best_by_rate: Vec<Candidate>,
}

impl Schedules {
    /// For `file` at `rate_hz` frames per second.
    pub fn of(file: &SceneFile, rate_hz: f64) -> Result<Self, DesignError> {
        let front_end = file.front_end.ok_or_else(|| TimingError::NoFrontEnd(file.name.clone()))?;
        let groupings = groupings(file)?;
        let at = |frame_rate_hz: f64| -> Result<Vec<Candidate>, DesignError> {
            let (mut found, mut refused) = (Vec::new(), None);
            for lighting in &groupings {
                for oversampling in OVERSAMPLING {
                    let front_end = FrontEnd { frame_rate_hz, oversampling, ..front_end };
                    let tried = SceneFile { front_end: Some(front_end), ..file.with_lighting(lighting.clone()) };
                    match configuration(&tried) {
                        Ok(_) => found.push(candidate(tried, front_end)?),
                        Err(error) => refused = refused.or(Some(error)),
                    }
                }
            }
            if let (true, Some(error)) = (found.is_empty(), refused) {
                return Err(error.into());
            }
            // Of equals, the one that leaves more of the frame idle.
            let size = |candidate: &Candidate| (candidate.sigma_m.ln() / EQUAL).round();
            found.sort_by(|a, b| size(a).total_cmp(&size(b)).then(a.busy.total_cmp(&b.busy)));
            Ok(found)
        };
        let at_rate = at(rate_hz)?;
        let mut best_by_rate: Vec<Candidate> = at_rate.iter().take(1).cloned().collect();
        for other_hz in OTHER_RATES.map(|by| by * rate_hz) {
            match at(other_hz) {
                Ok(found) => best_by_rate.extend(found.into_iter().next()),
                // Too fast for any slots.
                Err(DesignError::Timing(_)) => {}
                Err(error) => return Err(error),
            }
        }
        best_by_rate.sort_by(|a, b| a.frame_rate_hz.total_cmp(&b.frame_rate_hz));
        Ok(Self { at_rate, best_by_rate })
    }
}

fn candidate(file: SceneFile, front_end: FrontEnd) -> Result<Candidate, SceneError> {
    let slots = file.lighting.slots.clone();
    let (workspace, cells) = (file.workspace, file.scene.cells.len());
    let outlook = Outlook::of(Head::from(file))?;
    let views: Vec<View> = workspace.poses(POSES).map(|pose| outlook.at(&pose)).collect();
    let median = |of: fn(&View) -> Option<f64>| quantiles_of(views.iter(), [0.5], of)[0];
    Ok(Candidate {
        frame_rate_hz: front_end.frame_rate_hz,
        busy: slots.len() as f64 * front_end.slot_duration_s(cells) / front_end.frame_period_s(),
        slots,
        oversampling: front_end.oversampling,
        sigma_m: median(View::sigma_m),
        sigma_rad: median(View::sigma_rad),
    })
}

/// Ways to light the emitters: as the scene says, one by one, and as many together as do not shine on each other's
/// detectors.
fn groupings(file: &SceneFile) -> Result<Vec<Lighting>, SceneError> {
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper)?;
    let poses: Vec<_> = file.workspace.poses(POSES).collect();
    let disturb = |a: usize, b: usize| {
        let worst = |cell, other| {
            poses.iter().map(|pose| share_of_others(&plan, cell, &[cell, other], pose)).fold(0.0, f64::max)
        };
        worst(a, b) > MAX_CROSSTALK || worst(b, a) > MAX_CROSSTALK
    };
    let mut together = Lighting { slots: Vec::new() };
    // Both axes of a detector have one emitter, and one slot.
    let cells = file.scene.cells.iter().enumerate();
    for (emitter, cell) in cells.filter(|(number, cell)| !cell.is_second_axis(*number)) {
        let free = together.slots.iter_mut().find(|slot| slot.iter().all(|other| !disturb(emitter, *other)));
        let both = [emitter].into_iter().chain(cell.other_axis());
        match free {
            Some(slot) => slot.extend(both),
            None => together.slots.push(both.collect()),
        }
    }
    together.slots.push(Vec::new());
    let mut all = vec![file.lighting.clone()];
    for lighting in [Lighting::one_by_one(&file.scene), together] {
        if !all.contains(&lighting) {
            all.push(lighting);
        }
    }
    Ok(all)
}

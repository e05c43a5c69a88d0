//! A head as well as it is known: by its scene, by a calibration, or by the tolerances of its parts.

use std::path::Path;
use std::sync::Arc;

use heapless::Vec as FixedVec;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{
    Cell, CompiledScene, DegradedReason, Estimate, ModelError, Outcome, Pose, Scene, SceneError, Solution, Status,
    Tier, Tracked,
};

use crate::parameter::Quantity;
use crate::prior::Parameters;
use crate::reading::share;
use crate::{Calibration, CalibrationFileError, prior};

/// A head, and what its poses rest on. Scenes are large: copies of a head share them.
///
/// ```
/// use slitpose_calibration::Head;
/// use slitpose_head::scene_file::{ORDERABLE, WIDE};
/// let head: Head = WIDE.read()?.into();
/// assert!(head.calibration().is_none());
/// // A scene that states tolerances: poses have their part in their covariance.
/// let by_tolerances = Head::as_scene_says(ORDERABLE.read()?)?;
/// assert!(by_tolerances.file.tolerance.is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Head {
    /// The scene; its optics are those that readings are solved with.
    pub file: Arc<SceneFile>,
    /// The scene of a simulated head.
    pub simulated: Arc<SceneFile>,
    /// What the optics are known by.
    pub basis: Basis,
}

/// What the optics of a head are known by.
#[derive(Clone, Debug)]
pub enum Basis {
    /// The scene, which is taken for true.
    Scene,
    /// A calibration of the scene.
    Calibration(Arc<Calibration>),
    /// The scene, and the tolerances of its parts.
    Tolerances,
}

impl From<SceneFile> for Head {
    /// A head that is as its scene says.
    fn from(file: SceneFile) -> Self {
        Self::by(Arc::new(file), Basis::Scene)
    }
}

impl Head {
    fn by(file: Arc<SceneFile>, basis: Basis) -> Self {
        Self { simulated: Arc::clone(&file), file, basis }
    }

    /// The head of `file` by the calibration at `path`.
    pub fn open_calibrated(file: SceneFile, path: &Path) -> Result<Self, CalibrationFileError> {
        Self::calibrated(file, Calibration::open(path)?)
    }

    /// The head of `file` by `calibration`.
    pub fn calibrated(file: SceneFile, calibration: Calibration) -> Result<Self, CalibrationFileError> {
        let scene = calibration.apply(&file)?;
        Ok(Self::by(Arc::new(SceneFile { scene, ..file }), Basis::Calibration(Arc::new(calibration))))
    }

    /// The head of `file` by the tolerances of its parts. A simulated head is as the scene says.
    pub fn uncalibrated(file: SceneFile) -> Result<Self, SceneError> {
        let scene = uncalibrated(&file)?;
        let known = SceneFile { scene, ..file.clone() };
        Ok(Self { file: Arc::new(known), simulated: Arc::new(file), basis: Basis::Tolerances })
    }

    /// By its tolerances if the scene has any, else as the scene says.
    pub fn as_scene_says(file: SceneFile) -> Result<Self, SceneError> {
        if file.tolerance.is_some() { Self::uncalibrated(file) } else { Ok(file.into()) }
    }

    /// The calibration, if there is one.
    pub fn calibration(&self) -> Option<&Calibration> {
        match &self.basis {
            Basis::Calibration(calibration) => Some(calibration),
            Basis::Scene | Basis::Tolerances => None,
        }
    }

    /// The head if it is simulated: then the scene is the truth, unless it states tolerances.
    #[must_use]
    pub fn in_simulation(&self) -> Self {
        match self.basis {
            Basis::Tolerances if self.file.tolerance.is_none() => Self::by(Arc::clone(&self.simulated), Basis::Scene),
            _ => self.clone(),
        }
    }

    /// Completes a solution by [`Self::file`]: its covariance then includes what the calibration left open; without
    /// calibration it is [`DegradedReason::Uncalibrated`].
    pub fn complete(&self, solution: &mut Solution) {
        match &self.basis {
            Basis::Scene => {}
            Basis::Calibration(calibration) => {
                if let Some(estimate) = &mut solution.estimate {
                    widen(estimate, calibration);
                }
            }
            Basis::Tolerances => {
                if solution.outcome == Outcome::Converged {
                    solution.outcome = Outcome::Degraded(DegradedReason::Uncalibrated);
                }
            }
        }
    }

    /// [`Self::complete`] for the poses of a tracker.
    pub fn complete_tracked(&self, tracked: &mut Tracked) {
        self.complete(&mut tracked.solution);
        let Some(filtered) = &mut tracked.filtered else { return };
        match (&self.basis, &tracked.solution.estimate) {
            (Basis::Calibration(calibration), _) => widen(&mut filtered.estimate, calibration),
            // What the parts deviate by is the same in all frames: no mean over them lessens it.
            (Basis::Tolerances, Some(estimate)) => filtered.estimate.covariance = estimate.covariance,
            _ => {}
        }
    }
}

fn widen(estimate: &mut Estimate, calibration: &Calibration) {
    let open = calibration.pose_covariance(&estimate.pose);
    for (row, open) in estimate.covariance.iter_mut().zip(open) {
        for (value, open) in row.iter_mut().zip(open) {
            *value += open;
        }
    }
}

/// Poses at which the currents are looked at: the mean over them is good to a tenth.
const POSES: usize = 40;

/// Change of a parameter by which its effect is found, in its standard deviations.
const STEP: f64 = 0.25;

/// The most probable head of parts within the tolerances of `file`; its model errors are what the tolerances do to the
/// currents.
///
/// Its poses are off by the same amount at every visit: half a millimetre for milled parts.
pub fn uncalibrated(file: &SceneFile) -> Result<Scene, SceneError> {
    let parameters = prior::parameters(file)?;
    let mut scene = parameters.scene(&file.scene);
    // Each emitter's own intensity is less known, and a common factor is part of that.
    scene.uncertainty.light_level_relative = 0.0;
    let poses: Vec<Pose> = file.workspace.poses(POSES).collect();
    for (number, cell) in scene.cells.iter_mut().enumerate() {
        let given = cell.effects.model_error;
        let open = open_by(&parameters, number, &file.scene, &poses)?;
        cell.effects.model_error = ModelError {
            relative: libm::hypot(given.relative, open.relative),
            position_m: libm::hypot(given.position_m, open.position_m),
            current_a: libm::hypot(given.current_a, open.current_a),
            reach: given.reach,
        };
    }
    Ok(scene)
}

/// What the standard deviations of all parameters of cell `number` do to its currents, root mean square over `poses`.
fn open_by(parameters: &Parameters, number: usize, nominal: &Scene, poses: &[Pose]) -> Result<ModelError, SceneError> {
    let cell = &nominal.cells[number];
    let usual = alone(parameters.cell(cell, number, None))?;
    let lit: Vec<(&Pose, [f64; 2])> = poses.iter().filter_map(|pose| Some((pose, seen(&usual, pose)?))).collect();
    let [mut relative, mut position, mut current] = [0.0; 3];
    for place in parameters.acting_on(cell, number, 0) {
        let parameter = &parameters.entries[place];
        let adds_current =
            matches!(parameter.quantity, Quantity::Stray(_) | Quantity::StrayLevel(_) | Quantity::StrayBalance(_));
        let changed = Some((place, parameter.value + STEP * parameter.sigma));
        let changed = alone(parameters.cell(cell, number, changed))?;
        for (pose, before) in &lit {
            // A spot that the change moves off the detector is seen at other poses.
            let Some(after) = seen(&changed, pose) else { continue };
            let change = |of: fn([f64; 2]) -> f64| ((of(after) - of(*before)) / STEP).powi(2);
            if adds_current {
                current += 0.5 * (change(|[first, _]| first) + change(|[_, second]| second));
            } else {
                relative += change(|[first, second]| libm::log(first + second));
                position += change(share) * (0.5 * cell.detector.length_m).powi(2);
            }
        }
    }
    let [relative, position_m, current_a] =
        [relative, position, current].map(|sum| (sum / lit.len().max(1) as f64).sqrt());
    Ok(ModelError { relative, position_m, current_a, reach: None })
}

fn alone(mut cell: Cell) -> Result<CompiledScene<f64>, SceneError> {
    // The numbers of other emitters mean nothing here.
    cell.effects.lit_together = 0;
    CompiledScene::compile(&Scene { cells: FixedVec::from_iter([cell]), ..Scene::default() }, Tier::Paper)
}

/// The currents of a cell alone, if its spot lies on the detector.
fn seen(plan: &CompiledScene<f64>, pose: &Pose) -> Option<[f64; 2]> {
    let pair = plan.photocurrents(0, pose);
    let is_seen = plan.respond(0, pose).status == Status::Lit && pair.total_a() > 0.0;
    is_seen.then_some([pair.i_x1_a, pair.i_x2_a])
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::{MotionPrior, Photocurrents, Solver, Start};

    const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
    const SEED: u64 = 1;
    const HEADS: usize = 100;
    const ROWS: usize = 20;

    /// Polynomials with coefficients from a prior make light of a cell vanish or explode where no profile does.
    const USUAL: f64 = 4.0;

    #[test]
    fn model_errors_that_a_scene_states_stay() {
        let mut file = WIDE.read().expect("the scene");
        let without = uncalibrated(&file).expect("a head");
        let given = ModelError { relative: 0.5, position_m: 1e-3, current_a: 1e-6, reach: Some(0.5) };
        for cell in &mut file.scene.cells {
            cell.effects.model_error = given;
        }
        let with = uncalibrated(&file).expect("a head");
        for (with, without) in with.cells.iter().zip(&without.cells) {
            let [with, without] = [with, without].map(|cell| cell.effects.model_error);
            // Independent of what the tolerances do: squares add.
            let added = [
                (with.relative, without.relative, given.relative),
                (with.position_m, without.position_m, given.position_m),
                (with.current_a, without.current_a, given.current_a),
            ];
            for (with, without, given) in added {
                assert!((with * with / (without * without + given * given) - 1.0).abs() < 1e-9, "{with} {without}");
            }
        }
    }

    #[test]
    fn heads_drawn_from_the_tolerances_have_a_pose_everywhere_with_an_honest_covariance() {
        let file = WIDE.read().expect("the scene");
        let scene = uncalibrated(&file).expect("a head");
        let usual = CompiledScene::<f64>::compile(&scene, TIER).expect("a head");
        let solver = Solver::<f64>::new(&scene, TIER).expect("a head");
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let (mut squares, mut errors) = ([0.0; 6], Vec::new());
        let (mut poses, mut evaluations) = (0, 0);
        for head in 0..HEADS {
            let (drawn, _) = prior::draw(&file, || rng.sample(StandardNormal)).expect("a head");
            let truth = CompiledScene::<f64>::compile(&drawn, TIER).expect("a head");
            for _ in 0..ROWS {
                let mut within =
                    |extent: DVec3| extent * DVec3::from_array([(); 3].map(|()| rng.random_range(-1.0..1.0)));
                let translation_m = within(file.workspace.half_extent_m);
                let pose = Pose::from_vectors(translation_m, within(file.workspace.half_extent_rad));
                let pairs: Vec<_> = (0..truth.cell_count()).map(|cell| truth.photocurrents(cell, &pose)).collect();
                let is_usual = pairs.iter().enumerate().all(|(cell, pair)| {
                    let ratio = pair.total_a() / usual.photocurrents(cell, &pose).total_a();
                    (USUAL.recip()..USUAL).contains(&ratio)
                });
                if !is_usual {
                    continue;
                }
                let solution = solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST);
                let outcome = solution.outcome;
                let estimate = solution.estimate.unwrap_or_else(|| panic!("seed {SEED}, head {head}: {outcome:?}"));
                let (dt, dr) = estimate.pose.displacement_from(&pose);
                let sigma = estimate.sigma();
                for (axis, error) in [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z].into_iter().enumerate() {
                    squares[axis] += (error / sigma[axis]).powi(2);
                }
                errors.push(estimate.nees(&pose).expect("a covariance"));
                poses += 1;
                evaluations += solution.evaluations;
            }
        }
        errors.sort_by(f64::total_cmp);
        let rms = squares.map(|sum| (sum / f64::from(poses)).sqrt());
        let (median, mean) = (errors[errors.len() / 2], errors.iter().sum::<f64>() / f64::from(poses));
        let work = evaluations as f64 / f64::from(poses);
        println!(
            "seed {SEED}: {poses} poses, error/sigma {rms:.2?}, NEES {mean:.1}, median {median:.1}, {work:.1} evaluations"
        );
        // One constant for each kind of error in place of what each pose and head would have: the errors may be half as
        // large again as their σ, and not so small that σ says nothing.
        assert!(rms.iter().all(|ratio| (0.5..1.5).contains(ratio)) && poses > 1900);
        // The median of χ² with six degrees of freedom is 5.3.
        assert!((2.7..10.7).contains(&median), "{median}");
        assert!(work < 20.0, "{work}");
    }
}

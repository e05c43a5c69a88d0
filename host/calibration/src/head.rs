//! A head as well as it is known: by its scene, by a calibration, or by the tolerances of its parts.

use std::path::Path;
use std::sync::Arc;

use slitpose_head::scene_file::SceneFile;
use slitpose_model::{DegradedReason, Estimate, Outcome, SceneError, Solution, Tracked};

use crate::{Calibration, CalibrationFileError, uncalibrated};

/// A head, and what its poses rest on. Scenes are large: copies of a head share them.
#[derive(Clone, Debug)]
pub struct Head {
    /// The scene; its optics are those that readings are solved with.
    pub file: Arc<SceneFile>,
    /// The scene of a simulated head.
    simulated: Arc<SceneFile>,
    basis: Basis,
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
    ///
    /// # Errors
    /// A calibration that cannot be read, or of another scene.
    pub fn open_calibrated(file: SceneFile, path: &Path) -> Result<Self, CalibrationFileError> {
        Self::calibrated(file, Calibration::open(path)?)
    }

    /// The head of `file` by `calibration`.
    ///
    /// # Errors
    /// Those of [`Calibration::apply`].
    pub fn calibrated(file: SceneFile, calibration: Calibration) -> Result<Self, CalibrationFileError> {
        let scene = calibration.apply(&file)?;
        Ok(Self::by(Arc::new(SceneFile { scene, ..file }), Basis::Calibration(Arc::new(calibration))))
    }

    /// The head of `file` by the tolerances of its parts. A simulated head is as the scene says.
    ///
    /// # Errors
    /// Those of [`uncalibrated`].
    pub fn uncalibrated(file: SceneFile) -> Result<Self, SceneError> {
        let scene = uncalibrated(&file)?;
        let known = SceneFile { scene, ..file.clone() };
        Ok(Self { file: Arc::new(known), simulated: Arc::new(file), basis: Basis::Tolerances })
    }

    /// By its tolerances if the scene has any, else as the scene says.
    ///
    /// # Errors
    /// Those of [`uncalibrated`].
    pub fn as_scene_says(file: SceneFile) -> Result<Self, SceneError> {
        if file.tolerance.is_some() { Self::uncalibrated(file) } else { Ok(file.into()) }
    }

    /// What the optics are known by.
    pub fn basis(&self) -> &Basis {
        &self.basis
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

    /// The scene of a simulated head.
    pub fn simulated(&self) -> &SceneFile {
        &self.simulated
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

//! A scene compiled for evaluation: what each cell answers to a pose, and how that changes with it.

mod compile;
mod evaluate;

use heapless::Vec;

use crate::aperture::Aperture;
use crate::exact::{Orders, Rules};
use crate::pose::{Pose, Transform};
use crate::profile::CompiledProfile;
use crate::response::{Pair, Response, Status};
use crate::scalar::Scalar;
use crate::scene::{MAX_CELLS, Scene, SceneError};

/// How the optics of a cell are evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tier {
    /// Equations (3) to (5) of De La Cruz et al. 2018 as printed: the spot seen as one plate, its
    /// geometric centre as X_A, one γ for the whole beam.
    Paper,
    /// Intensity integrated over the spot, X_A the power-weighted centroid.
    Exact {
        /// Relative error allowed to the integrals.
        tolerance: f64,
    },
}

/// A scene compiled for one tier and one number type. Fixed size, no heap.
#[derive(Clone, Debug)]
pub struct Plan<S: Scalar> {
    cells: Vec<CompiledCell<S>, MAX_CELLS>,
    /// Absent in the paper tier.
    rules: Option<Rules<S>>,
}

/// The derivative of a cell's two currents by a perturbation of the pose in the base frame,
/// in the order (δt in metres, δθ in radians): A/m and A/rad.
pub type CurrentsJacobian<S> = [[S; 6]; 2];

#[derive(Clone, Debug)]
struct CompiledCell<S: Scalar> {
    receiver: Receiver<S>,
    emitter: CompiledEmitter<S>,
}

/// The parts of a cell that stay on the base.
#[derive(Clone, Debug)]
struct Receiver<S: Scalar> {
    /// x, y, z axes of the cell frame in the base frame.
    axes: [S::Vec3; 3],
    centre: S::Vec3,
    half: [S; 2],
    length: S,
    aperture: Aperture<S>,
    responsivity: S,
    dark: S,
    saturation: Option<S>,
    faint: S,
}

/// The part of a cell that rides on the tool.
#[derive(Clone, Debug)]
struct CompiledEmitter<S: Scalar> {
    position: S::Vec3,
    axis: S::Vec3,
    intensity: S,
    profile: CompiledProfile<S>,
    /// Absent in the paper tier.
    orders: Option<Orders<S>>,
}

impl<S: Scalar> Plan<S> {
    /// Checks `scene` and prepares it for evaluation in `tier`.
    ///
    /// # Errors
    /// The first impossible value, with its place in the scene. Values that are possible but
    /// useless (no slit width, an emitter behind the slit) compile; they answer with a status.
    pub fn compile(scene: &Scene, tier: Tier) -> Result<Self, SceneError> {
        Ok(Self { cells: compile::cells(scene, tier)?, rules: matches!(tier, Tier::Exact { .. }).then(Rules::new) })
    }

    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// Everything about cell `cell` with the tool at `pose`.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn respond(&self, cell: usize, pose: &Pose) -> Response<S> {
        evaluate::respond(self, cell, &Transform::of(pose))
    }

    /// The photocurrents of cell `cell` above its dark current, I_X − I_D/2 for each electrode:
    /// what is left when a dark sample is subtracted. Zero without spot.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn photocurrents(&self, cell: usize, pose: &Pose) -> Pair<S> {
        evaluate::photocurrents(self, cell, &Transform::of(pose))
    }

    /// As [`Self::photocurrents`], with the status and the analytic derivatives.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn linearise(&self, cell: usize, pose: &Pose) -> (Status, Pair<S>, CurrentsJacobian<S>) {
        self.linearise_at(cell, &Transform::of(pose))
    }

    /// [`Self::linearise`] at a transform already converted to the plan's numbers.
    #[inline]
    pub(crate) fn linearise_at(
        &self,
        cell: usize,
        base_from_tool: &Transform<S>,
    ) -> (Status, Pair<S>, CurrentsJacobian<S>) {
        evaluate::linearise(self, cell, base_from_tool)
    }

    /// Corners of the spot of cell `cell`, in order around it, in the cell's x and y (metres).
    /// Empty without spot.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn spot_outline_m(&self, cell: usize, pose: &Pose) -> Vec<[S; 2], 16> {
        evaluate::outline(self, cell, &Transform::of(pose))
    }

    /// The photocurrents above dark that the light of emitter `emitter` gives on the detector of
    /// cell `cell` through that cell's slit.
    ///
    /// # Panics
    /// If there is no such cell or emitter.
    pub fn crosstalk(&self, cell: usize, emitter: usize, pose: &Pose) -> Pair<S> {
        evaluate::crosstalk(self, cell, emitter, &Transform::of(pose))
    }
}

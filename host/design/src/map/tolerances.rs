//! What tolerances cost: heads drawn from them, before and after calibration.

use std::ops::ControlFlow;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use slitpose_calibration::{
    CalibrateError, Constraint, Data, Knowledge, KnownPoses, PartCosts, PoseRms, Request, Row, calibrate, draw,
    part_costs, uncalibrated,
};
use slitpose_head::scene_file::{SceneFile, Workspace};
use slitpose_head::simulator::noisy_reading;
use slitpose_model::{CompiledScene, MotionPrior, Photocurrents, Pose, Solver, Start, Tier};

use crate::report::frame_scene;

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// How heads are calibrated: at a hundred poses by an instrument as good as a coordinate measuring machine.
pub(crate) const KNOWN: KnownPoses = KnownPoses { count: 100, instrument: [2e-6, 20e-6], frames: 16.0 };

/// Poses at which errors are looked at.
const POSES: usize = 200;

/// What the tolerances of a scene cost.
#[derive(Clone, Debug)]
pub struct Tolerances {
    /// By kind of part, to first order.
    pub costs: PartCosts,
    /// Of each drawn head, errors of poses without noise, root mean square over the workspace: uncalibrated, calibrated.
    pub heads: Vec<[PoseRms; 2]>,
    /// Seed of the draws.
    pub seed: u64,
}

impl Tolerances {
    /// Draws `heads` heads of `file`; `progress` is called for each.
    ///
    /// # Errors
    /// A scene that cannot be computed or calibrated.
    pub fn of(file: &SceneFile, heads: usize, seed: u64, mut progress: impl FnMut()) -> Result<Self, CalibrateError> {
        let (scene, _) = frame_scene(file);
        let file = SceneFile { scene, ..file.clone() };
        let costs = part_costs(&file, KNOWN)?;
        let rough = Solver::new(&uncalibrated(&file)?, TIER)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut found = Vec::with_capacity(heads);
        for _ in 0..heads {
            progress();
            let (head, _) = draw(&file, || rng.sample(StandardNormal))?;
            let truth = CompiledScene::compile(&head, TIER)?;
            let mut data = Data::default();
            data.add("drawn", Constraint::Known, KNOWN.instrument, measured(&file, &truth, &mut rng));
            let request = Request { file: &file, data: &data, start: None, date: None };
            let calibration = calibrate(&request, &mut |_| ControlFlow::Continue(()))?.calibration;
            let known = Solver::new(&calibration.apply(&file)?, TIER)?;
            found.push([&rough, &known].map(|solver| errors(&file.workspace, &truth, solver)));
        }
        Ok(Self { costs, heads: found, seed })
    }
}

/// What an instrument and the board measure of the head whose optics are `truth`.
fn measured(file: &SceneFile, truth: &CompiledScene<f64>, rng: &mut ChaCha8Rng) -> Vec<Row> {
    let noise = file.scene.noise.map(|noise| noise.averaged(KNOWN.frames));
    let mut row = |pose: Pose| {
        let readings = (0..truth.cell_count()).map(|cell| {
            let pair = truth.photocurrents(cell, &pose);
            let pair = noise.map_or(pair, |noise| {
                noisy_reading(pair, &file.scene.cells[cell].detector, &noise, || rng.sample(StandardNormal))
            });
            Some([pair.i_x1_a, pair.i_x2_a])
        });
        let readings = readings.collect();
        let error = KNOWN
            .instrument
            .map(|sigma| DVec3::from_array([(); 3].map(|()| sigma * rng.sample::<f64, _>(StandardNormal))));
        let knowledge = Knowledge::Reported(pose.perturbed(error[0], error[1]));
        Row { id: String::new(), readings, frames: KNOWN.frames, time_s: None, knowledge }
    };
    file.workspace.poses(KNOWN.count).map(&mut row).collect()
}

/// Errors of the poses that `solver` finds in the light of `truth`, without noise.
fn errors(workspace: &Workspace, truth: &CompiledScene<f64>, solver: &Solver<f64>) -> PoseRms {
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    // Not those of the calibration.
    for pose in workspace.poses(KNOWN.count + POSES).skip(KNOWN.count) {
        let pairs: Vec<_> = (0..truth.cell_count()).map(|cell| truth.photocurrents(cell, &pose)).collect();
        let solution = solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST);
        let Some(estimate) = solution.estimate else { continue };
        let (t, r) = estimate.pose.displacement_from(&pose);
        squares = [squares[0] + t.length_squared(), squares[1] + r.length_squared()];
        count += 1.0;
    }
    squares.map(|sum| (sum / count).sqrt())
}

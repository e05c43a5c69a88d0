//! One head, drawn from the tolerances of a scene.

use slitpose_calibration::{Parameter, draw};
use slitpose_head::front_end::{Stage, TimingError, configuration};
use slitpose_head::scene_file::{SceneFile, SceneFileError};
use slitpose_head::simulator::{Electronics, Light, noisy_reading};
use slitpose_model::{CompiledScene, Noise, Pair, Pose, Scene, SceneError, Status, Tier};

use crate::BenchError;
use crate::beyond::{Beyond, BeyondOptics};
use crate::chance::Chance;

/// The integrals are far better than the mean of a hundred frames.
const TIER: Tier = Tier::Exact { tolerance: 1e-7 };

/// Share of the full scale that a bench engineer uses.
const USED_SCALE: f64 = 0.98;

/// What a head deviates in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Within {
    /// Only in parameters that a calibration has.
    Family,
    /// In these, and in effects that no calibration describes.
    Richer,
}

/// A head that no calibration has seen.
#[derive(Debug)]
pub struct DrawnHead {
    /// The scene that its designer believes, with a section `[tolerance]`: such heads are not as their scene says.
    pub nominal: SceneFile,
    /// Every parameter of the model, as it is.
    pub parameters: Vec<Parameter>,
    /// Physics beyond the model, one for each cell; or none.
    pub beyond: Vec<Beyond>,
    scene: Scene,
    optics: Optics,
    /// Emitters that are lit with each cell's own, at nominal level.
    lit: Vec<Vec<(usize, f64)>>,
    noise: Option<Noise>,
}

/// The light of a drawn head.
#[derive(Debug)]
struct Optics {
    plan: CompiledScene<f64>,
    beyond: Vec<BeyondOptics>,
}

impl Light for Optics {
    fn cell_count(&self) -> usize {
        self.plan.cell_count()
    }

    fn photocurrents(&self, cell: usize, lit: &[(usize, f64)], pose: &Pose) -> Pair<f64> {
        let pair = self.plan.photocurrents_of(cell, lit.iter().copied(), pose);
        let own = lit.iter().find(|(emitter, _)| *emitter == cell);
        match (self.beyond.get(cell), own) {
            (Some(beyond), Some((_, level))) => beyond.act(pair, *level, pose),
            _ => pair,
        }
    }
}

impl Optics {
    fn of(scene: &Scene, beyond: &[Beyond]) -> Result<Self, SceneError> {
        let beyond = scene.cells.iter().zip(beyond).map(|(cell, beyond)| BeyondOptics::of(cell, beyond.clone(), TIER));
        Ok(Self { plan: CompiledScene::compile(scene, TIER)?, beyond: beyond.collect::<Result<_, _>>()? })
    }
}

impl DrawnHead {
    /// Draws a head of parts within the tolerances of `scene`; deviations are normal, cut at three standard deviations.
    ///
    /// # Errors
    /// Parts that fit together to no head, and a front end that cannot sample the scene.
    pub fn draw(scene: &SceneFile, within: Within, seed: u64) -> Result<Self, BenchError> {
        let nominal = &with_tolerance(scene)?;
        let mut chance = Chance::of(seed, 0);
        let (scene, parameters) = draw(nominal, || chance.within_three_sigma())?;
        let plan = CompiledScene::compile(&scene, TIER)?;
        let mut chance = Chance::of(seed, 1);
        let mut of_cell = |cell| Beyond::draw(nominal, plan.photocurrents(cell, &Pose::HOME).total_a(), &mut chance);
        let beyond: Vec<Beyond> = match within {
            Within::Family => Vec::new(),
            Within::Richer => (0..scene.cells.len()).map(&mut of_cell).collect(),
        };
        let of_slot = |cell: usize| {
            let slot = nominal.lighting.slots.iter().find(|slot| slot.contains(&cell));
            slot.map_or(vec![(cell, 1.0)], |slot| slot.iter().map(|&emitter| (emitter, 1.0)).collect())
        };
        Ok(Self {
            lit: (0..scene.cells.len()).map(of_slot).collect(),
            optics: Optics::of(&scene, &beyond)?,
            noise: noise(nominal)?,
            nominal: nominal.clone(),
            parameters,
            beyond,
            scene,
        })
    }

    /// The scene of the simulated board: as the designer's, with the optics as they are. What lies beyond the model is in
    /// [`Self::light`] alone.
    pub fn simulated(&self) -> SceneFile {
        SceneFile { scene: self.scene.clone(), ..self.nominal.clone() }
    }

    /// The light on its detectors, for a simulated board.
    ///
    /// # Errors
    /// None that drawing it did not have.
    pub fn light(&self) -> Result<Box<dyn Light>, SceneError> {
        Ok(Box::new(Optics::of(&self.scene, &self.beyond)?))
    }

    /// Photocurrents above dark at `pose`, without noise. `None`: a spot is cut by an end of its detector or off it, or
    /// a current is outside the range of the converters.
    pub(crate) fn currents(&self, pose: &Pose) -> Option<Vec<Pair<f64>>> {
        let scale_a = self.nominal.front_end.map_or(f64::INFINITY, |front_end| USED_SCALE * front_end.full_scale_a);
        let of_cell = |cell: usize| {
            let pair = self.optics.photocurrents(cell, &self.lit[cell], pose);
            let is_lit = self.optics.plan.respond(cell, pose).status == Status::Lit;
            (is_lit && [pair.i_x1_a, pair.i_x2_a].iter().all(|current_a| (0.0..=scale_a).contains(current_a)))
                .then_some(pair)
        };
        (0..self.lit.len()).map(of_cell).collect()
    }

    /// The mean of `frames` readings of the currents `clean`, half the dark current included in each.
    pub(crate) fn reading(&self, clean: &[Pair<f64>], frames: u32, chance: &mut Chance) -> Vec<Pair<f64>> {
        let noise = self.noise.map(|noise| noise.averaged(f64::from(frames)));
        let of_cell = |(pair, cell): (&Pair<f64>, &slitpose_model::Cell)| {
            let detector = &cell.detector;
            let pair = noise.map_or(*pair, |noise| noisy_reading(*pair, detector, &noise, || chance.normal()));
            let half_dark_a = 0.5 * detector.dark_current_a;
            Pair { i_x1_a: pair.i_x1_a + half_dark_a, i_x2_a: pair.i_x2_a + half_dark_a }
        };
        clean.iter().zip(&self.scene.cells).map(of_cell).collect()
    }
}

/// The scene with its tolerances; with the default ones if it has none.
fn with_tolerance(scene: &SceneFile) -> Result<SceneFile, SceneFileError> {
    match scene.tolerance {
        Some(_) => Ok(scene.clone()),
        None => SceneFile::parse(&scene.origin, &format!("{}\n[tolerance]  # the defaults\n", scene.source)),
    }
}

/// Noise of a row of a table: what the scene gives for tables, else that of its front end.
fn noise(file: &SceneFile) -> Result<Option<Noise>, TimingError> {
    match (&file.scene.noise, &file.front_end) {
        (Some(noise), _) => Ok(Some(*noise)),
        (None, None) => Ok(None),
        (None, Some(front_end)) => {
            let schedule = configuration(file)?.schedule;
            let scaling = Electronics::new(&file.scene, front_end).scaling();
            Ok(Stage::weighted_scene(file, &schedule, &scaling).noise)
        }
    }
}

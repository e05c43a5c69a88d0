//! One head, drawn from the tolerances of a scene, and physics beyond the model: what a real head does and no parameter of a
//! calibration describes. Each such effect is a difference of evaluations of the model, added to the light of the head: first
//! order in what is small.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DVec2, DVec3};
use slitpose_calibration::{Parameter, draw};
use slitpose_head::scene_file::{SceneFile, SceneFileError};
use slitpose_head::simulator::{Light, noisy_reading, table_noise};
use slitpose_model::{Cell, CompiledScene, Effects, Noise, Pair, Pose, Scene, SceneError, Status, Tier, rotation_exp};

use crate::BenchError;
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
    scene: Scene,
    pub(crate) optics: Arc<Optics>,
    /// Emitters that are lit with each cell's own, at nominal level.
    lit: Vec<Vec<(usize, f64)>>,
    noise: Option<Noise>,
}

#[derive(Debug)]
pub(crate) struct Optics {
    plan: CompiledScene<f64>,
    /// Physics beyond the model, one for each cell; or none.
    pub(crate) beyond: Vec<BeyondOptics>,
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

impl DrawnHead {
    /// Draws a head of parts within the tolerances of `scene`; deviations are normal, cut at three standard deviations.
    pub fn draw(scene: &SceneFile, within: Within, seed: u64) -> Result<Self, BenchError> {
        let nominal = &with_tolerance(scene)?;
        let mut chance = Chance::of(seed, 0);
        let (scene, parameters) = draw(nominal, || chance.within_three_sigma())?;
        let plan = CompiledScene::<f64>::compile(&scene, TIER)?;
        let mut chance = Chance::of(seed, 1);
        let mut of_cell = |(number, cell): (usize, &Cell)| {
            let home_a = plan.photocurrents(number, &Pose::HOME).total_a();
            BeyondOptics::of(cell, Beyond::draw(nominal, home_a, &mut chance), TIER)
        };
        let beyond = match within {
            Within::Family => Vec::new(),
            Within::Richer => scene.cells.iter().enumerate().map(&mut of_cell).collect::<Result<_, _>>()?,
        };
        let of_slot = |cell: usize| {
            let slot = nominal.lighting.slots.iter().find(|slot| slot.contains(&cell));
            slot.map_or(vec![(cell, 1.0)], |slot| slot.iter().map(|&emitter| (emitter, 1.0)).collect())
        };
        Ok(Self {
            lit: (0..scene.cells.len()).map(of_slot).collect(),
            optics: Arc::new(Optics { plan, beyond }),
            noise: table_noise(nominal)?,
            nominal: nominal.clone(),
            parameters,
            scene,
        })
    }

    /// The scene of the simulated board: as the designer's, with the optics as they are. What lies beyond the model is in
    /// [`Self::light`] alone.
    pub fn simulated(&self) -> SceneFile {
        SceneFile { scene: self.scene.clone(), ..self.nominal.clone() }
    }

    /// The light on its detectors, for a simulated board.
    pub fn light(&self) -> Arc<dyn Light> {
        Arc::clone(&self.optics) as Arc<dyn Light>
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
        let of_cell = |(pair, cell): (&Pair<f64>, &Cell)| {
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

/// Amplitude of the ripple of a detector's position, standard deviation, metres. Data sheets state the whole
/// non-linearity, of which periods below a third of the length are a fortieth.
const RIPPLE_M: f64 = 1.5e-6;

/// Periods of the ripple, metres: shorter than the polynomials of a calibration follow well.
const RIPPLE_PERIOD_M: [f64; 2] = [1.5e-3, 4e-3];

/// Distance of the chip's three luminous points from its middle, metres: a chip of 0.3 mm.
const CHIP_M: f64 = 0.1e-3;

/// Standard deviation of the points' brightness, relative: a bond wire covers a part.
const CHIP_RELATIVE: f64 = 0.2;

/// Difference of the slit's width between its halves, standard deviation, metres: a burr.
const SLIT_STEP_M: f64 = 2e-6;

/// Change of stray light over the rotations of the workspace, in standard deviations of the stray light: the tool's body
/// turns its faces.
const STRAY_CHANGE: f64 = 0.03;

/// The effects of one cell.
#[derive(Clone, Debug)]
pub(crate) struct Beyond {
    /// Amplitude of the ripple X_measured − X_A = a·sin(2π·X_A/p + φ), metres.
    pub(crate) ripple_m: f64,
    /// Its period p, metres.
    pub(crate) ripple_period_m: f64,
    /// Its phase φ, radians.
    pub(crate) ripple_phase_rad: f64,
    /// Shares of three points of the emitter's chip.
    pub(crate) chip: [f64; 3],
    /// The slit is wider by half of this where y > 0, and narrower where y < 0, metres.
    pub(crate) slit_step_m: f64,
    /// Stray current of each electrode per component of the tool's rotation vector, A/rad.
    pub(crate) stray_a_per_rad: [[f64; 3]; 2],
}

impl Beyond {
    /// Of a cell with the current `home_a` with the tool at home.
    pub(crate) fn draw(file: &SceneFile, home_a: f64, chance: &mut Chance) -> Self {
        let tolerance = file.tolerance.unwrap_or_default();
        let extent_rad = file.workspace.half_extent_rad.max_element().max(0.1);
        let stray = STRAY_CHANGE * tolerance.stray_relative * home_a / extent_rad;
        let points = [0; 3].map(|_| (1.0 + CHIP_RELATIVE * chance.normal()).max(0.0));
        let sum = points.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        Self {
            ripple_m: RIPPLE_M * chance.normal(),
            ripple_period_m: chance.between(RIPPLE_PERIOD_M),
            ripple_phase_rad: chance.between([0.0, TAU]),
            chip: points.map(|point| point / sum),
            slit_step_m: SLIT_STEP_M * chance.normal(),
            stray_a_per_rad: [0; 2].map(|_| [0; 3].map(|_| stray * chance.normal())),
        }
    }
}

/// The effects of one cell, ready for evaluation.
#[derive(Debug)]
pub(crate) struct BeyondOptics {
    pub(crate) of: Beyond,
    length_m: f64,
    /// Light of the cell alone, with its weight: the differences that make chip and slit.
    parts: Vec<(f64, CompiledScene<f64>)>,
}

impl BeyondOptics {
    pub(crate) fn of(cell: &Cell, beyond: Beyond, tier: Tier) -> Result<Self, SceneError> {
        let (window, nonlinearity_m) = (cell.effects.window, cell.effects.nonlinearity_m.clone());
        let (opening, profile) = (cell.effects.opening, cell.effects.profile);
        let effects = Effects { opening, window, nonlinearity_m, profile, ..Effects::default() };
        let usual = Cell { effects, ..cell.clone() };
        let (a, b) = usual.emitter.axis_tool.any_orthonormal_pair();
        let mut cells = vec![(-1.0, usual.clone())];
        for (k, share) in beyond.chip.into_iter().enumerate() {
            let (sin, cos) = (2.0 * PI / 3.0 * k as f64).sin_cos();
            let mut point = usual.clone();
            point.emitter.position_tool_m += CHIP_M * (a * cos + b * sin);
            cells.push((share, point));
        }
        for side in [1.0, -1.0].into_iter().filter(|_| !opening.is_hole()) {
            let half = half_slit(&usual, side);
            let mut stepped = half.clone();
            stepped.slit.width_m = (half.slit.width_m + 0.5 * side * beyond.slit_step_m).max(0.0);
            cells.extend([(-1.0, half), (1.0, stepped)]);
        }
        let compile = |(weight, cell): (f64, Cell)| {
            let scene = Scene { cells: [cell].into_iter().collect(), ..Scene::default() };
            Ok((weight, CompiledScene::compile(&scene, tier)?))
        };
        let parts = cells.into_iter().map(compile).collect::<Result<_, SceneError>>()?;
        Ok(Self { of: beyond, length_m: cell.detector.length_m, parts })
    }

    /// The currents of a cell whose emitter is lit at `level`, and that has the currents `pair` by the model.
    pub(crate) fn act(&self, pair: Pair<f64>, level: f64, pose: &Pose) -> Pair<f64> {
        let mut currents = [pair.i_x1_a, pair.i_x2_a];
        for (weight, part) in &self.parts {
            let part = part.photocurrents(0, pose);
            currents[0] += level * weight * part.i_x1_a;
            currents[1] += level * weight * part.i_x2_a;
        }
        let total_a = currents[0] + currents[1];
        if total_a > 0.0 {
            let x_m = 0.5 * self.length_m * (currents[1] - currents[0]) / total_a;
            let Beyond { ripple_m, ripple_period_m, ripple_phase_rad, .. } = self.of;
            let moved = ripple_m * (TAU * x_m / ripple_period_m + ripple_phase_rad).sin() / self.length_m;
            currents[0] -= total_a * moved;
            currents[1] += total_a * moved;
        }
        let rotation = pose.rotation_rad();
        for (current, slope) in currents.iter_mut().zip(self.of.stray_a_per_rad) {
            *current += level * DVec3::from_array(slope).dot(rotation);
        }
        Pair { i_x1_a: currents[0], i_x2_a: currents[1] }
    }
}

/// The cell with only that half of its slit where `side`·y > 0.
fn half_slit(cell: &Cell, side: f64) -> Cell {
    let mut half = cell.clone();
    let off = rotation_exp(cell.slit.tilt_rad) * DVec3::new(0.0, 0.25 * side * cell.slit.length_m, 0.0);
    half.slit.offset_m += DVec2::new(off.x, off.y);
    half.slit.distance_m += off.z;
    half.slit.length_m *= 0.5;
    half
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::WIDE;

    use super::*;

    const TIER: Tier = Tier::Exact { tolerance: 1e-9 };

    #[test]
    fn both_halves_of_a_slit_pass_the_light_of_the_whole() {
        let mut cell = WIDE.read().unwrap().scene.cells[1].clone();
        cell.slit.tilt_rad = DVec3::new(0.02, -0.03, 0.05);
        let pose = Pose::from_vectors(DVec3::new(1e-3, -2e-3, 1e-3), DVec3::new(0.1, -0.05, 0.1));
        let total = |cell: Cell| {
            let scene = Scene { cells: [cell].into_iter().collect(), ..Scene::default() };
            CompiledScene::<f64>::compile(&scene, TIER).unwrap().photocurrents(0, &pose).total_a()
        };
        let halves = total(half_slit(&cell, 1.0)) + total(half_slit(&cell, -1.0));
        let whole = total(cell);
        // The integrals are good to 1e-9.
        assert!((halves / whole - 1.0).abs() < 1e-8, "{halves} {whole}");
    }

    #[test]
    fn without_deviations_there_is_nothing_beyond() {
        let file = WIDE.read().unwrap();
        let mut chance = Chance::of(1, 0);
        let drawn = Beyond::draw(&file, 7e-6, &mut chance);
        let plan = CompiledScene::<f64>::compile(&file.scene, TIER).unwrap();
        let pose = Pose::from_vectors(DVec3::new(1e-3, -2e-3, 1e-3), DVec3::new(0.1, -0.05, 0.1));
        let pair = plan.photocurrents(0, &pose);
        let change = |beyond: Beyond| {
            let after = BeyondOptics::of(&file.scene.cells[0], beyond, TIER).unwrap().act(pair, 1.0, &pose);
            (after.i_x1_a - pair.i_x1_a).abs().max((after.i_x2_a - pair.i_x2_a).abs()) / pair.total_a()
        };
        let none = Beyond { ripple_m: 0.0, slit_step_m: 0.0, stray_a_per_rad: [[0.0; 3]; 2], ..drawn.clone() };
        // Three equal points around the middle differ from one in the middle by the square of 0.1 mm in 15 mm.
        let even = change(Beyond { chip: [1.0 / 3.0; 3], ..none.clone() });
        assert!(even < 3e-4, "{even}");
        for beyond in [
            Beyond { chip: drawn.chip, ..none.clone() },
            Beyond { chip: [1.0 / 3.0; 3], ripple_m: drawn.ripple_m, ..none.clone() },
            Beyond { chip: [1.0 / 3.0; 3], slit_step_m: drawn.slit_step_m, ..none.clone() },
            Beyond { chip: [1.0 / 3.0; 3], stray_a_per_rad: drawn.stray_a_per_rad, ..none.clone() },
        ] {
            let found = change(beyond.clone());
            assert!((found - even).abs() > 1e-6, "{beyond:?} changes nothing: {found}, {even}");
        }
    }
}

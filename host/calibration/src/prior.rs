//! The parameters of a head as one vector, and what is known of them before calibration: the scene, and the tolerances of its parts.

use heapless::Vec as FixedVec;
use slitpose_head::scene_file::{SceneFile, Tolerance};
use slitpose_model::{Cell, CompiledScene, MAX_CELLS, Opening, Pose, Profile, Scene, SceneError, Tier};

use crate::parameter::{Quantity, cell_with};

/// Thickness of the mask of a scene that does not give it, and its standard deviation, metres: foil that holds a slit.
const MASK_M: [f64; 2] = [0.15e-3, 0.03e-3];

/// Thickness of the cover of a scene that does not give it, metres: the clear resin of an S3932 is 0.3 to 1 mm.
const RESIN_M: f64 = 0.7e-3;

/// 1 − cos γ of a ray to the edge of a usual workspace, and its sine: what the tolerance of the profile refers to.
const EDGE: [f64; 2] = [0.3, 0.7];

/// What of a profile's tolerance depends on the azimuth: chips are nearly square, and their tilt is a parameter of its own.
const AZIMUTH: f64 = 0.2;

/// Mean and standard deviation of the stray light of one electrode, in the tolerance of that of both together. Light adds, so
/// that this is the size of a normal number; centred anywhere on the detector with equal probability it divides into u and
/// 1 − u. Mean ½·√(2/π), mean square 1/3, and the electrodes are as good as independent (correlation 0.04).
const STRAY_OF_ELECTRODE: [f64; 2] = [0.399, 0.417];

/// Change of stray light from home to the edge of the workspace, relative: in proportion to the way, and to its square.
/// Surfaces that reflect are about ten workspaces' extents of path away.
const STRAY_CHANGE: [f64; 2] = [0.15, 0.05];

/// Change of the stray light of an electrode from home to the largest rotation, in the tolerance of that of both: parts of
/// the tool that turn are nearer to its emitters than walls are.
const STRAY_TURNING: f64 = 0.03;

/// How far the electrodes' stray light changes unlike: most of a change is that of its brightness.
const STRAY_BALANCE: f64 = 0.3;

/// Standard deviation of the coefficients of a converter's curve, in steps: data sheets state 1.5 steps at most.
const CONVERTER_LSB: f64 = 0.8;

/// A converter of a scene without front end: its full scale and its steps.
const FULL_SCALE_A: f64 = 10e-6;
const CODES: f64 = 4096.0;

/// Every parameter that the tolerances of `file` leave open, at its most probable value.
pub(crate) fn parameters(file: &SceneFile) -> Result<Parameters, SceneError> {
    let tolerance = file.tolerance.unwrap_or_default();
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance: 1e-6 })?;
    let extent_m = file.workspace.half_extent_m.max_element().max(1e-3);
    let extent_rad = file.workspace.half_extent_rad.max_element().max(0.1);
    let (full_scale_a, codes) = match &file.front_end {
        Some(front_end) => (front_end.full_scale_a, libm::exp2(f64::from(front_end.adc_bits))),
        None => (FULL_SCALE_A, CODES),
    };
    let mut entries = Vec::new();
    for (number, cell) in file.scene.cells.iter().enumerate() {
        let stray_a = tolerance.stray_relative * plan.photocurrents(number, &Pose::HOME).total_a();
        let is_second = cell.is_second_axis(number);
        for quantity in Quantity::of_cell().filter(|quantity| !(is_second && quantity.is_of_emitter())) {
            if let Some([mean, sigma]) = of_cell(&tolerance, cell, quantity, stray_a, [extent_m, extent_rad]) {
                entries.push(Parameter::at_prior(Some(number), quantity, mean, sigma));
            }
        }
    }
    if tolerance.nonlinearity_m > 0.0 {
        for quantity in Quantity::of_head() {
            let Quantity::Converter(_, order) = quantity else { continue };
            let sigma = CONVERTER_LSB * full_scale_a / codes * 2.0 / f64::from(order);
            entries.push(Parameter::at_prior(None, quantity, 0.0, sigma));
        }
    }
    Ok(Parameters { entries, full_scale_a })
}

/// Mean and standard deviation; `None`: no parameter.
fn of_cell(
    tolerance: &Tolerance,
    cell: &Cell,
    quantity: Quantity,
    stray_a: f64,
    [extent_m, extent_rad]: [f64; 2],
) -> Option<[f64; 2]> {
    let [z, v] = EDGE;
    let profile = tolerance.profile_relative;
    let around_zero = |sigma: f64| [0.0, sigma];
    let found = match quantity {
        Quantity::DetectorShift(_) | Quantity::SlitOffset | Quantity::SlitDistance | Quantity::EmitterShift(_) => {
            around_zero(tolerance.position_m)
        }
        // A round hole neither tilts nor is deep.
        Quantity::SlitTilt(_) | Quantity::MaskThickness if cell.opening().is_hole() => return None,
        Quantity::DetectorTurn(_) | Quantity::SlitTilt(_) => around_zero(tolerance.angle_rad),
        Quantity::SlitWidth => around_zero(tolerance.slit_width_m),
        Quantity::MaskThickness if tolerance.slit_width_m == 0.0 => return None,
        Quantity::MaskThickness if cell.slit.thickness_m == 0.0 => MASK_M,
        Quantity::MaskThickness => around_zero(MASK_M[1]),
        Quantity::EmitterTilt(_) => around_zero(tolerance.emitter_angle_rad),
        Quantity::LogIntensity => around_zero(tolerance.emitter_gain_relative),
        Quantity::ProfileExponent => match cell.emitter.profile {
            Profile::Cosine { .. } => around_zero(profile / -libm::log(1.0 - z)),
            Profile::Table(_) => return None,
        },
        Quantity::ProfileRadial(k) => {
            let order = i32::from(k) + 1;
            around_zero(profile / f64::from(order * order) / z.powi(order))
        }
        Quantity::ProfileAzimuthal(0 | 1) => around_zero(AZIMUTH * profile / (v * v)),
        Quantity::ProfileAzimuthal(_) => around_zero(AZIMUTH * profile / (z * v)),
        // Windows are not computed behind other openings.
        Quantity::WindowThickness if tolerance.window_m == 0.0 || cell.opening() != Opening::Slit => return None,
        Quantity::WindowThickness if cell.effects.window.is_none() => [RESIN_M, tolerance.window_m],
        Quantity::WindowThickness => around_zero(tolerance.window_m),
        Quantity::Nonlinearity(k) => {
            // Even and smooth: what a data sheet states as a whole is spread over the low orders.
            around_zero(tolerance.nonlinearity_m * 4.0 / (3.0 + f64::from(k)))
        }
        // What the scene gives may be wrong either way.
        Quantity::Stray(_) if cell.effects.stray.is_some() => around_zero(STRAY_OF_ELECTRODE[1] * stray_a),
        Quantity::Stray(_) => STRAY_OF_ELECTRODE.map(|share| share * stray_a),
        Quantity::StrayLevel(_) | Quantity::StrayBalance(_) | Quantity::StrayTurning(_) if stray_a == 0.0 => {
            return None;
        }
        Quantity::StrayLevel(0..3) => around_zero(STRAY_CHANGE[0] / extent_m),
        Quantity::StrayLevel(_) => around_zero(STRAY_CHANGE[1] / (extent_m * extent_m)),
        Quantity::StrayBalance(0..3) => around_zero(STRAY_BALANCE * STRAY_CHANGE[0] / extent_m),
        Quantity::StrayBalance(_) => around_zero(STRAY_BALANCE * STRAY_CHANGE[1] / (extent_m * extent_m)),
        Quantity::StrayTurning(_) => around_zero(STRAY_TURNING * stray_a / extent_rad),
        Quantity::ElectrodeGain => around_zero(tolerance.electrode_gain_relative * std::f64::consts::SQRT_2),
        Quantity::Converter(..) => return None,
    };
    (found[1] > 0.0).then_some(found)
}

/// One parameter: what was known, and what is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// The cell it belongs to; `None`: shared by all cells.
    pub cell: Option<usize>,
    /// What it is.
    pub quantity: Quantity,
    /// Most probable value before calibration, in the unit of the quantity.
    pub prior: f64,
    /// Its standard deviation.
    pub prior_sigma: f64,
    /// Value now.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl Parameter {
    pub(crate) fn at_prior(cell: Option<usize>, quantity: Quantity, prior: f64, prior_sigma: f64) -> Self {
        Self { cell, quantity, prior, prior_sigma, value: prior, sigma: prior_sigma }
    }

    /// Name with the cell, for people and files.
    pub fn name(&self) -> String {
        match self.cell {
            Some(cell) => format!("cell {cell} {}", self.quantity),
            None => self.quantity.to_string(),
        }
    }

    /// Shift from the prior, in its standard deviations.
    pub fn shift(&self) -> f64 {
        (self.value - self.prior) / self.prior_sigma
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Parameters {
    pub(crate) entries: Vec<Parameter>,
    /// Current at the top code of the converters, amperes.
    pub(crate) full_scale_a: f64,
}

impl Parameters {
    /// Which parameters act on `cell`, cell `number`, which sees light of the emitters `lit_together`, too: places in
    /// [`Self::entries`].
    pub(crate) fn acting_on(&self, cell: &Cell, number: usize, lit_together: u16) -> Vec<usize> {
        let emitters = lit_together | 1 << cell.emitter(number);
        let acts = |parameter: &Parameter| match parameter.cell {
            None => true,
            Some(own) => own == number || emitters >> own & 1 == 1 && parameter.quantity.is_of_emitter(),
        };
        (0..self.entries.len()).filter(|&k| acts(&self.entries[k])).collect()
    }

    /// Cell `number` with the parameters in force, that at place `changed.0` with another value.
    pub(crate) fn cell(&self, nominal: &Cell, number: usize, changed: Option<(usize, f64)>) -> Cell {
        let emitter = nominal.emitter(number);
        let acts = |entry: &Parameter| {
            entry.cell.is_none_or(|own| own == if entry.quantity.is_of_emitter() { emitter } else { number })
        };
        let of_cell = self.entries.iter().enumerate().filter(|(_, entry)| acts(entry));
        let values = of_cell.map(|(k, entry)| match changed {
            Some((place, value)) if place == k => (entry.quantity, value),
            _ => (entry.quantity, entry.value),
        });
        cell_with(nominal, self.full_scale_a, values)
    }

    /// The scene with the parameters in force.
    pub(crate) fn scene(&self, nominal: &Scene) -> Scene {
        let cells = nominal.cells.iter().enumerate().map(|(number, cell)| self.cell(cell, number, None));
        Scene { cells: cells.collect::<FixedVec<_, MAX_CELLS>>(), ..nominal.clone() }
    }
}

/// A head whose parts deviate from the scene of `file` by chance, as its tolerances say: its optics, and every parameter
/// as it is, with a standard deviation of zero. `normal` gives standard normal numbers.
pub fn draw(file: &SceneFile, mut normal: impl FnMut() -> f64) -> Result<(Scene, Vec<Parameter>), SceneError> {
    let mut parameters = parameters(file)?;
    for entry in &mut parameters.entries {
        entry.value = entry.prior + entry.prior_sigma * normal();
        // Light adds; a scene's own may be less.
        if matches!(entry.quantity, Quantity::Stray(_)) && entry.prior > 0.0 {
            entry.value = entry.value.abs();
        }
        entry.sigma = 0.0;
    }
    Ok((parameters.scene(&file.scene), parameters.entries))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;
    use slitpose_head::scene_file::{SceneFile, WIDE};
    use slitpose_model::{CompiledScene, Pose, Tier};

    use crate::Quantity;

    #[test]
    fn default_tolerances_leave_everything_open() {
        let (_, found) = draw(&WIDE.read().expect("the scene"), || 0.0).expect("a head");
        for quantity in Quantity::of_cell() {
            let cells = found.iter().filter(|entry| entry.quantity == quantity && entry.prior_sigma > 0.0).count();
            assert_eq!(cells, 6, "{quantity}");
        }
        assert_eq!(found.iter().filter(|entry| entry.cell.is_none()).count(), Quantity::of_head().count());
    }

    #[test]
    fn electrodes_share_the_stray_light_of_a_spot_anywhere() {
        const SEED: u64 = 3;
        const SPOTS: usize = 100_000;
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let of_electrode: Vec<f64> =
            (0..SPOTS).map(|_| rng.sample::<f64, _>(StandardNormal).abs() * rng.random_range(0.0..1.0)).collect();
        let mean = of_electrode.iter().sum::<f64>() / SPOTS as f64;
        let variance = of_electrode.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / SPOTS as f64;
        // Five times the standard error of the mean; that of a standard deviation is about the same.
        let tolerance = 5.0 * (variance / SPOTS as f64).sqrt();
        let [of_mean, of_sigma] = STRAY_OF_ELECTRODE;
        assert!((mean - of_mean).abs() < tolerance && (variance.sqrt() - of_sigma).abs() < tolerance, "seed {SEED}");
    }

    /// What the scene says of stray light is as likely too much as too little.
    #[test]
    fn stray_light_is_expected_unless_the_scene_gives_it() {
        let mut file = WIDE.read().expect("the scene");
        let stray = |file: &SceneFile| -> Vec<f64> {
            let (_, found) = draw(file, || 0.0).expect("a head");
            found.iter().filter(|entry| matches!(entry.quantity, Quantity::Stray(_))).map(|entry| entry.value).collect()
        };
        let home = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance: 1e-6 }).expect("a scene");
        let expected = 0.03 * 0.399 * home.photocurrents(0, &Pose::HOME).total_a();
        let found = stray(&file);
        assert!(found.len() == 12 && found.iter().all(|value| (value / expected - 1.0).abs() < 1e-3), "{found:?}");
        for cell in &mut file.scene.cells {
            cell.effects.stray = Some(slitpose_model::Stray::default());
        }
        assert!(stray(&file).iter().all(|value| *value == 0.0));
    }

    /// Data sheets of 12-bit converters state an integral non-linearity of 1 to 2 steps.
    #[test]
    fn curves_of_converters_are_those_of_data_sheets() {
        const SEED: u64 = 2;
        let (file, mut rng) = (WIDE.read().expect("the scene"), ChaCha8Rng::seed_from_u64(SEED));
        let front_end = file.front_end.as_ref().expect("a front end");
        let step_a = front_end.full_scale_a / 4096.0;
        let mut most: Vec<f64> = (0..101)
            .map(|_| {
                let (head, _) = draw(&file, || rng.sample(StandardNormal)).expect("a head");
                let converters = head.cells[0].effects.converters.as_ref().expect("curves");
                let at = |x: f64| converters.curves_a[0].iter().rev().fold(0.0, |sum, term| sum * x + term);
                (-50..=50).map(|k| at(f64::from(k) / 50.0).abs() / step_a).fold(0.0, f64::max)
            })
            .collect();
        most.sort_by(f64::total_cmp);
        println!("seed {SEED}: {:.2} steps in the median, {:.2} in nine of ten", most[50], most[90]);
        assert!((0.75..3.0).contains(&most[50]));
    }
}

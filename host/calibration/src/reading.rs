//! Readings of a cell: their covariance, and whether a calibration still describes its head by what they say of each other.

use slitpose_model::{
    Cell, CompiledScene, ModelError, MotionPrior, Noise, Pair, Pose, Reading, Scene, SceneError, Solution, Solver,
    Start, Tier,
};

use crate::data::Row;

/// The optics of calibration: finer than the noise of a thousand frames.
pub(crate) const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Place of the light, as a share of half the detector.
pub(crate) fn share([first, second]: [f64; 2]) -> f64 {
    (second - first) / (first + second)
}

/// Covariance of the currents of one cell, A²: three numbers, [1,1], [1,2] and [2,2].
pub(crate) type Covariance = [f64; 3];

/// Noise of one cell in one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReadingNoise {
    electrode: f64,
    johnson: f64,
    dark: f64,
    shot_a: f64,
    per_length: f64,
}

/// Least relative error of a current: what the arithmetic of the optics is good for.
const MIN_RELATIVE: f64 = 1e-6;

impl ReadingNoise {
    pub(crate) fn new(noise: Option<&Noise>, cell: &Cell) -> Self {
        let detector = &cell.detector;
        let of = |value: &dyn Fn(&Noise) -> f64| noise.map_or(0.0, value);
        let dark = of(&|noise| noise.dark_shot_a2(detector));
        Self {
            electrode: of(&|noise| noise.adc_a * noise.adc_a),
            johnson: of(&|noise| noise.johnson_a2(detector)) + dark / 12.0,
            dark,
            shot_a: of(&|noise| noise.shot_a()),
            per_length: detector.length_m.recip(),
        }
    }

    /// Derivatives of the currents `pair` by relative intensity and position.
    pub(crate) fn changes(&self, pair: [f64; 2]) -> [[f64; 2]; 2] {
        let across = (pair[0] + pair[1]) * self.per_length;
        [pair, [-across, across]]
    }

    /// Of the mean of `frames` frames, with what the model leaves out.
    pub(crate) fn covariance(&self, pair: [f64; 2], frames: f64, error: &ModelError) -> Covariance {
        let total = (pair[0] + pair[1]).abs().max(f64::MIN_POSITIVE);
        let square = total * total;
        let moved = error.position_m * self.per_length;
        let own = self.electrode / frames + error.current_a * error.current_a + MIN_RELATIVE * MIN_RELATIVE * square;
        let across = self.johnson / frames + moved * moved * square;
        let even = 0.25 * self.dark / frames;
        let along = self.shot_a / (total * frames) + error.relative * error.relative;
        [
            own + across + even + along * pair[0] * pair[0],
            even - across + along * pair[0] * pair[1],
            own + across + even + along * pair[1] * pair[1],
        ]
    }
}

/// Fourth differences, and the sum of their squares: motions of a hand leave next to nothing of them at 100 Hz and more.
const DIFFERENCES: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
const SQUARES: f64 = 70.0;

/// Fewest differences that tell the noise, to some percent.
const MIN_DIFFERENCES: usize = 1000;

/// Most of them, in time: the noise is then known to a percent.
const MAX_WINDOWS: usize = 20_000;

/// Median of χ² with two degrees of freedom: 2·ln 2.
const MEDIAN: f64 = 2.0 * std::f64::consts::LN_2;

/// Noise of single frames in a row, as a multiple of what `noise` says of the detectors of `scene`; `None`: too few frames
/// follow each other. Motion and single outliers hardly count.
pub fn measured_noise(rows: &[Row], scene: &Scene, noise: &Noise) -> Option<f64> {
    let stated: Vec<ReadingNoise> = scene.cells.iter().map(|cell| ReadingNoise::new(Some(noise), cell)).collect();
    let mut squares = Vec::new();
    for five in rows.windows(DIFFERENCES.len()).step_by(rows.len().div_ceil(MAX_WINDOWS).max(1)) {
        let times_s: [Option<[f64; 2]>; 5] = std::array::from_fn(|k| five[k].time_s.filter(|_| five[k].frames == 1.0));
        let [Some([a, _]), Some([b, _]), Some([c, _]), Some([d, _]), Some([e, _])] = times_s else { continue };
        let step_s = (e - a) / 4.0;
        if [b - a, c - b, d - c, e - d].iter().any(|way_s| (way_s - step_s).abs() >= 0.01 * step_s) {
            continue;
        }
        for (cell, stated) in stated.iter().enumerate() {
            let pairs: [Option<[f64; 2]>; 5] = std::array::from_fn(|k| five[k].readings[cell]);
            let [Some(a), Some(b), Some(c), Some(d), Some(e)] = pairs else { continue };
            let difference =
                [0, 1].map(|k| [a, b, c, d, e].iter().zip(DIFFERENCES).map(|(pair, by)| by * pair[k]).sum::<f64>());
            let [x, y] = whiten(whitener(stated.covariance(c, 1.0, &ModelError::default())), difference);
            squares.push((x * x + y * y) / SQUARES);
        }
    }
    if squares.len() < MIN_DIFFERENCES {
        return None;
    }
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    Some((*median / MEDIAN).sqrt())
}

/// The inverse of the lower Cholesky factor of a covariance: [1,1], [2,1], [2,2].
pub(crate) fn whitener([a, b, c]: Covariance) -> [f64; 3] {
    let first = a.sqrt();
    let below = b / first;
    let second = (c - below * below).max(f64::MIN_POSITIVE).sqrt();
    [first.recip(), -below / (first * second), second.recip()]
}

pub(crate) fn whiten(w: [f64; 3], pair: [f64; 2]) -> [f64; 2] {
    [w[0] * pair[0], w[1] * pair[0] + w[2] * pair[1]]
}

/// Derivatives of a reading's relative intensity and position by its currents.
pub(crate) fn directions(pair: [f64; 2], half_length_m: f64) -> [[f64; 2]; 2] {
    let total = pair[0] + pair[1];
    let share = (pair[1] - pair[0]) / total;
    let across = half_length_m / total;
    [[total.recip(); 2], [across * (-1.0 - share), across * (1.0 - share)]]
}

/// How far the reading `found` is from what `plan` expects of `cell` at `pose`: of its relative intensity and position, and
/// of its currents.
pub(crate) fn deviation(
    plan: &CompiledScene<f64>,
    cell: usize,
    pose: &Pose,
    found: [f64; 2],
    half_length_m: f64,
) -> ([f64; 2], [f64; 2]) {
    let Pair { i_x1_a, i_x2_a } = plan.photocurrents(cell, pose);
    let change = [found[0] - i_x1_a, found[1] - i_x2_a];
    (directions([i_x1_a, i_x2_a], half_length_m).map(|by| by[0] * change[0] + by[1] * change[1]), change)
}

/// Fewest rows that a verdict is given on.
const MIN_ROWS: usize = 20;

/// Rows that are looked at, spread over all.
const MAX_ROWS: usize = 400;

/// Mean χ² by its expectation, from which a calibration counts as stale. Of the heads that it was tried on it is 0.8 to
/// 1.1; a cell whose slit or emitter has moved by 10 µm makes it 3.
const STALE: f64 = 1.6;

/// Deviation of all light together that a level which the scene takes for known may have, and otherwise standard
/// deviations of the level.
const KNOWN_LEVEL: f64 = 2e-3;
const LEVEL_SIGMAS: f64 = 3.0;

/// Fewest cells that leave redundancy enough for the level of all light to be free.
const MIN_CELLS_WITH_LEVEL: usize = 6;

/// How much of the excess χ² must go with a cell to say that it is that one.
const BLAMED: f64 = 0.5;

/// What readings say of one cell, against what all others predict of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellValidity {
    /// Readings looked at.
    pub readings: usize,
    /// Mean deviation of its photocurrent, relative, from that of all cells.
    pub relative: f64,
    /// Mean deviation of the position of its light, metres.
    pub position_m: f64,
    /// Root mean square of that deviation, metres.
    pub rms_position_m: f64,
    /// χ² by its expectation without the cell.
    pub without: f64,
}

/// A verdict on a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Validity {
    /// Rows with a pose.
    pub rows: usize,
    /// χ² of all rows by its expectation.
    pub chi2: f64,
    /// Deviation of all light together, relative: the median of the cells'.
    pub light_level: f64,
    /// Whether poses allow for it, by the tolerance of the scene's light level.
    pub allows_level: bool,
    /// Of each cell.
    pub cells: Vec<CellValidity>,
    /// Whether the head has changed; `None`: too few rows to tell.
    pub is_valid: Option<bool>,
    /// The cell that has changed, if it is one alone.
    pub changed: Option<usize>,
}

/// Solves `rows` with the calibrated `scene`, whose `noise` is that of one frame, and compares each cell with the others.
pub fn validity(scene: &Scene, noise: Option<Noise>, rows: &[Row]) -> Result<Validity, SceneError> {
    let count = scene.cells.len();
    let every = rows.len().div_ceil(MAX_ROWS).max(1);
    let (mut used, mut sums) = (0, [0.0; 2]);
    let mut cells = vec![CellValidity::default(); count];
    let mut without = vec![[0.0; 2]; count];
    let mut solver: Option<(f64, Solver<f64>)> = None;
    // Other cells do not have to answer for a level that is off by more than the scene expects.
    let mut uncertainty = scene.uncertainty;
    if count >= MIN_CELLS_WITH_LEVEL {
        uncertainty.light_level_relative = 1.0;
    }
    // An excluded cell has shown at least what its exclusion takes.
    let add = |sums: &mut [f64; 2], solution: &Solution| {
        let excluded = solution.excluded.count() as f64;
        sums[0] += solution.chi2 + excluded * EXCLUDED_CHI2;
        sums[1] += solution.redundancy as f64 + 2.0 * excluded;
    };
    for row in rows.iter().step_by(every) {
        if solver.as_ref().is_none_or(|(frames, _)| *frames != row.frames) {
            let noise = noise.map(|noise| noise.averaged(row.frames));
            solver = Some((row.frames, Solver::new(&Scene { noise, uncertainty, ..scene.clone() }, TIER)?));
        }
        let Some((_, solver)) = &solver else { continue };
        let solve = |left_out: Option<usize>, start: Start<'_>| {
            let mut readings = row.photocurrents();
            if let Some(cell) = left_out {
                readings.cells[cell] = Reading::Missing;
            }
            let solution = solver.solve(&readings, start, &MotionPrior::AT_REST);
            // A reading that the solver leaves out tells most of all.
            let pose: Option<Pose> = solution.estimate.map(|estimate| estimate.pose);
            pose.filter(|_| solution.redundancy > 0).map(|pose| (pose, solution))
        };
        let Some((pose, solution)) = solve(None, Start::Cold) else { continue };
        used += 1;
        add(&mut sums, &solution);
        for cell in 0..count {
            let (Some(found), Some((pose, solution))) = (row.readings[cell], solve(Some(cell), Start::Near(&pose)))
            else {
                continue;
            };
            add(&mut without[cell], &solution);
            let half_length_m = 0.5 * scene.cells[cell].detector.length_m;
            let ([relative, position], _) = deviation(solver.plan(), cell, &pose, found, half_length_m);
            let cell = &mut cells[cell];
            cell.readings += 1;
            cell.relative += relative;
            cell.position_m += position;
            cell.rms_position_m += position * position;
        }
    }
    for (cell, [chi2, redundancy]) in cells.iter_mut().zip(without) {
        let readings = cell.readings.max(1) as f64;
        cell.relative /= readings;
        cell.position_m /= readings;
        cell.rms_position_m = (cell.rms_position_m / readings).sqrt();
        cell.without = chi2 / f64::max(redundancy, 1.0);
    }
    let mut light_level = 0.0;
    if uncertainty.light_level_relative > 0.0 {
        let mut sorted: Vec<f64> = cells.iter().map(|cell| cell.relative).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        light_level = 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]);
        cells.iter_mut().for_each(|cell| cell.relative -= light_level);
    }
    let chi2 = sums[0] / sums[1].max(1.0);
    let allowed = (LEVEL_SIGMAS * scene.uncertainty.light_level_relative).max(KNOWN_LEVEL);
    let allows_level = light_level.abs() <= allowed;
    let is_valid = (used >= MIN_ROWS).then_some(chi2 < STALE && allows_level);
    // Where one cell contradicts the others, rows without another one often have no pose that tells anything.
    let is_judged = |cell: &usize| 2 * cells[*cell].readings > used;
    let best = (0..count).filter(is_judged).min_by(|&a, &b| cells[a].without.total_cmp(&cells[b].without));
    let changed = best.filter(|&cell| {
        is_valid.is_some()
            && chi2 >= STALE
            && chi2 - cells[cell].without > BLAMED * (chi2 - 1.0)
            && cells[cell].without < STALE
    });
    Ok(Validity { rows: used, chi2, light_level, allows_level, cells, is_valid, changed })
}

/// What a cell that a solver excluded adds to χ² at least: its threshold is about that.
const EXCLUDED_CHI2: f64 = 25.0;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};
    use slitpose_head::scene_file::WIDE;

    /// Light's shot noise divides as its light does and moves no spot; what the resistance drives out of one electrode
    /// comes in by the other, and adds nothing to the sum.
    #[test]
    fn each_kind_of_noise_acts_where_its_physics_says() {
        let cell = &WIDE.read().unwrap().scene.cells[0];
        let noise = Noise { shot_bandwidth_hz: 1e4, johnson_bandwidth_hz: 1e4, temperature_k: 300.0, adc_a: 0.0 };
        let pair = [1e-6, 3e-6];
        let variances = |noise: Noise| {
            let [a, b, c] = ReadingNoise::new(Some(&noise), cell).covariance(pair, 1.0, &ModelError::default());
            let [_, [x, y]] = directions(pair, 1.0);
            [a + 2.0 * b + c, x * x * a + 2.0 * x * y * b + y * y * c]
        };
        let light = variances(Noise { temperature_k: 0.0, ..noise });
        // 2·q·I·B of 4 µA in 10 kHz (CODATA 2018), and nothing of the position, but for rounding and the dark current.
        let shot_a2 = 2.0 * 1.602_176_634e-19 * (4e-6 + cell.detector.dark_current_a) * 1e4;
        assert!((light[0] / shot_a2 - 1.0).abs() < 0.01, "{light:?} {shot_a2}");
        let shot_of_one = 1.602_176_634e-19 * 2.0 * 1e4 / 4e-6;
        assert!(light[1] < 0.01 * shot_of_one, "{light:?}");
        let resistance = variances(Noise { shot_bandwidth_hz: 0.0, ..noise });
        assert!(resistance[0] < 0.01 * shot_a2, "{resistance:?}");
        // 4·k·T·B/R on either electrode, against each other: the position moves by twice it over the sum.
        let johnson_a = (4.0 * 1.380_649e-23 * 300.0 * 1e4 / cell.detector.interelectrode_ohm.unwrap()).sqrt();
        let expected = (2.0 * johnson_a / 4e-6).powi(2);
        assert!((resistance[1] / expected - 1.0).abs() < 0.02, "{resistance:?} {expected}");
    }

    #[test]
    fn noise_is_measured_whatever_the_motion_and_single_outliers() {
        const SEED: u64 = 3;
        println!("seed {SEED}");
        let scene = WIDE.read().unwrap().scene;
        let noise = Noise { shot_bandwidth_hz: 1.0, johnson_bandwidth_hz: 1.0, temperature_k: 300.0, adc_a: 1.8e-9 };
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        for ratio in [1.0, 2.5] {
            let scatter = Normal::new(0.0, ratio * 1.8e-9).unwrap();
            let rows: Vec<Row> = (0..2000)
                .map(|k| {
                    let time_s = f64::from(k) * 2.5e-4;
                    let readings = (0..6).map(|cell| {
                        let swing = 0.5e-6 * (7.0 * time_s + f64::from(cell)).sin();
                        let glitch = if k % 50 == 3 { 1e-6 } else { 0.0 };
                        Some([1.5e-6 + swing + glitch, 1.5e-6 - swing].map(|pure| pure + scatter.sample(&mut rng)))
                    });
                    Row { readings: readings.collect(), time_s: Some([time_s; 2]), ..Row::default() }
                })
                .collect();
            let found = measured_noise(&rows, &scene, &noise).unwrap();
            // The median of 12 000 correlated numbers, a tenth of them with a glitch.
            assert!((0.95..1.15).contains(&(found / ratio)), "{found} of {ratio}");
            assert!(measured_noise(&rows[..100], &scene, &noise).is_none());
        }
    }
}

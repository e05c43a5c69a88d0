//! Covariance of one reading of a cell.

use slitpose_model::{Cell, ModelError, Noise, Scene};

use crate::data::Row;

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
const LEAST_RELATIVE: f64 = 1e-6;

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

    /// Of the mean of `frames` frames, with what the model leaves out.
    pub(crate) fn covariance(&self, pair: [f64; 2], frames: f64, error: &ModelError) -> Covariance {
        let total = (pair[0] + pair[1]).abs().max(f64::MIN_POSITIVE);
        let square = total * total;
        let moved = error.position_m * self.per_length;
        let own =
            self.electrode / frames + error.current_a * error.current_a + LEAST_RELATIVE * LEAST_RELATIVE * square;
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
const LEAST_DIFFERENCES: usize = 1000;

/// Most of them, in time: the noise is then known to a percent.
const MOST_WINDOWS: usize = 20_000;

/// Median of χ² with two degrees of freedom: 2·ln 2.
const MEDIAN: f64 = 2.0 * std::f64::consts::LN_2;

/// Noise of single frames in a row, as a multiple of what `noise` says of the detectors of `scene`; `None`: too few frames
/// follow each other. Motion and single outliers hardly count.
pub fn measured_noise(rows: &[Row], scene: &Scene, noise: &Noise) -> Option<f64> {
    let stated: Vec<ReadingNoise> = scene.cells.iter().map(|cell| ReadingNoise::new(Some(noise), cell)).collect();
    let mut squares = Vec::new();
    for five in rows.windows(DIFFERENCES.len()).step_by(rows.len().div_ceil(MOST_WINDOWS).max(1)) {
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
    if squares.len() < LEAST_DIFFERENCES {
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

/// The whitened pair.
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};
    use slitpose_head::scene_file::WIDE;

    use super::*;
    use crate::data::Knowledge;

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
                    let readings = readings.collect();
                    Row {
                        id: k.to_string(),
                        readings,
                        frames: 1.0,
                        time_s: Some([time_s; 2]),
                        knowledge: Knowledge::Nothing,
                    }
                })
                .collect();
            let found = measured_noise(&rows, &scene, &noise).unwrap();
            // The median of 12 000 correlated numbers, a tenth of them with a glitch.
            assert!((0.95..1.15).contains(&(found / ratio)), "{found} of {ratio}");
            assert!(measured_noise(&rows[..100], &scene, &noise).is_none());
        }
    }
}

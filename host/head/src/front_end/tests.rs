//! The noise of the front end, with each of its sources dominant in turn: compared with arithmetic on
//! physical constants, and with the scatter of simulated scans.

use slitpose_model::{Noise, Reading, Tier};
use slitpose_protocol::{AdcScaling, Command, Configuration, Decoder, Level, MAX_MESSAGE_BYTES, Message, RawScan};

use super::{Stage, board_configuration, configuration, dark_word_noise_a};
use crate::scene_file::{FrontEnd, SceneFile, WIDE};
use crate::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

/// The charge of an electron, coulomb, and Boltzmann's constant, joule per kelvin (CODATA 2018; exact).
const CHARGE_C: f64 = 1.602_176_634e-19;
const BOLTZMANN_J_PER_K: f64 = 1.380_649e-23;

/// Small beside the time between conversions, so that their noise is independent.
const FAST_S: f64 = 10e-9;

/// `wide` with a fast front end of 14 bits and next to no noise but that of light, changed by `change`.
fn wide(change: impl Fn(&mut SceneFile, &mut FrontEnd)) -> SceneFile {
    let mut file = WIDE.read().expect("shipped");
    let mut front_end = FrontEnd {
        adc_bits: 14,
        raw_noise_lsb: 0.5,
        oversampling: 4,
        time_constant_s: FAST_S,
        ..file.front_end.expect("the default scene has one")
    };
    file.scene.cells.iter_mut().for_each(|cell| cell.detector.interelectrode_ohm = None);
    change(&mut file, &mut front_end);
    file.front_end = Some(front_end);
    file
}

/// Pairs of a cell, one a scan: currents above dark, and the words of the dark slot in amperes.
#[derive(Default)]
struct Samples {
    light_a: Vec<[f64; 2]>,
    dark_a: Vec<[f64; 2]>,
}

/// Samples of each cell from a simulated board with the head of `file` and a tool at rest, and the noise
/// given to the solver.
fn simulated(file: &SceneFile, scans: usize, seed: u64) -> (Vec<Samples>, Noise, Vec<f64>) {
    let mut board =
        SimulatedBoard::new(file, Trajectory::of_kind(TrajectoryKind::Still, 0, 1.0), Tier::Paper, seed).expect("runs");
    let mut bytes = Vec::new();
    board.transmit(&mut bytes);
    board.ask(1, Command::Start);
    (0..scans).for_each(|_| board.step(&mut bytes));

    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let mut rest = bytes.as_slice();
    let schedule = configuration(file).expect("a front end").schedule;
    let mut scaling = None;
    let mut samples: Vec<Samples> = file.scene.cells.iter().map(|_| Samples::default()).collect();
    while let Some(message) = decoder.next::<Message>(&mut rest) {
        match message.expect("undamaged") {
            Message::Hello(hello) => scaling = Some(hello.scaling),
            Message::Batch(batch) => {
                let scaling = scaling.as_ref().expect("a hello comes first");
                let stage = Stage::new(file, &schedule, scaling);
                for scan in batch.scans(&schedule).expect("of this schedule") {
                    for (samples, reading) in samples.iter_mut().zip(stage.photocurrents(&scan).cells) {
                        let Reading::Light(pair) = reading else { panic!("{reading:?}") };
                        samples.light_a.push([pair.i_x1_a, pair.i_x2_a]);
                    }
                    let step_a = scaling.amperes_per_code / f64::from(schedule.oversampling);
                    for (samples, words) in samples.iter_mut().zip(scan.dark().into_iter().flatten()) {
                        samples.dark_a.push(words.map(|word| f64::from(word) * step_a));
                    }
                }
            }
            _ => {}
        }
    }
    let scaling = scaling.expect("a hello");
    let promised =
        (0..samples.len()).map(|cell| dark_word_noise_a(file, cell, &schedule, &scaling).expect("a front end"));
    let promised = promised.collect();
    let noise = Stage::weighted_scene(file, &schedule, &scaling).noise.expect("a front end");
    (samples, noise, promised)
}

fn moments(pairs: &[[f64; 2]]) -> ([f64; 2], [[f64; 2]; 2]) {
    let mean_of = |value: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(value).sum::<f64>() / pairs.len() as f64;
    let mean = [0, 1].map(|k| mean_of(&|pair| pair[k]));
    let covariance = [0, 1].map(|i| [0, 1].map(|j| mean_of(&|pair| (pair[i] - mean[i]) * (pair[j] - mean[j]))));
    (mean, covariance)
}

/// The covariance of a cell's two currents (PHYSICS.md, section 2): shot noise of a point-like spot is
/// common and divides like the current, and that of the dark current is also in the dark word; Johnson
/// current flows from one electrode into the other; converter noise is independent.
fn covariance(file: &SceneFile, cell: usize, noise: &Noise, mean: [f64; 2]) -> [[f64; 2]; 2] {
    let detector = &file.scene.cells[cell].detector;
    let total_a = mean[0] + mean[1];
    let light_a2 = 2.0 * CHARGE_C * noise.shot_bandwidth_hz * total_a;
    let dark_a2 = 2.0 * CHARGE_C * noise.johnson_bandwidth_hz * detector.dark_current_a;
    let johnson_a2 = detector
        .interelectrode_ohm
        .map_or(0.0, |ohm| 4.0 * BOLTZMANN_J_PER_K * noise.temperature_k * noise.johnson_bandwidth_hz / ohm);
    [0, 1].map(|i| {
        [0, 1].map(|j| {
            let (own, sign) = if i == j { (noise.adc_a * noise.adc_a, 1.0) } else { (0.0, -1.0) };
            own + sign * johnson_a2 + (light_a2 + dark_a2) * mean[i] * mean[j] / (total_a * total_a)
        })
    })
}

/// Every source in turn makes nearly all of the noise, but never more than a quarter of the 64 codes that
/// zero current keeps clear of the converter's end. Measured covariances, with the expected one
/// taken out by whitening, are the unit matrix: of 6 · 3 000 pairs a variance has a standard deviation
/// of √(2/18 000) = 1.1 %, and 6 % is five of these and the rounding of faint noise. A source that is
/// twice or half as strong as it should be is off by most of 100 %.
#[test]
fn simulated_noise_is_what_the_solver_takes_it_for() {
    const SCANS: usize = 3_000;
    let off_centre = |file: &mut SceneFile, mm: f64| {
        for cell in &mut file.scene.cells {
            cell.emitter.position_tool_m += 1e-3 * mm * cell.detector.x_axis_base;
        }
    };
    let regimes = [
        ("converter", wide(|_, front_end| (front_end.raw_noise_lsb, front_end.time_constant_s) = (8.0, 0.5e-6))),
        ("rounding", wide(|_, front_end| (front_end.adc_bits, front_end.time_constant_s) = (9, 0.5e-6))),
        ("shot, spots in the middle", wide(|_, _| {})),
        ("shot, spots aside", wide(|file, _| off_centre(file, 2.0))),
        (
            "shot of the dark current",
            wide(|file, front_end| {
                file.scene.cells.iter_mut().for_each(|cell| {
                    cell.detector.dark_current_a = 8e-6;
                    cell.emitter.radiant_intensity_w_per_sr *= 0.3;
                });
                front_end.full_scale_a = 12e-6;
            }),
        ),
        (
            "Johnson",
            wide(|file, _| {
                file.scene.cells.iter_mut().for_each(|cell| cell.detector.interelectrode_ohm = Some(5e3));
            }),
        ),
        (
            "Johnson, averaged by the low-pass",
            wide(|file, front_end| {
                file.scene.cells.iter_mut().for_each(|cell| cell.detector.interelectrode_ohm = Some(50.0));
                front_end.time_constant_s = 1.36e-6;
            }),
        ),
    ];
    for (seed, (name, file)) in (70..).zip(&regimes) {
        let (samples, noise, promised) = simulated(file, SCANS, seed);
        let (mut light, mut dark) = ([[0.0; 2]; 2], 0.0);
        for (cell, of_cell) in samples.iter().enumerate() {
            let (mean, measured) = moments(&of_cell.light_a);
            let whitened = whitened(measured, covariance(file, cell, &noise, mean));
            for (sum, part) in light.iter_mut().flatten().zip(whitened.as_flattened()) {
                *sum += part / samples.len() as f64;
            }
            let (_, [[first, _], [_, second]]) = moments(&of_cell.dark_a);
            dark += 0.5 * (first + second) / (promised[cell] * promised[cell]) / samples.len() as f64;
        }
        println!("{name}, seed {seed}: {light:?}, dark {dark}");
        for (i, row) in light.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                assert!((entry - f64::from(u8::from(i == j))).abs() < 0.06, "{name}, {i} {j}: {light:?}");
            }
        }
        assert!((dark - 1.0).abs() < 0.06, "{name}: dark words have {dark} of the variance promised");
    }
}

/// L⁻¹·measured·L⁻ᵀ with expected = L·Lᵀ.
fn whitened(measured: [[f64; 2]; 2], expected: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let l00 = expected[0][0].sqrt();
    let l10 = expected[1][0] / l00;
    let l11 = (expected[1][1] - l10 * l10).sqrt();
    let inverse = [[1.0 / l00, 0.0], [-l10 / (l00 * l11), 1.0 / l11]];
    let product = |i: usize, j: usize| -> f64 {
        (0..4).map(|n| inverse[i][n / 2] * measured[n / 2][n % 2] * inverse[j][n % 2]).sum()
    };
    [0, 1].map(|i| [0, 1].map(|j| product(i, j)))
}

/// Sampled before it has settled, a current is divided by the gain, and its noise with it. All cells
/// are weighed by the one that settles least, the first in each slot: for it the noise is right, and
/// for the others, sampled long after, too large by gain².
#[test]
fn a_front_end_that_has_not_settled_has_the_noise_of_its_slowest_cell() {
    const SCANS: usize = 6_000;
    // One conversion a word, 51 ns (1.02 τ) after the light goes on; the next cell's is 17 τ later.
    let slow = |ohm| {
        move |file: &mut SceneFile, front_end: &mut FrontEnd| {
            file.scene.cells.iter_mut().for_each(|cell| cell.detector.interelectrode_ohm = ohm);
            (front_end.oversampling, front_end.settling_s, front_end.time_constant_s) = (1, 51e-9, 50e-9);
        }
    };
    let converter = wide(|file, front_end| {
        slow(None)(file, front_end);
        (front_end.adc_bits, front_end.raw_noise_lsb) = (12, 8.0);
    });
    let gain = 1.0 - (-9.0 / 170e6 / 50e-9_f64).exp();
    for (seed, (name, file)) in (80..).zip([("converter", converter), ("Johnson", wide(slow(Some(2.2e3))))]) {
        let (samples, noise, _) = simulated(&file, SCANS, seed);
        for (cell, samples) in samples.iter().enumerate() {
            let (mean, measured) = moments(&samples.light_a);
            let expected_a2 = covariance(&file, cell, &noise, mean);
            let expected = if cell == 0 { 1.0 } else { gain * gain };
            for electrode in 0..2 {
                let variance = measured[electrode][electrode] / expected_a2[electrode][electrode];
                println!("{name}, seed {seed}, cell {cell}: {variance}, expected {expected}");
                // Five times √(2/6 000), 1.8 %.
                assert!((variance / expected - 1.0).abs() < 0.1, "{name}, cell {cell}: {variance}, not {expected}");
            }
        }
    }
}

/// By hand, for one conversion through 1 µs (250 kHz of noise bandwidth) at 330 K, 50 kΩ and
/// 200 nA of dark current.
#[test]
fn noise_of_one_conversion_by_hand() {
    let mut file = wide(|file, front_end| {
        let detectors = file.scene.cells.iter_mut().map(|cell| &mut cell.detector);
        detectors.for_each(|detector| (detector.interelectrode_ohm, detector.dark_current_a) = (Some(50e3), 200e-9));
        file.scene.noise.as_mut().expect("the default scene tells one").temperature_k = 330.0;
        (front_end.oversampling, front_end.time_constant_s, front_end.raw_noise_lsb) = (1, 1e-6, 2.0);
    });
    let scaling = AdcScaling { zero_code: 4031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };
    // Words with light or without; 13 µs leave 2 ppm of the light to come.
    for (words, name) in [(2.0, "lit minus dark"), (1.0, "lit, no dark slot")] {
        let schedule = configuration(&file).expect("a front end").schedule;
        let noise = Stage::weighted_scene(&file, &schedule, &scaling).noise.expect("a front end");
        let detector = &file.scene.cells[0].detector;
        let found =
            [noise.shot_a(), noise.dark_shot_a2(detector), noise.johnson_a2(detector), noise.adc_a * noise.adc_a];
        // 2 · 1.602e-19 C · 250 kHz, the same with 200 nA; 4 · 1.381e-23 J/K · 330 K · 250 kHz / 50 kΩ; 2² + 1/12 steps².
        let expected =
            [8.010_883e-14, words * 1.602_177e-20, words * 9.112_283e-20, words * 4.083_333 * 2.5e-9 * 2.5e-9];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-5, "{name}: {found:e}, not {expected:e}");
        }
        file.lighting.slots.retain(|slot| !slot.is_empty());
    }
}

#[test]
fn a_word_that_tells_no_current_gives_none() {
    let file = wide(|_, _| {});
    let scaling = AdcScaling { zero_code: 4031.0, amperes_per_code: -2.5e-9, bits: 12, saturation_code: 32 };
    let schedule = configuration(&file).expect("a front end").schedule;
    let mut scan = RawScan::new(6, true);
    scan.levels_mut().fill(Level::NOMINAL);
    scan.lit_mut().fill([8_000; 2]);
    scan.dark_mut().expect("a dark slot").fill([16_000; 2]);
    scan.levels_mut()[1] = Level(0);
    scan.levels_mut()[2] = Level(0x4000);
    // Code 32 in each of four conversions, of either electrode, is the first that cannot be relied on.
    (scan.lit_mut()[3], scan.lit_mut()[4], scan.lit_mut()[5]) = ([128, 8_000], [8_000, 128], [129; 2]);
    let readings = Stage::new(&file, &schedule, &scaling).photocurrents(&scan).cells;
    // 8 000 of a sum of four are 2 000 codes of 2.5 nA; at half the level it stands for twice that.
    for (cell, current_a) in [(0, 5e-6), (2, 10e-6), (5, 15_871.0 / 4.0 * 2.5e-9)] {
        let Reading::Light(pair) = readings[cell] else { panic!("{:?}", readings[cell]) };
        assert!((pair.i_x1_a / current_a - 1.0).abs() < 1e-9 && pair.i_x1_a == pair.i_x2_a, "{cell}: {pair:?}");
    }
    assert!(matches!(readings[1], Reading::Missing));
    assert!([3, 4].iter().all(|&cell| matches!(readings[cell], Reading::Saturated)));

    // Without dark words the scene says what there is in the dark: half of 200 nA an electrode, whatever
    // the level. Zero current is code 4031, and 8 000 of a sum of four code 2000.
    let mut file = wide(|file, _| file.scene.cells[0].detector.dark_current_a = 200e-9);
    file.lighting.slots.retain(|slot| !slot.is_empty());
    let schedule = configuration(&file).expect("a front end").schedule;
    let mut scan = RawScan::new(6, false);
    scan.levels_mut().fill(Level(0x4000));
    scan.lit_mut().fill([8_000; 2]);
    let Reading::Light(pair) = Stage::new(&file, &schedule, &scaling).photocurrents(&scan).cells[0] else { panic!() };
    let expected_a = (2_031.0 * 2.5e-9 - 100e-9) / 0.5;
    assert!((pair.i_x1_a / expected_a - 1.0).abs() < 1e-9, "{pair:?}");
}

#[test]
fn the_default_scene_runs_at_4_khz_with_a_third_of_the_frame_idle() {
    let Configuration { schedule, levels, .. } = configuration(&WIDE.read().unwrap()).unwrap();
    assert_eq!(schedule.frame_rate_hz(), 4000.0);
    assert_eq!((schedule.slots.len(), levels.len(), schedule.words_per_scan()), (3, 6, 24));
    let busy = 3.0 * f64::from(schedule.slot_ticks) / f64::from(schedule.frame_ticks);
    assert!((0.5..0.67).contains(&busy), "{busy}");
}

#[test]
fn a_board_whose_words_are_too_narrow_is_refused_but_not_its_noise() {
    let mut file = WIDE.read().unwrap();
    // 4 · 16 383 = 65 532 fits 16 bits, 4 · 32 767 does not; one conversion of 16 bits does.
    for (bits, oversampling, fits) in [(12, 16, true), (14, 4, true), (15, 4, false), (16, 1, true), (16, 2, false)] {
        let front_end = file.front_end.as_mut().unwrap();
        (front_end.adc_bits, front_end.oversampling, front_end.frame_rate_hz) = (bits, oversampling, 1000.0);
        assert!(configuration(&file).is_ok());
        match board_configuration(&file) {
            Ok(_) => assert!(fits, "{bits}, {oversampling}"),
            Err(error) => assert!(!fits && error.to_string().contains(&format!("{bits} bits")), "{error}"),
        }
    }
}

#[test]
fn a_schedule_that_does_not_fit_is_refused() {
    let mut file = WIDE.read().unwrap();
    file.front_end.as_mut().unwrap().frame_rate_hz = 8000.0;
    let refused = configuration(&file).unwrap_err().to_string();
    for part in
        ["wide:", "3 slots of 54.8 µs take 164.3 µs, the frame period is 125.0 µs", "lower front_end.frame_rate_hz"]
    {
        assert!(refused.contains(part), "`{part}` is not in: {refused}");
    }
    file.front_end.as_mut().unwrap().oversampling = 32;
    assert!(configuration(&file).unwrap_err().to_string().contains("32"));
    file.front_end = None;
    assert!(configuration(&file).unwrap_err().to_string().contains("[front_end]"));
}

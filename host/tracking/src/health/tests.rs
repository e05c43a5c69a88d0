//! Measurements of a head against the values expected from its electronics and its light.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use slitpose_model::{Tier, Tracker};
use slitpose_protocol::{
    Command, Decoder, Hello, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, RawScan, Request, encode,
};

use super::window::CellSums;
use super::*;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

/// Frames a second: a quarter of the shipped rate, and so a quarter of the work.
const FRAME_RATE: usize = 1000;

/// Scans of a second and a half: the health covers the last second.
const SCANS: usize = 3 * FRAME_RATE / 2;

fn wide() -> SceneFile {
    let mut file = WIDE.read().unwrap();
    file.front_end.as_mut().unwrap().frame_rate_hz = FRAME_RATE as f64;
    file
}

/// The scans that a board with the head of `file` takes, its schedule, and its scaling.
fn scans(file: &SceneFile, kind: TrajectoryKind, count: usize) -> (Vec<RawScan>, Schedule, AdcScaling) {
    let trajectory = Trajectory::of_kind(kind, 5, 3.0);
    let mut board = SimulatedBoard::new(file, trajectory, Tier::Paper, 6).unwrap();
    let configuration = front_end::configuration(file).unwrap();
    let mut buffer = [0; MAX_REQUEST_BYTES];
    for (number, command) in [(1, Command::Configure(configuration)), (2, Command::Start)] {
        board.write(encode(&Request { number, command }, &mut buffer).unwrap());
    }
    let (mut scans, mut line, mut hello) = (Vec::new(), Vec::new(), None);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    while scans.len() < count {
        line.clear();
        board.step(&mut line);
        let mut bytes = &line[..];
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            match message.unwrap() {
                Message::Hello(Hello { schedule, scaling, .. }) => hello = Some((schedule, scaling)),
                Message::Batch(batch) => scans.extend(batch.scans(&hello.as_ref().unwrap().0).unwrap()),
                _ => {}
            }
        }
    }
    let (schedule, scaling) = hello.unwrap();
    (scans, schedule, scaling)
}

/// The final health of the head of `board`, with the scene of `file`; `edit` changes each scan.
fn watched(
    board: &SceneFile,
    file: &SceneFile,
    kind: TrajectoryKind,
    count: usize,
    edit: impl Fn(&mut RawScan),
) -> HeadHealth {
    watched_as(board, file, kind, count, edit, |health| health)
}

/// The same, with a monitor that `with` prepares.
fn watched_as(
    board: &SceneFile,
    file: &SceneFile,
    kind: TrajectoryKind,
    count: usize,
    edit: impl Fn(&mut RawScan),
    with: impl Fn(Health) -> Health,
) -> HeadHealth {
    let (scans, schedule, scaling) = scans(board, kind, count);
    let stage = Stage::new(file, &schedule, &scaling);
    let scene = Stage::weighted_scene(file, &schedule, &scaling);
    let solver = Solver::new(&scene, Tier::Paper).unwrap().with_exposures(&stage.exposures_s());
    let mut tracker: Tracker<f64> = Tracker::new(solver, schedule.frame_rate_hz().recip());
    let mut health = with(Health::new(file, Tier::Paper, &schedule, &scaling).unwrap());
    for mut scan in scans {
        edit(&mut scan);
        let photocurrents = stage.photocurrents(&scan);
        let solution = tracker.track(scan.sequence, &photocurrents).solution;
        health.update(&scan, &photocurrents, &solution);
    }
    health.report()
}

#[test]
fn dark_current_is_no_light() {
    let mut file = wide();
    // A warm detector: some 4 % of the light at home, twenty times the error of the mean over a second.
    for cell in &mut file.scene.cells {
        cell.detector.dark_current_a = 300e-9;
    }
    let health = watched(&file, &file, TrajectoryKind::Smooth, SCANS, |_| {});
    assert!(health.findings.is_empty(), "{:?}", health.findings);
    for cell in &health.cells {
        let brightness = cell.brightness.unwrap();
        assert!((brightness - 1.0).abs() < 2e-3, "cell {}: {brightness}", cell.cell);
        // It includes the board's offset, a step of a word, but not the scene's dark current.
        let stray_a = cell.stray_a.unwrap();
        assert!(stray_a.abs() < 3e-9, "cell {}: {stray_a}", cell.cell);
    }
}

#[test]
fn a_slit_that_has_moved_makes_a_calibration_stale() {
    let calibrated = wide();
    let see =
        |board: &SceneFile| watched_as(board, &calibrated, TrajectoryKind::Smooth, SCANS, |_| {}, Health::calibrated);
    let healthy = see(&calibrated);
    assert!(healthy.findings.is_empty(), "{:?}", healthy.findings);
    let mut knocked = wide();
    knocked.scene.cells[2].slit.offset_m.x += 20e-6;
    let health = see(&knocked);
    let [Diagnosis { fault: Fault::CalibrationStale { cell: 2, shift_m, chi2 }, finding }] = &health.findings[..]
    else {
        panic!("{:?}", health.findings)
    };
    // The others hold the pose: most of the shift stays visible, and is enlarged by slit and emitter as a pinhole does.
    assert!((5e-6..60e-6).contains(&shift_m.abs()) && *chi2 > 2.5, "{shift_m} {chi2}");
    assert!(finding.to_string().contains("calibration_stale") && finding.to_string().contains("cell 2"), "{finding}");
}

#[test]
fn noise_is_told_in_steps_of_one_conversion() {
    let file = wide();
    let front_end = file.front_end.unwrap();
    assert_eq!((front_end.raw_noise_lsb, front_end.oversampling), (1.0, 4));
    let health = watched(&file, &file, TrajectoryKind::Still, SCANS, |_| {});
    for cell in &health.cells {
        // The mean of four conversions of one step each; rounding of each adds a twelfth of its square. σ of 1000
        // words is known to 3 %.
        let expected = ((1.0 + 1.0 / 12.0) / 4.0_f64).sqrt();
        let noise_lsb = cell.noise_lsb.unwrap();
        assert!((noise_lsb / expected - 1.0).abs() < 0.1, "cell {}: {noise_lsb}", cell.cell);
        // Full scale is the top code of 12 bits, 64 codes of which lie below zero current.
        let step_a = front_end.full_scale_a / (4095.0 - 64.0);
        assert!((cell.noise_a.unwrap() / (noise_lsb * step_a) - 1.0).abs() < 1e-3, "{cell:?}");
    }
}

#[test]
fn scans_without_one_cell_are_scans_that_the_scene_does_not_explain() {
    let file = wide();
    let health = watched(&file, &file, TrajectoryKind::Smooth, SCANS, |scan| {
        let dark = scan.dark().unwrap()[0];
        for (lit, dark) in scan.lit_mut()[0].iter_mut().zip(dark) {
            *lit = (f64::from(dark) + 0.7 * (f64::from(*lit) - f64::from(dark))).round() as u16;
        }
    });
    assert!(health.cells[0].shares.excluded > 0.9, "{health:?}");
    assert!(health.unexplained > 0.9, "{}", health.unexplained);
}

#[test]
fn exchanged_cells_are_exposed_in_each_others_slots() {
    // Slots so long that the tool moves tens of σ within one.
    let mut file = wide();
    file.front_end.as_mut().unwrap().settling_s = 180e-6;
    let mut board = file.clone();
    board.scene.cells.swap(0, 1);
    let health = watched(&board, &file, TrajectoryKind::Fast, 2 * FRAME_RATE, |_| {});
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::Exchange(Exchange::Cells { cells: [0, 1] })], "{:?}", health.findings);
}

#[test]
fn a_rise_of_stray_light_scatters_by_its_sigma() {
    const SEED: u64 = 8;
    const TRIALS: usize = 400;
    const WORDS: usize = 250;
    println!("seed {SEED}");
    let file = wide();
    let (_, schedule, scaling) = scans(&file, TrajectoryKind::Still, 1);
    let mut health = Health::new(&file, Tier::Paper, &schedule, &scaling).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let noise = Normal::new(0.0, 7.0).unwrap();
    let mut second = |mean: f64| {
        let (mut sums, mut before) = (CellSums::default(), None);
        for _ in 0..WORDS {
            let words: [u16; 2] =
                std::array::from_fn(|_| (mean + noise.sample(&mut rng) + rng.random::<f64>() - 0.5).round() as u16);
            sums.dark.add_words(words, before.replace(words));
        }
        sums
    };
    let mut squares = 0.0;
    for _ in 0..TRIALS {
        let mut start = Bucket::default();
        start.cells[2] = second(16_000.0);
        health.start = Some(start);
        let (rise_a, sigma_a) = health.rise(2, &second(16_000.0)).unwrap();
        squares += (rise_a / sigma_a).powi(2);
    }
    // χ² of 400 degrees of freedom over 400: 1 ± 0.07.
    let scatter = squares / TRIALS as f64;
    assert!((0.75..1.3).contains(&scatter), "{scatter}");
}

//! What is wrong with a head is named, nothing is said of a healthy one, and measurements have the values expected from
//! its electronics and its light.

use std::io::Write;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use slitpose_model::{Tier, Tracker};
use slitpose_protocol::{Command, Decoder, Hello, MAX_MESSAGE_BYTES, Message, RawScan};

use super::window::CellSums;
use super::*;
use slitpose_head::faults::{Faults, Injector};
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};

/// Frames a second: a quarter of the shipped rate. What is said rests on a second of scans, however many these are.
const FRAME_RATE: usize = 1000;

/// In the paper tier dark current moves the position, as printed there, and not on boards.
const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

fn wide() -> SceneFile {
    let mut file = WIDE.read().unwrap();
    file.front_end.as_mut().unwrap().frame_rate_hz = FRAME_RATE as f64;
    file
}

/// The scans that a board with the head of `file` sends, with `faults` injected; its schedule, and its scaling.
fn scans(
    file: &SceneFile,
    trajectory: Trajectory,
    count: usize,
    faults: &[&str],
) -> (Vec<RawScan>, Schedule, AdcScaling) {
    let mut board = SimulatedBoard::new(file, trajectory, TIER, 61).unwrap();
    board.ask(1, Command::Start);
    let faults = faults.iter().map(|text| text.parse().unwrap()).collect();
    let mut injector = Injector::of_recording(&Faults::new(faults, file.scene.cells.len()).unwrap());
    let (mut scans, mut hello) = (Vec::new(), None);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    while scans.len() < count {
        let (mut sent, mut received) = (Vec::new(), Vec::new());
        board.step(&mut sent);
        match &mut injector {
            Some(injector) => drop(injector.push(&sent, &mut received)),
            None => received = sent,
        }
        let mut bytes = &received[..];
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

/// A board in front of a host.
struct Watch<'a> {
    /// The head that the board has, and the one that the host takes it for.
    board: &'a SceneFile,
    file: &'a SceneFile,
    trajectory: Trajectory,
    scans: usize,
    faults: &'a [&'a str],
    is_calibrated: bool,
}

impl<'a> Watch<'a> {
    /// The head of `file`, for three seconds: the first is not judged.
    fn of(file: &'a SceneFile, kind: TrajectoryKind) -> Self {
        let trajectory = Trajectory::of_kind(kind, 62, 3.0);
        Self { board: file, file, trajectory, scans: 3 * FRAME_RATE, faults: &[], is_calibrated: false }
    }

    /// Passes on what is said every quarter of a second.
    fn run(self, mut take: impl FnMut(&HeadHealth)) {
        let (scans, schedule, scaling) = scans(self.board, self.trajectory, self.scans, self.faults);
        let stage = Stage::new(self.file, &schedule, &scaling);
        let scene = Stage::weighted_scene(self.file, &schedule, &scaling);
        let solver = Solver::new(&scene, TIER).unwrap().with_exposures(&stage.exposures_s());
        let mut tracker: Tracker<f64> = Tracker::new(solver, schedule.frame_rate_hz().recip());
        let mut health = Health::new(self.file, TIER, &schedule, &scaling, self.is_calibrated).unwrap();
        for (number, scan) in (1..).zip(&scans[..self.scans]) {
            let photocurrents = stage.photocurrents(scan);
            let solution = tracker.track(scan.sequence, &photocurrents).solution;
            health.update(scan, &photocurrents, &solution);
            if number % (FRAME_RATE / 4) == 0 {
                take(&health.report());
            }
        }
    }

    /// What is said in the end.
    fn last(self) -> HeadHealth {
        let mut last = HeadHealth::default();
        self.run(|health| last = health.clone());
        last.findings.iter().for_each(|finding| println!("{finding:?}"));
        last
    }
}

/// What is said in the end of a head that moves smoothly, with `faults`.
fn smooth(faults: &[&str]) -> HeadHealth {
    Watch { faults, ..Watch::of(&wide(), TrajectoryKind::Smooth) }.last()
}

fn faults(health: &HeadHealth) -> Vec<Fault> {
    health.findings.iter().map(|finding| finding.fault).collect()
}

/// That the only finding is `verdict` on `cell`.
#[track_caller]
fn assert_only(health: &HeadHealth, cell: usize, verdict: Verdict) {
    assert_eq!(faults(health), [Fault::Cell { cell, verdict }]);
    for other in &health.cells {
        assert_eq!(other.verdict, if other.cell == cell { verdict } else { Verdict::Ok }, "cell {}", other.cell);
    }
}

/// A path along the edges of the box of poses that the scene is meant for, a third of a second each.
fn around_the_workspace() -> Trajectory {
    let mut table = tempfile::NamedTempFile::new().unwrap();
    writeln!(table, "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad").unwrap();
    writeln!(table, "0,0,0,0,0,0,0").unwrap();
    // A Gray code passes all 64 corners of the box of six coordinates, one coordinate at a time.
    for step in 0..=64_u32 {
        let gray = (step % 64) ^ ((step % 64) >> 1);
        let side = |axis: u32| if gray >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let (mm, rad) = (4.0, 15.0_f64.to_radians());
        let row: Vec<String> = (0..6).map(|axis| (side(axis) * if axis < 3 { mm } else { rad }).to_string()).collect();
        writeln!(table, "{},{}", 1.0 + f64::from(step) / 3.0, row.join(",")).unwrap();
    }
    Trajectory::from_table(table.path().to_str().unwrap()).unwrap()
}

/// From 20 nA, the most that the data sheet of the default detector allows when it is new, to 200 nA,
/// when it is warm.
fn with_dark_current() -> SceneFile {
    let mut file = wide();
    for (n, cell) in (0..).zip(&mut file.scene.cells) {
        cell.detector.dark_current_a = 20e-9 + 36e-9 * f64::from(n);
    }
    file
}

#[test]
fn a_detector_is_saturated_by_light_and_dark_current_together() {
    let mut file = with_dark_current();
    let light_a = Watch::of(&file, TrajectoryKind::Still).last().cells[5].light_a.unwrap();
    for (margin, verdict) in [(1.5, Verdict::Ok), (0.5, Verdict::Saturated)] {
        let detector = &mut file.scene.cells[5].detector;
        detector.saturation_a = Some(light_a + margin * detector.dark_current_a);
        let health = Watch::of(&file, TrajectoryKind::Still).last();
        assert_eq!(health.cells[5].verdict, verdict, "{margin} dark currents above the light");
    }
}

#[test]
fn a_healthy_head_raises_nothing() {
    let motion = |kind| Trajectory::of_kind(kind, 63, 20.0);
    for (name, file, trajectory) in [
        ("smooth", wide(), motion(TrajectoryKind::Smooth)),
        ("fast", wide(), motion(TrajectoryKind::Fast)),
        ("contact", wide(), motion(TrajectoryKind::Contact)),
        ("around the workspace", wide(), around_the_workspace()),
        ("dark current", with_dark_current(), motion(TrajectoryKind::Smooth)),
    ] {
        let mut findings: Vec<Diagnosis> = Vec::new();
        let mut judged = 0;
        let mut last = HeadHealth::default();
        Watch { trajectory, scans: 20 * FRAME_RATE, ..Watch::of(&file, TrajectoryKind::Still) }.run(|health| {
            judged += usize::from(health.cells.iter().all(|cell| cell.verdict != Verdict::Unknown));
            findings.extend(health.findings.iter().cloned());
            last = health.clone();
        });
        let totals: Vec<_> = last.cells.iter().map(|cell| cell.totals).collect();
        println!("{name}: {} findings in {judged} looks of 20 s; {totals:?}", findings.len());
        assert_eq!(judged, 76, "all but the first second are judged");
        assert!(findings.is_empty(), "{name}: {findings:?}");
        for cell in &last.cells {
            // The model simulates what it expects; noise of a mean of thousands is below a per cent.
            let brightness = cell.brightness.unwrap();
            assert!((brightness - 1.0).abs() < 0.01, "{name}: {brightness}");
            let noise = cell.noise_a.unwrap() / cell.promised_noise_a.unwrap();
            assert!((0.9..1.1).contains(&noise), "{name}: noise {noise} of what is promised");
            // 4 000 means of two words with 0.5 LSB: 0.04 nA.
            let stray_a = cell.stray_a.unwrap();
            assert!(stray_a.abs() < 0.3e-9, "{name}: {stray_a} A of stray light");
        }
    }
}

#[test]
fn each_fault_of_a_cell_is_named() {
    // Every third scan.
    assert_only(&smooth(&["saturate:cell=1,for=1ms,every=3ms"]), 1, Verdict::Saturated);
    // An emitter that has failed.
    assert_only(&smooth(&["occlude:cell=4"]), 4, Verdict::Dark);
    // A loose plug: dark for a quarter of a second every second.
    assert_only(&smooth(&["occlude:cell=4,for=250ms,every=1s"]), 4, Verdict::Dark);
    // Dirt on one slit: 70 % of the light.
    let dirty = smooth(&["dim:cell=0,to=0.7"]);
    assert_only(&dirty, 0, Verdict::Excluded);
    let brightness = dirty.cells[0].brightness.unwrap();
    assert!((brightness - 0.7).abs() < 0.01, "{brightness}");
    assert!(dirty.cells[0].shares.excluded > 0.9 && dirty.unexplained > 0.9, "{dirty:?}");
    // The converter repeats itself from some scan on. Smooth motion: it contradicts, too, and that is why.
    assert_only(&smooth(&["stuck:cell=5,from=25ms"]), 5, Verdict::Stuck);
    // Noise of a bad contact, less than what contradicts the other cells.
    assert_only(&smooth(&["noisy:cell=2,rms=4nA"]), 2, Verdict::Noisy);
}

#[test]
fn stray_light_that_rises_is_told_and_steady_stray_light_is_not() {
    // From the second second on, up to so much on both electrodes of cell 3, in forty steps.
    let rising = |most_na: f64| -> Vec<String> {
        let step = |number: u32| {
            let from_ms = 1000 + 50 * number;
            format!("stray:cell=3,current={}nA,from={from_ms}ms", most_na / 40.0)
        };
        (0..40).map(step).collect()
    };
    let said = |faults: &[String]| smooth(&faults.iter().map(String::as_str).collect::<Vec<_>>());
    // Full scale are 10 µA: 2 %.
    let rising_much = said(&rising(200.0));
    assert_only(&rising_much, 3, Verdict::StrayRising);
    // The mean of the last second, some 1.4 % twice.
    let rise_a = rising_much.cells[3].stray_rise_a.unwrap();
    assert!((0.22e-6..0.4e-6).contains(&rise_a), "{rise_a}");

    let steady = smooth(&["stray:cell=3,current=200nA"]);
    assert!(steady.findings.is_empty(), "{:?}", steady.findings);
    let stray_a = steady.cells[3].stray_a.unwrap();
    assert!((stray_a - 0.4e-6).abs() < 5e-9, "{stray_a}");

    // A third of a per cent is less than an offset drifts.
    let little = said(&rising(30.0));
    assert!(little.findings.is_empty(), "{:?}", little.findings);

    // A lamp that flickers at half the frame rate: some 3 steps of the converter up and down, some six times the noise of a word.
    let flicker = smooth(&["stray:cell=3,current=15nA,for=1ms,every=2ms"]);
    assert_only(&flicker, 3, Verdict::Noisy);
}

#[test]
fn exchanged_electrodes_are_named() {
    // The head looks the same from every second cell, and from the others in a mirror.
    for (cell, kind) in [(0, TrajectoryKind::Smooth), (1, TrajectoryKind::Contact)] {
        let exchanged = format!("swap-electrodes:cell={cell}");
        let health = Watch { faults: &[&exchanged], scans: 2 * FRAME_RATE, ..Watch::of(&wide(), kind) }.last();
        assert_eq!(faults(&health), [Fault::Exchange(Exchange::Electrodes { cell })], "{kind:?}");
        assert_eq!(health.cells[cell].verdict, Verdict::Swapped);
    }
}

#[test]
fn exchanged_cells_are_named() {
    // Neighbours, next but one of either roll, and opposite ones, which share a slot: by symmetry there are no others.
    for (first, second) in [(0, 1), (0, 5), (0, 2), (1, 3), (0, 3)] {
        // On the wrong plugs: lit, and sampled, in each other's slot. Of cells 120 degrees apart neighbours are
        // then lit together, and shine on each other's detectors.
        let (file, mut board) = (wide(), wide());
        board.scene.cells.swap(first, second);
        let watch = Watch::of(&file, TrajectoryKind::Smooth);
        let health = Watch { board: &board, scans: 2 * FRAME_RATE, ..watch }.last();
        assert_eq!(faults(&health), [Fault::Exchange(Exchange::Cells { cells: [first, second] })]);
        assert!([first, second].iter().all(|&cell| health.cells[cell].verdict == Verdict::Swapped));
    }
}

#[test]
fn what_cannot_be_seen_is_not_claimed() {
    // At home every spot is in the middle, and all cells are alike.
    let (file, mut board) = (wide(), wide());
    let still = || Watch { scans: 2 * FRAME_RATE, ..Watch::of(&file, TrajectoryKind::Still) };
    let electrodes = Watch { faults: &["swap-electrodes:cell=3"], ..still() }.last();
    assert!(electrodes.findings.is_empty(), "{:?}", electrodes.findings);
    board.scene.cells.swap(0, 1);
    let cells = Watch { board: &board, ..still() }.last();
    assert!(cells.findings.is_empty(), "{:?}", cells.findings);
}

#[test]
fn a_head_that_is_another_one_is_told_without_a_guess() {
    // Three cells in a ring: no exchange of two explains it.
    let (file, mut board) = (wide(), wide());
    board.scene.cells[..3].rotate_left(1);
    let watch = Watch::of(&file, TrajectoryKind::Smooth);
    assert_eq!(faults(&Watch { board: &board, scans: 2 * FRAME_RATE, ..watch }.last()), [Fault::Unexplained]);
}

#[test]
fn a_tool_that_was_taken_away_is_one_finding() {
    let occluded = [0, 1, 2, 3, 4, 5].map(|cell| format!("occlude:cell={cell}"));
    assert_eq!(faults(&smooth(&occluded.each_ref().map(String::as_str))), [Fault::TooDark]);
}

#[test]
fn a_slit_that_has_moved_makes_a_calibration_stale() {
    let calibrated = wide();
    let see = |board| Watch { board, is_calibrated: true, ..Watch::of(&calibrated, TrajectoryKind::Smooth) }.last();
    let healthy = see(&calibrated);
    assert!(healthy.findings.is_empty(), "{:?}", healthy.findings);
    let mut knocked = wide();
    knocked.scene.cells[2].slit.offset_m.x += 14e-6;
    let health = see(&knocked);
    let [Diagnosis { fault: Fault::CalibrationStale { cell: 2, shift_m, chi2 }, finding }] = &health.findings[..]
    else {
        panic!("{:?}", health.findings)
    };
    // The others hold the pose: most of the shift stays visible, and is enlarged by slit and emitter as a pinhole does.
    assert!((3.5e-6..42e-6).contains(&shift_m.abs()) && *chi2 > 2.5, "{shift_m} {chi2}");
    assert!(finding.to_string().contains("calibration_stale") && finding.to_string().contains("cell 2"), "{finding}");
}

#[test]
fn noise_is_told_in_steps_of_one_conversion() {
    let file = wide();
    let front_end = file.front_end.unwrap();
    assert_eq!((front_end.raw_noise_lsb, front_end.oversampling), (1.0, 8));
    let health = Watch::of(&file, TrajectoryKind::Still).last();
    for cell in &health.cells {
        // The mean of eight conversions of one step each; rounding of each adds a twelfth of its square. σ of 1000
        // words is known to 3 %.
        let expected = ((1.0 + 1.0 / 12.0) / 8.0_f64).sqrt();
        let noise_lsb = cell.noise_lsb.unwrap();
        assert!((noise_lsb / expected - 1.0).abs() < 0.1, "cell {}: {noise_lsb}", cell.cell);
        // Full scale is the top code of 12 bits, 64 codes of which lie below zero current.
        let step_a = front_end.full_scale_a / (4095.0 - 64.0);
        assert!((cell.noise_a.unwrap() / (noise_lsb * step_a) - 1.0).abs() < 1e-3, "{cell:?}");
    }
}

#[test]
fn exchanged_cells_are_exposed_in_each_others_slots() {
    // Slots so long that the tool moves tens of σ within one.
    let mut file = wide();
    file.front_end.as_mut().unwrap().settling_s = 180e-6;
    let mut board = file.clone();
    board.scene.cells.swap(0, 1);
    let health = Watch { board: &board, scans: 2 * FRAME_RATE, ..Watch::of(&file, TrajectoryKind::Fast) }.last();
    assert_eq!(faults(&health), [Fault::Exchange(Exchange::Cells { cells: [0, 1] })], "{:?}", health.findings);
}

#[test]
fn a_rise_of_stray_light_scatters_by_its_sigma() {
    const SEED: u64 = 8;
    const TRIALS: usize = 400;
    const WORDS: usize = 250;
    println!("seed {SEED}");
    let file = wide();
    let (_, schedule, scaling) = scans(&file, Trajectory::of_kind(TrajectoryKind::Still, 1, 1.0), 1, &[]);
    let mut health = Health::new(&file, TIER, &schedule, &scaling, false).unwrap();
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

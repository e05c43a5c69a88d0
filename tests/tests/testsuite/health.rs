//! What is wrong with a head is named, and of a healthy one nothing is said.

use std::io::Write;

use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{Solver, Tier, Tracker};
use slitpose_tests::capture::{capture, decode, with_faults};
use slitpose_tracking::health::{Diagnosis, Exchange, Fault, HeadHealth, Health, Verdict};

/// Frames a second: a quarter of the shipped rate. What is said rests on a second of scans, however many these are.
const FRAME_RATE: usize = 1000;

fn wide() -> SceneFile {
    let mut file = WIDE.read().expect("shipped");
    file.front_end.as_mut().expect("has one").frame_rate_hz = FRAME_RATE as f64;
    file
}

/// Watches the head of `board` over `seconds`, taken for that of `file`; `faults` are injected into its scans, `take`
/// sees what is said every quarter of a second.
fn watch(
    file: &SceneFile,
    board: &SceneFile,
    trajectory: Trajectory,
    seconds: usize,
    faults: &[String],
    mut take: impl FnMut(&HeadHealth),
) {
    let bytes = capture(board, trajectory, Tier::Paper, 61, seconds * FRAME_RATE);
    let decoded = decode(&with_faults(bytes, board.scene.cells.len(), faults));
    let (schedule, scaling) = (&decoded.schedule, &decoded.scaling);
    let stage = Stage::new(file, schedule, scaling);
    let scene = Stage::weighted_scene(file, schedule, scaling);
    let solver = Solver::new(&scene, Tier::Paper).expect("valid").with_exposures(&stage.exposures_s());
    let mut tracker: Tracker<f64> = Tracker::new(solver, schedule.frame_rate_hz().recip());
    let mut health = Health::new(file, Tier::Paper, schedule, scaling).expect("valid");
    for (number, scan) in decoded.scans.into_iter().enumerate() {
        let photocurrents = stage.photocurrents(&scan);
        let solution = tracker.track(scan.sequence, &photocurrents).solution;
        health.update(&scan, &photocurrents, &solution);
        if number % (FRAME_RATE / 4) == FRAME_RATE / 4 - 1 {
            take(&health.report());
        }
    }
}

/// What is said after so many `seconds`: the first is not judged.
fn said_of(board: &SceneFile, kind: TrajectoryKind, seconds: usize, faults: &[&str]) -> HeadHealth {
    let mut last = HeadHealth::default();
    let motion = Trajectory::of_kind(kind, 62, seconds as f64);
    let faults: Vec<String> = faults.iter().map(|&fault| fault.to_owned()).collect();
    watch(&wide(), board, motion, seconds, &faults, |health| last = health.clone());
    last.findings.iter().for_each(|finding| println!("{finding:?}"));
    last
}

/// What is said in the end of a head that moves smoothly, with `faults`.
fn smooth(faults: &[&str]) -> HeadHealth {
    said_of(&wide(), TrajectoryKind::Smooth, 3, faults)
}

/// That the only finding is `verdict` on `cell`.
#[track_caller]
fn assert_only(health: &HeadHealth, cell: usize, verdict: Verdict) {
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::Cell { cell, verdict }]);
    assert_eq!(health.cells[cell].verdict, verdict);
    for other in health.cells.iter().filter(|other| other.cell != cell) {
        assert_eq!(other.verdict, Verdict::Ok, "cell {}", other.cell);
    }
}

/// A path along the edges of the box of poses that the scene is meant for, a third of a second each.
fn around_the_workspace() -> Trajectory {
    let mut table = tempfile::NamedTempFile::new().expect("temporary file");
    writeln!(table, "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad").expect("written");
    writeln!(table, "0,0,0,0,0,0,0").expect("written");
    // A Gray code passes all 64 corners of the box of six coordinates, one coordinate at a time.
    for step in 0..=64_u32 {
        let gray = (step % 64) ^ ((step % 64) >> 1);
        let side = |axis: u32| if gray >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let (mm, rad) = (4.0, 15.0_f64.to_radians());
        let row: Vec<String> = (0..6).map(|axis| (side(axis) * if axis < 3 { mm } else { rad }).to_string()).collect();
        writeln!(table, "{},{}", 1.0 + f64::from(step) / 3.0, row.join(",")).expect("written");
    }
    Trajectory::from_table(table.path().to_str().expect("plain path")).expect("ascending")
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
    let said = |file: &SceneFile| {
        let still = Trajectory::of_kind(TrajectoryKind::Still, 1, 2.0);
        let mut last = HeadHealth::default();
        watch(file, file, still, 2, &[], |health| last = health.clone());
        last
    };
    let mut file = with_dark_current();
    let light_a = said(&file).cells[5].light_a.expect("lit");
    for (margin, verdict) in [(1.5, Verdict::Ok), (0.5, Verdict::Saturated)] {
        let detector = &mut file.scene.cells[5].detector;
        detector.saturation_a = Some(light_a + margin * detector.dark_current_a);
        assert_eq!(said(&file).cells[5].verdict, verdict, "{margin} dark currents above the light");
    }
}

#[test]
fn a_healthy_head_raises_nothing() {
    let motion = |kind| Trajectory::of_kind(kind, 63, 20.0);
    for (name, file, motion) in [
        ("smooth", wide(), motion(TrajectoryKind::Smooth)),
        ("fast", wide(), motion(TrajectoryKind::Fast)),
        ("contact", wide(), motion(TrajectoryKind::Contact)),
        ("around the workspace", wide(), around_the_workspace()),
        ("dark current", with_dark_current(), motion(TrajectoryKind::Smooth)),
    ] {
        let mut findings: Vec<Diagnosis> = Vec::new();
        let mut judged = 0;
        let mut last = HeadHealth::default();
        watch(&file, &file, motion, 20, &[], |health| {
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
            let brightness = cell.brightness.expect("lit");
            assert!((brightness - 1.0).abs() < 0.01, "{name}: {brightness}");
            let noise = cell.noise_a.expect("dark words") / cell.promised_noise_a.expect("front end");
            assert!((0.9..1.1).contains(&noise), "{name}: noise {noise} of what is promised");
            // 4 000 means of two words with 0.5 LSB: 0.04 nA.
            let stray_a = cell.stray_a.expect("dark words");
            assert!(stray_a.abs() < 0.3e-9, "{name}: {stray_a} A of stray light");
        }
    }
}

#[test]
fn nothing_is_said_of_the_first_second() {
    let mut verdicts = Vec::new();
    let still = Trajectory::of_kind(TrajectoryKind::Still, 1, 1.0);
    let saturated = ["saturate:cell=2".to_owned()];
    watch(&wide(), &wide(), still, 2, &saturated, |health| verdicts.push(health.cells[2].verdict));
    assert_eq!(verdicts[0], Verdict::Unknown);
    assert_eq!(verdicts[7], Verdict::Saturated);
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
    let brightness = dirty.cells[0].brightness.expect("lit");
    assert!((brightness - 0.7).abs() < 0.01, "{brightness}");
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
    let rise_a = rising_much.cells[3].stray_rise_a.expect("dark words");
    assert!((0.22e-6..0.4e-6).contains(&rise_a), "{rise_a}");

    let steady = smooth(&["stray:cell=3,current=200nA"]);
    assert!(steady.findings.is_empty(), "{:?}", steady.findings);
    let stray_a = steady.cells[3].stray_a.expect("dark words");
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
        let health = said_of(&wide(), kind, 2, &[&format!("swap-electrodes:cell={cell}")]);
        let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
        assert_eq!(faults, [Fault::Exchange(Exchange::Electrodes { cell })], "{kind:?}");
        assert_eq!(health.cells[cell].verdict, Verdict::Swapped);
    }
}

#[test]
fn exchanged_cells_are_named() {
    // Neighbours, next but one of either roll, and opposite ones, which share a slot: by symmetry there are no others.
    for (first, second) in [(0, 1), (0, 5), (0, 2), (1, 3), (0, 3)] {
        // On the wrong plugs: lit, and sampled, in each other's slot. Of cells 120 degrees apart neighbours are
        // then lit together, and shine on each other's detectors.
        let mut board = wide();
        board.scene.cells.swap(first, second);
        let health = said_of(&board, TrajectoryKind::Smooth, 2, &[]);
        let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
        assert_eq!(faults, [Fault::Exchange(Exchange::Cells { cells: [first, second] })]);
        assert!([first, second].iter().all(|&cell| health.cells[cell].verdict == Verdict::Swapped));
    }
}

#[test]
fn what_cannot_be_seen_is_not_claimed() {
    // At home every spot is in the middle, and all cells are alike.
    let electrodes = said_of(&wide(), TrajectoryKind::Still, 2, &["swap-electrodes:cell=3"]);
    assert!(electrodes.findings.is_empty(), "{:?}", electrodes.findings);
    let mut board = wide();
    board.scene.cells.swap(0, 1);
    let cells = said_of(&board, TrajectoryKind::Still, 2, &[]);
    assert!(cells.findings.is_empty(), "{:?}", cells.findings);
}

#[test]
fn a_head_that_is_another_one_is_told_without_a_guess() {
    // Three cells in a ring: no exchange of two explains it.
    let mut board = wide();
    board.scene.cells[..3].rotate_left(1);
    let health = said_of(&board, TrajectoryKind::Smooth, 2, &[]);
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::Unexplained]);
}

#[test]
fn a_tool_that_was_taken_away_is_one_finding() {
    let occluded: Vec<String> = (0..6).map(|cell| format!("occlude:cell={cell}")).collect();
    let health = smooth(&occluded.iter().map(String::as_str).collect::<Vec<_>>());
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::TooDark]);
}

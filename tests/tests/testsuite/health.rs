//! What is wrong with a head is named, and of a healthy one nothing is said.

use std::io::Write;

use slitpose::health::{Diagnosis, Exchange, Fault, HeadHealth, Health, Verdict};
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{Solver, Tier, Tracker};
use slitpose_protocol::RawScan;
use slitpose_tests::capture::{capture, decode};

/// Frames a second: a quarter of the shipped rate. What is said rests on a second of scans, however many these are.
const FRAME_RATE: usize = 1000;

/// Steps of a word for one step of a conversion: four are added up.
const WORD_STEPS: f64 = 4.0;

fn wide() -> SceneFile {
    let mut file = WIDE.read().expect("shipped");
    file.front_end.as_mut().expect("has one").frame_rate_hz = FRAME_RATE as f64;
    file
}

/// Watches the head of `board` over `seconds`, taken for that of `file`; `edit` is what befalls the
/// words of each scan, `take` sees what is said every quarter of a second.
fn watch(
    file: &SceneFile,
    board: &SceneFile,
    trajectory: Trajectory,
    seconds: usize,
    edit: impl Fn(usize, &mut RawScan),
    mut take: impl FnMut(&HeadHealth),
) {
    let decoded = decode(&capture(board, trajectory, Tier::Paper, 61, seconds * FRAME_RATE));
    let (schedule, scaling) = (&decoded.schedule, &decoded.scaling);
    let stage = Stage::new(file, schedule, scaling);
    let scene = Stage::weighted_scene(file, schedule, scaling);
    let solver = Solver::new(&scene, Tier::Paper).expect("valid").with_exposures(&stage.exposures_s());
    let mut tracker: Tracker<f64> = Tracker::new(solver, schedule.frame_rate_hz().recip());
    let mut health = Health::new(file, Tier::Paper, schedule, scaling).expect("valid");
    for (number, mut scan) in decoded.scans.into_iter().enumerate() {
        edit(number, &mut scan);
        let photocurrents = stage.photocurrents(&scan);
        let solution = tracker.track(scan.sequence, &photocurrents).solution;
        health.update(&scan, &photocurrents, &solution);
        if number % (FRAME_RATE / 4) == FRAME_RATE / 4 - 1 {
            take(&health.report());
        }
    }
}

/// What is said after so many `seconds`: the first is not judged.
fn said_of(board: &SceneFile, kind: TrajectoryKind, seconds: usize, edit: impl Fn(usize, &mut RawScan)) -> HeadHealth {
    let mut last = HeadHealth::default();
    let motion = Trajectory::of_kind(kind, 62, seconds as f64);
    watch(&wide(), board, motion, seconds, edit, |health| last = health.clone());
    last.findings.iter().for_each(|finding| println!("{finding:?}"));
    last
}

/// What is said in the end of a head that moves smoothly, and `edit` befalls it.
fn smooth(edit: impl Fn(usize, &mut RawScan)) -> HeadHealth {
    said_of(&wide(), TrajectoryKind::Smooth, 3, edit)
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
        watch(file, file, still, 2, |_, _| {}, |health| last = health.clone());
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
        watch(
            &file,
            &file,
            motion,
            20,
            |_, _| {},
            |health| {
                judged += usize::from(health.cells.iter().all(|cell| cell.verdict != Verdict::Unknown));
                findings.extend(health.findings.iter().cloned());
                last = health.clone();
            },
        );
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
    // Codes fall as the current rises: cell 2 is saturated from the first scan on.
    let saturate = |_: usize, scan: &mut RawScan| scan.lit_mut()[2] = [0, 0];
    watch(&wide(), &wide(), still, 2, saturate, |health| verdicts.push(health.cells[2].verdict));
    assert_eq!(verdicts[0], Verdict::Unknown);
    assert_eq!(verdicts[7], Verdict::Saturated);
}

#[test]
fn each_fault_of_a_cell_is_named() {
    // Codes fall as the current rises: 0 is more than can be measured.
    assert_only(
        &smooth(|number, scan| {
            if number % 3 == 0 {
                scan.lit_mut()[1] = [0, 4000];
            }
        }),
        1,
        Verdict::Saturated,
    );
    // An emitter that has failed: lit as dark, but for what the words were worth in noise.
    let dead = smooth(|_, scan| scan.lit_mut()[4] = scan.dark().expect("dark slot")[4].map(|word| word - 1));
    assert_only(&dead, 4, Verdict::Dark);
    // A loose plug: dark for a quarter of a second every second.
    let loose = smooth(|number, scan| {
        if number % FRAME_RATE < FRAME_RATE / 4 {
            scan.lit_mut()[4] = scan.dark().expect("dark slot")[4];
        }
    });
    assert_only(&loose, 4, Verdict::Dark);
    // Dirt on one slit: 70 % of the light.
    let dirty = smooth(|_, scan| {
        let dark = scan.dark().expect("dark slot")[0];
        for (lit, dark) in scan.lit_mut()[0].iter_mut().zip(dark) {
            *lit = (f64::from(dark) + 0.7 * (f64::from(*lit) - f64::from(dark))).round() as u16;
        }
    });
    assert_only(&dirty, 0, Verdict::Excluded);
    let brightness = dirty.cells[0].brightness.expect("lit");
    assert!((brightness - 0.7).abs() < 0.01, "{brightness}");
    // The converter repeats itself from some scan on. Smooth motion: it contradicts, too, and that is why.
    let first = std::cell::Cell::new(None);
    let stuck = smooth(|number, scan| {
        if number == FRAME_RATE / 40 {
            first.set(Some((scan.lit()[5], scan.dark().expect("dark slot")[5])));
        }
        if let Some((lit, dark)) = first.get() {
            scan.lit_mut()[5] = lit;
            scan.dark_mut().expect("dark slot")[5] = dark;
        }
    });
    assert_only(&stuck, 5, Verdict::Stuck);
}

/// Light of `full_scales` of an electrode on both electrodes of cell 3, in all slots.
fn stray(scan: &mut RawScan, full_scales: f64) {
    // 4095 − 64 steps to full scale: see the simulator's front end.
    let words = (full_scales * 4031.0 * WORD_STEPS).round() as u16;
    for word in scan.lit_mut()[3].iter_mut() {
        *word -= words;
    }
    for word in scan.dark_mut().expect("dark slot")[3].iter_mut() {
        *word -= words;
    }
}

#[test]
fn stray_light_that_rises_is_told_and_steady_stray_light_is_not() {
    let since = |number: usize| number.saturating_sub(FRAME_RATE) as f64 / (2 * FRAME_RATE) as f64;
    // From the second second on, up to 2 % on both electrodes.
    let rising = smooth(|number, scan| stray(scan, 0.02 * since(number)));
    assert_only(&rising, 3, Verdict::StrayRising);
    // The mean of the last second, some 1.4 % twice.
    let rise_a = rising.cells[3].stray_rise_a.expect("dark words");
    assert!((0.22e-6..0.4e-6).contains(&rise_a), "{rise_a}");

    let steady = smooth(|_, scan| stray(scan, 0.02));
    assert!(steady.findings.is_empty(), "{:?}", steady.findings);
    let stray_a = steady.cells[3].stray_a.expect("dark words");
    assert!((stray_a - 0.4e-6).abs() < 5e-9, "{stray_a}");

    // A third of a per cent is less than an offset drifts.
    let little = smooth(|number, scan| stray(scan, 0.003 * since(number)));
    assert!(little.findings.is_empty(), "{:?}", little.findings);

    // A lamp that flickers at half the frame rate: 3 steps of the converter up and down, some six times the noise of a word.
    let flicker = smooth(|number, scan| stray(scan, if number % 2 == 0 { 6.0 / 4031.0 } else { 0.0 }));
    assert_only(&flicker, 3, Verdict::Noisy);
}

#[test]
fn exchanged_electrodes_are_named() {
    // The head looks the same from every second cell, and from the others in a mirror.
    for (cell, kind) in [(0, TrajectoryKind::Smooth), (1, TrajectoryKind::Contact)] {
        let health = said_of(&wide(), kind, 2, |_, scan| {
            scan.lit_mut()[cell].swap(0, 1);
            scan.dark_mut().expect("dark slot")[cell].swap(0, 1);
        });
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
        let health = said_of(&board, TrajectoryKind::Smooth, 2, |_, _| {});
        let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
        assert_eq!(faults, [Fault::Exchange(Exchange::Cells { cells: [first, second] })]);
        assert!([first, second].iter().all(|&cell| health.cells[cell].verdict == Verdict::Swapped));
    }
}

#[test]
fn what_cannot_be_seen_is_not_claimed() {
    // At home every spot is in the middle, and all cells are alike.
    let electrodes = said_of(&wide(), TrajectoryKind::Still, 2, |_, scan| scan.lit_mut()[3].swap(0, 1));
    assert!(electrodes.findings.is_empty(), "{:?}", electrodes.findings);
    let mut board = wide();
    board.scene.cells.swap(0, 1);
    let cells = said_of(&board, TrajectoryKind::Still, 2, |_, _| {});
    assert!(cells.findings.is_empty(), "{:?}", cells.findings);
}

#[test]
fn a_head_that_is_another_one_is_told_without_a_guess() {
    // Three cells in a ring: no exchange of two explains it.
    let mut board = wide();
    board.scene.cells[..3].rotate_left(1);
    let health = said_of(&board, TrajectoryKind::Smooth, 2, |_, _| {});
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::Unexplained]);
}

#[test]
fn a_tool_that_was_taken_away_is_one_finding() {
    let health = smooth(|_, scan| {
        let dark: Vec<_> = scan.dark().expect("dark slot").to_vec();
        scan.lit_mut().copy_from_slice(&dark);
    });
    let faults: Vec<_> = health.findings.iter().map(|finding| finding.fault).collect();
    assert_eq!(faults, [Fault::TooDark]);
}

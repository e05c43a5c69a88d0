//! Automatic exposure in the loop of emitters, optics, converters and program.

use std::fs;

use crate::common::light::{Bench, light_on};
use crate::common::pins::level_code;
use slitpose_emulator::rig::WORLD_TIER;
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::default_configuration;
use slitpose_firmware::pcb::wiring::highest_level;
use slitpose_head::front_end::Stage;
use slitpose_head::simulator::Trajectory;
use slitpose_model::{Plan, Reading};
use slitpose_protocol::{Command, Configuration, Exposure, Level, RawScan};

/// Noise of a lit-minus-dark current at nominal level, amperes: converter, 1 code rms a conversion
/// of 2.5 nA, 4 conversions a word, twice; shot and Johnson noise add as much again at the most.
const NOISE_A: f64 = 4e-9;

/// The tool at rest 5 mm from home towards detector 0: some 9 µA an electrode there at nominal level,
/// beyond [`BRIGHT`](slitpose_firmware), 1.7 µA at the opposite one.
fn near_detector_0() -> Trajectory {
    let path = std::env::temp_dir().join(format!("slitpose-near-{}.csv", std::process::id()));
    fs::write(&path, "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,5,0,0,0,0,0\n").expect("a temporary file");
    let trajectory = Trajectory::from_table(path.to_str().expect("a plain path")).expect("it is a table");
    fs::remove_file(&path).expect("it is there");
    trajectory
}

/// Runs `configuration` for 300 ms from a Start on.
fn expose(configuration: &Configuration) -> (Bench, Vec<RawScan>) {
    let mut bench = Bench::new(near_detector_0(), NoiseSource::Seeded(1));
    bench.accept(&Command::Configure(configuration.clone()));
    bench.forget();
    bench.accept(&Command::Start);
    bench.run_ms(300);
    bench.accept(&Command::Stop);
    bench.run_ms(5);
    let scans = bench.scans();
    (bench, scans)
}

/// Levels at which scans were taken, one after the other.
fn steps(scans: &[RawScan]) -> Vec<Vec<Level>> {
    let mut levels: Vec<_> = scans.iter().map(|scan| scan.levels().to_vec()).collect();
    levels.dedup();
    levels
}

#[test]
fn faint_and_saturating_cells_come_into_range() {
    let mut configuration = default_configuration();
    configuration.exposure = Exposure::Automatic;
    // Cell 0 saturates; cells 3 and 4 are faint.
    configuration.levels[0] = Level(0xf000);
    configuration.levels[3] = Level(0x2000);
    configuration.levels[4] = Level(0x1000);
    let schedule = configuration.schedule.clone();
    let (mut bench, scans) = expose(&configuration);
    let steps = steps(&scans);
    for levels in &steps {
        println!("levels {:04x?}", levels.iter().map(|level| level.0).collect::<Vec<_>>());
    }
    // Halved, then brought to the target; faint light is raised along with it or 20 ms later.
    assert!((3..=8).contains(&steps.len()), "{}", steps.len());
    let settled = scans.len() - 400;
    assert_eq!(scans[settled].levels(), scans[scans.len() - 1].levels(), "100 ms without a change");

    let stage = Stage::new(&bench.scene, &schedule, &bench.scaling);
    assert_eq!(stage.photocurrents(&scans[0]).cells[0], Reading::Saturated);
    let plan = Plan::<f64>::compile(&bench.scene.scene, WORLD_TIER).expect("the scene is valid");
    let pose = near_detector_0().pose(0.0);
    let full_scale_a = bench.scaling.amperes_per_code.abs() * bench.scaling.zero_code;
    let levels = scans[settled].levels().to_vec();
    for cell in 0..6 {
        let (mut sum, count) = ([0.0; 2], (scans.len() - settled) as f64);
        for scan in &scans[settled..] {
            let Reading::Light(pair) = stage.photocurrents(scan).cells[cell] else {
                panic!("scan {}, cell {cell}", scan.sequence);
            };
            sum = [sum[0] + pair.i_x1_a, sum[1] + pair.i_x2_a];
        }
        let expected = light_on(&plan, &schedule, cell, &levels, &pose);
        let relative = levels[cell].relative();
        for (seen, expected) in sum.map(|sum| sum / count).into_iter().zip([expected.i_x1_a, expected.i_x2_a]) {
            let share = expected * relative / full_scale_a;
            println!(
                "cell {cell}: level {relative:.3}, {:.4} µA of {:.4} µA, share {share:.3}",
                1e6 * seen,
                1e6 * expected
            );
            // Five standard deviations of a mean; half a step of the level converters.
            let tolerance =
                5.0 * NOISE_A / relative / count.sqrt() + expected * 0.5 / f64::from(level_code(levels[cell]));
            assert!((seen - expected).abs() <= tolerance, "cell {cell}: {seen} of {expected} ± {tolerance}");
        }
        let share = expected.i_x1_a.max(expected.i_x2_a) * relative / full_scale_a;
        let highest = highest_level(&schedule);
        assert!(share < 0.85 && (share > 0.3 || levels[cell] == highest), "cell {cell}: {share}");
    }

    // A change of levels costs the frame under way, and no other; the Stop may cost one.
    let begun =
        bench.record().drives.windows(2).filter(|pair| pair[0].gates != 0b00_1001 && pair[1].gates == 0b00_1001);
    let interrupted = begun.count() - scans.len();
    let lost: u64 = scans.windows(2).map(|pair| pair[1].sequence - pair[0].sequence - 1).sum();
    println!("{} changes, {interrupted} frames interrupted, {lost} numbers missing", steps.len() - 1);
    assert!(interrupted <= steps.len());
    assert!(lost < steps.len() as u64);
    assert_never_above(&mut bench, &scans, highest_level(&schedule));
    bench.assert_no_faults();
}

#[test]
fn an_emitter_lit_for_long_is_not_driven_above_nominal() {
    let mut configuration = default_configuration();
    configuration.exposure = Exposure::Automatic;
    configuration.schedule.slots.pop();
    configuration.schedule.frame_ticks = 3 * configuration.schedule.slot_ticks;
    assert_eq!(highest_level(&configuration.schedule), Level::NOMINAL);
    let (mut bench, scans) = expose(&configuration);
    let last = scans.last().expect("there are scans").levels();
    assert!(last[0] < Level::NOMINAL, "bright: {last:?}");
    assert_eq!(last[3], Level::NOMINAL, "faint, and no more to be had");
    assert_never_above(&mut bench, &scans, Level::NOMINAL);
    bench.assert_no_faults();
}

#[test]
fn a_fixed_exposure_stays() {
    let mut configuration = default_configuration();
    configuration.levels[0] = Level(0xc000);
    let (bench, scans) = expose(&configuration);
    assert_eq!(steps(&scans), [configuration.levels.to_vec()]);
    bench.assert_no_faults();
}

/// Neither the levels on the wire nor those on the lines go beyond `highest`.
fn assert_never_above(bench: &mut Bench, scans: &[RawScan], highest: Level) {
    assert!(scans.iter().all(|scan| scan.levels().iter().all(|&level| level <= highest)));
    let most = level_code(highest);
    assert!(bench.record().drives.iter().all(|drive| drive.levels.iter().all(|&code| code <= most)));
}

use super::*;
use slitpose_head::scene_file::Shipped;
use slitpose_head::simulator::TrajectoryKind;
use slitpose_model::{Pair, Plan};

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
const NOMINAL: [u16; 2] = [NOMINAL_LEVEL_CODE; 2];

fn wide() -> SceneFile {
    Shipped::named("wide").unwrap().read().unwrap()
}

fn moving() -> Trajectory {
    Trajectory::of_kind(TrajectoryKind::Smooth, 3, 1.0)
}

fn world(trajectory: Trajectory, noise: NoiseSource) -> OpticsWorld {
    OpticsWorld::new(&wide(), trajectory, TIER, noise).unwrap()
}

fn amperes(world: &OpticsWorld, code: u16) -> f64 {
    let scaling = world.scaling();
    (f64::from(code) - scaling.zero_code) * scaling.amperes_per_code
}

/// The schedule of the default configuration: pairs of emitters, then darkness.
const SLOT_TICKS: Ticks = 5_800;
const FRAME_TICKS: Ticks = 42_500;
const GATES: [u8; 4] = [0b001_001, 0b010_010, 0b100_100, 0];

#[test]
fn codes_follow_a_fine_integration_through_edges_and_motion() {
    let (mut world, file) = (world(moving(), NoiseSource::Off), wide());
    let plan = Plan::<f64>::compile(&file.scene, TIER).unwrap();
    let trajectory = moving();
    let origin = 1_000_000;
    world.set_origin(origin);
    // A converter that sees every slot from its first microsecond on, at odd distances.
    let levels = [NOMINAL, [NOMINAL_LEVEL_CODE, NOMINAL_LEVEL_CODE / 2], [0, 3_000]];
    let tau = file.front_end.unwrap().time_constant_s;
    let step = 10;
    let decay = (-(step as f64) / 170e6 / tau).exp();
    let mut state = [[0.0_f64; 2]; BOARD_CELLS];
    let mut worst = 0.0_f64;
    let (mut gates, mut relative) = (0, [0.0; 2]);
    let mut light = [Pair::default(); BOARD_CELLS];
    for tick in (origin..origin + 3 * FRAME_TICKS).step_by(step) {
        let in_frame = (tick - origin) % FRAME_TICKS;
        let frame = ((tick - origin) / FRAME_TICKS) as usize;
        if in_frame.is_multiple_of(SLOT_TICKS) && in_frame / SLOT_TICKS < 4 {
            gates = GATES[(in_frame / SLOT_TICKS) as usize];
            world.drive(tick, gates, levels[frame]);
            relative = levels[frame].map(|code| f64::from(code) / 2048.0);
        }
        let light_at = |tick: Ticks| {
            let pose = trajectory.pose((tick - origin) as f64 / 170e6);
            std::array::from_fn(|cell| {
                (0..BOARD_CELLS).filter(|emitter| gates & 1 << emitter != 0).fold(
                    Pair::default(),
                    |sum: Pair<f64>, e| {
                        let pair = plan.crosstalk(cell, e, &pose);
                        let level = relative[e / 3];
                        Pair { i_x1_a: sum.i_x1_a + level * pair.i_x1_a, i_x2_a: sum.i_x2_a + level * pair.i_x2_a }
                    },
                )
            })
        };
        if in_frame.is_multiple_of(50) {
            light = light_at(tick);
        }
        if in_frame % 740 == 30 {
            for cell in 0..BOARD_CELLS {
                for (electrode, (adc, channel)) in
                    [(1, ADC1_INPUTS[cell]), (2, ADC2_INPUTS[cell])].into_iter().enumerate()
                {
                    let code = world.sample(tick, adc, channel);
                    let expected =
                        world.scaling().zero_code + state[cell][electrode] / world.scaling().amperes_per_code;
                    worst = worst.max((f64::from(code) - expected.clamp(0.0, 4095.0)).abs());
                }
            }
        }
        for cell in 0..BOARD_CELLS {
            for (electrode, light) in [light[cell].i_x1_a, light[cell].i_x2_a].into_iter().enumerate() {
                state[cell][electrode] = light + (state[cell][electrode] - light) * decay;
            }
        }
    }
    // Half a step is rounding; the reference holds its light for 0.3 µs, in which the tool moves.
    println!("codes off by at most {worst:.3} steps, rounding included");
    assert!((0.45..0.6).contains(&worst), "{worst} steps");
}

#[test]
fn linear_stretches_are_as_good_as_the_optics_themselves() {
    let reference = Plan::<f64>::compile(&wide().scene, TIER).unwrap();
    let mut illumination = Illumination::new(&wide().scene, moving(), TIER, Flaws::default()).unwrap();
    illumination.switch(0, 0b111_111, [1.0; 2]);
    let step_a = 10e-6 / 4096.0;
    let mut worst = 0.0_f64;
    for tick in (0..20_000_000).step_by(1_234) {
        while illumination.end() < tick {
            illumination.go_on();
        }
        let pose = moving().pose(tick as f64 / 170e6);
        for cell in 0..BOARD_CELLS {
            let exact: f64 = (0..BOARD_CELLS).map(|emitter| reference.crosstalk(cell, emitter, &pose).i_x1_a).sum();
            worst = worst.max((illumination.light(cell, tick).i_x1_a - exact).abs() / step_a);
        }
    }
    println!("smooth motion, stretches of 35 µs: light off by at most {worst:.4} steps of the converter");
    assert!(worst < 0.02, "{worst}");
}

#[test]
fn levels_gates_and_darkness_are_told_apart() {
    let mut world = world(Trajectory::of_kind(TrajectoryKind::Still, 0, 0.0), NoiseSource::Off);
    let settled = 17_000;
    let mut now = 0;
    let mut current = |world: &mut OpticsWorld, gates, levels, cell: usize| {
        world.drive(now, gates, levels);
        now += settled;
        let code = world.sample(now, 1, ADC1_INPUTS[cell]);
        amperes(world, code)
    };
    let full = current(&mut world, 1, NOMINAL, 0);
    assert!((full - 3.4e-6).abs() < 0.2e-6, "{full}");
    let half = current(&mut world, 1, [NOMINAL_LEVEL_CODE / 2, NOMINAL_LEVEL_CODE], 0);
    assert!((half / full - 0.5).abs() < 1e-3, "{half}");
    assert_eq!(current(&mut world, 1, [0, NOMINAL_LEVEL_CODE], 0), 0.0);
    assert_eq!(current(&mut world, 0, NOMINAL, 0), 0.0);
    // Emitter 3 hangs on the other level, and shines on its own cell.
    let opposite = current(&mut world, 0b1000, [0, NOMINAL_LEVEL_CODE], 3);
    assert!((opposite / full - 1.0).abs() < 1e-2, "{opposite}");
    assert_eq!(current(&mut world, 0b1000, [0, NOMINAL_LEVEL_CODE], 0), 0.0);
}

#[test]
fn noise_is_what_the_electronics_say() {
    // A quarter of the light at five times the gain, so that the converter is quieter than the rest.
    let mut file = wide();
    let front_end = file.front_end.as_mut().unwrap();
    (front_end.full_scale_a, front_end.raw_noise_lsb) = (2e-6, 0.3);
    let still = Trajectory::of_kind(TrajectoryKind::Still, 0, 0.0);
    let mut world = OpticsWorld::new(&file, still, TIER, NoiseSource::Seeded(5)).unwrap();
    world.drive(0, 1, [NOMINAL_LEVEL_CODE / 4; 2]);
    let count = 20_000;
    let mut pairs = Vec::new();
    for i in 0..count {
        // Far apart: independent.
        let now = 17_000 * (i + 1);
        let pair = [world.sample(now, 1, ADC1_INPUTS[0]), world.sample(now, 2, ADC2_INPUTS[0])];
        pairs.push(pair.map(|code| amperes(&world, code)));
    }
    let n = count as f64;
    let mean = [0, 1].map(|k| pairs.iter().map(|pair| pair[k]).sum::<f64>() / n);
    let moment = |a: usize, b: usize| pairs.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>() / n;
    // Bandwidth of the low-pass, shot noise of the light, Johnson noise of 50 kΩ, converter noise,
    // and 1/√12 of a step of rounding.
    let bandwidth = 0.25 / 1.36e-6;
    let total = mean[0] + mean[1];
    let shot = 2.0 * 1.602_176_634e-19 * bandwidth * total;
    let johnson = 4.0 * 1.380_649e-23 * 300.0 * bandwidth / 50e3;
    let converter = (0.3 * 0.3 + 1.0 / 12.0) * world.scaling().amperes_per_code.powi(2);
    let share = mean[0] / total;
    let variance = shot * share * share + johnson + converter;
    let covariance = shot * share * (1.0 - share) - johnson;
    println!("variance {:e} (expected {variance:e}), covariance {:e} ({covariance:e})", moment(0, 0), moment(0, 1));
    assert!((moment(0, 0) / variance - 1.0).abs() < 0.05);
    assert!((moment(0, 1) - covariance).abs() < 0.04 * variance);
    assert!(covariance < -0.1 * variance, "Johnson noise is to be seen in it");
}

#[test]
fn the_same_seed_gives_the_same_codes() {
    let codes = |seed| {
        let mut world = world(moving(), NoiseSource::Seeded(seed));
        world.drive(0, 1, NOMINAL);
        (1..200).map(|i| world.sample(i * 148, 1, ADC1_INPUTS[0])).collect::<Vec<_>>()
    };
    assert_eq!(codes(1), codes(1));
    assert_ne!(codes(1), codes(2));
}

#[test]
fn inputs_without_detector_and_scenes_without_board() {
    let bench = Shipped::named("bench").unwrap().read().unwrap();
    assert_eq!(bench.scene.cells.len(), 1);
    let still = || Trajectory::of_kind(TrajectoryKind::Still, 0, 0.0);
    let mut file = wide();
    file.front_end.as_mut().unwrap().adc_bits = 16;
    assert!(matches!(
        OpticsWorld::new(&file, still(), TIER, NoiseSource::Off),
        Err(WorldError::AdcBits { bits: 16, .. })
    ));
    file.front_end = None;
    assert!(matches!(OpticsWorld::new(&file, still(), TIER, NoiseSource::Off), Err(WorldError::NoFrontEnd { .. })));
    let mut file = wide();
    file.scene.cells.truncate(2);
    let mut world = OpticsWorld::new(&file, still(), TIER, NoiseSource::Seeded(1)).unwrap();
    world.drive(0, 0b111_111, NOMINAL);
    assert_eq!(world.sample(1_000, 2, ADC2_INPUTS[5]), world.scaling().zero_code as u16);
    assert_eq!(world.sample(1_000, 1, 3), 0);
    let mut file = wide();
    let cell = file.scene.cells[0].clone();
    file.scene.cells.push(cell).unwrap();
    assert!(matches!(
        OpticsWorld::new(&file, still(), TIER, NoiseSource::Off),
        Err(WorldError::TooManyCells { cells: 7, .. })
    ));
}

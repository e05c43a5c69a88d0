use super::*;
use slitpose_head::scene_file::Shipped;
use slitpose_head::simulator::TrajectoryKind;

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
const NOMINAL: [u16; 2] = [NOMINAL_LEVEL_CODE; 2];

fn wide() -> SceneFile {
    Shipped::named("wide").unwrap().read().unwrap()
}

fn moving() -> Trajectory {
    Trajectory::of_kind(TrajectoryKind::Smooth, 3, 1.0)
}

fn world(trajectory: Trajectory, noise: NoiseSource) -> OpticsWorld {
    OpticsWorld::new(&wide(), trajectory, TIER, noise, Faults::default()).unwrap()
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
        OpticsWorld::new(&file, still(), TIER, NoiseSource::Off, Faults::default()),
        Err(WorldError::AdcBits { bits: 16, .. })
    ));
    file.front_end = None;
    assert!(matches!(
        OpticsWorld::new(&file, still(), TIER, NoiseSource::Off, Faults::default()),
        Err(WorldError::NoFrontEnd { .. })
    ));
    let mut file = wide();
    file.scene.cells.truncate(2);
    let mut world = OpticsWorld::new(&file, still(), TIER, NoiseSource::Seeded(1), Faults::default()).unwrap();
    world.drive(0, 0b111_111, NOMINAL);
    assert_eq!(world.sample(1_000, 2, ADC2_INPUTS[5]), world.scaling().zero_code as u16);
    assert_eq!(world.sample(1_000, 1, 3), 0);
    let mut file = wide();
    let cell = file.scene.cells[0].clone();
    file.scene.cells.push(cell).unwrap();
    assert!(matches!(
        OpticsWorld::new(&file, still(), TIER, NoiseSource::Off, Faults::default()),
        Err(WorldError::TooManyCells { cells: 7, .. })
    ));
}

//! Where a fault of the silicon ends sessions, words are still the model's, and each end of the light is as quick.
//! `--example silicon` has every fault and mixtures of them.

use crate::common::silicon;
use crate::common::trial::Plan;
use crate::common::trial::endings::Ending;
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::rig::{Rig, open_image, open_pose_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};

/// Both are there from the first instruction on.
#[test]
fn images_start_where_first_writes_are_lost_and_sleep_with_a_barrier_behind_it() {
    let (wide, still) = (WIDE.read().expect("shipped"), Trajectory::of_kind(TrajectoryKind::Still, 1, 10.0));
    for image in [open_image(None), open_pose_image()] {
        let image = image.expect("firmware/build makes it");
        for fault in [Fault::SramFirstWrite, Fault::SleepFetch] {
            let mut rig = Rig::boot(&image, &wide, still.clone(), NoiseSource::Off, Faults::default().with(fault))
                .expect("it fits");
            rig.run_for(0.05);
            assert_eq!(rig.faults(), [""; 0], "{fault:?}");
            let machine = rig.machine();
            assert_eq!((machine.cpu.last_fault(), machine.resets().len()), (None, 1), "{fault:?}");
        }
    }
}

#[test]
fn a_host_that_breaks_sessions_gets_no_wrong_word_and_leaves_no_light() {
    let image = open_image(None).expect("firmware/build makes it");
    let silicon = silicon().with(Fault::UsbHost);
    let mut missing = 0;
    let endings = [Ending::Stop, Ending::ClosedPort, Ending::PulledCable, Ending::Panic, Ending::Hang];
    for (seed, ending) in (1..).zip(endings) {
        let plan = Plan { silicon, ending, seconds: 0.4, seed };
        let outcome = plan.carry_out(&image).unwrap_or_else(|error| panic!("{ending:?}: {error}"));
        println!(
            "{ending:?}: {} scans, {} missing, at most {:.3} codes off, lit for {} ticks more",
            outcome.scans, outcome.missing, outcome.worst_codes, outcome.lit_ticks
        );
        assert!(outcome.scans > 1_000, "{ending:?}: {} scans", outcome.scans);
        missing += outcome.missing;
    }
    assert!(missing > 0, "sessions broke while it was lit");
}

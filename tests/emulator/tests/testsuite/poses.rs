//! The image that solves poses: its poses are those that a host finds in the same words, and come in time.

use crate::common::talk::Talk;
use crate::common::{SEED, calibrated, head_of, is_ready_high, scene, silicon, smooth, us};
use slitpose_emulator::faults::Fault;
use slitpose_emulator::memory::{CCM_BYTES, RAM_BYTES};
use slitpose_emulator::peripherals::TICKS_PER_SECOND;
use slitpose_emulator::rig::open_pose_image;
use slitpose_emulator::world::NoiseSource;
use slitpose_firmware::pcb::default_configuration;
use slitpose_firmware::pose::{HEAD_BYTES, Head, PoseSolver};
use slitpose_head::front_end::board_configuration;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::{Estimate, Pose};
use slitpose_protocol::poses::{PoseRecord, PoseStatus, READY_TICKS};
use slitpose_protocol::{Command, Configuration, HeadPart, Level, RawScan, Schedule, Stream};

/// Frames a second that a board follows a calibrated head with.
const CALIBRATED_HZ: u64 = 3_200;

/// Mean of χ² of six degrees of freedom, and half its variance.
const DEGREES: f64 = 6.0;

/// What a host that runs the board's solver makes of `scans`, the first of them the first that the board has solved.
fn replayed<'a>(head: &Head, schedule: &Schedule, scans: impl Iterator<Item = &'a RawScan>) -> Vec<PoseRecord> {
    let mut solver = PoseSolver::default();
    let mut bytes = [0; HEAD_BYTES];
    solver.load(head.encode(&mut bytes).expect("room")).expect("whole");
    solver.begin(schedule);
    scans.map(|scan| solver.solve(scan).expect("the head is for this schedule").record).collect()
}

fn bits(record: &PoseRecord) -> ([u32; 8], PoseStatus, [u16; 2]) {
    let mut numbers = record.translation_m.iter().chain(&record.rotation_xyzw).chain([&record.chi2]);
    let numbers = [(); 8].map(|()| numbers.next().expect("eight").to_bits());
    (numbers, record.status, [record.cells_used, record.excluded])
}

fn pose(record: &PoseRecord) -> Pose {
    Pose {
        rotation: glam::DQuat::from_array(record.rotation_xyzw.map(f64::from)).normalize(),
        translation_m: glam::DVec3::from_array(record.translation_m.map(f64::from)),
    }
}

/// Scans and poses of a second, at the rate at which both pass over USB: the poses are the host's bit for bit. How far they
/// are from those that it finds in `f64` and the exact tier, the test `board_solver` says.
#[test]
fn poses_are_those_of_a_host_bit_for_bit() {
    agree(&scene(), &at(2_500));
}

/// The same of a head whose parts are as calibration finds them.
#[test]
fn poses_of_a_calibrated_head_are_those_of_a_host_bit_for_bit() {
    // At 2.5 kHz USB does not carry both beside so much work, and at 2 kHz hardly: with seed 19 some scans are dropped.
    agree(&calibrated(), &at(2_000));
}

/// The same of emitters that take turns for half a millisecond, in which acceleration moves the tool by some σ.
#[test]
fn poses_of_long_frames_are_those_of_a_host_bit_for_bit() {
    let source = scene()
        .source
        .replace("slots = [[0, 2, 4], [1, 3, 5], []]", "slots = [[0], [1], [2], [3], [4], [5], []]")
        .replace("oversampling = 8", "oversampling = 16")
        .replace("frame_rate_hz = 4000", "frame_rate_hz = 1000");
    let file = SceneFile::parse("long frames", &source).expect("a scene");
    agree(&file, &board_configuration(&file).expect("fits"));
}

fn at(frame_rate_hz: u32) -> Configuration {
    let mut configuration = default_configuration();
    configuration.schedule.frame_ticks = TICKS_PER_SECOND as u32 / frame_rate_hz;
    configuration
}

/// The poses are a host's bit for bit.
fn agree(file: &SceneFile, configuration: &Configuration) {
    let mut talk = Talk::solving(file, NoiseSource::Seeded(SEED));
    talk.rig.send(Command::Configure(configuration.clone()));
    talk.run_ms(2.0);
    let schedule = talk.ear.schedule().clone();
    let head = head_of(&talk.ear, file);
    talk.rig.send_head(&head);
    talk.rig.send(Command::Stream(Stream::BOTH));
    talk.run_ms(2.0);
    talk.rig.send(Command::Start);
    talk.run_ms(1_200.0);
    let status = talk.ear.status.expect("twice a second");
    // What waits in the queue comes after the last frame.
    talk.rig.send(Command::Stop);
    talk.run_ms(100.0);
    assert_eq!((talk.ear.damaged(), talk.ear.missed, status.scans_lost, status.scans_dropped), (0, 0, 0, 0));
    let count = talk.ear.poses.len().min(talk.ear.scans.len());
    assert!(count as u64 > TICKS_PER_SECOND * 29 / 25 / u64::from(schedule.frame_ticks), "{count}");
    let scans = &talk.ear.scans[..count];
    let on_host = replayed(&head, &schedule, scans.iter());
    for ((_, (sequence, tick, record)), (scan, on_host)) in talk.ear.poses.iter().zip(scans.iter().zip(&on_host)) {
        assert_eq!((*sequence, *tick), (scan.sequence, scan.tick));
        assert_eq!(record.status, PoseStatus::Converged, "frame {sequence}");
        assert_eq!(bits(record), bits(on_host), "frame {sequence}");
    }
    println!("{count} poses; load {} per mille, stack {} bytes", status.cpu_load_permille, talk.rig.stack_bytes());
}

/// Ten seconds at 4 kHz, a moving tool, poses alone on the link: none is missed; load; from the last conversion of a frame
/// to its pose, by what the records say and by the pin; errors are what covariances say.
#[test]
fn every_frame_of_ten_seconds_is_solved_in_time() {
    let seconds = 10;
    let mut talk = Talk::solving(&scene(), NoiseSource::Seeded(SEED));
    talk.start_poses();
    let mut load = 0;
    for second in 0..seconds {
        talk.run_ms(1_000.0);
        if second > 0 {
            load = load.max(talk.ear.status.expect("twice a second").cpu_load_permille);
        }
    }
    let status = talk.ear.status.expect("twice a second");
    println!("load {load} per mille, {} poses, stack {} bytes", talk.ear.poses.len(), talk.rig.stack_bytes());
    let (stack, variables) = (talk.rig.stack_bytes() as usize, open_pose_image().expect("an image").static_ram_bytes);
    assert!(stack + variables <= RAM_BYTES - CCM_BYTES, "{stack} bytes of stack, {variables} of variables");
    assert!(talk.ear.scans.is_empty(), "only poses are asked for");
    assert_eq!((talk.ear.damaged(), talk.ear.missed, status.scans_lost), (0, 0, 0));
    assert!(talk.ear.poses.len() >= 4_000 * seconds - 12, "{}", talk.ear.poses.len());
    assert!(talk.ear.poses.windows(2).all(|pair| pair[1].1.0 == pair[0].1.0 + 1), "every frame, in order");
    assert!(talk.ear.poses.iter().all(|(_, (.., record))| record.status == PoseStatus::Converged));
    assert!(load <= 850, "{load}");

    let schedule = talk.ear.schedule().clone();
    let last = schedule.last_sample_ticks();
    let ready = |record: &PoseRecord| u64::from(record.ready) * u64::from(READY_TICKS);
    // The first poses are found from nothing.
    let mut late: Vec<u64> = talk.ear.poses.iter().skip(40).map(|(_, (.., record))| ready(record) - last).collect();
    late.sort_unstable();
    let (median, most) = (us(late[late.len() / 2]), us(late[late.len() - 1]));
    println!(
        "last conversion to pose: median {median:.1} µs, at most {most:.1} µs; first: {}",
        us(ready(&talk.ear.poses[0].1.2))
    );
    assert!(median <= 200.0 && most <= 400.0, "{median} {most}");

    let trajectory = smooth();
    let mut nees = 0.0;
    for (index, triangle) in &talk.ear.covariances {
        let (_, (_, tick, record)) = &talk.ear.poses[*index];
        let mut covariance = [[0.0; 6]; 6];
        let mut elements = triangle.iter();
        for i in 0..6 {
            for j in 0..=i {
                covariance[i][j] = f64::from(*elements.next().expect("21"));
                covariance[j][i] = covariance[i][j];
            }
        }
        let time_s = (*tick as f64 + schedule.reference_ticks()) / f64::from(schedule.tick_hz);
        let solved = Estimate { pose: pose(record), covariance };
        nees += solved.nees(&trajectory.pose(time_s)).expect("regular");
    }
    let count = talk.ear.covariances.len() as f64;
    println!("NEES {:.3} of {count}", nees / count);
    assert!(count > 2_400.0);
    // Five standard deviations of the mean of that many.
    assert!((nees / count - DEGREES).abs() < 5.0 * (2.0 * DEGREES / count).sqrt(), "{}", nees / count);

    let origin = talk.origin();
    // The pin toggles once a pose: looked at every microsecond, and compared with what the records of that time say.
    let before = talk.ear.poses.len();
    let began = talk.rig.now();
    let (mut toggles, mut high) = (Vec::new(), is_ready_high(&mut talk));
    while talk.rig.now() < began + 40 * u64::from(schedule.frame_ticks) {
        let _ = talk.rig.run_for(1e-6);
        if is_ready_high(&mut talk) != high {
            high = !high;
            toggles.push(talk.rig.now());
        }
    }
    talk.run_ms(5.0);
    assert!((39..=41).contains(&toggles.len()), "{}", toggles.len());
    for toggle in &toggles {
        let of_records =
            talk.ear.poses[before - 8..].iter().map(|(_, (_, tick, record))| origin + tick + ready(record));
        let off = of_records.map(|at| at.abs_diff(*toggle)).min().expect("poses");
        // A microsecond between two looks, a unit of `ready`, and the way from the clock's reading to the pin.
        assert!(off <= 170 + 64 + 170, "{off}");
    }
}

/// A board whose parts are off their places, and its scene does not know: poses are of no use. It is sent its calibration
/// while it runs, and from then on they are right. The calibrated head is stored, and poses come by themselves.
#[test]
fn a_calibrated_head_takes_over_while_the_board_runs_and_outlives_the_supply() {
    let file = calibrated();
    let mut talk = Talk::solving(&file, NoiseSource::Seeded(SEED));
    let as_designed = head_of(&talk.ear, &scene());
    talk.rig.send_head(&as_designed);
    let mut configuration = default_configuration();
    configuration.schedule.frame_ticks = (TICKS_PER_SECOND / CALIBRATED_HZ) as u32;
    talk.rig.send(Command::Configure(configuration));
    talk.start_poses();
    talk.run_ms(200.0);
    let off_m = |talk: &Talk| {
        let schedule = talk.ear.schedule();
        let of = |(_, (_, tick, record)): &(_, (u64, u64, PoseRecord))| {
            let time_s = (*tick as f64 + schedule.reference_ticks()) / f64::from(schedule.tick_hz);
            pose(record).displacement_from(&smooth().pose(time_s)).0.length()
        };
        let mut off: Vec<f64> =
            talk.ear.poses.iter().filter(|(_, (.., record))| record.status.has_pose()).map(of).collect();
        off.sort_by(f64::total_cmp);
        off
    };
    let before = off_m(&talk);
    println!("as designed: {} poses, off by {:.0?} um at least", before.len(), before.first().map(|off| off * 1e6));
    assert!(before.iter().all(|&off| off > 50e-6));

    let head = head_of(&talk.ear, &file);
    talk.rig.send_head(&head);
    // While the tool is looked for.
    talk.run_ms(150.0);
    talk.ear.poses.clear();
    talk.ear.missed = 0;
    let seconds = 3;
    let began = talk.rig.now();
    talk.run_ms(1e3 * f64::from(seconds));
    let status = talk.ear.status.expect("twice a second");
    assert_eq!((talk.ear.damaged(), status.scans_lost), (0, 0));
    let after = off_m(&talk);
    let mut late: Vec<u64> = talk
        .ear
        .poses
        .iter()
        .map(|(_, (.., record))| {
            u64::from(record.ready) * u64::from(READY_TICKS) - talk.ear.schedule().last_sample_ticks()
        })
        .collect();
    late.sort_unstable();
    println!(
        "calibrated: {} poses in {:.2} s, off by {:.1} um in the median, {:.1} at most; load {} per mille, last conversion to \
         pose {:.0} us in the median, {:.0} at most; stack {} bytes",
        after.len(),
        us(talk.rig.now() - began) * 1e-6,
        after[after.len() / 2] * 1e6,
        after[after.len() - 1] * 1e6,
        status.cpu_load_permille,
        us(late[late.len() / 2]),
        us(late[late.len() - 1]),
        talk.rig.stack_bytes()
    );
    assert!(talk.ear.poses.iter().all(|(_, (.., record))| record.status == PoseStatus::Converged));
    assert!(talk.ear.poses.windows(2).all(|pair| pair[1].1.0 == pair[0].1.0 + 1), "every frame, in order");
    // It may be looked for a little longer.
    assert!(after.len() as u64 + CALIBRATED_HZ / 10 > u64::from(seconds as u32) * CALIBRATED_HZ, "{}", after.len());
    // σ of a frame is 2 µm an axis, up to twice that where the workspace ends.
    assert!(after[after.len() / 2] < 6e-6 && after[after.len() - 1] < 30e-6);

    let replies = talk.ear.accepted().len();
    talk.rig.send(Command::Store(head.readout.hashes));
    talk.run_ms(300.0);
    assert_eq!(talk.ear.accepted()[replies..], [true]);
    talk.cut_supply();
    talk.run_ms(500.0);
    talk.start_poses();
    let statuses = statuses(&mut talk, 0.2);
    assert!(
        statuses.len() > 500 && statuses[40..].iter().all(|&status| status == PoseStatus::Converged),
        "{statuses:?}"
    );
}

fn statuses(talk: &mut Talk, seconds: f64) -> Vec<PoseStatus> {
    talk.ear.poses.clear();
    talk.run_ms(1e3 * seconds);
    talk.ear.poses.iter().map(|(_, (.., record))| record.status).collect()
}

/// Cells go dark and come back, the tool is gone and back, the frame rate changes, and so does the head.
#[test]
fn what_happens_to_light_schedule_and_head_shows_in_the_poses_and_passes() {
    let file = scene();
    let mut talk = Talk::solving(&file, NoiseSource::Seeded(SEED));
    talk.start_poses();
    let whole = statuses(&mut talk, 0.1);
    assert!(whole.len() > 380 && whole.iter().all(|&status| status == PoseStatus::Converged), "{whole:?}");

    let configured = |talk: &mut Talk, change: &dyn Fn(&mut Configuration)| {
        let mut configuration = default_configuration();
        change(&mut configuration);
        talk.rig.send(Command::Configure(configuration));
        // The packets of what was before come, too.
        talk.run_ms(5.0);
    };
    // A cell without its emitter: a pose of five.
    configured(&mut talk, &|new| new.levels[2] = Level(0));
    let fewer = statuses(&mut talk, 0.1);
    assert!(fewer.len() > 300 && fewer.iter().all(|&status| status == PoseStatus::FewerCells), "{fewer:?}");
    assert!(talk.ear.poses.iter().all(|(_, (.., record))| record.cells_used == 0b11_1011));

    // No tool at all, and it is back: found within so many frames.
    configured(&mut talk, &|new| new.levels.iter_mut().for_each(|level| *level = Level(0)));
    let none = statuses(&mut talk, 0.05);
    assert!(none.len() > 150 && none.iter().all(|status| !status.has_pose()), "{none:?}");
    assert!(talk.ear.poses.iter().all(|(_, (.., record))| record.translation_m[0].is_nan()));
    configured(&mut talk, &|_| {});
    let back = statuses(&mut talk, 0.1);
    let (first, last) = (talk.ear.poses[0].1.0, talk.ear.poses[talk.ear.poses.len() - 1].1.0);
    println!("back: {} poses of {} frames, missed {}", back.len(), last - first + 1, talk.ear.missed);
    assert!(back[8..].iter().all(|&status| status == PoseStatus::Converged), "{back:?}");
    assert!(back.len() as u64 + 40 > last - first, "{} of {}", back.len(), last - first);

    // Another frame rate needs no other head; other slots do.
    configured(&mut talk, &|new| new.schedule.frame_ticks = 85_000);
    let slower = statuses(&mut talk, 0.1);
    assert!((180..=202).contains(&slower.len()), "{}", slower.len());
    assert!(slower[8..].iter().all(|&status| status == PoseStatus::Converged), "{slower:?}");
    configured(&mut talk, &|new| new.schedule.settling_ticks -= 10);
    assert!(statuses(&mut talk, 0.05).is_empty());
    assert!(talk.ear.events().iter().any(|text| text.contains("another schedule")), "{:?}", talk.ear.events());
    configured(&mut talk, &|_| {});
    assert!(statuses(&mut talk, 0.05).len() > 150);

    talk.rig.send(Command::Head(HeadPart { offset: 0, total: 0, bytes: [].into_iter().collect() }));
    talk.run_ms(2.0);
    assert!(statuses(&mut talk, 0.05).is_empty(), "a board without a head solves nothing");
    assert_eq!(talk.ear.damaged(), 0);
}

/// An emitter of half its intensity, from switch-on: its cell contradicts the others. It is found out and left out, while
/// acquisition loses nothing.
#[test]
fn a_board_with_a_faulty_cell_has_poses_of_the_others() {
    let mut talk = Talk::solving_on(&scene(), NoiseSource::Seeded(SEED), silicon().with(Fault::WeakEmitter));
    talk.start_poses();
    talk.run_ms(1_000.0);
    let status = talk.ear.status.expect("twice a second");
    assert_eq!((talk.ear.damaged(), status.scans_lost, status.adc_overruns), (0, 0, 0));
    let excluded = |record: &PoseRecord| record.status == PoseStatus::CellExcluded && record.excluded == 1 << 5;
    let first = talk.ear.poses.iter().position(|(_, (.., record))| excluded(record)).expect("found out");
    let schedule = talk.ear.schedule().clone();
    let begun = us(talk.ear.poses[first].1.1 - talk.ear.poses[0].1.1);
    let (mut squares, mut late, mut without) = (0.0_f64, Vec::new(), 0);
    for (_, (sequence, tick, record)) in &talk.ear.poses[first..] {
        if !record.status.has_pose() {
            without += 1;
            continue;
        }
        assert!(excluded(record), "frame {sequence}: {record:?}");
        let time_s = (*tick as f64 + schedule.reference_ticks()) / f64::from(schedule.tick_hz);
        squares += pose(record).displacement_from(&smooth().pose(time_s)).0.length_squared();
        late.push(u64::from(record.ready) * u64::from(READY_TICKS) - schedule.last_sample_ticks());
    }
    late.sort_unstable();
    let rms_um = (squares / late.len() as f64).sqrt() * 1e6;
    // Poses that have come are of now, though fewer than scans.
    let (over, (last, tick, record)) = talk.ear.poses[talk.ear.poses.len() - 1];
    let solved = talk.origin() + tick + u64::from(record.ready) * u64::from(READY_TICKS);
    println!("scan {last} of {}: its packet was over {:.0} us after the pose", status.scans_taken, us(over - solved));
    assert!(us(over - solved) < 20e3, "{}", us(over - solved));
    println!(
        "found out after {begun:.0} us; then {} poses, {} scans missed in all, load {} per mille, last conversion to pose \
         {:.0} us in the median, {:.0} at most; {rms_um:.1} um rms",
        late.len(),
        talk.ear.missed,
        status.cpu_load_permille,
        us(late[late.len() / 2]),
        us(late[late.len() - 1])
    );
    println!("{without} scans solved without a pose");
    assert!(without * 50 < late.len(), "{without}");
    // Without any one cell a frame errs by 5 to 7 um (`slitpose scene map wide`).
    assert!(rms_um < 12.0, "{rms_um}");
    assert!(begun < 100e3, "{begun}");
}

//! The solver of a board, which is a host's in `f32` with shorter optics, beside a host's in `f64`: the same words of a
//! simulated board, its tool moving at up to 0.5 m/s and 5 rad/s.

use glam::{DQuat, DVec3};
use slitpose_firmware::pose::{HEAD_BYTES, PoseSolver};
use slitpose_head::board_head;
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{Outcome, Pose, Solver, Tracker};
use slitpose_protocol::{Hashes, PoseStatus};
use slitpose_tests::capture::{Decoded, STREAM, capture, decode};
use slitpose_tests::consistency::{Sorted, worst_axis};
use slitpose_tests::scenes::{parse, wide_with};

/// Of noise and motion.
const SEED: u64 = 17;

/// Scans that pass before the motion is known.
const BEGINNING: usize = 50;

/// Largest logarithm of the ratio of two variances that are the same: 5 % of σ.
const SAME: f64 = 0.1;

/// How a board's poses differ from a host's.
struct Difference {
    /// In σ of the coordinate that differs most, of each scan of which both have a pose of all cells, and the same σ.
    sigmas: Sorted,
    /// Scans of which only one had lost track of the motion, so that its σ is another.
    apart: usize,
    /// Scans in which the host has such a pose and the board has not.
    lacking: usize,
}

impl Difference {
    /// Of a head over `seconds` at `frame_rate_hz`. The host's tracker takes the motion within a frame as exact once it is
    /// uncertain by less than `neglected` σ.
    fn of(mut file: SceneFile, frame_rate_hz: f64, seconds: f64, neglected: f64) -> Self {
        file.front_end.as_mut().expect("a front end").frame_rate_hz = frame_rate_hz;
        let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, SEED, seconds);
        let Decoded { schedule, scaling, scans, .. } =
            decode(&capture(&file, trajectory, STREAM, SEED, (frame_rate_hz * seconds) as usize));
        let head = board_head::compile(&file, &schedule, &scaling, Hashes::default()).expect("a head for a board");
        let mut board = PoseSolver::default();
        board.load(head.encode(&mut [0; HEAD_BYTES]).expect("room")).expect("whole");
        board.begin(&schedule);
        let stage = Stage::new(&file, &schedule, &scaling);
        let mut weighted = Stage::weighted_scene(&file, &schedule, &scaling);
        // As on the board.
        weighted.uncertainty.light_level_relative = 0.0;
        let solver = Solver::<f64>::new(&weighted, STREAM).expect("shipped").with_exposures(&stage.exposures_s());
        let mut host = Tracker::new(solver, frame_rate_hz.recip()).neglecting_motion(neglected);
        let mut difference = Self { sigmas: Sorted::default(), apart: 0, lacking: 0 };
        let mut sigmas = Vec::new();
        for (number, scan) in scans.iter().enumerate() {
            let solved = board.solve(scan).expect("a head for this schedule");
            let record = &solved.record;
            let solution = host.track(scan.sequence, &stage.photocurrents(scan)).solution;
            let Some(estimate) = solution.estimate.filter(|_| solution.outcome == Outcome::Converged) else { continue };
            if number < BEGINNING {
                continue;
            }
            if record.status != PoseStatus::Converged {
                difference.lacking += 1;
                continue;
            }
            let pose = Pose {
                rotation: DQuat::from_array(record.rotation_xyzw.map(f64::from)).normalize(),
                translation_m: DVec3::from_array(record.translation_m.map(f64::from)),
            };
            let variance = solved.covariance.map_or(0.0, |covariance| f64::from(covariance[0]));
            if (variance / estimate.covariance[0][0]).ln().abs() > SAME {
                difference.apart += 1;
                continue;
            }
            sigmas.push(worst_axis(&estimate, &pose));
        }
        difference.sigmas = Sorted::of(sigmas);
        println!(
            "{frame_rate_hz} Hz, seed {SEED}, motion neglected below {neglected} sigma: {} poses, {:.4} sigma rms, {:.3} for \
             99.9 %, {:.3} at worst, {} apart, {} lacking",
            difference.sigmas.0.len(),
            difference.rms(),
            difference.sigmas.at(0.999),
            difference.sigmas.most(),
            difference.apart,
            difference.lacking
        );
        difference
    }

    fn rms(&self) -> f64 {
        (self.sigmas.0.iter().map(|sigma| sigma * sigma).sum::<f64>() / self.sigmas.0.len() as f64).sqrt()
    }
}

fn wide() -> SceneFile {
    WIDE.read().expect("shipped")
}

/// What a board knows of the motion within a frame to less than this share of σ, it takes as exact.
const NEGLECTED: f64 = 0.15;

/// Asserts that all poses of a board differ from a host's by less than so many σ at worst and rms, but for so many scans of which
/// one side alone had lost track of the motion.
#[track_caller]
fn assert_alike(difference: &Difference, most: f64, rms: f64, apart: usize) {
    assert!(difference.sigmas.most() < most && difference.rms() < rms && difference.apart <= apart);
    assert_eq!(difference.lacking, 0);
}

#[test]
fn at_4_khz_a_board_has_the_poses_of_a_host() {
    // The arithmetic takes 1e-3 σ, the rest is what cells that are not linearised anew neglect: 0.015 σ rms, 0.15 at worst, a
    // fiftieth of the squared error. It goes with the square of a step in σ, and frames of 3 µm have a small one.
    assert_alike(&Difference::of(wide(), 4e3, 10.0, NEGLECTED), 0.2, 0.02, 0);
    // A host that neglects nothing. What the neglected takes of σ may be taken of the pose, too.
    assert_alike(&Difference::of(wide(), 4e3, 10.0, 0.0), 0.05 + NEGLECTED, 0.025, 0);
}

#[test]
fn at_1_khz_where_the_tool_goes_far_between_two_frames_a_board_lacks_no_pose() {
    assert_alike(&Difference::of(wide(), 1e3, 10.0, 0.0), 0.25, 0.01, 0);
}

/// At 1.5 kHz these motions are just too fast to be foreseen: three frames of a hundred are solved without knowing how the tool
/// moves within them, not always the same ones on both sides. None is without a pose.
#[test]
fn where_motion_is_hardly_foreseen_a_board_may_know_less_of_it_but_lacks_no_pose() {
    assert_alike(&Difference::of(wide(), 1.5e3, 10.0, 0.0), f64::INFINITY, 0.1, 750);
}

/// Emitters take turns for half a millisecond. Where it is a near thing whether the tool went on as foreseen, one side takes
/// its acceleration for known and the other does not, and their poses differ while they do.
#[test]
fn in_long_frames_a_board_lacks_no_pose() {
    let slots = ("slots = [[0, 2, 4], [1, 3, 5], []]", "slots = [[0], [1], [2], [3], [4], [5], []]");
    let file = parse(&wide_with(&[slots, ("oversampling = 8", "oversampling = 16")]));
    assert_alike(&Difference::of(file, 1e3, 5.0, NEGLECTED), 3.5, 0.5, usize::MAX);
}

/// In one frame of twelve an emitter is at a wall of its thick mask, where derivatives jump: there is time for a second step.
#[test]
fn at_2_khz_a_calibrated_board_has_the_poses_of_a_host() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/heads/calibrated_1.toml");
    let file = SceneFile::open(path).expect("a scene");
    assert_alike(&Difference::of(file, 2e3, 5.0, NEGLECTED), 0.15, 0.03, 9);
}

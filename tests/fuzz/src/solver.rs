//! The board's solver: the head that a host sends it, single against double precision, and its poses against the host's.

use std::sync::LazyLock;

use glam::DVec3;
use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_firmware::pose::{HEAD_BYTES, Head, PoseSolver};
use slitpose_head::board_head;
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_model::{CompiledScene, Outcome, Pose, Solver, Tier, Tracker};
use slitpose_protocol::{AdcScaling, Hashes, Level, PoseStatus, RawScan, Schedule};

/// Bytes before the payload: magic, version, length, checksum.
const HEADER_BYTES: usize = 12;

/// Bytes are no head, or a head that the board loads, too, and that encodes to bytes that are again that head; it solves
/// scans or says why not. The first bytes are the words of scans; the bytes after them count as they are, and with
/// length and checksum put right.
pub(crate) fn head(bytes: &[u8]) {
    let (words, bytes) = bytes.split_at(bytes.len().min(4));
    judge(words, bytes);
    judge(words, &repaired(bytes));
}

fn judge(words: &[u8], bytes: &[u8]) {
    let mut board = PoseSolver::default();
    let loaded = board.load(bytes);
    let head = match Head::decode(bytes) {
        Ok(head) => head,
        Err(error) => return assert_eq!(loaded, Err(error)),
    };
    assert_eq!(loaded, Ok(()));
    let mut room = [0; HEAD_BYTES];
    let again = head.encode(&mut room).expect("no longer than it came").to_vec();
    assert!(again.len() <= bytes.len());
    let head = Head::decode(&again).expect("as it was written");
    assert_eq!(head.encode(&mut [0; HEAD_BYTES]).expect("the same"), again);
    let schedule = head.readout.schedule.clone();
    board.begin(&schedule);
    for (sequence, &word) in (0..).zip(words) {
        let mut scan = RawScan::new(schedule.cells.into(), schedule.dark_slot().is_some());
        scan.sequence = sequence;
        scan.levels_mut().fill(if word == 0 { Level(0) } else { Level::NOMINAL });
        let lit = scan.lit_mut().iter_mut().zip(1_u16..);
        lit.for_each(|(pair, cell)| *pair = [u16::from(word) << 8, (u16::from(word) << 7).wrapping_add(cell)]);
        let solved = board.solve(&scan).expect("the schedule is its own");
        assert_eq!(solved.sequence, sequence);
    }
}

/// With length and checksum of what follows the header.
fn repaired(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes[..bytes.len().min(HEAD_BYTES)].to_vec();
    if let Some((header, payload)) = bytes.split_first_chunk_mut::<HEADER_BYTES>() {
        header[6..8].copy_from_slice(&(payload.len() as u16).to_le_bytes());
        let sum = crc32fast::hash(&[&header[4..8], payload].concat());
        header[8..].copy_from_slice(&sum.to_le_bytes());
    }
    bytes
}

/// Largest share by which a current in single precision may be off: the optics of a cell are some hundred operations of
/// 6·10⁻⁸ each, part of which cancel.
const SHARE: f64 = 1e-4;

/// Currents below this, amperes, are dark: the noise of a cell is a hundred times as much.
const DARK_A: f64 = 1e-11;

/// Distance of the poses of board and host in standard deviations: both have the same words, so that only their arithmetic
/// tells them apart.
const SIGMAS: f64 = 1.0;

/// What the board runs, and what its words are worth.
fn setup() -> (Schedule, AdcScaling) {
    (default_configuration().schedule, default_scaling())
}

static FILE: LazyLock<SceneFile> = LazyLock::new(|| WIDE.read().expect("shipped"));

/// A pose within the workspace of `wide`, a 16-bit number each axis; `None` if there are too few bytes.
fn pose(bytes: &[u8]) -> Option<Pose> {
    let share = |axis: usize| {
        let number = i16::from_le_bytes([*bytes.get(2 * axis)?, *bytes.get(2 * axis + 1)?]);
        Some(f64::from(number) / 32_768.0)
    };
    let translation = DVec3::new(share(0)?, share(1)?, share(2)?);
    let rotation = DVec3::new(share(3)?, share(4)?, share(5)?);
    Some(Pose::from_vectors(translation * FILE.workspace.half_extent_m, rotation * FILE.workspace.half_extent_rad))
}

/// The currents of a pose agree in both precisions.
pub(crate) fn single_and_double_agree(bytes: &[u8]) {
    static DOUBLE: LazyLock<CompiledScene<f64>> =
        LazyLock::new(|| CompiledScene::compile(&FILE.scene, Tier::Paper).expect("shipped"));
    static SINGLE: LazyLock<CompiledScene<f32>> =
        LazyLock::new(|| CompiledScene::compile(&FILE.scene, Tier::Paper).expect("shipped"));
    let Some(pose) = pose(bytes) else { return };
    for cell in 0..DOUBLE.cell_count() {
        let (double, single) = (DOUBLE.photocurrents(cell, &pose), SINGLE.photocurrents(cell, &pose));
        let whole = double.i_x1_a + double.i_x2_a;
        for (double, single) in [(double.i_x1_a, single.i_x1_a), (double.i_x2_a, single.i_x2_a)] {
            let off = (f64::from(single) - double).abs();
            assert!(off <= SHARE * whole.abs() + DARK_A, "cell {cell} at {pose:?}: {single} for {double}");
        }
    }
}

/// Of the words of a pose, which the bytes after it disturb, the board's pose is the host's, where both are sure.
pub(crate) fn board_and_host_agree(bytes: &[u8]) {
    static LIGHT: LazyLock<CompiledScene<f64>> =
        LazyLock::new(|| CompiledScene::compile(&FILE.scene, Tier::Exact { tolerance: 1e-6 }).expect("shipped"));
    static STAGE: LazyLock<Stage> = LazyLock::new(|| {
        let (schedule, scaling) = setup();
        Stage::new(&FILE, &schedule, &scaling)
    });
    static HEAD: LazyLock<Head> = LazyLock::new(|| {
        let (schedule, scaling) = setup();
        board_head::compile(&FILE, &schedule, &scaling, Hashes::default()).expect("slits and cosines")
    });
    static HOST: LazyLock<Tracker<f64>> = LazyLock::new(|| {
        let (schedule, scaling) = setup();
        let scene = Stage::weighted_scene(&FILE, &schedule, &scaling);
        let solver = Solver::new(&scene, Tier::Exact { tolerance: 1e-6 }).expect("shipped");
        let period_s = f64::from(schedule.frame_ticks) / f64::from(schedule.tick_hz);
        Tracker::new(solver.with_exposures(&STAGE.exposures_s()), period_s)
    });
    let Some(pose) = pose(bytes) else { return };
    let (schedule, scaling) = setup();
    let mut scan = RawScan::new(schedule.cells.into(), schedule.dark_slot().is_some());
    scan.levels_mut().fill(Level::NOMINAL);
    // A little above the words of no light: ambient light.
    let dark_word = (0.97 * scaling.zero_code * f64::from(schedule.oversampling)).trunc();
    if let Some(dark) = scan.dark_mut() {
        dark.fill([dark_word as u16; 2]);
    }
    let noise = |at: usize| bytes.get(12 + at).map_or(0.0, |&byte| f64::from(byte as i8) / 64.0);
    for (cell, words) in scan.lit_mut().iter_mut().enumerate() {
        let pair = LIGHT.photocurrents(cell, &pose);
        let amperes_per_word = f64::from(HEAD.readout.stages[cell].amperes_per_word);
        let word = |current: f64, at: usize| (dark_word + current / amperes_per_word + noise(at)).round() as u16;
        *words = [word(pair.i_x1_a, 2 * cell), word(pair.i_x2_a, 2 * cell + 1)];
    }

    let mut board = PoseSolver::default();
    board.load(HEAD.encode(&mut [0; HEAD_BYTES]).expect("room")).expect("whole");
    board.begin(&schedule);
    let solved = board.solve(&scan).expect("its schedule");
    let host = HOST.clone().track(scan.sequence, &STAGE.photocurrents(&scan)).solution;
    let are_sure = solved.record.status == PoseStatus::Converged && host.outcome == Outcome::Converged;
    let Some(estimate) = host.estimate.as_ref().filter(|_| are_sure) else { return };
    let found = DVec3::from_array(solved.record.translation_m.map(f64::from));
    let off = (found - estimate.pose.translation_m).to_array();
    for (axis, (off, sigma)) in off.into_iter().zip(estimate.sigma()).enumerate() {
        assert!(
            off.abs() <= SIGMAS * sigma + 1e-6,
            "axis {axis} at {pose:?}: off by {off} m, sigma {sigma} m, {:?} {:?}",
            solved.record,
            host
        );
    }
}

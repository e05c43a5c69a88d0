//! A hostile device on the port: its bytes through the pipeline.

use std::sync::LazyLock;

use slitpose::pipeline::{Item, Pipeline, PipelineError, SceneMatch};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_model::Tier;

use crate::framing::repaired;

/// That of a main thread, where `replay` runs: without optimisation a pipeline is moved about by value.
const STACK_BYTES: usize = 8 << 20;

/// Every scan is solved once, in the order of the board's numbers; each pose has a covariance of numbers; the same bytes in
/// two pieces give the same. Boards that do not suit the scene are refused.
pub(crate) fn hostile_board(bytes: &[u8]) {
    let (&cut, bytes) = bytes.split_first().unwrap_or((&0, &[]));
    let stream = repaired(bytes);
    let at = stream.len() * usize::from(cut) / 256;
    let judge = || assert_eq!(solve(&[&stream]), solve(&[&stream[..at], &stream[at..]]), "cut at {at}");
    std::thread::scope(|scope| {
        let judged = std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(scope, judge);
        judged.expect("a thread").join().unwrap_or_else(|reason| std::panic::resume_unwind(reason));
    });
}

/// The number of a scan, and the bits of its pose.
type Solved = (u64, Option<[u64; 3]>);

/// What came of the scans, and whether the board was refused.
fn solve(pieces: &[&[u8]]) -> (Vec<Solved>, bool) {
    static HEAD: LazyLock<SceneFile> = LazyLock::new(|| WIDE.read().expect("shipped"));
    let mut pipeline = Pipeline::new(HEAD.clone(), Tier::Paper, SceneMatch::Waived).watched();
    let (mut solved, mut scans) = (Vec::new(), 0_usize);
    let mut is_refused = false;
    for piece in pieces {
        let pushed = pipeline.push(piece, |item| {
            match item {
                Item::Scan(_) => scans += 1,
                Item::Pose(record) => {
                    let bits = record.solution.estimate.as_ref().map(|estimate| {
                        assert!(estimate.covariance.iter().flatten().all(|value| value.is_finite()), "{record:?}");
                        estimate.pose.translation_m.to_array().map(f64::to_bits)
                    });
                    solved.push((record.sequence, bits));
                }
                _ => {}
            }
            Ok::<_, PipelineError>(())
        });
        if pushed.is_err() {
            is_refused = true;
            break;
        }
    }
    assert!(solved.len() <= scans, "{} poses of {scans} scans", solved.len());
    (solved, is_refused)
}

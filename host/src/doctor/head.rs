//! Whether board, head and scene belong together.

use super::default_scene;
use crate::device::BoardInfo;
use slitpose_head::finding::Finding;
use slitpose_head::front_end::is_full_scale_of;
use slitpose_head::scene_file::{SceneFile, Shipped};

/// The scene for the measurement: the given one, the shipped one that the board belongs to, or the default one.
/// `None` if that contradicts the hash stored on the board.
pub(super) fn scene(given: Option<&SceneFile>, info: &BoardInfo, checks: &mut Vec<Finding>) -> Option<SceneFile> {
    let stored = info.hashes.scene;
    let scene = given.cloned().or_else(|| stored.and_then(Shipped::with_hash)).or_else(default_scene)?;
    let (name, hash) = (&scene.name, scene.hash);
    let (check, fits) = match stored {
        Some(stored) if stored == hash => {
            (Finding::ok("scene", format!("board and scene `{name}` have the hash {hash:016x}")), true)
        }
        Some(stored) => (
            Finding::failed(
                "scene",
                format!("the board belongs to a scene with hash {stored:016x}, `{name}` has {hash:016x}"),
                "give the scene of this head with --scene; if the head has changed, store it: slitpose device set --scene",
            ),
            false,
        ),
        None => (
            Finding::warning(
                "scene",
                format!("no scene is stored on the board; taking `{name}`, hash {hash:016x}"),
                "store the scene of this head: slitpose device set --scene FILE",
            ),
            true,
        ),
    };
    checks.push(check);
    fits.then_some(scene)
}

/// Whether front end and scene agree on the full scale.
pub(super) fn full_scale(scene: &SceneFile, info: &BoardInfo) -> Finding {
    let board_a = info.scaling.full_scale_a();
    let Some(front_end) = scene.front_end else {
        return Finding::failed(
            "full scale",
            format!("scene `{}` has no [front_end]", scene.name),
            "add one, or take the scene of this head",
        );
    };
    let scene_a = front_end.full_scale_a;
    let finding = format!("the board measures up to {:.3} uA, the scene says {:.3} uA", board_a * 1e6, scene_a * 1e6);
    if is_full_scale_of(board_a, scene_a) {
        Finding::ok("full scale", finding)
    } else {
        let next_step = "correct front_end.full_scale_a, or tell the board what its feedback resistors make: \
                         slitpose device set --scene FILE --full-scale UA";
        Finding::warning("full scale", finding, next_step)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use slitpose_protocol::Hashes;

    use super::*;
    use crate::device::{Conversation, SimulatedDevice};
    use slitpose_head::finding::Grade;
    use slitpose_head::scene_file::WIDE;

    fn info() -> BoardInfo {
        let device = SimulatedDevice::live(&WIDE.read().unwrap()).unwrap();
        Conversation::open(Box::new(device)).unwrap().introduce(Duration::from_secs(1)).unwrap()
    }

    fn looked(given: Option<&SceneFile>, stored: Option<u64>) -> (Grade, Option<String>) {
        let info = BoardInfo { hashes: Hashes { scene: stored, calibration: None }, ..info() };
        let mut checks = Vec::new();
        let scene = scene(given, &info, &mut checks);
        (checks[0].grade, scene.map(|scene| scene.origin))
    }

    #[test]
    fn the_scene_of_the_board_is_taken_and_no_other() {
        let wide = WIDE.read().unwrap();
        let named = || Some("wide".to_owned());
        assert_eq!(looked(None, Some(wide.hash)), (Grade::Ok, named()));
        assert_eq!(looked(Some(&wide), Some(wide.hash)), (Grade::Ok, named()));
        assert_eq!(looked(None, None), (Grade::Warning, named()));
        assert_eq!(looked(Some(&wide), Some(!wide.hash)), (Grade::Failed, None));
    }

    #[test]
    fn another_front_end_is_pointed_out() {
        let (wide, mut info) = (WIDE.read().unwrap(), info());
        assert_eq!(full_scale(&wide, &info).grade, Grade::Ok);
        info.scaling.amperes_per_code *= 1.02;
        let check = full_scale(&wide, &info);
        assert!(check.grade == Grade::Warning && check.text.contains("10.200 uA"), "{check}");
        assert_eq!(full_scale(&SceneFile { front_end: None, ..wide }, &info).grade, Grade::Failed);
    }
}

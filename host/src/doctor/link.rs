//! Ports, permissions, whether a board answers, and whether board, head and scene belong together.

use slitpose_head::causes::with_causes;
use slitpose_head::finding::{Finding, Grade};
use slitpose_head::front_end::is_full_scale_of;
use slitpose_head::scene_file::{SceneFile, Shipped};
use slitpose_head::simulator::TrajectoryKind;

use super::{Subject, default_scene, judged};
use crate::device::{
    BoardInfo, Conversation, Device, DeviceError, Port, Search, Selector, SerialDevice, SimulatedDevice, find, ports,
};
use crate::platform::{holders, port_permission};
use slitpose_tracking::link::Versions;

/// Opens the board and reads its hello; `None` if that cannot be understood, and a finding if it fails.
pub(super) fn reach(
    subject: &Subject<'_>,
    checks: &mut Vec<Finding>,
) -> Result<Option<(Conversation, BoardInfo)>, Finding> {
    let device = match subject.device {
        Selector::Sim => {
            checks.push(Finding::skipped("port", "a simulated board has no port"));
            let Some(scene) = subject.scene.cloned().or_else(default_scene) else { return Ok(None) };
            let next_step = "correct the scene, or take a shipped one";
            let device = SimulatedDevice::for_trials(&scene, TrajectoryKind::Smooth);
            Box::new(device.map_err(|error| Finding::failed("scene", with_causes(&error), next_step))?)
        }
        selector => open(selector, subject.search, checks)?,
    };
    let next_step = "reset the board, or flash it again";
    let reached = Conversation::introduced(device);
    let (board, info) = reached.map_err(|error| Finding::failed("hello", with_causes(&error), next_step))?;
    let (hello, understood) = judge(&info);
    checks.extend(hello);
    Ok(understood.then_some((board, info)))
}

fn open(selector: &Selector, search: &[Search], checks: &mut Vec<Finding>) -> Result<Box<dyn Device>, Finding> {
    checks.push(of_ports(ports()));
    let found = find(selector, search);
    let next_step = "`slitpose device list` shows what there is";
    let port = found.map_err(|error| Finding::failed("board", with_causes(&error), next_step))?.name;
    checks.push(port_permission(&port));
    let device = SerialDevice::open(&port).map_err(|error| {
        let holders: String = holders(&port).iter().map(|holder| format!("; {holder} has it open")).collect();
        let busy = matches!(error, DeviceError::Busy { .. });
        let next_step = if busy { "end the program that has the port open" } else { "see the error in the line above" };
        Finding::failed("exclusive", with_causes(&error) + &holders, next_step)
    })?;
    checks.push(Finding::ok("exclusive", "no other program has the port open"));
    Ok(Box::new(device))
}

fn of_ports(listed: Result<Vec<Port>, DeviceError>) -> Finding {
    match listed {
        Ok(ports) => {
            let boards = ports.iter().filter(|port| port.is_board()).count();
            let debuggers = ports.iter().filter(|port| port.is_debugger()).count();
            let count = ports.len();
            Finding::ok("ports", format!("{count} serial ports, of which boards: {boards}, debuggers: {debuggers}"))
        }
        Err(error) => Finding::warning("ports", with_causes(&error), "give the path of the port with --device"),
    }
}

/// Findings on a board's hello, and whether it is understood.
pub(super) fn judge(info: &BoardInfo) -> (Vec<Finding>, bool) {
    use slitpose_protocol::ResetCause::{BrownOut, Panic, StackOverflow, Watchdog};
    let who =
        format!("{} ({} board), serial {}, firmware {}", info.board, info.kind_name(), info.device, info.firmware);
    let mut checks = vec![Finding::ok("hello", who)];
    checks.push(match info.mismatch {
        None => Finding::ok("version", format!("board and program both speak protocol {}", info.protocol)),
        Some(mismatch) => Finding::failed(
            "version",
            format!("{}; {mismatch}", Versions { board: info.protocol }),
            "update whichever is older",
        ),
    });
    let cause = info.reset_cause_name();
    checks.push(match info.reset_cause {
        BrownOut => Finding::warning("last start", cause, "check cable and supply: the supply voltage dropped"),
        Watchdog | Panic | StackOverflow => {
            Finding::warning("last start", cause, "update the firmware; if it happens again, report it")
        }
        _ => Finding::ok("last start", cause),
    });
    (checks, info.mismatch.is_none())
}

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
    let next_step = "correct front_end.full_scale_a, or tell the board what its feedback resistors make: \
                     slitpose device set --scene FILE --full-scale UA";
    judged("full scale", finding, [(!is_full_scale_of(board_a, scene_a), Grade::Warning, next_step)])
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::WIDE;
    use slitpose_protocol::{Hashes, ResetCause};

    use super::*;

    fn info() -> BoardInfo {
        let device = SimulatedDevice::for_trials(&default_scene().unwrap(), TrajectoryKind::Smooth).unwrap();
        Conversation::introduced(Box::new(device)).unwrap().1
    }

    #[test]
    fn a_board_that_was_reset_by_trouble_is_pointed_out() {
        let verdicts = |info: &BoardInfo| judge(info).0.iter().map(|check| check.grade).collect::<Vec<_>>();
        assert_eq!(verdicts(&info()), [Grade::Ok; 3]);
        for reset_cause in [ResetCause::BrownOut, ResetCause::Watchdog, ResetCause::Panic, ResetCause::StackOverflow] {
            assert_eq!(verdicts(&BoardInfo { reset_cause, ..info() })[2], Grade::Warning);
        }
    }

    #[test]
    fn a_board_of_another_build_is_not_measured() {
        let mismatch = slitpose_protocol::schema::SchemaMismatch { name: "Batch", ours: 1, theirs: 2 };
        let (checks, understood) = judge(&BoardInfo { mismatch: Some(mismatch), ..info() });
        assert!(!understood && checks[1].grade == Grade::Failed, "{checks:?}");
        assert!(checks[1].text.contains("different builds") && checks[1].text.contains("Batch"));
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

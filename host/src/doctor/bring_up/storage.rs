//! Settings over a power cut: a schedule and the hash of the scene are stored, and must be back at the next start.
//!
//! What a board has stored before is not overwritten: then its hashes and its schedule must be the same after the cut.

use std::time::{Duration, Instant};

use slitpose_protocol::{BootTarget, Hashes, Level, Schedule, SettingsSource};

use super::bench::{Bench, BenchError};
use super::sampling;
use crate::device::{BoardInfo, Conversation, DeviceError};
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;

/// Time for the board to disconnect after Reboot, and for it to be there again.
const DISCONNECTED: Duration = Duration::from_millis(500);
const BACK_WITHIN: Duration = Duration::from_secs(15);
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Timeout of the hello that shows what was stored.
const HELLO_WITHIN: Duration = Duration::from_secs(1);

#[derive(Clone, Debug, PartialEq)]
struct Stored {
    hashes: Hashes,
    schedule: Schedule,
}

impl From<BoardInfo> for Stored {
    fn from(info: BoardInfo) -> Self {
        Self { hashes: info.hashes, schedule: info.schedule }
    }
}

pub(super) fn take(bench: &mut Bench<'_>, cut_power: &mut dyn FnMut() -> bool) -> Result<Vec<Finding>, BenchError> {
    if bench.is_simulated() {
        return Ok(vec![Finding::skipped("storage", "a simulated board stores nothing")]);
    }
    // What a start brings is the reference; the configuration in force may be another.
    let (board, _) = bench.connect()?;
    let (mut board, info) = restart(bench, board)?;
    let had_settings = board.status()?.settings != SettingsSource::Defaults || info.hashes != Hashes::default();
    let before = if had_settings {
        Stored::from(info)
    } else {
        // One frame in two: a schedule that no board starts with.
        let schedule = bench.schedule()?;
        board
            .configure(sampling::at(Schedule { frame_ticks: 2 * schedule.frame_ticks, ..schedule }, Level::NOMINAL))?;
        let hashes = Hashes { scene: Some(bench.scene.hash), ..Hashes::default() };
        if let Err(error) = board.store(hashes) {
            return Ok(vec![refused(&error)]);
        }
        Stored::from(board.introduce(HELLO_WITHIN)?)
    };
    drop(board);
    let is_cut = cut_power();
    let after = if is_cut {
        reconnect(bench)?.1
    } else {
        let (board, _) = bench.connect()?;
        restart(bench, board)?.1
    };
    let after = Stored::from(after);
    let mut findings = vec![judge(&before, &after, is_cut)];
    if !had_settings {
        let (mut board, _) = bench.connect()?;
        findings.push(match board.forget_stored() {
            Ok(()) => Finding::ok("forget", "the settings of this test are erased again"),
            Err(error) => {
                Finding::failed("forget", with_causes(&error), "store the settings of the head: device set --scene")
            }
        });
    }
    Ok(findings)
}

fn restart(bench: &mut Bench<'_>, mut board: Conversation) -> Result<(Conversation, BoardInfo), BenchError> {
    board.reboot(BootTarget::Firmware)?;
    drop(board);
    std::thread::sleep(DISCONNECTED);
    reconnect(bench)
}

/// Connects to a board that may take a while to be there.
fn reconnect(bench: &mut Bench<'_>) -> Result<(Conversation, BoardInfo), BenchError> {
    let until = Instant::now() + BACK_WITHIN;
    loop {
        match bench.connect() {
            Err(BenchError::Device(_)) if Instant::now() < until => std::thread::sleep(LOOK_EVERY),
            outcome => return outcome,
        }
    }
}

fn refused(error: &DeviceError) -> Finding {
    let next_step = "option byte DBANK must be 1, and the image must have the feature storage; if both are so, change the \
                     MCU: its flash is worn out";
    Finding::failed("storage", format!("the board does not store its settings: {}", with_causes(error)), next_step)
}

fn judge(before: &Stored, after: &Stored, is_cut: bool) -> Finding {
    let how = if is_cut { "the power cut" } else { "a reboot" };
    let scene = |stored: &Stored| stored.hashes.scene.map_or("none".to_owned(), |hash| format!("{hash:016x}"));
    let rate = |stored: &Stored| stored.schedule.frame_rate_hz();
    let text = format!(
        "hash of the scene {}, {:.0} frames/s stored; after {how} {}, {:.0} frames/s",
        scene(before),
        rate(before),
        scene(after),
        rate(after)
    );
    if before == after {
        Finding::ok("storage", text)
    } else {
        let next_step = "store once more and take this step again; if settings are lost again, the flash or its supply at \
                         the cut is at fault: run from the scene file with --scene, and change the MCU";
        Finding::failed("storage", format!("{text}: settings are lost"), next_step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;
    use slitpose_head::front_end;
    use slitpose_head::scene_file::WIDE;

    #[test]
    fn lost_hashes_and_lost_schedules_are_found() {
        let schedule = front_end::configuration(&WIDE.read().unwrap()).unwrap().schedule;
        let stored = Stored { hashes: Hashes { scene: Some(7), calibration: None }, schedule };
        assert_eq!(judge(&stored, &stored, true).grade, Grade::Ok);
        let hashes = Stored { hashes: Hashes::default(), ..stored.clone() };
        let lost = judge(&stored, &hashes, false);
        assert!(lost.grade == Grade::Failed && lost.text.contains("after a reboot none"), "{lost}");
        let mut slower = stored.clone();
        slower.schedule.frame_ticks *= 2;
        assert_eq!(judge(&stored, &slower, true).grade, Grade::Failed);
    }
}

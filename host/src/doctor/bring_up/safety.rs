//! Whether the board is dark after Stop, and without a host.

use std::time::{Duration, Instant};

use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_protocol::{BootTarget, Hashes, Level, Schedule, SettingsSource, Status};

use super::bench::{Bench, BenchError, sample};
use super::sampling;
use crate::device::{BoardInfo, Conversation, DeviceError};

const SCANS: usize = 40;

/// Time without a host. By its own USB port the board goes dark after 0.5 s, by a serial line after 2 s of silence and
/// 0.5 s more.
const CLOSED_OWN_PORT: Duration = Duration::from_secs(1);
const CLOSED_SERIAL: Duration = Duration::from_secs(3);

pub(super) fn take(bench: &mut Bench<'_>) -> Result<Vec<Finding>, BenchError> {
    let (mut board, _) = bench.connect()?;
    let configuration = sampling::at(bench.schedule()?, Level::NOMINAL);
    let taken = sample(&mut board, configuration, SCANS)?.scans.len();
    let mut findings = vec![judge(After::Stop, &[board.status()?, board.status()?], taken)];
    if bench.is_simulated() {
        findings.push(Finding::skipped("port closed", "a simulated board has no port"));
        return Ok(findings);
    }
    board.start()?;
    while board.listen()? && board.received().is_empty() {}
    board.abandon();
    let closed = if bench.has_own_port() { CLOSED_OWN_PORT } else { CLOSED_SERIAL };
    std::thread::sleep(closed);
    let (mut board, _) = bench.connect()?;
    let statuses = [board.status()?, board.status()?];
    // Whatever was found, it is dark now.
    board.stop(crate::device::Keep::Replies)?;
    findings.push(judge(After::Closed(closed), &statuses, taken));
    Ok(findings)
}

/// What the emitters should be off after.
#[derive(Clone, Copy, Debug)]
enum After {
    Stop,
    Closed(Duration),
}

/// Two successive statuses, and the scans that were taken before.
fn judge(after: After, statuses: &[Status; 2], taken: usize) -> Finding {
    let (place, when) = match after {
        After::Stop => ("stop", format!("after {taken} frames and Stop")),
        After::Closed(closed) => ("port closed", format!("after the port was closed for {} s", closed.as_secs())),
    };
    let [first, second] = statuses;
    if first.acquiring || second.acquiring || first.scans_taken != second.scans_taken {
        let frames = second.scans_taken.saturating_sub(first.scans_taken);
        let text = format!("{when} the board is still acquiring: {frames} frames between two statuses");
        return Finding::failed(
            place,
            text,
            "disconnect the emitters' supply: they may be lit; flash the firmware again, and report it",
        );
    }
    Finding::ok(
        place,
        format!("{when} the board is idle, emitters off; confirm 0 V over the 3.3 ohm with an oscilloscope"),
    )
}

// What a board has stored before is not overwritten: then its hashes and its schedule must be the same after the cut.

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

pub(super) fn take_storage(
    bench: &mut Bench<'_>,
    cut_power: &mut dyn FnMut() -> bool,
) -> Result<Vec<Finding>, BenchError> {
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
    let mut findings = vec![judge_storage(&before, &after, is_cut)];
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

fn judge_storage(before: &Stored, after: &Stored, is_cut: bool) -> Finding {
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
pub(super) mod tests {
    use super::*;
    use crate::device::SimulatedDevice;
    use slitpose_head::finding::Grade;
    use slitpose_head::front_end;
    use slitpose_head::scene_file::WIDE;

    pub(in super::super) fn status() -> Status {
        let device = SimulatedDevice::at_rest(&WIDE.read().unwrap()).unwrap();
        Conversation::open(Box::new(device)).unwrap().status().unwrap()
    }

    #[test]
    fn a_board_that_goes_on_is_found_by_its_state_or_by_its_count() {
        let idle = status();
        let status = |acquiring, scans_taken| Status { acquiring, scans_taken, ..idle };
        let grade = |first, second| judge(After::Stop, &[first, second], 40).grade;
        assert_eq!(grade(status(false, 44), status(false, 44)), Grade::Ok);
        assert_eq!(grade(status(true, 44), status(false, 44)), Grade::Failed);
        assert_eq!(grade(status(false, 44), status(false, 45)), Grade::Failed);
        let closed = judge(After::Closed(CLOSED_OWN_PORT), &[status(true, 0), status(true, 2_000)], 40);
        assert!(closed.text.contains("closed for 1 s") && closed.text.contains("2000 frames"), "{closed}");
    }

    #[test]
    fn lost_hashes_and_lost_schedules_are_found() {
        let schedule = front_end::configuration(&WIDE.read().unwrap()).unwrap().schedule;
        let stored = Stored { hashes: Hashes { scene: Some(7), calibration: None }, schedule };
        assert_eq!(judge_storage(&stored, &stored, true).grade, Grade::Ok);
        let hashes = Stored { hashes: Hashes::default(), ..stored.clone() };
        let lost = judge_storage(&stored, &hashes, false);
        assert!(lost.grade == Grade::Failed && lost.text.contains("after a reboot none"), "{lost}");
        let mut slower = stored.clone();
        slower.schedule.frame_ticks *= 2;
        assert_eq!(judge_storage(&stored, &slower, true).grade, Grade::Failed);
    }
}

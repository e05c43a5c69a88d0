//! Whether the board is dark after Stop, and without a host.

use std::time::Duration;

use slitpose_protocol::{Level, Status};

use super::bench::{Bench, BenchError, sample};
use super::sampling;
use slitpose_head::finding::Finding;

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

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::device::{Conversation, SimulatedDevice};
    use slitpose_head::finding::Grade;
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
}

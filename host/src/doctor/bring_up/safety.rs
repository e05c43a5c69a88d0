//! The board itself: link and start, supply and temperature; whether it is dark after Stop and without a host, and keeps
//! its settings over a power cut; whether trigger input and frame output work.

use std::time::Duration;

use anyhow::Result;
use slitpose_protocol::{BootTarget, Command, Edge, Hashes, Level, Pulse, Schedule, SettingsSource, Status};

use super::bench::{Bench, Wiring, sample, sample_with};
use super::sampling;
use crate::device::{ANSWER_WITHIN, BoardInfo, Conversation, DeviceError};
use crate::doctor::{judged, link, measurement, named};
use slitpose_head::causes::with_causes;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::Failed;

/// Duration of the measurement, seconds.
const DURATION_S: f64 = 2.0;

pub(super) fn link(bench: &mut Bench) -> Result<Vec<Finding>> {
    let (mut board, info) = bench.connect()?;
    let (mut findings, _) = link::judge(&info);
    let dark = sampling::at(bench.schedule()?, Level(0));
    let measured = measurement::measure(&mut board, &bench.scene, dark, DURATION_S, &mut Vec::new())?;
    findings.extend(measured.dark_checks());
    Ok(findings)
}

pub(super) fn supply(bench: &mut Bench) -> Result<Vec<Finding>> {
    let status = bench.connect()?.0.status()?;
    Ok(judge_supply(&status).into())
}

fn judge_supply(status: &Status) -> [Finding; 2] {
    let volts = status.supply_v;
    let range = measurement::SUPPLY_V;
    let text = format!("V_DDA {volts:.3} V, expected {:.3} to {:.3} V", range.start(), range.end());
    // NaN is in no range.
    let next_step = "measure 3.3 V and V_DDA: regulator, cable, a short or a load that does not \
                     belong there; currents scale with V_DDA";
    let supply = judged("supply", text, [(!range.contains(&volts), Failed, next_step)]);
    let text = format!("MCU at {:.1} C, expected -40 to 85 C", status.temperature_k - 273.15);
    let is_hot = !measurement::TEMPERATURE_K.contains(&status.temperature_k);
    let next_step = "if the MCU is hot, switch the supply off at once: one of its pins drives against another output";
    [supply, judged("temperature", text, [(is_hot, Failed, next_step)])]
}

// Dark, and settings.

const SCANS: usize = 40;

/// Time without a host. By its own USB port the board goes dark after 0.5 s, by a serial line after 2 s of silence and
/// 0.5 s more.
const CLOSED_OWN_PORT: Duration = Duration::from_secs(1);
const CLOSED_SERIAL: Duration = Duration::from_secs(3);

pub(super) fn take(bench: &mut Bench) -> Result<Vec<Finding>> {
    let (mut board, _) = bench.connect()?;
    let configuration = sampling::at(bench.schedule()?, Level::NOMINAL);
    let taken = sample(&mut board, configuration, SCANS)?.scans.len();
    let when = format!("after {taken} frames and Stop");
    let mut findings = vec![judge("stop", &when, &[board.status()?, board.status()?])];
    if bench.is_simulated() {
        findings.push(Finding::skipped("port closed", "a simulated board has no port"));
        return Ok(findings);
    }
    board.start()?;
    while board.listen()? && board.received().is_empty() {}
    board.abandon();
    let closed = if bench.contact.has_own_port() { CLOSED_OWN_PORT } else { CLOSED_SERIAL };
    std::thread::sleep(closed);
    let (mut board, _) = bench.connect()?;
    let statuses = [board.status()?, board.status()?];
    // Whatever was found, it is dark now.
    board.stop()?;
    let when = format!("after the port was closed for {} s", closed.as_secs());
    findings.push(judge("port closed", &when, &statuses));
    Ok(findings)
}

/// Two successive statuses, after `when`, which is when the emitters should be off.
fn judge(place: &'static str, when: &str, [first, second]: &[Status; 2]) -> Finding {
    if first.acquiring || second.acquiring || first.scans_taken != second.scans_taken {
        let frames = second.scans_taken.saturating_sub(first.scans_taken);
        let text = format!("{when} the board is still acquiring: {frames} frames between two statuses");
        let next_step = "disconnect the emitters' supply: they may be lit; flash the firmware again, and report it";
        return Finding::failed(place, text, next_step);
    }
    let text = format!("{when} the board is idle, emitters off; confirm 0 V over the 3.3 ohm with an oscilloscope");
    Finding::ok(place, text)
}

// What a board has stored before is not overwritten: then its hashes and its schedule must be the same after the cut.

/// Time for the board to disconnect after Reboot, and for it to be there again.
const DISCONNECTED: Duration = Duration::from_millis(500);
const BACK_WITHIN: Duration = Duration::from_secs(15);

type Stored = (Hashes, Schedule);

pub(super) fn take_storage(bench: &mut Bench) -> Result<Vec<Finding>> {
    if bench.is_simulated() {
        return Ok(vec![Finding::skipped("storage", "a simulated board stores nothing")]);
    }
    // What a start brings is the reference; the configuration in force may be another.
    let (board, _) = bench.connect()?;
    let (mut board, info) = restart(bench, board)?;
    let had_settings = board.status()?.settings != SettingsSource::Defaults || info.hashes != Hashes::default();
    let before = if had_settings {
        (info.hashes, info.schedule)
    } else {
        // One frame in two: a schedule that no board starts with.
        let schedule = bench.schedule()?;
        board
            .configure(sampling::at(Schedule { frame_ticks: 2 * schedule.frame_ticks, ..schedule }, Level::NOMINAL))?;
        let hashes = Hashes { scene: Some(bench.scene.hash), ..Hashes::default() };
        if let Err(error) = board.order(Command::Store(hashes)) {
            return Ok(vec![refused(&error)]);
        }
        let info = board.introduce(ANSWER_WITHIN)?;
        (info.hashes, info.schedule)
    };
    drop(board);
    let is_cut = (bench.cut_power)();
    let after = if is_cut {
        bench.reconnect(BACK_WITHIN)?.1
    } else {
        let (board, _) = bench.connect()?;
        restart(bench, board)?.1
    };
    let mut findings = vec![judge_storage(&before, &(after.hashes, after.schedule), is_cut)];
    if !had_settings {
        let (mut board, _) = bench.connect()?;
        findings.push(match board.order(Command::Forget) {
            Ok(()) => Finding::ok("forget", "the settings of this test are erased again"),
            Err(error) => {
                Finding::failed("forget", with_causes(&error), "store the settings of the head: device set --scene")
            }
        });
    }
    Ok(findings)
}

fn restart(bench: &mut Bench, mut board: Conversation) -> Result<(Conversation, BoardInfo)> {
    board.order(Command::Reboot(BootTarget::Firmware))?;
    drop(board);
    std::thread::sleep(DISCONNECTED);
    bench.reconnect(BACK_WITHIN)
}

fn refused(error: &DeviceError) -> Finding {
    let next_step = "option byte DBANK must be 1, and the image must have the feature storage; if both are so, change the \
                     MCU: its flash is worn out";
    Finding::failed("storage", format!("the board does not store its settings: {}", with_causes(error)), next_step)
}

fn judge_storage(before: &Stored, after: &Stored, is_cut: bool) -> Finding {
    let how = if is_cut { "the power cut" } else { "a reboot" };
    let scene = |stored: &Stored| stored.0.scene.map_or("none".to_owned(), |hash| format!("{hash:016x}"));
    let rate = |stored: &Stored| stored.1.frame_rate_hz();
    let text = format!(
        "hash of the scene {}, {:.0} frames/s stored; after {how} {}, {:.0} frames/s",
        scene(before),
        rate(before),
        scene(after),
        rate(after)
    );
    let next_step = "store once more and take this step again; if settings are lost again, the flash or its supply at the \
                     cut is at fault: run from the scene file with --scene, and change the MCU";
    named("storage", text, &[(before != after, Failed, "settings are lost", next_step)])
}

// Trigger input and frame output: a wire between them brings each pulse back as two edges.

/// Scans, and how many of them at the end may be here before their edges.
const TRIGGER_SCANS: usize = 400;
const LAST_SCANS: usize = 40;

/// Frames from one pulse to the next.
const EVERY: u16 = 10;

pub(super) fn take_trigger(bench: &mut Bench) -> Result<Vec<Finding>> {
    if bench.is_simulated() {
        return Ok(vec![Finding::skipped("trigger", "a simulated board has no frame output")]);
    }
    let (mut board, _) = bench.connect()?;
    let dark = sampling::at(bench.schedule()?, Level(0));
    let sampling = sample_with(&mut board, dark, Pulse { every: EVERY, slot: 0 }, TRIGGER_SCANS)?;
    let scans = &sampling.scans[..sampling.scans.len().saturating_sub(LAST_SCANS)];
    let frames = scans.iter().filter(|scan| scan.sequence % u64::from(EVERY) == 0).map(|scan| scan.tick);
    Ok(vec![judge_trigger(&frames.collect::<Vec<_>>(), &sampling.edges, &sampling.schedule, bench.wiring)])
}

/// `frames`: ticks of the frames with a pulse in their first slot.
fn judge_trigger(frames: &[u64], edges: &[Edge], schedule: &Schedule, wiring: Wiring) -> Finding {
    let within = |from: u64, ticks: u32| edges.iter().filter(move |edge| edge.tick().wrapping_sub(from) < ticks.into());
    let is_back = |at: &&u64| within(**at, schedule.slot_ticks).any(|edge| edge.is_high());
    let (asked, back) = (frames.len(), frames.iter().filter(is_back).count());
    let in_these: usize = frames.iter().map(|&at| within(at, u32::from(EVERY) * schedule.frame_ticks).count()).sum();
    let [output, input] = ["frame output", "trigger input"].map(|signal| wiring.named(signal));
    let text = format!("{back} of {asked} pulses of the {output} came back at the {input}, as {in_these} edges");
    let is_faulty = asked == 0 || back != asked || in_these != 2 * asked;
    judged(
        "trigger",
        text,
        [(is_faulty, Failed, "join the two by a wire, and take other signals off the trigger input")],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples;
    use slitpose_head::finding::Grade::{Failed, Ok};

    #[test]
    fn a_board_that_goes_on_is_found_by_its_state_or_by_its_count() {
        let status = |acquiring, scans_taken| Status { acquiring, scans_taken, ..samples::status() };
        let grade = |first, second| judge("stop", "after Stop", &[first, second]).grade;
        assert_eq!(grade(status(false, 44), status(false, 44)), Ok);
        assert_eq!(grade(status(true, 44), status(false, 44)), Failed);
        assert_eq!(grade(status(false, 44), status(false, 45)), Failed);
    }

    #[test]
    fn a_supply_of_three_volts_is_too_low() {
        let grades = |supply_v, temperature_k| {
            let status = Status { supply_v, temperature_k, ..samples::status() };
            judge_supply(&status).map(|finding| finding.grade)
        };
        assert_eq!(grades(3.3, 300.0), [Ok, Ok]);
        assert_eq!(grades(3.0, 300.0), [Failed, Ok]);
        assert_eq!(grades(f32::NAN, f32::NAN), [Failed, Failed]);
        assert_eq!(grades(3.3, 400.0), [Ok, Failed]);
    }

    #[test]
    fn a_missing_wire_and_other_signals_are_told_from_pulses_that_come_back() {
        let schedule = slitpose_firmware::pcb::default_configuration().schedule;
        let frames: Vec<u64> = (0..36).map(|k| 1_000_000 + 425_000 * k).collect();
        let pulse = |at: &u64| [Edge::new(at + 2_114, true), Edge::new(at + 7_914, false)];
        let edges: Vec<Edge> = frames.iter().flat_map(pulse).collect();
        let grade = |edges: &[Edge]| judge_trigger(&frames, edges, &schedule, Wiring::Nucleo).grade;
        assert_eq!(grade(&edges), Ok);
        let other = [&edges[..], &pulse(&1_200_000)].concat();
        assert_eq!([grade(&[]), grade(&edges[2..]), grade(&other)], [Failed; 3]);
    }
}

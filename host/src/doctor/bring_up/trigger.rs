//! Trigger input and frame output: a wire between them brings each pulse back as two edges.

use anyhow::Result;
use slitpose_protocol::{Edge, Level, Pulse, Schedule};

use super::bench::{Bench, Wiring, sample_with};
use super::sampling;
use crate::doctor::judged;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::Failed;

/// Scans, and how many of them at the end may be here before their edges.
const SCANS: usize = 400;
const LAST_SCANS: usize = 40;

/// Frames from one pulse to the next.
const EVERY: u16 = 10;

pub(super) fn take(bench: &mut Bench) -> Result<Vec<Finding>> {
    if bench.is_simulated() {
        return Ok(vec![Finding::skipped("trigger", "a simulated board has no frame output")]);
    }
    let (mut board, _) = bench.connect()?;
    let dark = sampling::at(bench.schedule()?, Level(0));
    let sampling = sample_with(&mut board, dark, Pulse { every: EVERY, slot: 0 }, SCANS)?;
    let scans = &sampling.scans[..sampling.scans.len().saturating_sub(LAST_SCANS)];
    let frames = scans.iter().filter(|scan| scan.sequence % u64::from(EVERY) == 0).map(|scan| scan.tick);
    Ok(vec![judge(&frames.collect::<Vec<_>>(), &sampling.edges, &sampling.schedule, bench.wiring)])
}

/// `frames`: ticks of the frames with a pulse in their first slot.
fn judge(frames: &[u64], edges: &[Edge], schedule: &Schedule, wiring: Wiring) -> Finding {
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
    use slitpose_head::finding::Grade;

    #[test]
    fn a_missing_wire_and_other_signals_are_told_from_pulses_that_come_back() {
        let schedule = slitpose_firmware::pcb::default_configuration().schedule;
        let frames: Vec<u64> = (0..36).map(|k| 1_000_000 + 425_000 * k).collect();
        let pulse = |at: &u64| [Edge::new(at + 2_114, true), Edge::new(at + 7_914, false)];
        let edges: Vec<Edge> = frames.iter().flat_map(pulse).collect();
        let grade = |edges: &[Edge]| judge(&frames, edges, &schedule, Wiring::Nucleo).grade;
        assert_eq!(grade(&edges), Grade::Ok);
        let other = [&edges[..], &pulse(&1_200_000)].concat();
        assert_eq!([grade(&[]), grade(&edges[2..]), grade(&other)], [Failed; 3]);
    }
}

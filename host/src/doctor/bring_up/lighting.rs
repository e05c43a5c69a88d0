//! Configurations for single measurements, from that of a scene.
//!
//! The dark slot comes first, after the idle rest of the frame: so dark words hold no light that has not settled.

use slitpose_protocol::{Configuration, EmitterSet, Exposure, Level, MAX_CELLS, Schedule};

/// The schedule of `base` with a dark slot, then one slot for each of `groups`, whose emitters are lit together. The
/// frame is at least as long as that of `base`, with a rest of two settling times.
pub(super) fn grouped(base: &Schedule, groups: &[Vec<usize>]) -> Schedule {
    let conversions = u32::from(base.cells) * u32::from(base.oversampling);
    let slot_ticks = base.slot_ticks.max(base.settling_ticks + conversions * base.conversion_ticks);
    let frame_ticks = (groups.len() as u32 + 1) * slot_ticks + 2 * base.settling_ticks;
    Schedule {
        frame_ticks: frame_ticks.max(base.frame_ticks),
        slots: std::iter::once(EmitterSet::DARK).chain(groups.iter().map(|group| EmitterSet::of(group))).collect(),
        slot_ticks,
        ..base.clone()
    }
}

/// The same with each emitter alone.
pub(super) fn alone(base: &Schedule) -> Schedule {
    let singles: Vec<_> = (0..usize::from(base.cells)).map(|emitter| vec![emitter]).collect();
    grouped(base, &singles)
}

/// `schedule` with all emitters at `level`.
pub(super) fn at(schedule: Schedule, level: Level) -> Configuration {
    let cells = usize::from(schedule.cells);
    let levels = [level; MAX_CELLS].into_iter().take(cells).collect();
    Configuration { schedule, levels, exposure: Exposure::Fixed }
}

/// Rounds in which each of `count` emitters is lit along with each other one once: the circle method for tournaments.
/// Where the number is odd, one emitter of each round is lit alone.
pub(super) fn rounds(count: usize) -> Vec<Vec<Vec<usize>>> {
    let seats = count + count % 2;
    let turning = seats.saturating_sub(1);
    let group = |first: usize, second: usize| {
        let mut group: Vec<_> = [first, second].into_iter().filter(|&emitter| emitter < count).collect();
        group.sort_unstable();
        group
    };
    (0..turning)
        .map(|round| {
            let seat = |k: usize| (round + k) % turning;
            let fixed = group(turning, seat(0));
            let others = (1..seats / 2).map(|k| group(seat(k), seat(turning - k)));
            std::iter::once(fixed).chain(others).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::front_end;
    use slitpose_head::scene_file::WIDE;

    #[test]
    fn each_pair_of_emitters_meets_once_and_none_is_left_out_of_a_round() {
        for count in 1..=7 {
            let rounds = rounds(count);
            let mut met = std::collections::BTreeSet::new();
            for round in &rounds {
                let mut lit: Vec<_> = round.concat();
                lit.sort_unstable();
                assert_eq!(lit, (0..count).collect::<Vec<_>>(), "{round:?}");
                met.extend(round.iter().filter(|group| group.len() == 2).cloned());
            }
            assert_eq!(met.len(), count * (count - 1) / 2, "{rounds:?}");
        }
    }

    #[test]
    fn every_schedule_of_the_bring_up_is_valid_and_dark_first() {
        let base = front_end::configuration(&WIDE.read().unwrap()).unwrap().schedule;
        let fewer = Schedule { oversampling: 1, ..base.clone() };
        let pairs = rounds(6).into_iter().map(|round| grouped(&base, &round));
        for schedule in pairs.chain([alone(&base), alone(&fewer)]) {
            assert_eq!(schedule.validate(), Ok(()), "{schedule:?}");
            assert_eq!(schedule.dark_slot(), Some(0));
            assert!(schedule.frame_rate_hz() > 3_500.0, "{}", schedule.frame_rate_hz());
        }
    }
}

//! What a board could run.

use slitpose_protocol::{Configuration, Rejection};

use crate::defaults::TICK_HZ;
use crate::timing::FramePlan;

/// Whether the board of the image could run `configuration`.
pub fn can_run(configuration: &Configuration) -> bool {
    check(configuration, TICK_HZ).is_ok() && FramePlan::new(configuration).is_ok()
}

/// Whether a board of `board_hz` ticks a second could run `configuration`, hardware aside.
pub(crate) fn check(configuration: &Configuration, board_hz: u32) -> Result<(), Rejection> {
    let Configuration { schedule, levels, .. } = configuration;
    schedule.validate().map_err(Rejection::Schedule)?;
    if schedule.tick_hz != board_hz {
        return Err(Rejection::TickRate { asked_hz: schedule.tick_hz, board_hz });
    }
    if levels.len() != usize::from(schedule.cells) {
        return Err(Rejection::Levels { levels: levels.len() as u8, cells: schedule.cells });
    }
    Ok(())
}

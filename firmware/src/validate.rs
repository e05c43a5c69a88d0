//! Checks of a configuration that hold for every board.

use slitpose_protocol::{Configuration, Rejection};

/// Checks that a board of `board_hz` ticks a second could run `configuration`, apart from
/// the limits of its hardware.
///
/// # Errors
/// If the schedule contradicts itself or is in other ticks, or if there is not one level
/// for each cell.
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

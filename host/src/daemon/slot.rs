//! The state of a board, written by its threads and read by others.

use std::sync::Mutex;

use super::link::Link;
use crate::clock::HostInstant;
use crate::pipeline::Pipeline;
use crate::telemetry::{BoardReport, BoardStatistics};
use slitpose_head::threads::lock;

/// The state of a board.
pub(super) struct BoardSlot {
    pub(super) link: Link,
    report: Mutex<BoardReport>,
}

impl BoardSlot {
    pub(super) fn new(name: String, link: Link) -> Self {
        Self { link, report: Mutex::new(BoardReport { name, ..BoardReport::default() }) }
    }

    /// Updates the state; called a few times per second.
    pub(super) fn account(&self, pipeline: &Pipeline, statistics: &mut BoardStatistics) {
        statistics.set_clock(pipeline.drift_ppm(), pipeline.contradicts_crystal());
        let report = statistics.report(&pipeline.counts(), pipeline.health(), HostInstant::now());
        *lock(&self.report) = BoardReport { board_poses: pipeline.agreement(), ..report };
    }

    /// The newest state.
    pub(super) fn report(&self) -> BoardReport {
        let report = lock(&self.report).clone();
        BoardReport { link: self.link.report(), ..report }
    }
}

//! Looking for a tool that is not where it was expected, and what a frame may spend on it.

use super::Tracker;
use crate::plan::Optics;
use crate::pose::Transform;
use crate::scalar::Number;
use crate::solve::cold_start::{COLD_WORK, Search};
use crate::solve::compiled::Prior;
use crate::solve::normal_equations::Workspace;
use crate::solve::outcome::{Outcome, Solution};
use crate::solve::readings::Sorted;

/// Evaluations of all cells that frames may take.
#[derive(Clone, Copy, Debug)]
pub(in crate::solve) struct Budget {
    /// Each of them.
    pub(in crate::solve) frame: usize,
    /// That each leaves to a later search, and the most that are left.
    pub(in crate::solve) saved_a_frame: usize,
    pub(in crate::solve) most_saved: usize,
    /// That the first search may take besides.
    pub(in crate::solve) first: usize,
}

impl Budget {
    /// Of a host: at some 2.4 µs each, exact tier and twist unknown, a frame takes half of the 100 µs that it may cost at
    /// 4 kHz, because minimisations under way are completed; with what others have left, no longer than the 250 µs to
    /// the next. The first search may take as much as a cold solve, so that the first frame has a pose.
    pub(super) const HOST: Self = Self { frame: 20, saved_a_frame: 2, most_saved: 56, first: COLD_WORK };
}

/// Frames between two searches while a misfit is followed.
const PAUSE: u32 = 256;

/// A tool that is not where it was expected.
#[derive(Clone, Debug)]
pub(super) struct Lost<S: Number> {
    search: Search<S>,
    /// Where it may as well be, if it may be in two places.
    images: Option<[Transform<S>; 2]>,
    /// Frames until the next search.
    pub(super) wait: u32,
    /// Evaluations that a search may take besides those of its frame.
    pub(super) saved_work: usize,
}

impl<S: Number> Lost<S> {
    pub(super) fn new(saved_work: usize) -> Self {
        Self { search: Search::in_pieces(), images: None, wait: 0, saved_work }
    }

    /// Whether anything is to be forgotten when the tool has been found.
    pub(super) fn is_under_way(&self, most_saved: usize) -> bool {
        self.search.has_begun() || self.images.is_some() || self.wait > 0 || self.saved_work > most_saved
    }
}

impl<S: Number, P: Optics<S>> Tracker<S, P> {
    /// Looks for the tool everywhere, a piece of the search a frame.
    pub(super) fn find(&mut self, sorted: &Sorted<S>, motion: &Prior<S>, workspace: &mut Workspace<S>) -> Solution<S> {
        let lost = &mut self.lost;
        if let Some(images) = lost.images.take() {
            lost.images = self.solver.compiled.still_images(sorted, motion, images, workspace);
            if lost.images.is_some() {
                return Solution::without_pose(Outcome::Ambiguous, sorted.used);
            }
        }
        if lost.wait > 0 {
            lost.wait -= 1;
            return Solution::without_pose(Outcome::Diverged, sorted.used);
        }
        workspace.work += lost.saved_work;
        let solution = self.solver.compiled.search(sorted, motion, &mut lost.search, workspace);
        lost.saved_work = lost.saved_work.min(workspace.work).min(self.budget.most_saved);
        if lost.search.is_over() {
            lost.images = lost.search.images();
            lost.search = Search::in_pieces();
            lost.wait = if self.is_misfit { PAUSE } else { 0 };
        }
        solution
    }
}

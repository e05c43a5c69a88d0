//! The places where missing scans were lost.
//!
//! Gaps in the numbering show missing scans. Twice per second the board reports how many it has lost itself since its
//! reset. The rest was lost on the link.

use slitpose_protocol::Status;

use super::report::BoardLosses;

/// Follows the board's counters across its resets.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LossBook {
    /// Losses while followed, before the last reset.
    carried: BoardLosses,
    /// The counters when following began, or zero after a reset.
    base: BoardLosses,
    last: Option<(u64, BoardLosses)>,
    next_sequence: Option<u64>,
    /// Scans missing in the numbering so far.
    missed: u64,
    link_scans: u64,
}

impl LossBook {
    /// Restarts the numbering for another board.
    pub(super) fn begin_numbering(&mut self) {
        self.next_sequence = None;
    }

    /// Adds the number of the next scan, and how many of those missing before it were not lost. A number that goes back
    /// shows that the board was reset.
    pub(super) fn scan(&mut self, sequence: u64, not_lost: u64) {
        let missing = self.next_sequence.map_or(0, |expected| sequence.saturating_sub(expected));
        self.missed += missing.saturating_sub(not_lost);
        self.next_sequence = Some(sequence.wrapping_add(1));
    }

    /// Adds a status that came after the scans so far.
    pub(super) fn status(&mut self, status: &Status) {
        let now = BoardLosses {
            scans_dropped: status.scans_dropped,
            scans_lost: status.scans_lost,
            adc_overruns: status.adc_overruns.into(),
        };
        match self.last {
            Some((tick, _)) if status.tick < tick => {
                self.carried = self.board();
                self.base = BoardLosses::default();
            }
            Some(_) => {}
            // Losses before the first scan do not count; scans missing in the numbering since then do.
            None => {
                let dropped = now.scans_dropped.min(self.missed);
                let lost = now.scans_lost.min(self.missed - dropped);
                self.base = BoardLosses {
                    scans_dropped: now.scans_dropped - dropped,
                    scans_lost: now.scans_lost - lost,
                    ..now
                };
            }
        }
        self.last = Some((status.tick, now));
        // The board reports a loss before the numbering shows it: only the largest difference counts.
        let board = self.board();
        self.link_scans = self.link_scans.max(self.missed.saturating_sub(board.scans_dropped + board.scans_lost));
    }

    /// Losses on the board.
    pub(super) fn board(&self) -> BoardLosses {
        let last = self.last.map_or(self.base, |(_, last)| last);
        let since = |last: u64, base: u64, carried: u64| carried + last.saturating_sub(base);
        BoardLosses {
            scans_dropped: since(last.scans_dropped, self.base.scans_dropped, self.carried.scans_dropped),
            scans_lost: since(last.scans_lost, self.base.scans_lost, self.carried.scans_lost),
            adc_overruns: since(last.adc_overruns, self.base.adc_overruns, self.carried.adc_overruns),
        }
    }

    /// Scans lost on the link.
    pub(super) fn link_scans(&self) -> u64 {
        self.link_scans
    }
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::{ClockSource, SettingsSource};

    use super::*;

    fn status(tick: u64, scans_dropped: u64, scans_lost: u64) -> Status {
        Status {
            tick,
            acquiring: true,
            scans_taken: 0,
            scans_dropped,
            batches_dropped: 0,
            scans_lost,
            adc_overruns: 0,
            replies_dropped: 0,
            commands_damaged: 0,
            commands_rejected: 0,
            supply_v: 3.3,
            temperature_k: 300.0,
            cpu_load_permille: 0,
            clock: ClockSource::Crystal,
            settings: SettingsSource::Stored,
        }
    }

    fn shares(book: &LossBook) -> (u64, u64, u64) {
        let board = book.board();
        (board.scans_dropped, board.scans_lost, book.link_scans())
    }

    #[test]
    fn scans_that_a_board_says_not_to_have_solved_are_not_lost() {
        let mut book = LossBook::default();
        book.scan(0, 0);
        book.scan(8, 5);
        book.status(&status(1, 0, 0));
        assert_eq!(shares(&book), (0, 0, 2));
    }

    #[test]
    fn each_missing_scan_has_one_place() {
        let mut book = LossBook::default();
        // 1000 scans dropped before the link was opened, 4 lost since then in the first half second.
        [0, 1, 6].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(1, 1004, 7));
        assert_eq!(shares(&book), (4, 0, 0));
        // The board has dropped 10 more; the numbering shows 6 of them so far.
        book.scan(13, 0);
        book.status(&status(2, 1014, 7));
        assert_eq!(shares(&book), (14, 0, 0));
        // Those, and 3 that the board does not report.
        book.scan(21, 0);
        book.status(&status(3, 1014, 7));
        assert_eq!(shares(&book), (14, 0, 3));
        // Another drop, not in the numbering yet, does not reduce the losses of the link.
        book.status(&status(4, 1016, 8));
        assert_eq!(shares(&book), (16, 1, 3));
    }

    #[test]
    fn no_scan_is_missing_between_two_boards() {
        let mut book = LossBook::default();
        [5, 6].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.begin_numbering();
        [900, 901].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(1, 0, 0));
        assert_eq!(shares(&book), (0, 0, 0));
    }

    #[test]
    fn a_reset_of_the_board_takes_nothing_back() {
        let mut book = LossBook::default();
        book.scan(0, 0);
        book.status(&status(100, 50, 0));
        book.scan(6, 0);
        book.status(&status(200, 55, 0));
        [0, 4].iter().for_each(|&sequence| book.scan(sequence, 0));
        book.status(&status(10, 2, 1));
        assert_eq!(shares(&book), (7, 1, 0));
    }
}

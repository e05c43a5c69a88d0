//! Counts of received, solved and lost data.
//!
//! Gaps in the numbering show missing scans. Twice per second the board reports how many it has lost itself since its
//! reset. The rest was lost on the link.

use std::mem::discriminant;

use schemars::JsonSchema;
use serde::Serialize;
use slitpose_model::{DegradedReason, Directions, Outcome};
use slitpose_protocol::{DecoderCounters, Status};

/// Counters since the pipeline was made.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Scans that arrived.
    pub scans: u64,
    /// Scans missing in the board's numbering, wherever they were lost.
    pub scans_lost: u64,
    /// Scans that arrived but were not solved, because the solver was behind or interrupted.
    pub scans_skipped: u64,
    /// Scans of these that the user did not wait for: they waited when the program was interrupted.
    pub scans_given_up: u64,
    /// Scans that came again, or behind later ones; they are not solved.
    pub scans_repeated: u64,
    /// Restarts of the board, detected by restarts of its numbering.
    pub restarts: u64,
    /// Solved scans by outcome.
    pub outcomes: Outcomes,
    /// Batches without a hello, which cannot be decoded.
    pub batches_without_hello: u64,
    /// Batches that do not fit their schedule.
    pub batches_unreadable: u64,
    /// Poses of the board that cannot be right: their scans count as solved without a pose.
    pub poses_refused: u64,
    /// The decoder's counters.
    pub decoder: DecoderCounters,
    /// Bytes of a packet that has not ended.
    pub pending_bytes: u64,
    /// The board's latest status.
    pub board_status: Option<Status>,
    /// Scans dropped and lost by the board and its overruns, while it was followed, up to its last reset.
    carried: [u64; 3],
    /// The board's counters when following began, or zero after a reset.
    base: [u64; 3],
    /// Scans lost between board and host.
    pub scans_lost_on_link: u64,
    next_sequence: Option<u64>,
    /// The board has introduced itself since the last scan: it may have restarted.
    is_greeted: bool,
}

/// Scans that come again, or late, are at most so many behind the newest: more than a board queues.
const MAX_BEHIND: u64 = 1024;

impl Counts {
    /// Takes note that the board has introduced itself, as it does when it starts.
    pub(super) fn greet(&mut self) {
        self.is_greeted = true;
    }

    /// Counts scan `sequence` if it came again, or behind later ones; returns whether it did. A board that has
    /// restarted introduces itself before it sends a scan.
    pub(super) fn count_repeat(&mut self, sequence: u64) -> bool {
        let behind = self.next_sequence.map_or(0, |expected| expected.saturating_sub(sequence));
        let is_repeat = !self.is_greeted && (1..=MAX_BEHIND).contains(&behind);
        self.scans_repeated += u64::from(is_repeat);
        is_repeat
    }

    /// Scans missing in the numbering before scan `sequence`.
    pub(super) fn missing_before(&self, sequence: u64) -> u64 {
        self.next_sequence.map_or(0, |expected| sequence.saturating_sub(expected))
    }

    /// Counts a scan. `unsolved` of those missing before it came to the board, which did not solve them.
    pub(super) fn count_scan(&mut self, sequence: u64, unsolved: u64) {
        self.scans += 1 + unsolved;
        self.scans_skipped += unsolved;
        self.scans_lost += self.missing_before(sequence) - unsolved;
        self.restarts += u64::from(self.next_sequence.is_some_and(|expected| sequence < expected));
        self.next_sequence = Some(sequence.wrapping_add(1));
        self.is_greeted = false;
    }

    /// Counts the scans that are missing before scan `sequence`, the first behind the end, as far as they were due before
    /// it: `due`.
    pub(super) fn count_lost_before_end(&mut self, sequence: u64, due: u64) {
        self.scans_lost += self.missing_before(sequence).min(due);
        self.next_sequence = Some(sequence.wrapping_add(1));
    }

    /// Takes a status that came after the scans so far.
    pub fn take_status(&mut self, status: &Status) {
        let now = counters(status);
        match self.board_status {
            Some(before) if status.tick < before.tick => (self.carried, self.base) = (self.lost_on_board(), [0; 3]),
            Some(_) => {}
            // Losses before the first scan do not count; scans missing in the numbering since then do.
            None => {
                let dropped = now[0].min(self.scans_lost);
                let lost = now[1].min(self.scans_lost - dropped);
                self.base = [now[0] - dropped, now[1] - lost, now[2]];
            }
        }
        self.board_status = Some(*status);
        // The board reports a loss before the numbering shows it: only the largest difference counts.
        let [dropped, lost, _] = self.lost_on_board();
        self.scans_lost_on_link = self.scans_lost_on_link.max(self.scans_lost.saturating_sub(dropped + lost));
    }

    /// Scans that the board has dropped and lost, and its overruns, while it was followed, across its resets.
    pub fn lost_on_board(&self) -> [u64; 3] {
        let last = self.board_status.as_ref().map_or(self.base, counters);
        std::array::from_fn(|k| self.carried[k] + last[k].saturating_sub(self.base[k]))
    }

    /// Begins a new numbering: another board, or another session of the same board.
    pub(super) fn begin_numbering(&mut self) {
        self.next_sequence = None;
    }

    /// Scans that gave a pose.
    pub fn poses(&self) -> u64 {
        self.outcomes.poses()
    }

    /// Whether data were damaged or lost anywhere on the way, a cut-off end included.
    pub fn has_loss(&self) -> bool {
        self.pending_bytes > 0 || self.has_loss_before_end()
    }

    /// Whether data were damaged or lost before the end.
    pub fn has_loss_before_end(&self) -> bool {
        self.scans_lost > 0
            || self.scans_repeated > 0
            || self.restarts > 0
            || self.batches_without_hello > 0
            || self.batches_unreadable > 0
            || self.poses_refused > 0
            || self.decoder.bytes_skipped > 0
    }

    /// What was damaged or lost, in words; `None`: nothing. A packet under way when the end was `wanted` is not lost: it
    /// was not waited for.
    pub fn losses(&self, wanted: bool) -> Option<String> {
        let is_lossy = if wanted { self.has_loss_before_end() } else { self.has_loss() };
        let decoder = self.decoder;
        is_lossy.then(|| {
            format!(
                "data were damaged or lost: {} scans missing, {} repeated or late, {} restarts of the board, {} damaged and {} unreadable \
                 packets ({} bytes skipped), {} bytes of a packet that was cut off, {} batches without a hello, {} impossible \
                 poses",
                self.scans_lost,
                self.scans_repeated,
                self.restarts,
                decoder.damaged(),
                decoder.unknown + decoder.malformed + self.batches_unreadable,
                decoder.bytes_skipped,
                self.pending_bytes,
                self.batches_without_hello,
                self.poses_refused,
            )
        })
    }
}

fn counters(status: &Status) -> [u64; 3] {
    [status.scans_dropped, status.scans_lost, status.adc_overruns.into()]
}

/// Why a pose is degraded, or which coordinates are unobservable.
pub fn reason(outcome: &Outcome) -> Option<String> {
    match outcome {
        Outcome::Degraded(reason) => Some(reason.as_str().to_owned()),
        Outcome::Unobservable(directions) => Some(directions.to_string()),
        Outcome::Converged | Outcome::Ambiguous | Outcome::TooDark | Outcome::Diverged => None,
    }
}

/// Counts of solutions by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Outcomes {
    /// A pose from all cells.
    pub converged: u64,
    /// A less trustworthy pose.
    pub degraded: u64,
    /// Several poses fit.
    pub ambiguous: u64,
    /// The data leave directions undetermined.
    pub unobservable: u64,
    /// Too little light.
    pub too_dark: u64,
    /// No pose fits.
    pub diverged: u64,
}

impl Outcomes {
    /// One outcome of each kind, in the order of their numbers in datagrams.
    fn kinds() -> [Outcome; 6] {
        [
            Outcome::Converged,
            Outcome::Degraded(DegradedReason::FewerCells),
            Outcome::Ambiguous,
            Outcome::Unobservable(Directions::default()),
            Outcome::TooDark,
            Outcome::Diverged,
        ]
    }

    fn of_kind(&mut self, outcome: &Outcome) -> &mut u64 {
        match outcome {
            Outcome::Converged => &mut self.converged,
            Outcome::Degraded(_) => &mut self.degraded,
            Outcome::Ambiguous => &mut self.ambiguous,
            Outcome::Unobservable(_) => &mut self.unobservable,
            Outcome::TooDark => &mut self.too_dark,
            Outcome::Diverged => &mut self.diverged,
        }
    }

    /// The number of an outcome in datagrams.
    pub fn number_of(outcome: &Outcome) -> u16 {
        let is_other = |kind: &Outcome| discriminant(kind) != discriminant(outcome);
        Self::kinds().into_iter().take_while(is_other).count() as u16
    }

    /// Counts one more `outcome`.
    pub fn count(&mut self, outcome: &Outcome) {
        *self.of_kind(outcome) += 1;
    }

    /// The word for each outcome and its count, in the order of their numbers in datagrams.
    pub fn by_name(mut self) -> [(&'static str, u64); 6] {
        Self::kinds().map(|kind| (kind.as_str(), *self.of_kind(&kind)))
    }

    /// The counts since `before`.
    #[must_use]
    pub fn since(&self, before: &Self) -> Self {
        let mut since = *self;
        for (kind, (_, count)) in Self::kinds().iter().zip(before.by_name()) {
            let since = since.of_kind(kind);
            *since = since.saturating_sub(count);
        }
        since
    }

    /// Solutions with a pose.
    pub fn poses(&self) -> u64 {
        self.converged + self.degraded
    }

    /// All solutions.
    pub fn all(&self) -> u64 {
        self.by_name().iter().map(|(_, count)| count).sum()
    }

    /// The outcomes that occurred, as text.
    pub fn words(&self) -> String {
        let there = self.by_name().into_iter().filter(|(_, count)| *count > 0);
        there.map(|(name, count)| format!("{name} {count}")).collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use slitpose_protocol::{ClockSource, SettingsSource};

    use super::*;

    #[test]
    fn gaps_are_counted_and_restarts_are_no_gaps() {
        let mut counts = Counts::default();
        for sequence in [7, 8, 11, 12, 0, 1] {
            counts.count_scan(sequence, 0);
        }
        assert_eq!((counts.scans, counts.scans_lost, counts.restarts), (6, 2, 1));
        counts.count_scan(12, 7);
        assert_eq!((counts.scans, counts.scans_skipped, counts.scans_lost), (14, 7, 5));
    }

    #[test]
    fn scans_that_come_again_are_no_restart_unless_the_board_has_introduced_itself() {
        let mut counts = Counts::default();
        assert!(!counts.count_repeat(7));
        for sequence in 7..2000 {
            counts.count_scan(sequence, 0);
        }
        let repeats = [2000, 1999, 976, 975, 2001].map(|sequence| counts.count_repeat(sequence));
        assert_eq!((repeats, counts.scans_repeated), ([false, true, true, false, false], 2));
        counts.greet();
        assert!(!counts.count_repeat(1990));
        counts.count_scan(1990, 0);
        assert_eq!((counts.restarts, counts.count_repeat(1990)), (1, true));
    }

    #[test]
    fn every_kind_of_loss_is_one_by_itself() {
        assert!(!Counts::default().has_loss() && !Counts::default().has_loss_before_end());
        let kinds: [fn(&mut Counts); 7] = [
            |counts| counts.scans_lost = 1,
            |counts| counts.scans_repeated = 1,
            |counts| counts.restarts = 1,
            |counts| counts.batches_without_hello = 1,
            |counts| counts.batches_unreadable = 1,
            |counts| counts.poses_refused = 1,
            |counts| counts.decoder.bytes_skipped = 1,
        ];
        for (kind, lose) in kinds.iter().enumerate() {
            let mut counts = Counts::default();
            lose(&mut counts);
            assert!(counts.has_loss() && counts.has_loss_before_end(), "{kind}");
        }
        // An incomplete packet at the end is a loss only for `has_loss`.
        let pending = Counts { pending_bytes: 1, ..Counts::default() };
        assert!(pending.has_loss() && !pending.has_loss_before_end());
        // Skipped scans were not lost on the way, and a gap between boards is no loss.
        assert!(!Counts { scans_skipped: 1, ..Counts::default() }.has_loss());
        let mut counts = Counts::default();
        counts.count_scan(1000, 0);
        counts.begin_numbering();
        counts.count_scan(3, 0);
        counts.begin_numbering();
        counts.count_scan(7000, 0);
        assert!(!counts.has_loss(), "{counts:?}");
    }

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
            settings: SettingsSource::Defaults,
        }
    }

    fn shares(counts: &Counts) -> (u64, u64, u64) {
        let [dropped, lost, _] = counts.lost_on_board();
        (dropped, lost, counts.scans_lost_on_link)
    }

    #[test]
    fn scans_that_a_board_says_not_to_have_solved_are_not_lost() {
        let mut counts = Counts::default();
        counts.count_scan(0, 0);
        counts.count_scan(8, 5);
        counts.take_status(&status(1, 0, 0));
        assert_eq!(shares(&counts), (0, 0, 2));
    }

    #[test]
    fn each_missing_scan_has_one_place() {
        let mut counts = Counts::default();
        // 1000 scans dropped before the link was opened, 4 lost since then in the first half second.
        [0, 1, 6].iter().for_each(|&sequence| counts.count_scan(sequence, 0));
        counts.take_status(&status(1, 1004, 7));
        assert_eq!(shares(&counts), (4, 0, 0));
        // The board has dropped 10 more; the numbering shows 6 of them so far.
        counts.count_scan(13, 0);
        counts.take_status(&status(2, 1014, 7));
        assert_eq!(shares(&counts), (14, 0, 0));
        // Those, and 3 that the board does not report.
        counts.count_scan(21, 0);
        counts.take_status(&status(3, 1014, 7));
        assert_eq!(shares(&counts), (14, 0, 3));
        // Another drop, not in the numbering yet, does not reduce the losses of the link.
        counts.take_status(&status(4, 1016, 8));
        assert_eq!(shares(&counts), (16, 1, 3));
    }

    #[test]
    fn no_scan_is_missing_between_two_boards() {
        let mut counts = Counts::default();
        [5, 6].iter().for_each(|&sequence| counts.count_scan(sequence, 0));
        counts.begin_numbering();
        [900, 901].iter().for_each(|&sequence| counts.count_scan(sequence, 0));
        counts.take_status(&status(1, 0, 0));
        assert_eq!(shares(&counts), (0, 0, 0));
    }

    #[test]
    fn a_reset_of_the_board_takes_nothing_back() {
        let mut counts = Counts::default();
        counts.count_scan(0, 0);
        counts.take_status(&status(100, 50, 0));
        counts.count_scan(6, 0);
        counts.take_status(&status(200, 55, 0));
        [0, 4].iter().for_each(|&sequence| counts.count_scan(sequence, 0));
        counts.take_status(&status(10, 2, 1));
        assert_eq!(shares(&counts), (7, 1, 0));
    }
}

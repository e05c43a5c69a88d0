//! Chooses the scan that is solved next.
//!
//! Scans are solved in the order of their arrival, each once for all outputs, as long as the solver keeps up with the
//! board. When it does not, the newest scan is solved ahead of its turn, for control loops. Where an output promises
//! every pose (standard output, or a run of a given duration), older scans wait and are solved in between; else they
//! are skipped and counted. A capture contains their bytes in either case.
//!
//! Thus a control loop gets each pose at most [`LATE_NS`] + [`GRACE_NS`] and the duration of three solutions after its
//! scan arrived, however long a solution takes.

use slitpose_tracking::pipeline::Queue;

/// A scan that has waited longer is late: 20 scans at 4 kHz.
const LATE_NS: u64 = 5_000_000;

/// A solver that does not catch up within this time is behind. A healthy solver catches up within it even if the
/// system has suspended it for longer.
const GRACE_NS: u64 = 5_000_000;

/// Time after which a solver that skips scans tries to solve each again: skipping hides whether it could keep up. The
/// first trial comes soon, because scans that a stalled link delivers at once are a matter of milliseconds; each trial
/// that fails doubles the time to the next.
const FIRST_TRIAL_AFTER_NS: u64 = 10_000_000;
const LAST_TRIAL_AFTER_NS: u64 = 1_000_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Wait for more bytes, or until poses are printed.
    Wait,
    /// Solve the oldest scan, for all outputs that have not had a newer one.
    Oldest,
    /// Solve the newest scan ahead of its turn, for control loops.
    Newest,
    /// Skip this many of the oldest scans.
    Skip(usize),
}

/// Tracks how far the solver is behind.
#[derive(Debug, Default)]
pub(super) struct Backlog {
    keeps_all: bool,
    late_since_ns: Option<u64>,
    behind_since_ns: Option<u64>,
    /// How long scans are skipped, this time or the last.
    trial_after_ns: u64,
    tried_ns: Option<u64>,
    /// The last scan was solved ahead of its turn.
    was_newest: bool,
}

impl Backlog {
    /// `keeps_all`: each scan must be solved, however late.
    pub(super) fn new(keeps_all: bool) -> Self {
        Self { keeps_all, trial_after_ns: FIRST_TRIAL_AFTER_NS, ..Self::default() }
    }

    /// Whether scans are solved ahead of their turn.
    pub(super) fn is_behind(&self) -> bool {
        self.behind_since_ns.is_some()
    }

    /// The next action for `queue` at `now_ns`, CLOCK_MONOTONIC; `can_print`: the oldest scan could be printed once it
    /// is solved.
    pub(super) fn next(&mut self, queue: &Queue, can_print: bool, now_ns: u64) -> Next {
        if queue.waiting == 0 {
            self.late_since_ns = None;
            if self.keeps_all {
                self.behind_since_ns = None;
            }
            return Next::Wait;
        }
        let Some(oldest_ns) = queue.oldest_ns else {
            // Device time waits as well.
            return if can_print { Next::Oldest } else { Next::Wait };
        };
        self.judge(oldest_ns, now_ns);
        let has_newer = queue.passed < queue.waiting;
        if self.is_behind() && !self.keeps_all {
            return if queue.waiting > 1 { Next::Skip(queue.waiting - 1) } else { Next::Oldest };
        }
        // Oldest and newest alternate, so that neither waits for the other.
        let is_urgent = has_newer && (!can_print || (self.is_behind() && !self.was_newest));
        self.was_newest = is_urgent;
        match (is_urgent, can_print) {
            (true, _) => Next::Newest,
            (false, true) => Next::Oldest,
            (false, false) => Next::Wait,
        }
    }

    fn judge(&mut self, oldest_ns: u64, now_ns: u64) {
        if now_ns.saturating_sub(oldest_ns) <= LATE_NS {
            self.late_since_ns = None;
            if self.keeps_all {
                self.behind_since_ns = None;
            }
        } else {
            let late_since_ns = *self.late_since_ns.get_or_insert(now_ns);
            if now_ns - late_since_ns > GRACE_NS && self.behind_since_ns.is_none() {
                self.behind_since_ns = Some(now_ns);
                let has_failed = self.tried_ns.is_some_and(|tried_ns| now_ns - tried_ns < LAST_TRIAL_AFTER_NS);
                self.trial_after_ns = match has_failed {
                    true => (2 * self.trial_after_ns).min(LAST_TRIAL_AFTER_NS),
                    false => FIRST_TRIAL_AFTER_NS,
                };
            }
        }
        if !self.keeps_all
            && let Some(behind_since_ns) = self.behind_since_ns
            && now_ns - behind_since_ns > self.trial_after_ns
        {
            (self.late_since_ns, self.behind_since_ns) = (None, None);
            self.tried_ns = Some(now_ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;

    /// Period of the scans, and their number per read.
    const FRAME_NS: u64 = 250_000;
    const AT_ONCE: u64 = 4;

    /// A solver with a given cost per scan, on a simulated clock.
    #[derive(Default)]
    struct Trial {
        backlog: Backlog,
        /// Number and arrival of the waiting scans, and how many of them were passed.
        waiting: VecDeque<(u64, u64)>,
        passed: usize,
        now_ns: u64,
        arrived: u64,
        printed: Vec<u64>,
        /// Number and age of each scan given to a control loop.
        given: Vec<(u64, u64)>,
        skipped: u64,
        was_behind: bool,
    }

    impl Trial {
        fn new(keeps_all: bool) -> Self {
            Self { backlog: Backlog::new(keeps_all), now_ns: 1, ..Self::default() }
        }

        /// Queues all scans that arrived until now and before `end_ns`.
        fn arrive(&mut self, end_ns: u64) {
            let read_ns = AT_ONCE * FRAME_NS;
            while (self.arrived / AT_ONCE + 1) * read_ns <= self.now_ns.min(end_ns) {
                let at_ns = (self.arrived / AT_ONCE + 1) * read_ns;
                self.waiting.push_back((self.arrived, at_ns));
                self.arrived += 1;
            }
        }

        fn give(&mut self, (number, at_ns): (u64, u64)) {
            self.given.push((number, self.now_ns - at_ns));
        }

        /// Runs until `end_ns` and then, if `drain`, without further scans until nothing waits.
        fn run(&mut self, end_ns: u64, can_print: bool, drain: bool, cost_ns: impl Fn(u64) -> u64) {
            while self.now_ns < end_ns || (drain && !self.waiting.is_empty()) {
                self.arrive(end_ns);
                let oldest_ns = self.waiting.front().map(|(_, at_ns)| *at_ns);
                let queue = Queue { waiting: self.waiting.len(), passed: self.passed, oldest_ns, sessions: 0 };
                let next = self.backlog.next(&queue, can_print, self.now_ns);
                self.was_behind |= self.backlog.is_behind();
                match next {
                    Next::Wait => self.now_ns += FRAME_NS,
                    Next::Oldest => {
                        assert!(can_print || !self.backlog.keeps_all);
                        let scan = self.waiting.pop_front().unwrap();
                        self.now_ns += cost_ns(scan.0);
                        if self.passed == 0 {
                            self.give(scan);
                        }
                        self.passed = self.passed.saturating_sub(1);
                        self.printed.push(scan.0);
                    }
                    Next::Newest => {
                        assert!(self.passed < self.waiting.len(), "the newest has been solved already");
                        self.passed = self.waiting.len();
                        let scan = *self.waiting.back().unwrap();
                        self.now_ns += cost_ns(scan.0);
                        self.give(scan);
                    }
                    Next::Skip(count) => {
                        assert!(count < self.waiting.len(), "the newest is never skipped");
                        self.waiting.drain(..count);
                        self.skipped += count as u64;
                    }
                }
            }
        }

        fn oldest_given_ns(&self) -> u64 {
            self.given.iter().map(|(_, age_ns)| *age_ns).max().unwrap()
        }

        /// Whether all that arrived was printed, in order.
        fn is_printed(&self) -> bool {
            self.printed.iter().copied().eq(0..self.arrived)
        }

        fn is_in_order(&self) -> bool {
            self.given.windows(2).all(|pair| pair[0].0 < pair[1].0)
        }
    }

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_solver_that_keeps_up_gives_every_scan_to_all_outputs() {
        for keeps_all in [true, false] {
            let mut trial = Trial::new(keeps_all);
            trial.run(2 * SECOND_NS, true, true, |_| 240_000);
            assert!(trial.arrived >= 7_990 && trial.skipped == 0 && !trial.was_behind);
            assert!(trial.is_in_order() && trial.given.len() == trial.printed.len());
            assert!(trial.is_printed());
            // The last of four waits for the three ahead of it.
            assert!(trial.oldest_given_ns() <= 4 * 240_000 + FRAME_NS, "{} ns", trial.oldest_given_ns());
            // The system suspends the solver for 60 ms every half second.
            let mut trial = Trial::new(keeps_all);
            trial.run(3 * SECOND_NS, true, true, |number| if number % 2000 == 500 { 60_000_000 } else { 10_000 });
            assert_eq!((trial.skipped, trial.was_behind, trial.given.len()), (0, false, trial.arrived as usize));
        }
    }

    #[test]
    fn a_pause_that_is_too_long_to_make_up_for_costs_what_waited_and_no_more() {
        let mut trial = Trial::new(false);
        // 400 ms, four times: 1600 scans wait, which would take 16 ms.
        trial.run(8 * SECOND_NS, true, true, |number| if number % 8000 == 500 { 400_000_000 } else { 10_000 });
        assert!(trial.was_behind && trial.is_in_order());
        assert_eq!(trial.given.len() as u64 + trial.skipped, trial.arrived);
        // Those of the 10 ms until the next trial are solved too, but for three of each read.
        let most = 4 * (1_600 + 3 * 11);
        assert!((1..=most).contains(&trial.skipped), "{} skipped", trial.skipped);
    }

    #[test]
    fn a_solver_that_stays_too_slow_is_tried_ever_more_rarely() {
        let mut trial = Trial::new(false);
        let (mut times_behind, mut is_behind) = (0, false);
        // Ten seconds, each scan of which costs two of its periods.
        for step in 1..=10_000 {
            trial.run(step * 1_000_000, true, false, |_| 2 * FRAME_NS);
            times_behind += u32::from(trial.backlog.is_behind() && !is_behind);
            is_behind = trial.backlog.is_behind();
        }
        // Skipped for 10, 20, … 640 ms and then a second each time, with some 15 ms in between until it is behind again.
        assert!((15..=17).contains(&times_behind), "{times_behind} times");
    }

    #[test]
    fn poses_for_control_loops_stay_new_however_slow_the_solver_is() {
        for keeps_all in [true, false] {
            for cost_ns in [260_000, 370_000, 924_000, 1_536_000, 10_000_000, 400_000_000] {
                let mut trial = Trial::new(keeps_all);
                trial.run(5 * SECOND_NS, true, true, |_| cost_ns);
                let name = format!("keeps all {keeps_all}, {cost_ns} ns");
                assert!(trial.was_behind && trial.is_in_order(), "{name}");
                // The scan under way when the solver falls behind, one in turn, and the newest itself.
                let most_ns = LATE_NS + GRACE_NS + 3 * cost_ns;
                assert!(trial.oldest_given_ns() <= most_ns, "{name}: {} ns", trial.oldest_given_ns());
                // When behind, the solver spends at least half its time on the newest scans.
                let given = 5 * SECOND_NS / cost_ns / 2;
                assert!(trial.given.len() as u64 >= given.min(4_500), "{name}: {} given", trial.given.len());
                if keeps_all {
                    assert!(trial.is_printed() && trial.skipped == 0, "{name}");
                } else {
                    assert_eq!(trial.given.len() as u64 + trial.skipped, trial.arrived, "{name}");
                    assert!(trial.skipped > 0, "{name}");
                }
            }
        }
    }

    #[test]
    fn a_solver_that_can_keep_up_again_recovers() {
        for keeps_all in [true, false] {
            let mut trial = Trial::new(keeps_all);
            // Slow for the scans of one second.
            let cost_ns = |number| if (4_000..8_000).contains(&number) { 500_000 } else { 10_000 };
            trial.run(3 * SECOND_NS, true, false, cost_ns);
            assert!(trial.was_behind);
            // They keep the solver busy for two more seconds, and those solved ahead of them for another.
            trial.run(5 * SECOND_NS, true, false, cost_ns);
            (trial.was_behind, trial.given) = (false, Vec::new());
            let skipped = trial.skipped;
            trial.run(11 * SECOND_NS / 2, true, true, cost_ns);
            assert!(!trial.was_behind && trial.skipped == skipped, "keeps all {keeps_all}");
            // Every scan of the last half second, in time.
            assert!(trial.given.len() >= 1_990 && trial.oldest_given_ns() < 1_000_000, "keeps all {keeps_all}");
        }
    }

    #[test]
    fn control_loops_do_not_wait_while_standard_output_is_not_read() {
        let mut trial = Trial::new(true);
        trial.run(SECOND_NS, false, false, |_| 10_000);
        assert_eq!(trial.printed, Vec::<u64>::new());
        // The newest of each read, at once.
        assert!(trial.given.len() >= 990 && trial.oldest_given_ns() < 1_000_000 && trial.is_in_order());
        trial.run(2 * SECOND_NS, true, true, |_| 10_000);
        assert!(trial.is_printed());
        assert!(!trial.backlog.is_behind() && trial.is_in_order());
    }
}

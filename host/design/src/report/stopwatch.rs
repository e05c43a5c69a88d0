//! Run times on a machine with other load.
//!
//! Candidates are timed in turn, round after round: a temporary load disturbs all of them alike, and the least time of each is the one that was disturbed least.

use std::time::Instant;

/// Time of one unit of work.
#[derive(Clone, Copy, Debug)]
pub(super) struct RunTime {
    /// In the fastest round, seconds.
    pub(super) least_s: f64,
    /// In the middle round, seconds.
    pub(super) median_s: f64,
}

/// One of several ways to do something.
pub(super) struct Candidate<'a> {
    /// Does all units of work once.
    pub(super) work: Box<dyn FnMut() + 'a>,
}

impl<'a> Candidate<'a> {
    pub(super) fn new(work: impl FnMut() + 'a) -> Self {
        Self { work: Box::new(work) }
    }
}

/// Times `candidates` in turn over `rounds`; each does `units` of work a round. One round more
/// goes ahead, to fill caches.
pub(super) fn race(candidates: &mut [Candidate<'_>], rounds: usize, units: usize) -> Vec<RunTime> {
    let mut times: Vec<Vec<f64>> = candidates.iter().map(|_| Vec::with_capacity(rounds)).collect();
    for round in 0..=rounds {
        for (candidate, times) in candidates.iter_mut().zip(&mut times) {
            let start = Instant::now();
            (candidate.work)();
            let took_s = start.elapsed().as_secs_f64() / units as f64;
            if round > 0 {
                times.push(took_s);
            }
        }
    }
    times
        .into_iter()
        .map(|mut times| {
            times.sort_by(f64::total_cmp);
            RunTime { least_s: times[0], median_s: times[times.len() / 2] }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn candidates_take_turns() {
        let (first, second) = (Cell::new(0), Cell::new(0));
        let mut candidates = [
            Candidate::new(|| {
                assert_eq!(first.get(), second.get(), "the first is ahead");
                first.set(first.get() + 1);
            }),
            Candidate::new(|| second.set(second.get() + 1)),
        ];
        let run_times = race(&mut candidates, 5, 1);
        drop(candidates);
        assert_eq!((first.get(), second.get()), (6, 6));
        assert!(run_times.iter().all(|run_time| run_time.least_s <= run_time.median_s));
    }
}

//! Locks and threads after a panic of another thread, and work on all cores.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::{self, JoinHandle};

/// Locks `mutex`, also after a thread that held it has panicked: for values that are whole at any time,
/// because each change of them is one.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits for the result of a thread.
///
/// # Panics
/// If the thread has panicked.
pub fn join<T>(thread: JoinHandle<T>) -> T {
    thread.join().unwrap_or_else(|panic| resume_unwind(panic))
}

/// The results of `work` on each of `items`, in their order, by as many threads as there are cores.
///
/// # Panics
/// If `work` has panicked.
pub fn on_all_cores<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let (mut next, mut results) = (items.iter(), Vec::with_capacity(items.len()));
    let take = |result| {
        results.push(result);
        Ok::<_, Infallible>(())
    };
    let Ok(()) = in_order(cores(), || Ok(next.next()), work, take);
    results
}

/// What [`limit`] was told; zero: nothing.
static LIMIT: AtomicUsize = AtomicUsize::new(0);

/// Limits the threads of this process that work at once to `jobs`. Results do not depend on it, and threads that wait for a
/// board or a user do not count.
pub fn limit(jobs: NonZero<usize>) {
    LIMIT.store(jobs.get(), Ordering::Relaxed);
}

/// As many threads as this process may use at once.
pub fn cores() -> NonZero<usize> {
    let limit = NonZero::new(LIMIT.load(Ordering::Relaxed));
    limit.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZero::<usize>::MIN)
}

/// Passes the results of `work` on each of the items that `next` gives to `take`, in their order. `jobs` threads work;
/// `next` and `take` run on the calling one. Three times as many items as threads are under way at most, so that memory
/// does not grow with their number.
///
/// # Errors
/// The first error of `next` or `take`. Items before one that `next` fails at are taken first.
///
/// # Panics
/// If `work` has panicked.
pub fn in_order<T: Send, R: Send, E>(
    jobs: NonZero<usize>,
    mut next: impl FnMut() -> Result<Option<T>, E>,
    work: impl Fn(T) -> R + Sync,
    mut take: impl FnMut(R) -> Result<(), E>,
) -> Result<(), E> {
    let most = 3 * jobs.get();
    let (items, waiting) = mpsc::sync_channel::<(T, mpsc::SyncSender<R>)>(most);
    let waiting = Mutex::new(waiting);
    let run = || {
        loop {
            // The lock is free again before the work begins.
            let Ok((item, result)) = lock(&waiting).recv() else { return };
            // Who waits for results may have failed.
            let _ = result.send(work(item));
        }
    };
    thread::scope(|scope| {
        // Workers end when it is gone.
        let items = items;
        for _ in 0..jobs.get() {
            scope.spawn(run);
        }
        let mut under_way = VecDeque::new();
        let mut end = Ok(());
        let mut is_over = false;
        loop {
            while !is_over && under_way.len() < most {
                match next() {
                    Ok(Some(item)) => {
                        let (result, coming) = mpsc::sync_channel(1);
                        under_way.push_back(coming);
                        // There is room, and the workers are there.
                        let _ = items.send((item, result));
                    }
                    Ok(None) => is_over = true,
                    Err(error) => (is_over, end) = (true, Err(error)),
                }
            }
            let Some(coming) = under_way.pop_front() else { break };
            match coming.recv() {
                Ok(result) => take(result)?,
                // The worker has panicked, and the scope will.
                Err(_) => break,
            }
        }
        end
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_the_order_of_the_items_however_long_each_takes() {
        let items: Vec<u64> = (0..200).collect();
        let sum_to = |&item: &u64| (0..=(200 - item) * 100).sum::<u64>();
        assert_eq!(on_all_cores(&items, sum_to), items.iter().map(sum_to).collect::<Vec<_>>());
        assert!(on_all_cores(&[], |item: &u64| *item).is_empty());
    }

    #[test]
    fn items_are_taken_in_order_up_to_the_first_error_and_few_are_under_way() {
        for jobs in [1, 2, 5] {
            let jobs = NonZero::new(jobs).unwrap();
            let (given, taken) = (AtomicUsize::new(0), AtomicUsize::new(0));
            let next = || {
                let item = given.fetch_add(1, Ordering::Relaxed);
                assert!(item <= taken.load(Ordering::Relaxed) + 3 * jobs.get(), "{item} items at once");
                if item < 100 { Ok(Some(item)) } else { Err("no more") }
            };
            let work = |item: usize| (item, (0..(100 - item) * 100).sum::<usize>());
            let take = |(item, _)| {
                assert_eq!(item, taken.fetch_add(1, Ordering::Relaxed));
                Ok(())
            };
            assert_eq!(in_order(jobs, next, work, take), Err("no more"));
            assert_eq!(taken.load(Ordering::Relaxed), 100);
            let mut left = 10..20;
            let stopped =
                in_order(jobs, || Ok(left.next()), |item| item, |item| if item < 13 { Ok(()) } else { Err(item) });
            assert_eq!(stopped, Err(13));
        }
    }
}

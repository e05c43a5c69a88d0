//! Random trials on all cores, each with a generator of its own: trial 4711 is the same whatever
//! the count and however many cores, so what failed in a long run can be repeated alone.

use std::thread;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// How many trials, and from which seed.
#[derive(Clone, Copy, Debug)]
pub struct Trials {
    /// Trials to run.
    pub count: usize,
    /// Seed of all of them.
    pub seed: u64,
}

impl Trials {
    /// The generator of trial `index`: a stream of the seed's own.
    pub fn generator(&self, index: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(index as u64);
        rng
    }

    /// Runs `trial` with its number and generator, for all numbers; results in their order.
    ///
    /// # Panics
    /// If a trial does.
    pub fn run<T: Send>(&self, trial: impl Fn(usize, &mut ChaCha8Rng) -> T + Sync) -> Vec<T> {
        let workers = thread::available_parallelism().map_or(1, usize::from);
        let trial = &trial;
        thread::scope(|scope| {
            // Dealt in turn: hard trials come in no order, and no worker is left with them all.
            let deal = |worker| (worker..self.count).step_by(workers).map(|i| trial(i, &mut self.generator(i)));
            let handles: Vec<_> =
                (0..workers).map(|worker| scope.spawn(move || deal(worker).collect::<Vec<T>>())).collect();
            let mut hands: Vec<_> = handles
                .into_iter()
                .map(|handle| handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)).into_iter())
                .collect();
            (0..self.count).filter_map(|i| hands[i % workers].next()).collect()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn a_trial_does_not_depend_on_the_others() {
        let draw = |_: usize, rng: &mut ChaCha8Rng| rng.random_range(0.0..1.0);
        let many: Vec<f64> = Trials { count: 23, seed: 1 }.run(draw);
        let few = Trials { count: 5, seed: 1 }.run(draw);
        assert_eq!((many.len(), &many[..5]), (23, &few[..]));
        assert!(many.windows(2).all(|pair| pair[0] != pair[1]));
    }
}

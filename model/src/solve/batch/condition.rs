//! Condition numbers of many solutions, a solution per SIMD lane.

use crate::lanes::{PerLane, array, set};
use crate::scalar::Real;
use crate::width::{Instructions, Lanes, Task, Width};

use super::super::algebra::Factor;
use super::super::outcome::Solution;

/// The condition numbers of no more `solutions` than `width` has lanes; one of those that have no factor.
pub fn of_group(width: Width, solutions: &[Solution]) -> PerLane {
    let identity = Factor::of_parts(core::array::from_fn(|i| core::array::from_fn(|j| f64::from(i == j))), [1.0; 6]);
    let factor = |lane: usize| solutions.get(lane).and_then(|solution| solution.factor.as_ref()).unwrap_or(&identity);
    let mut conditions = PerLane::default();
    width.run(Condition { factor, conditions: &mut conditions });
    conditions
}

/// The condition number of the factor of each lane.
struct Condition<'a, F> {
    factor: F,
    conditions: &'a mut PerLane,
}

impl<'f, F: Fn(usize) -> &'f Factor<f64>> Task for Condition<'_, F> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        let zero = Lanes::zero(instructions);
        let mut lower = [[zero; 6]; 6];
        for (i, row) in lower.iter_mut().enumerate() {
            for (j, element) in row.iter_mut().enumerate() {
                *element = zero.fill_with(|lane| (self.factor)(lane).lower()[i][j]);
            }
        }
        let [least, largest] = Factor::of_parts(lower, array(zero, |_| zero)).extreme_singular_values();
        set(self.conditions, largest / least);
    }
}

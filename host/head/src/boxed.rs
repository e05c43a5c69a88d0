//! Plans and solvers on the heap: each has 120 kB, and a thread's stack is no place for several.

use slitpose_model::{Plan, Scene, SceneError, Solver, Tier};

/// [`Plan::compile`] on the heap.
///
/// # Errors
/// Those of [`Plan::compile`].
#[inline(never)]
pub fn boxed_plan(scene: &Scene, tier: Tier) -> Result<Box<Plan<f64>>, SceneError> {
    Ok(Box::new(Plan::compile(scene, tier)?))
}

/// [`Solver::new`] on the heap.
///
/// # Errors
/// Those of [`Plan::compile`].
#[inline(never)]
pub fn boxed_solver(scene: &Scene, tier: Tier) -> Result<Box<Solver<f64>>, SceneError> {
    Ok(Box::new(Solver::new(scene, tier)?))
}

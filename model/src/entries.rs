//! Where other crates enter the generic code.
//!
//! A generic function is compiled anew in each crate that calls it, with all that it calls: optics and solver are
//! most of a megabyte. With the feature `lanes`, entries are functions of their own for each number type, which this
//! crate compiles once for all others. Without it, as for the board, they leave no trace.

use heapless::Vec;

use crate::plan::{CellTerms, CellsAtOnce, CompiledScene, NoLanes, Tier, evaluate};
use crate::pose::{Pose, Transform};
use crate::response::{Pair, Response};
use crate::scalar::Number;
use crate::scene::{Scene, SceneError};
use crate::solve::{Directions, MotionPrior, Observation, Photocurrents, PoseTracker, Solution, Solver, Start};

#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
type WideCells = crate::plan::CellsInLanes;
#[cfg(not(all(feature = "lanes", target_arch = "x86_64")))]
type WideCells = NoLanes;

macro_rules! entries {
    ($($entry:tt)*) => {
        declare! { $($entry)* }
        implement! { f32, NoLanes: $($entry)* }
        implement! { f64, WideCells: $($entry)* }
    };
}

macro_rules! declare {
    ($($name:ident($($argument:ident: $of:ty),*) -> $result:ty { $body:expr })*) => {
        /// A number that heads are compiled and solved in.
        #[allow(missing_docs, reason = "each function is the method of the same name")]
        pub trait Scalar: Number {
            /// Cells in as many lanes as the processor has at run time.
            type CellsInLanes: CellsAtOnce<Self>;

            $(fn $name($($argument: $of),*) -> $result;)*
        }
    };
}

macro_rules! implement {
    ($scalar:ty, $cells:ty: $($name:ident($($argument:ident: $of:ty),*) -> $result:ty { $body:expr })*) => {
        impl Scalar for $scalar {
            type CellsInLanes = $cells;

            $(
                #[cfg_attr(feature = "lanes", inline(never))]
                #[cfg_attr(not(feature = "lanes"), inline(always))]
                fn $name($($argument: $of),*) -> $result {
                    $body
                }
            )*
        }
    };
}

entries! {
    solver(scene: &Scene, tier: Tier) -> Result<Solver<Self>, SceneError> {
        Solver::new_here(scene, tier)
    }
    compile(scene: &Scene, tier: Tier) -> Result<CompiledScene<Self>, SceneError> {
        CompiledScene::compile_here(scene, tier)
    }
    respond(plan: &CompiledScene<Self>, cell: usize, pose: &Pose) -> Response<Self> {
        evaluate::respond(plan, cell, &Transform::of(pose))
    }
    photocurrents(plan: &CompiledScene<Self>, cell: usize, pose: &Pose) -> Pair<Self> {
        evaluate::photocurrents(plan, cell, &Transform::of(pose))
    }
    photocurrents_of(
        plan: &CompiledScene<Self>, cell: usize, lit: &mut dyn Iterator<Item = (usize, Self)>, pose: &Pose
    ) -> Pair<Self> {
        evaluate::photocurrents_of_emitters(plan, cell, lit, &Transform::of(pose))
    }
    linearise(plan: &CompiledScene<Self>, cell: usize, pose: &Pose) -> CellTerms<Self> {
        evaluate::linearise(plan, cell, &Transform::of(pose))
    }
    spot_outline_m(plan: &CompiledScene<Self>, cell: usize, pose: &Pose) -> Vec<[Self; 2], 16> {
        evaluate::outline(plan, cell, &Transform::of(pose))
    }
    free_directions(solver: &Solver<Self>, pose: &Pose) -> Option<Directions> {
        solver.free_directions_here(pose)
    }
    bound(solver: &Solver<Self>, pose: &Pose) -> Option<[[Self; 6]; 6]> {
        solver.bound_here(pose)
    }
    solve(
        solver: &Solver<Self>, readings: &Photocurrents<Self>, start: Start<'_>, motion: &MotionPrior
    ) -> Solution<Self> {
        solver.solve_here(readings, start, motion)
    }
    track(tracker: &mut PoseTracker<Self>, frame: u64, readings: &Photocurrents<Self>) -> Solution<Self> {
        tracker.track_here(frame, readings)
    }
    observe(
        tracker: &PoseTracker<Self>, readings: &Photocurrents<Self>, solution: &Solution<Self>
    ) -> Option<Observation<Self>> {
        tracker.observe_here(readings, solution)
    }
}

//! What the solver does with many random poses: acceptance studies, not unit tests.
//!
//! Each study draws poses, computes what the cells of a scene deliver there, disturbs that as the
//! scene says, solves, and compares with the pose it drew. `examples/monte_carlo.rs` runs them at
//! full size and prints their tables; `tests/monte_carlo.rs` runs the same code small.
//!
//! * [`cold`]: noise-free data, no idea where the tool is;
//! * [`efficiency`]: errors against the Cramér–Rao bound and against the reported covariance;
//! * [`moving`]: the same for a tool that moves while its cells are exposed one after another;
//! * [`outliers`]: one cell answers for another pose;
//! * [`subsets`]: three, four or five cells.
//!
//! [`trials`] draws reproducibly on all cores, [`data`] makes photocurrents, [`tally`] counts
//! outcomes and keeps what went wrong, [`layout`] prints.

pub mod cold;
pub mod data;
pub mod efficiency;
pub mod layout;
pub mod moving;
pub mod outliers;
pub mod subsets;
pub mod tally;
pub mod trials;

/// Half sides of the box of poses that a head is meant for.
pub const HALF_MM: f64 = 4.0;
/// See [`HALF_MM`].
pub const HALF_DEG: f64 = 15.0;

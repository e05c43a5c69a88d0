//! Poses for other programs by their own protocols: ROS 2 by Zenoh, and 6-DoF mice. The first is in builds with the feature
//! `zenoh` only; without, the option that asks for it says which build has it.

mod spacenav;
#[cfg(feature = "zenoh")]
mod zenoh;

pub(crate) use spacenav::{Axes, Feel, SpacenavInput, SpacenavServer};
#[cfg(feature = "zenoh")]
pub(crate) use zenoh::publish_by_zenoh;

/// Where the router of ROS 2 listens.
pub(crate) const DEFAULT_ROUTER: &str = "tcp/localhost:7447";

/// A build without Zenoh publishes nothing.
#[cfg(not(feature = "zenoh"))]
pub(crate) fn publish_by_zenoh(
    _: &str,
    _: Vec<crate::live::LiveBoard>,
    _: f64,
    _: impl Fn() -> slitpose_tracking::telemetry::DaemonReport + Send + 'static,
) -> anyhow::Result<crate::daemon::StreamPlan> {
    anyhow::bail!("this build has no Zenoh; build with `cargo build --release -p slitpose --features zenoh`")
}

//! Zenoh, as `run` offers it. Builds without it hide the options, and say which build has it.

use std::sync::Arc;

use super::options::parse_number;
use super::talk;
use crate::daemon::StreamPlan;
use crate::live::LiveBoard;
use crate::telemetry::DaemonReport;
use crate::zenoh::{DEFAULT_ROUTER, ZenohError, ZenohSession};

/// Poses a second: what other programs of a robot take without effort.
const POSES_HZ: f64 = 100.0;

/// What is published, and where.
#[derive(clap::Args, Debug)]
pub(super) struct ZenohOptions {
    /// Publish poses, velocities, head, health and bytes of boards by Zenoh, where ROS 2 with rmw_zenoh sees them
    #[arg(long, hide = !cfg!(feature = "zenoh"))]
    zenoh: bool,
    /// The router of Zenoh
    #[arg(long, value_name = "ENDPOINT", default_value = DEFAULT_ROUTER, hide = !cfg!(feature = "zenoh"))]
    zenoh_router: String,
    /// Poses a second by Zenoh; 0 for every scan
    #[arg(long, value_name = "HZ", value_parser = parse_rate, default_value_t = POSES_HZ, hide = !cfg!(feature = "zenoh"))]
    zenoh_poses: f64,
}

/// The name of a board that another host publishes begins with this.
const PREFIX: &str = "zenoh:";

/// The key of a board that another host publishes.
pub(super) fn key_of(device: &str) -> Option<&str> {
    device.strip_prefix(PREFIX)
}

impl ZenohOptions {
    /// The session, if one of the `devices` or the user needs it.
    pub(super) fn open(&self, devices: &[String]) -> Result<Option<ZenohSession>, ZenohError> {
        let is_needed = self.zenoh || devices.iter().any(|device| key_of(device).is_some());
        is_needed.then(|| ZenohSession::open(&self.zenoh_router)).transpose()
    }

    /// What publishes the boards, if asked.
    pub(super) fn publisher(
        &self,
        session: Option<&ZenohSession>,
        boards: impl FnOnce() -> Vec<LiveBoard>,
        report: impl Fn() -> DaemonReport + Send + 'static,
    ) -> Option<StreamPlan> {
        let session = session.filter(|_| self.zenoh)?;
        let pose_every_s = if self.zenoh_poses > 0.0 { self.zenoh_poses.recip() } else { 0.0 };
        Some(session.publisher(boards(), pose_every_s, report, Arc::new(talk)))
    }
}

fn parse_rate(text: &str) -> Result<f64, &'static str> {
    parse_number(
        text,
        |rate| rate >= 0.0 && rate.is_finite(),
        "give a number of poses a second, such as 100, or 0 for every scan",
    )
}

//! NDJSON: one object per scan.

use std::io;
use std::io::Write;

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use slitpose_model::{Filtered, NoTwist, Pose, TwistEstimate};

use super::{Accounts, Note, Sink};
use slitpose_head::faults::ANNOUNCED;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Record, reason};

/// A pose as JSON: SI units, frame base_from_tool, quaternion x, y, z, w; the covariance row-major in the order (t, θ).
struct Line<'a>(&'a Record);

impl Serialize for Line<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Record { solution, host_time, twist, filtered, light_level, truth, .. } = self.0;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("seq", &self.0.sequence)?;
        map.serialize_entry("device", &self.0.device)?;
        map.serialize_entry("device_time_s", &self.0.device_time_s)?;
        if let Some(time) = host_time {
            map.serialize_entry("host_monotonic_ns", &time.monotonic_ns)?;
            map.serialize_entry("host_utc_ns", &time.utc_ns)?;
            map.serialize_entry("host_uncertainty_ns", &time.uncertainty_ns)?;
        }
        map.serialize_entry("status", solution.outcome.as_str())?;
        if let Some(reason) = reason(&solution.outcome) {
            map.serialize_entry("reason", &reason)?;
        }
        let estimate = solution.estimate.as_ref();
        put_pose(&mut map, estimate.map(|estimate| &estimate.pose))?;
        map.serialize_entry("covariance", &estimate.map(|estimate| estimate.covariance.as_flattened()))?;
        map.serialize_entry("cells_used", &solution.cells_used.count())?;
        map.serialize_entry("chi2", &Some(solution.chi2).filter(|chi2| chi2.is_finite()))?;
        map.serialize_entry("redundancy", &solution.redundancy)?;
        map.serialize_entry("verified", solution.verified().as_str())?;
        // External reliability: the greatest shift of the pose by one undetected outlier, in its σ; absent if unbounded.
        if solution.unnoticed_sigmas.is_finite() {
            map.serialize_entry("unnoticed_sigmas", &solution.unnoticed_sigmas)?;
        }
        if solution.excluded.iter().next().is_some() {
            map.serialize_entry("excluded_cells", &solution.excluded.iter().collect::<Vec<_>>())?;
        }
        put_twist(&mut map, twist)?;
        if let Some(filtered) = filtered {
            map.serialize_entry("filtered", &FilteredPose(filtered))?;
        }
        if let Some(level) = light_level {
            map.serialize_entry("light_level", level)?;
        }
        map.serialize_entry("simulated", &self.0.simulated)?;
        if let Some(truth) = truth {
            map.serialize_entry("truth", &TruePose(truth))?;
        }
        map.end()
    }
}

fn put_pose<M: SerializeMap>(map: &mut M, pose: Option<&Pose>) -> Result<(), M::Error> {
    map.serialize_entry("translation_m", &pose.map(|pose| pose.translation_m.to_array()))?;
    map.serialize_entry("rotation_xyzw", &pose.map(|pose| pose.rotation.to_array()))
}

/// Of a frame with a pose also the reason for no twist.
fn put_twist<M: SerializeMap>(map: &mut M, twist: &Result<TwistEstimate, NoTwist>) -> Result<(), M::Error> {
    map.serialize_entry("twist", &twist.as_ref().ok().map(Motion))?;
    match twist {
        Err(NoTwist::Start) => map.serialize_entry("no_twist", "start"),
        Err(NoTwist::Jump) => map.serialize_entry("no_twist", "jump"),
        Ok(_) | Err(NoTwist::NoPose) => Ok(()),
    }
}

struct TruePose<'a>(&'a Pose);

impl Serialize for TruePose<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        put_pose(&mut map, Some(self.0))?;
        map.end()
    }
}

/// Velocity of the tool in the base frame.
struct Motion<'a>(&'a TwistEstimate);

impl Serialize for Motion<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let TwistEstimate { twist, covariance } = self.0;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("linear_m_per_s", &twist.linear_m_per_s.to_array())?;
        map.serialize_entry("angular_rad_per_s", &twist.angular_rad_per_s.to_array())?;
        map.serialize_entry("sigma", &std::array::from_fn::<_, 6, _>(|i| covariance[i][i].sqrt()))?;
        map.end()
    }
}

struct FilteredPose<'a>(&'a Filtered);

impl Serialize for FilteredPose<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Filtered { estimate, twist, lag_s, frames, .. } = self.0;
        let mut map = serializer.serialize_map(None)?;
        put_pose(&mut map, Some(&estimate.pose))?;
        map.serialize_entry("covariance", estimate.covariance.as_flattened())?;
        put_twist(&mut map, twist)?;
        map.serialize_entry("lag_s", lag_s)?;
        map.serialize_entry("frames", frames)?;
        map.end()
    }
}

#[derive(Serialize)]
struct FaultLine<'a> {
    kind: &'static str,
    fault: &'a str,
    device: Option<DeviceId>,
    device_time_s: f64,
}

pub(super) struct Ndjson<W>(pub(super) W);

impl<W: Write> Sink for Ndjson<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        serde_json::to_writer(&mut self.0, &Line(record))?;
        self.0.write_all(b"\n")
    }

    /// Poses that follow an injected fault are not what the board would have given: the stream says so.
    fn note(&mut self, note: &Note) -> io::Result<()> {
        let Note { device, device_time_s, text, .. } = note;
        let Some(fault) = text.strip_prefix(ANNOUNCED) else { return Ok(()) };
        let line = FaultLine { kind: "injected_fault", fault, device: *device, device_time_s: *device_time_s };
        serde_json::to_writer(&mut self.0, &line)?;
        self.0.write_all(b"\n")
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.0.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.0.flush()
    }
}

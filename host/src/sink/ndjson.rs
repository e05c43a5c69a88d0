//! NDJSON: one object per scan.

use std::io;
use std::io::Write;

use serde::Serialize;
use slitpose_model::{self as model, Estimate, Pose, TwistEstimate};

use super::{Accounts, Note, Sink};
use slitpose_head::faults::ANNOUNCED;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Record, reason};

/// A pose as JSON: SI units, frame base_from_tool, quaternion x, y, z, w.
#[derive(Serialize)]
struct Line<'a> {
    seq: u64,
    device: DeviceId,
    device_time_s: f64,
    /// The same instant by CLOCK_MONOTONIC and by UTC since 1970, absent while unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    host_monotonic_ns: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    host_utc_ns: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    host_uncertainty_ns: Option<u64>,
    status: &'a str,
    /// Why a pose is degraded, or which coordinates are unobservable.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    translation_m: Option<[f64; 3]>,
    rotation_xyzw: Option<[f64; 4]>,
    /// Row-major, order (t, θ): m², m·rad, rad².
    #[serde(serialize_with = "covariance::serialize")]
    covariance: Option<[f64; 36]>,
    cells_used: usize,
    chi2: Option<f64>,
    redundancy: usize,
    verified: &'static str,
    /// External reliability: greatest shift of the pose by one undetected outlier, in its σ; absent if unbounded.
    #[serde(skip_serializing_if = "Option::is_none")]
    unnoticed_sigmas: Option<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    excluded_cells: Vec<usize>,
    twist: Option<Motion>,
    #[serde(skip_serializing_if = "Option::is_none")]
    filtered: Option<Filtered>,
    simulated: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<TruePose>,
}

// serde derives arrays up to 32 elements; 36 are written as a sequence.
mod covariance {
    use serde::Serializer;

    pub(super) fn serialize<S: Serializer>(value: &Option<[f64; 36]>, serializer: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => serializer.collect_seq(value),
            None => serializer.serialize_none(),
        }
    }
}

/// Velocity of the tool in the base frame.
#[derive(Serialize)]
struct Motion {
    linear_m_per_s: [f64; 3],
    angular_rad_per_s: [f64; 3],
    sigma: [f64; 6],
}

impl From<TwistEstimate> for Motion {
    fn from(TwistEstimate { twist, covariance }: TwistEstimate) -> Self {
        Self {
            linear_m_per_s: twist.linear_m_per_s.to_array(),
            angular_rad_per_s: twist.angular_rad_per_s.to_array(),
            sigma: std::array::from_fn(|i| covariance[i][i].sqrt()),
        }
    }
}

#[derive(Serialize)]
struct Filtered {
    translation_m: [f64; 3],
    rotation_xyzw: [f64; 4],
    #[serde(serialize_with = "covariance::serialize")]
    covariance: Option<[f64; 36]>,
    twist: Motion,
    lag_s: f64,
    frames: u32,
}

impl From<model::Filtered> for Filtered {
    fn from(filtered: model::Filtered) -> Self {
        let Estimate { pose, covariance } = filtered.estimate;
        Self {
            translation_m: pose.translation_m.to_array(),
            rotation_xyzw: pose.rotation.to_array(),
            covariance: Some(flat(&covariance)),
            twist: filtered.twist.into(),
            lag_s: filtered.lag_s,
            frames: filtered.frames,
        }
    }
}

fn flat(matrix: &[[f64; 6]; 6]) -> [f64; 36] {
    std::array::from_fn(|i| matrix[i / 6][i % 6])
}

#[derive(Serialize)]
struct TruePose {
    translation_m: [f64; 3],
    rotation_xyzw: [f64; 4],
}

impl From<Pose> for TruePose {
    fn from(pose: Pose) -> Self {
        Self { translation_m: pose.translation_m.to_array(), rotation_xyzw: pose.rotation.to_array() }
    }
}

impl<'a> From<&'a Record> for Line<'a> {
    fn from(record: &'a Record) -> Self {
        let solution = &record.solution;
        let estimate = solution.estimate;
        Self {
            seq: record.sequence,
            device: record.device,
            device_time_s: record.device_time_s,
            host_monotonic_ns: record.host_time.map(|time| time.monotonic_ns),
            host_utc_ns: record.host_time.map(|time| time.utc_ns),
            host_uncertainty_ns: record.host_time.map(|time| time.uncertainty_ns),
            status: solution.outcome.as_str(),
            reason: reason(&solution.outcome),
            translation_m: estimate.map(|estimate| estimate.pose.translation_m.to_array()),
            rotation_xyzw: estimate.map(|estimate| estimate.pose.rotation.to_array()),
            covariance: estimate.map(|estimate| flat(&estimate.covariance)),
            cells_used: solution.cells_used.count(),
            chi2: Some(solution.chi2).filter(|chi2| chi2.is_finite()),
            redundancy: solution.redundancy,
            verified: solution.verified().as_str(),
            unnoticed_sigmas: Some(solution.unnoticed_sigmas).filter(|sigmas| sigmas.is_finite()),
            excluded_cells: solution.excluded.iter().collect(),
            twist: record.twist.map(Motion::from),
            filtered: record.filtered.map(Filtered::from),
            simulated: record.simulated,
            truth: record.truth.map(TruePose::from),
        }
    }
}

#[derive(Serialize)]
struct FaultLine<'a> {
    kind: &'static str,
    fault: &'a str,
    device: Option<DeviceId>,
    device_time_s: f64,
}

pub(super) struct Ndjson<W> {
    output: W,
}

impl<W: Write> Ndjson<W> {
    pub(super) fn new(output: W) -> Self {
        Self { output }
    }
}

impl<W: Write> Sink for Ndjson<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        serde_json::to_writer(&mut self.output, &Line::from(record))?;
        self.output.write_all(b"\n")
    }

    /// Poses that follow an injected fault are not what the board would have given: the stream says so.
    fn note(&mut self, note: &Note) -> io::Result<()> {
        let Note::Event { device, device_time_s, text, .. } = note else { return Ok(()) };
        let Some(fault) = text.strip_prefix(ANNOUNCED) else { return Ok(()) };
        let line = FaultLine { kind: "injected_fault", fault, device: *device, device_time_s: *device_time_s };
        serde_json::to_writer(&mut self.output, &line)?;
        self.output.write_all(b"\n")
    }

    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        self.output.flush()
    }
}

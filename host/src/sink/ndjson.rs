//! One JSON object a scan, one line an object.

use std::io::{self, Write};

use serde::Serialize;
use slitpose_model::Pose;

use super::Sink;
use crate::pipeline::{Counts, Item, Record};

/// A pose as JSON: SI units, frame base_from_tool, quaternion x, y, z, w.
#[derive(Serialize)]
struct Line<'a> {
    seq: u64,
    device_time_s: f64,
    status: &'a str,
    translation_m: Option<[f64; 3]>,
    rotation_xyzw: Option<[f64; 4]>,
    /// Row-major, order (t, θ): m², m·rad, rad².
    #[serde(serialize_with = "covariance::serialize")]
    covariance: Option<[f64; 36]>,
    cells_used: usize,
    chi2: Option<f64>,
    redundancy: usize,
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
            device_time_s: record.device_time_s,
            status: solution.outcome.as_str(),
            translation_m: estimate.map(|estimate| estimate.pose.translation_m.to_array()),
            rotation_xyzw: estimate.map(|estimate| estimate.pose.rotation.to_array()),
            covariance: estimate.map(|estimate| std::array::from_fn(|i| estimate.covariance[i / 6][i % 6])),
            cells_used: solution.cells_used.count(),
            chi2: Some(solution.chi2).filter(|chi2| chi2.is_finite()),
            redundancy: solution.redundancy,
            simulated: record.simulated,
            truth: record.truth.map(TruePose::from),
        }
    }
}

/// Writes NDJSON.
pub(super) struct Ndjson<W> {
    output: W,
}

impl<W: Write> Ndjson<W> {
    pub(super) fn new(output: W) -> Self {
        Self { output }
    }
}

impl<W: Write> Sink for Ndjson<W> {
    fn take(&mut self, item: &Item<'_>) -> io::Result<()> {
        if let Item::Pose(record) = item {
            serde_json::to_writer(&mut self.output, &Line::from(*record))?;
            self.output.write_all(b"\n")?;
        }
        Ok(())
    }

    fn tick(&mut self, _: &Counts) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Counts) -> io::Result<()> {
        self.output.flush()
    }
}

//! NDJSON: one object per scan.

use std::io;
use std::io::Write;

use schemars::JsonSchema;
use serde::Serialize;

use super::{Note, Reports, Sink, json};
use slitpose_calibration::values_of;
use slitpose_head::faults::ANNOUNCED;
use slitpose_tracking::columns::{COLUMNS, Column, Get, Row, entries};
use slitpose_tracking::frame::View;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{EdgeRecord, Record};

/// Writes an object with the values of `row`, whose keys go on behind `behind` bytes.
fn write(columns: &[&'static Column], behind: usize, row: &Row<'_>, out: &mut Vec<u8>) {
    out.push(b'{');
    for (name, first, object) in entries(columns, behind) {
        let before = out.len();
        // The first of an object has no comma.
        out.extend_from_slice(if out.last() == Some(&b'{') { b"\"" } else { b",\"" });
        out.extend_from_slice(name.as_bytes());
        out.extend_from_slice(b"\":");
        let is_written = if let Some((inner, behind)) = object {
            let is_there = match first.get {
                Get::Translation(get) | Get::Velocity(get) => get(row).is_some(),
                _ => true,
            };
            if is_there {
                write(inner, behind, row, out);
            }
            is_there
        } else {
            value(first, row, out)
        };
        match (is_written, first.is_null) {
            (true, _) => {}
            (false, true) => out.extend_from_slice(b"null"),
            (false, false) => out.truncate(before),
        }
    }
    out.push(b'}');
}

/// Writes the value of `row`; `false`: it has none.
fn value(column: &Column, row: &Row<'_>, out: &mut Vec<u8>) -> bool {
    fn put<T: Serialize>(out: &mut Vec<u8>, value: &Option<T>) -> bool {
        value.iter().for_each(|value| json(out, value));
        value.is_some()
    }
    match column.get {
        Get::Integer(get) => put(out, &get(row)),
        Get::Count(get) => put(out, &Some(get(row))),
        Get::Number(get) => put(out, &get(row)),
        Get::Flag(get) => put(out, &Some(get(row))),
        Get::Word(_, get) => put(out, &Some(get(row)).filter(|word| !word.is_empty())),
        Get::Device(get) => put(out, &Some(get(row))),
        Get::Directions(get) => put(out, &Some(get(row).to_string()).filter(|names| !names.is_empty())),
        Get::Cells(get) => {
            let cells = get(row);
            put(out, &(!cells.is_empty()).then(|| cells.iter().collect::<Vec<_>>()))
        }
        Get::Translation(get) | Get::Velocity(get) | Get::AngularVelocity(get) => {
            put(out, &get(row).map(|v| v.to_array()))
        }
        Get::Rotation(get) => put(out, &get(row).map(|r| r.to_array())),
        Get::Covariance(get) | Get::Correlation(get) => put(out, &get(row).map(|matrix| matrix.as_flattened())),
        Get::TwistSigma(get) => put(out, &get(row)),
    }
}

/// A fault is injected from here on.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FaultLine<'a> {
    kind: &'static str,
    fault: &'a str,
    device: Option<DeviceId>,
    device_time_s: f64,
}

/// An edge of a board's trigger input. Its keys are those of a pose where they mean the same.
#[derive(Serialize, JsonSchema)]
pub(crate) struct EdgeLine {
    kind: &'static str,
    device: DeviceId,
    number: u32,
    device_time_s: f64,
    host_monotonic_ns: Option<u64>,
    host_utc_ns: Option<u64>,
    host_uncertainty_ns: Option<u64>,
    is_high: bool,
    missed: u32,
}

impl From<&EdgeRecord> for EdgeLine {
    fn from(edge: &EdgeRecord) -> Self {
        let time = edge.host_time.as_ref();
        Self {
            kind: "edge",
            device: edge.device,
            number: edge.number,
            device_time_s: edge.device_time_s,
            host_monotonic_ns: time.map(|time| time.monotonic_ns),
            host_utc_ns: time.map(|time| time.utc_ns),
            host_uncertainty_ns: time.map(|time| time.uncertainty_ns),
            is_high: edge.is_high,
            missed: edge.missed,
        }
    }
}

/// The frame that the next objects speak of.
#[derive(Serialize, JsonSchema)]
pub(crate) struct FrameLine<'a> {
    kind: &'static str,
    device: DeviceId,
    frame: &'a str,
    /// Translation, m, and rotation vector, rad.
    user_from_base: [f64; 6],
    /// The tip in the tool frame, m.
    tip_m: [f64; 3],
}

pub(super) struct Ndjson<W> {
    output: W,
    /// The last one of each board.
    views: Vec<(DeviceId, &'static View)>,
    columns: Vec<&'static Column>,
    line: Vec<u8>,
}

impl<W: Write> Ndjson<W> {
    pub(super) fn new(output: W) -> Self {
        let columns = COLUMNS.iter().filter(|column| !column.key.is_empty()).collect();
        Self { output, views: Vec::new(), columns, line: Vec::new() }
    }
}

impl<W: Write> Sink for Ndjson<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.line.clear();
        if let Some(view) = record.view.filter(|view| !self.views.contains(&(record.device, view))) {
            self.views.retain(|(device, _)| *device != record.device);
            self.views.push((record.device, view));
            json(
                &mut self.line,
                &FrameLine {
                    kind: "frame",
                    device: record.device,
                    frame: view.name(),
                    user_from_base: values_of(view.user_from_base()),
                    tip_m: view.tip_m().to_array(),
                },
            );
            self.line.push(b'\n');
        }
        write(&self.columns, 0, &Row::from(record), &mut self.line);
        self.line.push(b'\n');
        self.output.write_all(&self.line)
    }

    fn note(&mut self, note: &Note) -> io::Result<()> {
        self.line.clear();
        match note {
            Note::Edge(edge) => json(&mut self.line, &EdgeLine::from(edge)),
            // Poses that follow an injected fault are not what the board would have given: the stream says so.
            Note::Text { device, device_time_s, text, .. } => {
                let Some(fault) = text.strip_prefix(ANNOUNCED) else { return Ok(()) };
                let line = FaultLine { kind: "injected_fault", fault, device: *device, device_time_s: *device_time_s };
                json(&mut self.line, &line);
            }
        }
        self.line.push(b'\n');
        self.output.write_all(&self.line)
    }

    fn tick(&mut self, _: &Reports<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Reports<'_>) -> io::Result<()> {
        self.output.flush()
    }
}

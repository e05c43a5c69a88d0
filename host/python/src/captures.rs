//! Captures, solved again or as photocurrents.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slitpose_head::threads::lock;
use slitpose_model::{Photocurrents, Reading};
use slitpose_tracking::frame::View;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{EdgeRecord, Item, Scan};
use slitpose_tracking::playback::{Choice, Event, Playback, PlaybackError, Yields};
use slitpose_tracking::solving::{Filter, Solving};

use crate::arrays::{Columns, PoseArrays, number_in};
use crate::work::{beside, raised, seconds, tier_choice};

/// What a cell's reading is, by its number.
pub(crate) const READINGS: [&str; 3] = ["light", "saturated", "missing"];

/// Captures that are read from front to back.
#[pyclass(module = "slitpose._native")]
pub(crate) struct Captures {
    /// Never locked by two: Python's classes have to be shareable, and decompressors are not.
    playback: Mutex<Playback>,
    yields_currents: bool,
    heard: Heard,
    is_ended: bool,
}

/// What the captures have told so far, besides rows.
#[derive(Default)]
struct Heard {
    devices: Vec<DeviceId>,
    edges: Vec<EdgeRecord>,
    remarks: Vec<String>,
    losses: Vec<String>,
}

/// The rows of one call.
struct Rows {
    records: PoseArrays,
    currents: CurrentColumns,
}

#[pymethods]
impl Captures {
    #[new]
    #[pyo3(signature = (files, *, scene=None, calibration=None, tier=None, tolerance=None, filter_s=None,
        without_clipped=false, known_light=false, frame=None, tip=None, from_s=None, to_s=None, duration_s=None,
        warm_up_s=None, currents=false))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        files: Vec<PathBuf>,
        scene: Option<String>,
        calibration: Option<PathBuf>,
        tier: Option<&str>,
        tolerance: Option<f64>,
        filter_s: Option<f64>,
        without_clipped: bool,
        known_light: bool,
        frame: Option<&str>,
        tip: Option<&str>,
        from_s: Option<f64>,
        to_s: Option<f64>,
        duration_s: Option<f64>,
        warm_up_s: Option<f64>,
        currents: bool,
    ) -> PyResult<Self> {
        for (name, value) in [
            ("filter_s", filter_s),
            ("from_s", from_s),
            ("to_s", to_s),
            ("duration_s", duration_s),
            ("warm_up_s", warm_up_s.filter(|warm_up_s| *warm_up_s != f64::INFINITY)),
        ] {
            seconds(name, value)?;
        }
        if let (from_s, Some(to_s)) = (from_s.unwrap_or(0.0), to_s)
            && to_s <= from_s
        {
            let text = format!("to_s = {to_s} does not lie behind from_s = {from_s}; give a later end");
            return Err(PyValueError::new_err(text));
        }
        // No filter is one of no memory.
        let filter = filter_s.map(|filter_s| Filter(Some(filter_s).filter(|filter_s| *filter_s > 0.0)));
        let choice = Choice {
            scene,
            calibration,
            solving: Solving { filter, without_clipped, known_light, tier: tier_choice(tier, tolerance)? },
            from_s,
            to_s,
            duration_s: duration_s.filter(|duration_s| *duration_s > 0.0),
            is_watched: false,
            yields: match warm_up_s {
                _ if currents => Yields::Currents,
                Some(warm_up_s) => Yields::PosesOfPart { warm_up_s },
                None => Yields::Poses,
            },
            faults: Vec::new(),
            view: View::open(frame, tip).map_err(raised)?,
        };
        Ok(Self {
            playback: beside(py, |_| Playback::open(files, choice))?.map_err(raised)?.into(),
            yields_currents: currents,
            heard: Heard::default(),
            is_ended: false,
        })
    }

    /// The next rows, at least so many if there are, as arrays by name; None at the end.
    #[pyo3(signature = (min_rows=None))]
    fn read<'py>(&mut self, py: Python<'py>, min_rows: Option<usize>) -> PyResult<Option<Bound<'py, PyDict>>> {
        if self.is_ended {
            return Ok(None);
        }
        let Self { playback, heard, .. } = self;
        let playback = playback.get_mut().unwrap_or_else(PoisonError::into_inner);
        let mut rows = Rows { records: PoseArrays::new(true), currents: CurrentColumns::default() };
        let mut is_more = true;
        let wanted = min_rows.unwrap_or(usize::MAX);
        let read = beside(py, |stop| {
            while is_more && rows.len() < wanted && !stop.load(Ordering::Relaxed) {
                is_more = playback.step(|event| heard.hear(event, &mut rows))?;
            }
            if !is_more {
                playback.end(|event| heard.hear(event, &mut rows))?;
            }
            Ok::<_, PlaybackError>(())
        });
        self.is_ended = !is_more;
        read?.map_err(raised)?;
        let columns = Columns::new(py, rows.len());
        if self.yields_currents {
            rows.currents.put(&columns)?;
        } else {
            rows.records.put(&columns)?;
        }
        Ok(Some(columns.dict))
    }

    /// The boards, by the numbers of the column `device`: 24 hexadecimal digits each.
    #[getter]
    fn devices(&self) -> Vec<String> {
        self.heard.devices.iter().map(ToString::to_string).collect()
    }

    /// The edges of trigger inputs so far, as arrays by name.
    #[getter]
    fn edges<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Heard { devices, edges, .. } = &mut self.heard;
        let columns = Columns::new(py, edges.len());
        let device = edges.iter().map(|edge| number_in(devices, edge.device)).collect();
        columns.put::<u8>("device", device)?;
        columns.put("number", edges.iter().map(|edge| edge.number).collect())?;
        columns.put("time_s", edges.iter().map(|edge| edge.device_time_s).collect())?;
        let host_utc_ns = |edge: &EdgeRecord| edge.host_time.map_or(0, |time| time.utc_ns);
        columns.put("host_utc_ns", edges.iter().map(host_utc_ns).collect())?;
        columns.put("is_high", edges.iter().map(|edge| edge.is_high).collect())?;
        columns.put("missed", edges.iter().map(|edge| edge.missed).collect())?;
        Ok(columns.dict)
    }

    /// What is remarkable so far.
    #[getter]
    fn remarks(&self) -> Vec<String> {
        self.heard.remarks.clone()
    }

    /// What was damaged or lost so far; of the boards, at the end.
    #[getter]
    fn losses(&self) -> Vec<String> {
        self.heard.losses.clone()
    }

    /// When sessions began, seconds after the beginning; not the first of each board.
    #[getter]
    fn sessions(&self) -> Vec<f64> {
        lock(&self.playback).sessions().flat_map(|(_, begun_s)| begun_s).copied().collect()
    }

    /// Of each board, by its name, digests of what its poses depend on before the part and behind it.
    #[getter]
    fn seams(&self) -> Vec<(String, Option<u64>, Option<u64>)> {
        let name = |device: Option<DeviceId>| device.map_or_else(String::new, |device| device.to_string());
        lock(&self.playback).seams().map(|(device, seam)| (name(device), seam.before, seam.behind)).collect()
    }
}

impl Rows {
    fn len(&self) -> usize {
        self.records.rows.max(self.currents.time_s.len())
    }
}

impl Heard {
    fn hear(&mut self, event: Event<'_>, rows: &mut Rows) -> Result<(), PlaybackError> {
        match event {
            Event::Item { item: Item::Pose(record), .. } => rows.records.push(&record.into(), &mut self.devices),
            Event::Item { item: Item::Edge(edge), .. } => self.edges.push(edge),
            Event::Item { item: Item::Oddity { oddity, .. }, .. } => self.remarks.push(oddity.to_string()),
            Event::Item { .. } | Event::Board { .. } => {}
            Event::Currents { device, scan, currents, .. } => {
                let device = number_in(&mut self.devices, device.unwrap_or_default());
                rows.currents.push(device, scan, currents);
            }
            Event::Remark(remark) => self.remarks.push(remark.to_owned()),
            Event::Loss(loss) => self.losses.push(loss.to_owned()),
        }
        Ok(())
    }
}

#[derive(Default)]
struct CurrentColumns {
    device: Vec<u8>,
    sequence: Vec<u64>,
    time_s: Vec<f64>,
    host_utc_ns: Vec<u64>,
    /// Cells of the widest scan so far: heads of one capture may differ.
    cells: usize,
    rows: Vec<Vec<(f64, f64, u8)>>,
}

impl CurrentColumns {
    fn push(&mut self, device: u8, scan: &Scan, currents: &Photocurrents) {
        self.device.push(device);
        self.sequence.push(scan.sequence);
        self.time_s.push(scan.device_time_s);
        self.host_utc_ns.push(scan.host_time.map_or(0, |time| time.utc_ns));
        self.cells = self.cells.max(currents.cells.len());
        let of_cell = |reading: &Reading| match reading {
            Reading::Light(pair) => (pair.i_x1_a, pair.i_x2_a, 0),
            Reading::Saturated => (f64::NAN, f64::NAN, 1),
            Reading::Missing => (f64::NAN, f64::NAN, 2),
        };
        self.rows.push(currents.cells.iter().map(of_cell).collect());
    }

    fn put(self, columns: &Columns<'_>) -> PyResult<()> {
        let mut currents_a = Vec::with_capacity(self.rows.len() * self.cells * 2);
        let mut reading = Vec::with_capacity(self.rows.len() * self.cells);
        for row in &self.rows {
            for cell in 0..self.cells {
                let (i_x1_a, i_x2_a, kind) = row.get(cell).copied().unwrap_or((f64::NAN, f64::NAN, 2));
                currents_a.extend([i_x1_a, i_x2_a]);
                reading.push(kind);
            }
        }
        columns.put("device", self.device)?;
        columns.put("sequence", self.sequence)?;
        columns.put("time_s", self.time_s)?;
        columns.put("host_utc_ns", self.host_utc_ns)?;
        columns.put_shaped("currents_a", currents_a, &[self.cells, 2])?;
        columns.put_shaped("reading", reading, &[self.cells])
    }
}

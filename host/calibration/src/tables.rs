//! Rows from CSV tables.

use std::collections::HashSet;

use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{CurrentColumns, PoseColumns, TableError, TableReader};
use slitpose_model::{Cell, Detector, Pair};

use crate::data::{Constraint, Data, Knowledge, Row};
use crate::{CalibrateError, Implausible};

/// Rows of a table without poses that are taken at most; more tell next to nothing new.
pub const MAX_ROWS: usize = 1500;

/// Rows of a table that are read at most: some 300 MB of memory for six cells.
const MAX_READ_ROWS: u64 = 1 << 20;

/// Change of a cell's currents, relative to its total, up to which neighbouring readings are averaged: curvature over
/// such a way is below 2e-5.
const AVERAGED_CHANGE: f64 = 0.02;

const MAX_AVERAGED: usize = 256;

/// Change of the same between the halves of a rest.
const REST_CHANGE: f64 = 2e-3;

/// Reads a table into `data`.
pub fn read(
    file: &SceneFile,
    table: &str,
    constraint: Constraint,
    sigmas: [f64; 2],
    data: &mut Data,
) -> Result<(), CalibrateError> {
    let mut reader = TableReader::open(table)?.of_at_most(MAX_READ_ROWS);
    let cells = file.scene.cells.len();
    if reader.optional_column(&format!("i_x1_{cells}_a"))?.is_some() {
        return Err(Implausible::MoreCells(table.to_owned(), cells).into());
    }
    let currents = CurrentColumns::find(&reader, cells)?;
    let frames = reader.optional_column("frames")?;
    let id = reader.column("id")?;
    let time = reader.optional_column("time_s")?;
    let has_poses = matches!(constraint, Constraint::Known | Constraint::KnownInOwnFrames);
    let poses = has_poses.then(|| PoseColumns::find(&reader)).transpose()?;
    let step = (constraint == Constraint::Stage).then(|| reader.column("step_mm")).transpose()?;
    let mut known: HashSet<Vec<u64>> = data.rows.iter().filter_map(digits).collect();
    let mut rows = Vec::new();
    while let Some(row) = reader.next_row()? {
        let knowledge = match (&poses, step) {
            (Some(poses), _) => Knowledge::Reported(poses.pose(&row)?),
            (None, Some(step)) => Knowledge::Step(row.number(step)? * 1e-3),
            (None, None) => Knowledge::Nothing,
        };
        // Some other table's idea of time is no fault: rows then count in their order.
        let time_s = time.and_then(|time| row.number(time).ok()).map(|time_s| [time_s; 2]);
        let frames = match frames.map(|column| row.number(column).map(|frames| (column, frames))).transpose()? {
            None => 1.0,
            Some((_, frames)) if frames >= 1.0 => frames,
            Some((column, frames)) => {
                let allowed = "the number of frames averaged, at least 1";
                return Err(row.out_of_range(column, frames, allowed).into());
            }
        };
        let of_cell = |(number, cell): (usize, &Cell)| Ok(above_dark(&cell.detector, &currents.pair(&row, number)?));
        let readings = file.scene.cells.iter().enumerate().map(of_cell).collect::<Result<_, TableError>>()?;
        let row = Row { id: row.text(id).to_owned(), readings, frames, time_s, knowledge };
        if digits(&row).is_some_and(|digits| !known.insert(digits)) {
            return Err(Implausible::Repeated(table.to_owned(), rows.len() + 1).into());
        }
        rows.push(row);
    }
    if constraint == Constraint::Free {
        rows = thinned(rows);
    }
    data.add(table, constraint, sigmas, rows);
    Ok(())
}

/// All numbers of a reported pose and its readings.
fn digits(row: &Row) -> Option<Vec<u64>> {
    let Knowledge::Reported(pose) = row.knowledge else { return None };
    let readings = row.readings.iter().flatten().flatten().copied();
    let numbers = pose.translation_m.to_array().into_iter().chain(pose.rotation.to_array()).chain(readings);
    Some(numbers.map(f64::to_bits).collect())
}

/// The currents of a cell above dark, amperes; `None`: faint, or beyond saturation.
pub fn above_dark(detector: &Detector, pair: &Pair<f64>) -> Option<[f64; 2]> {
    let half_dark = 0.5 * detector.dark_current_a;
    let is_usable = pair.total_a() - detector.dark_current_a > detector.faint_a
        && detector.saturation_a.is_none_or(|limit| pair.total_a() <= limit);
    is_usable.then_some([pair.i_x1_a - half_dark, pair.i_x2_a - half_dark])
}

/// Thins rows without poses: at most [`MAX_ROWS`] rows, spread evenly, each the mean of its neighbours as long as the tool hardly moves.
pub fn thinned(rows: Vec<Row>) -> Vec<Row> {
    if rows.len() <= MAX_ROWS {
        return rows;
    }
    let (mut groups, mut rest) = (Vec::new(), &rows[..]);
    while let Some((first, after)) = rest.split_first() {
        let near = after.iter().take(MAX_AVERAGED - 1).take_while(|next| is_near(first, next, AVERAGED_CHANGE)).count();
        let (group, others) = rest.split_at(1 + near);
        groups.extend(mean(group));
        rest = others;
    }
    let count = groups.len();
    let most = MAX_ROWS.min(count);
    (0..most).map(|k| groups[k * count / most].clone()).collect()
}

/// The mean of rows whose tool hardly moves, with the name of the first; `None`: there are none.
pub fn mean(rows: &[Row]) -> Option<Row> {
    let mut sum = rows.first()?.clone();
    for next in &rows[1..] {
        sum.frames += next.frames;
        if let (Some([_, last]), Some([_, of_next])) = (&mut sum.time_s, next.time_s) {
            *last = of_next;
        }
        for (sum, next) in sum.readings.iter_mut().zip(&next.readings) {
            *sum = sum.zip(*next).map(|(sum, next)| [0, 1].map(|k| sum[k] + next[k]));
        }
    }
    for reading in sum.readings.iter_mut().flatten() {
        *reading = reading.map(|value| value / rows.len() as f64);
    }
    Some(sum)
}

/// Whether the light on the detectors differs by no more than a tool at rest allows: some 10 µm.
pub fn is_at_rest(first: &Row, next: &Row) -> bool {
    is_near(first, next, REST_CHANGE)
}

/// Whether the currents of each cell differ by less than this share of its total.
fn is_near(first: &Row, next: &Row, share: f64) -> bool {
    first.frames == next.frames
        && first.readings.iter().zip(&next.readings).all(|pair| match pair {
            (Some(a), Some(b)) => {
                let change = share * (a[0] + a[1]);
                (a[0] - b[0]).abs() < change && (a[1] - b[1]).abs() < change
            }
            (None, None) => true,
            _ => false,
        })
}

//! `slitpose solve`: currents of all cells in, poses out.

use std::path::PathBuf;

use slitpose_model::Pair;

use super::options::{CalibrationOption, FrameOptions, Jobs, TierOptions, UNREADABLE, open_scene};
use super::{CommandError, Outcome, options};
use slitpose_head::table::{
    Column, CurrentColumns, Output, Row, Rows, TableError, TableReader, TableRows, TableWriter,
};
use slitpose_tracking::columns::{self, Column as PoseColumn, Field};
use slitpose_tracking::frame::View;
use slitpose_tracking::solving::{RowSolver, STREAM_TOLERANCE};

/// Finds the pose behind each row of currents, each from a cold start.
///
/// Columns in: id, and for each cell k i_x1_k_a and i_x2_k_a, all taken at one instant, dark current
/// included; and optionally frames: the row is the mean of so many, and has less noise. Columns out: status, pose, standard deviations, condition number, chi2, iterations,
/// cells_used, free_directions, which names what an unobservable pose leaves open, excluded_cells,
/// which contradict all others, and verified: how well redundancy checked the pose (well: no single
/// faulty cell can have moved it by 30 sigma unnoticed; weakly: by 300; not); reason, why a pose is
/// degraded. A row without a pose keeps its place, with a status. A row with a field that is no number has the status
/// unreadable; its fault is said, and the exit code is 3.
///
/// A scene with [tolerance] is solved by these, unless a calibration is given: every pose is degraded, as
/// uncalibrated, and its standard deviations are those of parts within their tolerances.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose model wide --poses poses.csv | slitpose solve wide --currents -")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Table of currents; - is standard input
    #[arg(long, value_name = "CSV")]
    currents: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    #[command(flatten)]
    tier: TierOptions,
    #[command(flatten)]
    frame: FrameOptions,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    without_clipped: bool,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let head = args.calibration.head(open_scene(&args.scene)?)?;
    let solver = RowSolver::new(head, args.tier.tier(STREAM_TOLERANCE), args.without_clipped)?;
    let mut currents = TableReader::open(&args.currents)?;
    let columns = Columns {
        id: currents.column("id")?,
        currents: CurrentColumns::find(&currents, solver.cells())?,
        frames: currents.optional_column("frames")?,
    };
    let poses = columns::of_tables(false);
    let names: Vec<String> = poses.iter().flat_map(|column| column.names()).collect();
    let header = std::iter::once("id").chain(names.iter().map(String::as_str));
    let table = TableWriter::new(Output::open(args.output.as_deref())?, header)?;
    let view = args.frame.view()?;
    args.jobs.table("solve", &mut currents, table, |rows, table| solve(&solver, view, &columns, &poses, rows, table))
}

/// Where the table of currents keeps what is read of it.
struct Columns {
    id: Column,
    currents: CurrentColumns,
    frames: Option<Column>,
}

struct Read<'a> {
    id: &'a str,
    /// Of every cell; of none, if the row is unreadable.
    currents: Vec<Pair<f64>>,
    frames: f64,
}

impl Columns {
    fn read(&self, row: &Row<'_>, cells: usize) -> Result<(Vec<Pair<f64>>, f64), TableError> {
        let currents = (0..cells).map(|cell| self.currents.pair(row, cell)).collect::<Result<_, _>>()?;
        let frames = match self.frames {
            Some(column) => match row.number(column)? {
                frames if frames >= 1.0 => frames,
                frames => return Err(row.out_of_range(column, frames, "a number of frames, 1 or more")),
            },
            None => 1.0,
        };
        Ok((currents, frames))
    }
}

/// Solves `rows` into `table`; returns the faults of those that cannot be read.
fn solve(
    solver: &RowSolver,
    view: Option<&View>,
    columns: &Columns,
    poses: &[&PoseColumn],
    rows: &Rows,
    table: &mut TableRows,
) -> Result<Vec<TableError>, CommandError> {
    let cells = solver.cells();
    let mut read = Vec::with_capacity(rows.len());
    let mut faults = Vec::new();
    for row in rows.iter() {
        let (currents, frames) = match columns.read(&row, cells) {
            Err(fault @ TableError::NotANumber { .. }) => {
                faults.push(fault);
                (Vec::new(), 1.0)
            }
            read => read?,
        };
        read.push(Read { id: row.text(columns.id), currents, frames });
    }
    // Those that are means of as many frames have one solver.
    for run in read.chunk_by(|a, b| a.frames.to_bits() == b.frames.to_bits()) {
        let ready = solver.with_frames(run[0].frames)?;
        for row in run {
            let readings = ready.readings((0..cells).map(|cell| row.currents.get(cell).copied()));
            let mut solution = ready.solve(&readings);
            view.iter().for_each(|view| view.apply(&mut solution));
            table.text(row.id);
            if row.currents.is_empty() {
                table.text(UNREADABLE);
            }
            // The first column is the status.
            let poses = &poses[usize::from(row.currents.is_empty())..];
            let mut put = |field: Field<'_>| match field {
                Field::Integer(Some(value)) => table.integer(value as usize),
                Field::Integer(None) => table.text(""),
                Field::Number(value) => table.optional(value),
                Field::Word(word) => table.text(word),
                Field::Flag(flag) => table.text(if flag { "true" } else { "false" }),
            };
            poses.iter().for_each(|column| column.put(&(&solution).into(), &mut put));
            table.end_row();
        }
    }
    Ok(faults)
}

//! `slitpose solve`: currents of all cells in, poses out; and `slitpose model`, the other way.

use std::path::PathBuf;
use std::sync::Mutex;

use slitpose_model::{CompiledScene, Pair, Pose, Response, Tier};

use super::options::{CalibrationOption, Jobs, TierOptions, UNREADABLE, open_scene};
use super::{CommandError, Outcome, options, talk};
use slitpose_head::table::{
    Column, CurrentColumns, Output, PoseColumns, PoseSizes, Row, Rows, SOLUTION_COLUMNS, SolutionRow, TableError,
    TableReader, TableRows, TableWriter,
};
use slitpose_head::threads::lock;
use slitpose_tracking::solving::{MODEL_TOLERANCE, RowSolver, STREAM_TOLERANCE};

/// Solutions that are kept until their condition numbers are known.
const AT_ONCE: usize = 64;

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
    let header = std::iter::once("id").chain(SOLUTION_COLUMNS);
    let table = TableWriter::new(Output::open(args.output.as_deref())?, header)?;
    args.jobs.table("solve", &mut currents, table, |rows, table| solve(&solver, &columns, rows, table))
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
    columns: &Columns,
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
    // Those that are means of as many frames are solved at once.
    for run in read.chunk_by(|a, b| a.frames.to_bits() == b.frames.to_bits()) {
        let ready = solver.with_frames(run[0].frames)?;
        let readings: Vec<_> =
            run.iter().map(|row| ready.readings((0..cells).map(|cell| row.currents.get(cell).copied()))).collect();
        for (run, readings) in run.chunks(AT_ONCE).zip(readings.chunks(AT_ONCE)) {
            let mut solutions = Vec::with_capacity(run.len());
            ready.solve(readings, |solution| solutions.push(solution));
            let mut rows = run.iter().zip(&solutions);
            ready.conditions(&solutions, |condition| {
                if let Some((row, solution)) = rows.next() {
                    let mut solution = SolutionRow::with_condition(solution, condition);
                    if row.currents.is_empty() {
                        solution.status = UNREADABLE;
                    }
                    write(table, row.id, &solution);
                }
            });
        }
    }
    Ok(faults)
}

fn write(table: &mut TableRows, id: &str, solution: &SolutionRow) {
    table.text(id);
    table.text(solution.status);
    for number in solution.numbers {
        table.optional(number);
    }
    table.integer(solution.iterations);
    table.integer(solution.cells_used);
    table.text(&solution.free_directions);
    table.text(&solution.excluded_cells);
    table.text(solution.verified);
    table.text(solution.reason);
    table.end_row();
}

// The other way.

/// How many times as far out as the workspace poses may lead without a word: beyond, currents are of interest, too.
const FAR: f64 = 100.0;

/// Evaluates every cell of a scene at every pose of a table.
///
/// Columns in: id, tx_mm, ty_mm, tz_mm, rx_rad, ry_rad, rz_rad (rotation vector), in any order.
/// Columns out, for each cell k: status_k, flags_k, x_a_k_mm, solid_angle_k_sr, i_o_k_a,
/// i_x1_k_a, i_x2_k_a. x_a is empty where there is no light. A row that holds no pose keeps its place, with the status
/// unreadable; its fault is said, and the exit code is 3.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose model wide --poses poses.csv --output currents.csv")]
pub(super) struct ModelArgs {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Table of poses; - is standard input
    #[arg(long, value_name = "CSV")]
    poses: String,
    #[command(flatten)]
    calibration: CalibrationOption,
    #[command(flatten)]
    tier: TierOptions,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
}

pub(super) fn model(args: &ModelArgs) -> Result<Outcome, CommandError> {
    let file = args.calibration.head_as_drawn(open_scene(&args.scene)?)?.file;
    let tier = args.tier.tier(MODEL_TOLERANCE);
    let plan = CompiledScene::<f64>::compile(&file.scene, tier)?;
    let mut poses = TableReader::open(&args.poses)?;
    let columns = PoseColumns::find(&poses)?;
    let names: Vec<String> = (0..plan.cell_count()).flat_map(column_names).collect();
    let header = std::iter::once("id").chain(names.iter().map(String::as_str));
    let table = TableWriter::new(Output::open(args.output.as_deref())?, header)?;
    let inexact = Mutex::new(Inexact { rows: 0, worst: 0.0 });
    let all_sizes = Mutex::new(PoseSizes::default());
    let outcome = args.jobs.table("model", &mut poses, table, |rows, table| {
        let (mut sizes, mut faults) = (PoseSizes::default(), Vec::new());
        for row in rows.iter() {
            let pose = match sizes.pose(&columns, &row) {
                Ok(pose) => pose,
                Err(fault @ TableError::NotANumber { .. }) => {
                    faults.push(fault);
                    write_unreadable(table, columns.id(&row), plan.cell_count());
                    continue;
                }
                Err(fault) => return Err(fault.into()),
            };
            let reached = evaluate(&plan, columns.id(&row), &pose, table);
            if let Tier::Exact { tolerance } = tier
                && reached > tolerance
            {
                lock(&inexact).add(reached);
            }
        }
        lock(&all_sizes).merge(&sizes);
        Ok(faults)
    })?;
    let finding = lock(&all_sizes).finding(&args.poses, &file.workspace, FAR);
    finding.iter().for_each(|finding| talk(format_args!("{finding}")));
    let Inexact { rows: inexact_rows, worst } = *lock(&inexact);
    let most = CompiledScene::<f64>::MAX_EVALUATIONS;
    if worst.is_infinite() {
        talk(format_args!(
            "{inexact_rows} rows are not good to the tolerance: the exact tier met its limit of {most} values of a \
             profile for a cell, in some before it found light where there may be some; a smaller spot or a wider \
             profile takes fewer"
        ));
    } else if inexact_rows > 0 {
        talk(format_args!(
            "{inexact_rows} rows are good to {worst:.1e} of I_O only: the exact tier met its limit of {most} values of a \
             profile for a cell, or of rounding; --tolerance {worst:.0e} takes less time"
        ));
    }
    Ok(outcome)
}

/// Rows that are not good to the tolerance, and the largest relative error of one.
struct Inexact {
    rows: u64,
    worst: f64,
}

impl Inexact {
    fn add(&mut self, reached: f64) {
        self.rows += 1;
        self.worst = self.worst.max(reached);
    }
}

/// Writes the row of a pose, and says how large the relative error of its integrals may be.
fn evaluate(plan: &CompiledScene<f64>, id: &str, pose: &Pose, table: &mut TableRows) -> f64 {
    table.text(id);
    let mut reached = 0.0_f64;
    for cell in 0..plan.cell_count() {
        let response = plan.respond(cell, pose);
        write_response(table, &response);
        if let Some(integration) = response.integration {
            reached = reached.max(integration.relative_error);
        }
    }
    table.end_row();
    reached
}

fn write_unreadable(table: &mut TableRows, id: &str, cells: usize) {
    table.text(id);
    for _ in 0..cells {
        table.text(UNREADABLE);
        (1..column_names(0).len()).for_each(|_| table.text(""));
    }
    table.end_row();
}

fn column_names(cell: usize) -> [String; 7] {
    [
        format!("status_{cell}"),
        format!("flags_{cell}"),
        format!("x_a_{cell}_mm"),
        format!("solid_angle_{cell}_sr"),
        format!("i_o_{cell}_a"),
        format!("i_x1_{cell}_a"),
        format!("i_x2_{cell}_a"),
    ]
}

fn write_response(table: &mut TableRows, response: &Response<f64>) {
    table.text(response.status.as_str());
    table.text(&response.flags.to_string());
    table.optional(response.x_a_m.map(|x_a_m| x_a_m * 1e3));
    table.number(response.solid_angle_sr);
    table.number(response.i_o_a);
    table.number(response.currents.i_x1_a);
    table.number(response.currents.i_x2_a);
}

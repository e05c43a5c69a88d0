//! `slitpose model`: poses in, currents of all cells out.

use std::path::PathBuf;
use std::sync::Mutex;

use slitpose_model::{CompiledScene, Pose, Response, Tier};

use super::options::{CalibrationOption, Jobs, TierOptions, UNREADABLE, open_scene};
use super::{CommandError, Outcome, options, talk};
use slitpose_head::table::{Output, PoseColumns, PoseSizes, TableError, TableReader, TableRows, TableWriter};
use slitpose_head::threads::lock;
use slitpose_tracking::solving::MODEL_TOLERANCE;

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
pub(super) struct Args {
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

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
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

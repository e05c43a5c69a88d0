//! `slitpose solve`: currents of all cells in, poses out.

use std::path::PathBuf;

use super::options::{CalibrationOption, TierOptions};
use super::{CommandError, Outcome, names};
use crate::solving::RowSolver;
pub(super) use crate::solving::STREAM_TOLERANCE as DEFAULT_TOLERANCE;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{CurrentColumns, Output, SOLUTION_COLUMNS, SolutionRow, TableReader, TableWriter};

/// Finds the pose behind each row of currents, each from a cold start.
///
/// Columns in: id, and for each cell k i_x1_k_a and i_x2_k_a, all taken at one instant, dark current
/// included; and optionally frames: the row is the mean of so many, and has less noise. Columns out: status, pose, standard deviations, condition number, chi2, iterations,
/// cells_used, free_directions, which names what an unobservable pose leaves open, excluded_cells,
/// which contradict all others, and verified: how well redundancy checked the pose (well: no single
/// faulty cell can have moved it by 30 sigma unnoticed; weakly: by 300; not); reason, why a pose is
/// degraded. A row without a pose keeps its place, with a status.
///
/// A scene with [tolerance] is solved by these, unless a calibration is given: every pose is degraded, as
/// uncalibrated, and its standard deviations are those of parts within their tolerances.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose model wide --poses poses.csv | slitpose solve wide --currents -")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = names::scenes(), hide_possible_values = true)]
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
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let head = args.calibration.head(SceneFile::open(&args.scene)?)?;
    let mut solver = RowSolver::new(head, args.tier.tier(DEFAULT_TOLERANCE), args.without_clipped)?;
    let cells = solver.cells();
    let mut currents = TableReader::open(&args.currents)?;
    let id = currents.column("id")?;
    let columns = CurrentColumns::find(&currents, cells)?;
    let frames_column = currents.optional_column("frames")?;
    let header = std::iter::once("id").chain(SOLUTION_COLUMNS);
    let mut table = TableWriter::new(Output::open(args.output.as_deref())?, header)?;
    while let Some(row) = currents.next_row()? {
        let pairs = (0..cells).map(|cell| columns.pair(&row, cell)).collect::<Result<Vec<_>, _>>()?;
        let frames = match frames_column {
            Some(column) => match row.number(column)? {
                frames if frames >= 1.0 => frames,
                frames => return Err(row.out_of_range(column, frames, "a number of frames, 1 or more").into()),
            },
            None => 1.0,
        };
        let solution = solver.with_frames(frames)?.solve(pairs.into_iter().map(Some));
        let solution = SolutionRow::of(&solution);
        table.text(row.text(id))?;
        table.text(solution.status)?;
        for number in solution.numbers {
            table.optional(number)?;
        }
        table.text(&solution.iterations.to_string())?;
        table.text(&solution.cells_used.to_string())?;
        table.text(&solution.free_directions)?;
        table.text(&solution.excluded_cells)?;
        table.text(solution.verified)?;
        table.text(solution.reason)?;
        table.end_row()?;
    }
    table.finish()?;
    Ok(Outcome::Done)
}

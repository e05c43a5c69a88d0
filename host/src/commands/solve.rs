//! `slitpose solve`: currents of all cells in, poses out.

use std::collections::BTreeMap;
use std::path::PathBuf;

use slitpose_calibration::Head;
use slitpose_model::{MotionPrior, Pair, Photocurrents, Scene, SceneError, Solver, Start, Tier};

use super::options::{CalibrationOption, TierOptions};
use super::{CommandError, Outcome, names};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::{CurrentColumns, Output, SOLUTION_COLUMNS, SolutionRow, TableReader, TableWriter};

/// A measured current is worth no more digits.
pub(super) const DEFAULT_TOLERANCE: f64 = 1e-6;

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

/// Most numbers of averaged frames whose solvers are kept.
const MOST_SOLVERS: usize = 64;

/// Solvers by the frames that a reading is the mean of.
struct Solvers {
    scene: Scene,
    tier: Tier,
    without_clipped: bool,
    ready: BTreeMap<u64, Solver<f64>>,
}

impl Solvers {
    /// That for readings of `frames` frames.
    fn of(&mut self, frames: f64) -> Result<&Solver<f64>, SceneError> {
        let key = frames.to_bits();
        if !self.ready.contains_key(&key) {
            if self.ready.len() >= MOST_SOLVERS {
                self.ready.clear();
            }
            let noise = self.scene.noise.map(|noise| noise.averaged(frames));
            let solver = Solver::new(&Scene { noise, ..self.scene.clone() }, self.tier)?;
            self.ready.insert(key, if self.without_clipped { solver.without_clipped() } else { solver });
        }
        Ok(&self.ready[&key])
    }
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let head = args.calibration.head(SceneFile::open(&args.scene)?, Head::as_scene_says)?;
    let scene = head.file.scene.clone();
    let half_dark: Vec<f64> = scene.cells.iter().map(|cell| 0.5 * cell.detector.dark_current_a).collect();
    let mut solvers = Solvers {
        scene,
        tier: args.tier.tier(DEFAULT_TOLERANCE),
        without_clipped: args.without_clipped,
        ready: BTreeMap::new(),
    };
    solvers.of(1.0)?;
    let mut currents = TableReader::open(&args.currents)?;
    let id = currents.column("id")?;
    let columns = CurrentColumns::find(&currents, half_dark.len())?;
    let frames_column = currents.optional_column("frames")?;
    let header = std::iter::once("id").chain(SOLUTION_COLUMNS);
    let mut table = TableWriter::new(Output::open(args.output.as_deref())?, header)?;
    while let Some(row) = currents.next_row()? {
        let mut pairs = Vec::with_capacity(half_dark.len());
        for (cell, half_dark) in half_dark.iter().enumerate() {
            let pair = columns.pair(&row, cell)?;
            pairs.push(Pair { i_x1_a: pair.i_x1_a - half_dark, i_x2_a: pair.i_x2_a - half_dark });
        }
        let frames = match frames_column {
            Some(column) => match row.number(column)? {
                frames if frames >= 1.0 => frames,
                frames => return Err(row.out_of_range(column, frames, "a number of frames, 1 or more").into()),
            },
            None => 1.0,
        };
        let solver = solvers.of(frames)?;
        let mut solution = solver.solve(&Photocurrents::of_pairs(pairs), Start::Cold, &MotionPrior::AT_REST);
        head.complete(&mut solution);
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

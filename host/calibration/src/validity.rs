//! Whether a calibration still describes its head: what single readings say that the others do not.

use slitpose_model::{MotionPrior, Noise, Pair, Photocurrents, Pose, Reading, Scene, SceneError, Solver, Start};

use crate::data::Row;
use crate::reading_noise::directions;
use crate::sensitivity::TIER;

/// Fewest rows that a verdict is given on.
const LEAST_ROWS: usize = 20;

/// Rows that are looked at, spread over all.
const MOST_ROWS: usize = 400;

/// Mean χ² by its expectation, from which a calibration counts as stale. Of the heads that it was tried on it is 0.8 to
/// 1.1; a cell whose slit or emitter has moved by 10 µm makes it 3.
const STALE: f64 = 1.6;

/// How much of the excess χ² must go with a cell to say that it is that one.
const BLAMED: f64 = 0.5;

/// What readings say of one cell, against what all others predict of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellValidity {
    /// Readings looked at.
    pub readings: usize,
    /// Mean deviation of its photocurrent, relative.
    pub relative: f64,
    /// Mean deviation of the position of its light, metres.
    pub position_m: f64,
    /// Root mean square of that deviation, metres.
    pub rms_position_m: f64,
    /// χ² by its expectation without the cell.
    pub without: f64,
}

/// A verdict on a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Validity {
    /// Rows with a pose.
    pub rows: usize,
    /// χ² of all rows by its expectation.
    pub chi2: f64,
    /// Of each cell.
    pub cells: Vec<CellValidity>,
    /// Whether the head has changed; `None`: too few rows to tell.
    pub is_valid: Option<bool>,
    /// The cell that has changed, if it is one alone.
    pub changed: Option<usize>,
}

/// Solves `rows` with the calibrated `scene`, whose `noise` is that of one frame, and compares each cell with the others.
///
/// # Errors
/// A scene that cannot be computed.
pub fn validity(scene: &Scene, noise: Option<Noise>, rows: &[Row]) -> Result<Validity, SceneError> {
    let count = scene.cells.len();
    let every = rows.len().div_ceil(MOST_ROWS).max(1);
    let (mut used, mut sums) = (0, [0.0; 2]);
    let mut cells = vec![CellValidity::default(); count];
    let mut without = vec![[0.0; 2]; count];
    let mut solver: Option<(f64, Solver<f64>)> = None;
    for row in rows.iter().step_by(every) {
        if solver.as_ref().is_none_or(|(frames, _)| *frames != row.frames) {
            let noise = noise.map(|noise| noise.averaged(row.frames));
            solver = Some((row.frames, Solver::new(&Scene { noise, ..scene.clone() }, TIER)?));
        }
        let Some((_, solver)) = &solver else { continue };
        let solve = |left_out: Option<usize>, start: Start<'_>| {
            let reading = |(cell, pair): (usize, &Option<[f64; 2]>)| match pair {
                Some([i_x1_a, i_x2_a]) if left_out != Some(cell) => {
                    Reading::Light(Pair { i_x1_a: *i_x1_a, i_x2_a: *i_x2_a })
                }
                _ => Reading::Missing,
            };
            let readings = Photocurrents { cells: row.readings.iter().enumerate().map(reading).collect() };
            let solution = solver.solve(&readings, start, &MotionPrior::AT_REST);
            // A reading that the solver leaves out tells most of all.
            let pose: Option<Pose> = solution.estimate.map(|estimate| estimate.pose);
            pose.filter(|_| solution.redundancy > 0).map(|pose| (pose, solution))
        };
        let Some((pose, solution)) = solve(None, Start::Cold) else { continue };
        used += 1;
        let excluded = solution.excluded.count() as f64;
        // An excluded cell has shown at least what its exclusion takes.
        sums[0] += solution.chi2 + excluded * EXCLUDED_CHI2;
        sums[1] += solution.redundancy as f64 + 2.0 * excluded;
        for cell in 0..count {
            let (Some(found), Some((pose, solution))) = (row.readings[cell], solve(Some(cell), Start::Near(&pose)))
            else {
                continue;
            };
            let excluded = solution.excluded.count() as f64;
            without[cell][0] += solution.chi2 + excluded * EXCLUDED_CHI2;
            without[cell][1] += solution.redundancy as f64 + 2.0 * excluded;
            let expected = solver.plan().photocurrents(cell, &pose);
            let expected = [expected.i_x1_a, expected.i_x2_a];
            let change = [found[0] - expected[0], found[1] - expected[1]];
            let half_length_m = 0.5 * scene.cells[cell].detector.length_m;
            let [relative, position] =
                directions(expected, half_length_m).map(|by| by[0] * change[0] + by[1] * change[1]);
            let cell = &mut cells[cell];
            cell.readings += 1;
            cell.relative += relative;
            cell.position_m += position;
            cell.rms_position_m += position * position;
        }
    }
    for (cell, [chi2, redundancy]) in cells.iter_mut().zip(without) {
        let readings = cell.readings.max(1) as f64;
        cell.relative /= readings;
        cell.position_m /= readings;
        cell.rms_position_m = (cell.rms_position_m / readings).sqrt();
        cell.without = chi2 / f64::max(redundancy, 1.0);
    }
    let chi2 = sums[0] / sums[1].max(1.0);
    let is_valid = (used >= LEAST_ROWS).then_some(chi2 < STALE);
    // Where one cell contradicts the others, rows without another one often have no pose that tells anything.
    let is_judged = |cell: &usize| 2 * cells[*cell].readings > used;
    let best = (0..count).filter(is_judged).min_by(|&a, &b| cells[a].without.total_cmp(&cells[b].without));
    let changed = best.filter(|&cell| {
        is_valid == Some(false) && chi2 - cells[cell].without > BLAMED * (chi2 - 1.0) && cells[cell].without < STALE
    });
    Ok(Validity { rows: used, chi2, cells, is_valid, changed })
}

/// What a cell that a solver excluded adds to χ² at least: its threshold is about that.
const EXCLUDED_CHI2: f64 = 25.0;

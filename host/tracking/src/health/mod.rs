//! The health of a head, cell by cell, judged from its scans during tracking.
//!
//! [`Health`] adds every scan of one board session, with its photocurrents and solution, to sums over a second of
//! device time; it allocates nothing. [`HeadHealth`] is judged from these sums: shares, levels, noise, a [`Verdict`]
//! for each cell and, for people, a [`Diagnosis`] of each fault.
//!
//! A cell without light is no fault if the model predicts no light for it at the pose. Poses cannot reveal cells whose
//! plugs or electrodes are exchanged; if most scans contradict the scene, such exchanges are tried one after another on
//! a few scans.

mod diagnosis;
mod exchange;
mod judge;
#[cfg(test)]
mod tests;
mod window;

use slitpose_model::{Outcome, Photocurrents, Reading, SceneError, Solution, Solver, Status, Tier};
use slitpose_protocol::{AdcScaling, RawScan, Schedule};

pub use diagnosis::{CellHealth, CellTotals, Diagnosis, Fault, HeadHealth, Shares, Verdict};
pub use exchange::Exchange;

use diagnosis::Places;
use exchange::Search;
use slitpose_head::front_end::{self, Settling, Stage};
use slitpose_head::scene_file::SceneFile;
use window::{Bucket, Window};

/// Most scans per second whose cells are compared with the model: a cell's optics cost more than all other steps.
const LOOKS_PER_S: f64 = 128.0;

/// A cell counts as dark only where the model predicts this many times the faint limit, as in the solver: near the
/// limit noise decides.
const MISSED_FROM: f64 = 2.0;

/// Least duration and least number of frames of a bucket of the window.
const BUCKET_S: f64 = 0.25;
const BUCKET_FRAMES: u64 = 8;

/// Time between scans kept for the search for exchanges, in which the tool moves.
const SAMPLE_S: f64 = 0.125;

/// Monitors the cells of one head over one board session.
#[derive(Debug)]
pub struct Health {
    solver: Solver<f64>,
    cells: Vec<Cell>,
    scaling: AdcScaling,
    oversampling: u16,
    bucket_ticks: u64,
    look_every: u64,
    window: Window,
    totals: Vec<CellTotals>,
    start: Option<Bucket>,
    before: Option<RawScan>,
    taken: u64,
    search: Search,
    /// Of a head that is known by a calibration.
    places: Option<Places>,
    tick_s: f64,
}

/// Properties of a cell from its scene.
#[derive(Clone, Copy, Debug)]
struct Cell {
    faint_a: f64,
    /// Saturation limit of the photocurrent, without dark current.
    saturation_a: f64,
    dark_current_a: f64,
    /// Standard deviation of one dark word by the scene's front end, amperes.
    promised_noise_a: Option<f64>,
    /// Greatest share of the cell's own light that the front end can leave in the dark slot.
    afterglow: f64,
    half_length_m: f64,
}

impl Health {
    /// A monitor for a board that runs `schedule` with `scaling` on the head of `file`, with poses
    /// solved in `tier`; `is_calibrated`: by a calibration, which may go stale.
    ///
    /// The schedule and the scaling must be valid and have a slot for each of the scene's cells.
    pub fn new(
        file: &SceneFile,
        tier: Tier,
        schedule: &Schedule,
        scaling: &AdcScaling,
        is_calibrated: bool,
    ) -> Result<Self, SceneError> {
        let exposures_s = Stage::new(file, schedule, scaling).exposures_s();
        let scene = Stage::weighted_scene(file, schedule, scaling);
        let solver = Solver::new(&scene, tier)?.with_exposures(&exposures_s);
        let time_constant_s = file.front_end.map_or(0.0, |front_end| front_end.time_constant_s);
        let cells: Vec<Cell> = file
            .scene
            .cells
            .iter()
            .enumerate()
            .map(|(cell, description)| Cell {
                faint_a: description.detector.faint_a,
                saturation_a: description
                    .detector
                    .saturation_a
                    .map_or(f64::INFINITY, |limit_a| limit_a - description.detector.dark_current_a),
                dark_current_a: description.detector.dark_current_a,
                promised_noise_a: front_end::dark_word_noise_a(file, cell, schedule, scaling),
                afterglow: Settling::of_cell(schedule, cell, time_constant_s)
                    .map_or(0.0, |settling| (1.0 - settling.gain).max(0.0)),
                half_length_m: 0.5 * description.detector.length_m,
            })
            .collect();
        let bucket_ticks =
            ((f64::from(schedule.tick_hz) * BUCKET_S) as u64).max(BUCKET_FRAMES * u64::from(schedule.frame_ticks));
        Ok(Self {
            search: Search::new(&solver, schedule, exposures_s, (SAMPLE_S * schedule.frame_rate_hz()) as u32),
            solver,
            scaling: *scaling,
            oversampling: schedule.oversampling,
            bucket_ticks,
            look_every: ((schedule.frame_rate_hz() / LOOKS_PER_S) as u64).max(1),
            window: Window::default(),
            totals: vec![CellTotals::default(); cells.len()],
            cells,
            start: None,
            before: None,
            taken: 0,
            places: is_calibrated.then(Places::default),
            tick_s: f64::from(schedule.tick_hz).recip(),
        })
    }

    /// Adds the next scan, its photocurrents and its solution.
    pub fn update(&mut self, scan: &RawScan, photocurrents: &Photocurrents, solution: &Solution) {
        if self.window.turn(scan.tick / self.bucket_ticks) {
            self.turned();
        }
        let look = self.taken.is_multiple_of(self.look_every);
        self.taken += 1;
        let troubled = is_troubled(&solution.outcome);
        let bucket = self.window.current();
        bucket.scans += 1;
        bucket.troubled += u32::from(troubled);
        let mut places = self.places.as_mut().filter(|_| look && solution.redundancy > 0 && solution.chi2.is_finite());
        if let (Some(places), Some(estimate)) = (&mut places, &solution.estimate) {
            places.add(scan.tick as f64 * self.tick_s, &estimate.pose, solution.chi2, solution.redundancy as f64);
        }
        let before = self.before.replace(*scan);
        let readings = photocurrents.cells.iter().zip(&self.cells).zip(&mut self.totals);
        for (cell, (((reading, known), total), sums)) in readings.zip(&mut bucket.cells).enumerate() {
            total.scans += 1;
            let light_a = match reading {
                Reading::Missing => {
                    sums.missing += 1;
                    total.off += 1;
                    None
                }
                Reading::Light(pair) if pair.total_a() <= known.saturation_a => Some(pair.total_a()),
                _ => {
                    sums.saturated += 1;
                    total.saturated += 1;
                    None
                }
            };
            if let Some(light_a) = light_a {
                sums.measured += 1;
                sums.light_a += light_a;
                let faint = light_a < known.faint_a;
                sums.faint += u32::from(faint);
                total.faint += u64::from(faint);
            }
            if solution.excluded.contains(cell) {
                sums.excluded += 1;
                total.excluded += 1;
            }
            let still = before.as_ref().is_some_and(|before| {
                before.lit().get(cell) == scan.lit().get(cell)
                    && before.dark().map(|dark| dark.get(cell)) == scan.dark().map(|dark| dark.get(cell))
            });
            sums.still += u32::from(still);
            if let Some(words) = scan.dark().and_then(|dark| dark.get(cell)) {
                let before = before.as_ref().and_then(|before| before.dark()?.get(cell).copied());
                sums.dark.add_words(*words, before);
            }
            if look && let Some(estimate) = &solution.estimate {
                let response = self.solver.plan().respond(cell, &estimate.pose);
                let expected_a = response.i_o_a - known.dark_current_a;
                sums.looks += 1;
                sums.clipped += u32::from(response.status == Status::Clipped);
                if expected_a >= MISSED_FROM * known.faint_a
                    && let Some(light_a) = light_a
                {
                    let missed = light_a < known.faint_a;
                    sums.missed += u32::from(missed);
                    total.dark += u64::from(missed);
                    sums.compared_a += light_a;
                    sums.expected_a += expected_a;
                    sums.expected += 1;
                    if let (Some(places), Reading::Light(pair)) = (&mut places, reading) {
                        let share = |[first, second]: [f64; 2]| (second - first) / (first + second);
                        let expected = share([response.currents.i_x1_a, response.currents.i_x2_a]);
                        let moved = share([pair.i_x1_a, pair.i_x2_a]) - expected;
                        places.add_shift(cell, known.half_length_m * moved);
                    }
                }
            }
        }
        self.search.update(photocurrents, troubled);
    }

    fn turned(&mut self) {
        if !self.window.is_full() {
            return;
        }
        let sum = self.window.sum();
        if self.start.is_none() {
            self.start = Some(sum.clone());
        }
        self.search.turned(2 * sum.troubled > sum.scans);
    }
}

/// Whether the scene does not explain the scan: it has outliers, identified or not.
fn is_troubled(outcome: &Outcome) -> bool {
    *outcome == Outcome::Diverged || outcome.is_contradiction()
}

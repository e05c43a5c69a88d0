//! Detection of swapped electrodes or plugs: each swap is tried on a few scans that the scene does not explain.

use schemars::JsonSchema;
use serde::Serialize;
use slitpose_model::{
    DegradedReason, MAX_CELLS, MotionPrior, Outcome, Photocurrents, Pose, Reading, Solution, Solver, Start, Twist,
};
use slitpose_protocol::Schedule;

const SAMPLES: usize = 8;

/// Least number of scans that distinguish an exchange from chance.
const MIN_SAMPLES: usize = 4;

/// Scans that the right exchange may leave unexplained: another fault may occur in them.
const MISSES: usize = 1;

/// Least number of data beyond the unknowns, that of five cells: with fewer, wrong exchanges fit, too.
const MIN_REDUNDANCY: usize = 4;

/// Steps of a first attempt, and the χ² above which a longer one is useless. The right exchange has a χ²
/// of some tens; the search for a pose that does not exist would take as long as a hundred frames.
const STEPS: usize = 40;
const HOPELESS: f64 = 200.0;

/// Iterations to find the light of other emitters along with the pose. Each reduces the error to a tenth.
const ROUNDS: usize = 6;

/// Motion prior for a single scan: the tool may move as fast as a hand.
const ANY_MOTION: MotionPrior = MotionPrior {
    twist: Twist { linear_m_per_s: glam::DVec3::ZERO, angular_rad_per_s: glam::DVec3::ZERO },
    linear_sigma_m_per_s: 0.5,
    angular_sigma_rad_per_s: 5.0,
};

/// Two electrodes or two cells swapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Exchange {
    /// I_X1 and I_X2 of a cell.
    Electrodes {
        /// The cell.
        cell: usize,
    },
    /// Two cells, emitters and detectors.
    Cells {
        /// Their numbers, ascending.
        cells: [usize; 2],
    },
}

impl Exchange {
    /// Whether `cell` takes part.
    pub fn concerns(&self, cell: usize) -> bool {
        match self {
            Self::Electrodes { cell: exchanged } => *exchanged == cell,
            Self::Cells { cells } => cells.contains(&cell),
        }
    }

    /// All among `count` cells, in the order in which they are tried: each cell's electrodes, then each pair of cells.
    fn all(count: usize) -> impl Iterator<Item = Self> {
        let pairs = (0..count).flat_map(move |first| (first + 1..count).map(move |second| [first, second]));
        (0..count).map(|cell| Self::Electrodes { cell }).chain(pairs.map(|cells| Self::Cells { cells }))
    }

    /// The plug of `cell`, which is also the cell on plug `cell`.
    fn other(&self, cell: usize) -> usize {
        match *self {
            Self::Cells { cells: [first, second] } if cell == first => second,
            Self::Cells { cells: [first, second] } if cell == second => first,
            _ => cell,
        }
    }

    fn undone(&self, photocurrents: &Photocurrents) -> Photocurrents {
        let mut photocurrents = photocurrents.clone();
        match *self {
            Self::Electrodes { cell } => {
                if let Reading::Light(pair) = &mut photocurrents.cells[cell] {
                    std::mem::swap(&mut pair.i_x1_a, &mut pair.i_x2_a);
                }
            }
            Self::Cells { cells: [first, second] } => photocurrents.cells.swap(first, second),
        }
        photocurrents
    }
}

/// Search for the exchange that explains scans that the scene does not. It makes one trial per scan, so that no scan
/// waits.
#[derive(Debug)]
pub(super) struct Search {
    hasty: Solver<f64>,
    thorough: Solver<f64>,
    exposures_s: Vec<f64>,
    /// Plugs whose emitters are lit together with that of each plug, one bit each.
    together: Vec<u16>,
    exchanges: Vec<Exchange>,
    samples: [Photocurrents; SAMPLES],
    kept: usize,
    keep_every: u32,
    until_next: u32,
    trial: Option<Trial>,
    pub(super) found: Option<Exchange>,
}

#[derive(Clone, Copy, Debug)]
struct Trial {
    /// Place among all exchanges.
    number: usize,
    sample: usize,
    misses: usize,
    /// The first exchange found that explains the scans, and whether it is the only one.
    explains: Option<(Exchange, bool)>,
}

impl Search {
    /// A search that keeps every `keep_every`th unexplained scan for its trials.
    pub(super) fn new(solver: &Solver<f64>, schedule: &Schedule, exposures_s: Vec<f64>, keep_every: u32) -> Self {
        let lit_with = |cell: usize| {
            let slot = schedule.lit_slot(cell).map(|slot| schedule.slots[slot].emitters());
            slot.into_iter().flatten().filter(|&other| other != cell).fold(0, |set, other| set | 1 << other)
        };
        Self {
            together: (0..exposures_s.len()).map(lit_with).collect(),
            exchanges: Exchange::all(exposures_s.len()).collect(),
            hasty: solver.clone().with_max_steps(STEPS),
            thorough: solver.clone(),
            exposures_s,
            samples: Default::default(),
            kept: 0,
            keep_every,
            until_next: 0,
            trial: None,
            found: None,
        }
    }

    /// Adds the next scan and makes one trial.
    pub(super) fn update(&mut self, photocurrents: &Photocurrents, troubled: bool) {
        if let Some(trial) = self.trial {
            return self.go_on(trial);
        }
        if !troubled {
            return;
        }
        if self.until_next > 0 {
            self.until_next -= 1;
            return;
        }
        self.until_next = self.keep_every.saturating_sub(1);
        self.samples[self.kept % SAMPLES].clone_from(photocurrents);
        self.kept += 1;
    }

    /// To be called several times per second. If most scans are unexplained, begins a search, unless one is
    /// running or too few scans are kept; if most are explained, withdraws the exchange found.
    pub(super) fn turned(&mut self, mostly_troubled: bool) {
        if !mostly_troubled {
            (self.kept, self.until_next, self.trial, self.found) = (0, 0, None, None);
        } else if self.trial.is_none() && self.kept >= MIN_SAMPLES {
            self.trial = Some(Trial { number: 0, sample: 0, misses: 0, explains: None });
        }
    }

    fn go_on(&mut self, mut trial: Trial) {
        let exchange = self.exchanges[trial.number];
        trial.misses += usize::from(!self.explains(exchange, &self.samples[trial.sample]));
        trial.sample += 1;
        let fails = trial.misses > MISSES;
        if !fails && trial.sample < self.kept.min(SAMPLES) {
            self.trial = Some(trial);
            return;
        }
        if !fails {
            trial.explains = Some(trial.explains.map_or((exchange, true), |(first, _)| (first, false)));
        }
        if trial.number + 1 < self.exchanges.len() {
            self.trial = Some(Trial { number: trial.number + 1, sample: 0, misses: 0, ..trial });
        } else {
            self.found = trial.explains.filter(|(_, alone)| *alone).map(|(exchange, _)| exchange);
            // The next search uses new scans.
            (self.kept, self.until_next, self.trial) = (0, 0, None);
        }
    }

    /// Whether the data of a scan fit the scene once `exchange` is undone.
    fn explains(&self, exchange: Exchange, sample: &Photocurrents) -> bool {
        let measured = exchange.undone(sample);
        let mut undone = measured.clone();
        for _ in 0..ROUNDS {
            let hasty = self.solve(&self.hasty, exchange, &undone);
            if hasty.chi2 <= HOPELESS && is_clean(&self.solve(&self.thorough, exchange, &undone)) {
                return true;
            }
            let Some(estimate) = hasty.estimate else {
                return false;
            };
            undone.clone_from(&measured);
            if !self.exchange_cross_light(exchange, &estimate.pose, &mut undone) {
                return false;
            }
        }
        false
    }

    /// Subtracts the light that cells receive at `pose` from emitters that `exchange` lights together with
    /// their own, and adds that which the solver expects from emitters lit with them without it; `false` if there is
    /// neither.
    fn exchange_cross_light(&self, exchange: Exchange, pose: &Pose, photocurrents: &mut Photocurrents) -> bool {
        let plan = self.thorough.plan();
        let mut found = false;
        for cell in 0..self.together.len() {
            let (plugs, expected) = (self.together[exchange.other(cell)], plan.lit_together(cell));
            let Reading::Light(pair) = &mut photocurrents.cells[cell] else {
                continue;
            };
            for emitter in 0..self.together.len() {
                let [lit, expected] = [plugs >> exchange.other(emitter), expected >> emitter].map(|set| set & 1);
                if lit == expected {
                    continue;
                }
                let light = plan.crosstalk(cell, emitter, pose);
                let sign = f64::from(expected) - f64::from(lit);
                pair.i_x1_a += sign * light.i_x1_a;
                pair.i_x2_a += sign * light.i_x2_a;
                found |= light.total_a() > 0.0;
            }
        }
        found
    }

    fn solve(&self, solver: &Solver<f64>, exchange: Exchange, undone: &Photocurrents) -> Solution {
        match exchange {
            Exchange::Cells { cells: [first, second] } if self.exposures_s[first] != self.exposures_s[second] => {
                // A cell on another cell's plug is exposed in that cell's slot.
                let mut exposures_s = [0.0; MAX_CELLS];
                exposures_s[..self.exposures_s.len()].copy_from_slice(&self.exposures_s);
                exposures_s.swap(first, second);
                solver.clone().with_exposures(&exposures_s).solve(undone, Start::Cold, &ANY_MOTION)
            }
            _ => solver.solve(undone, Start::Cold, &ANY_MOTION),
        }
    }
}

/// Whether all cells with light agree on a pose, and enough of them do.
fn is_clean(solution: &Solution) -> bool {
    matches!(solution.outcome, Outcome::Converged | Outcome::Degraded(DegradedReason::FewerCells))
        && solution.redundancy >= MIN_REDUNDANCY
}

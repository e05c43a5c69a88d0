//! How light changes while a session lasts, and until its head is used.
//!
//! Emitters are brightest when they are switched on, and warm: each session of measurements with known poses begins cold. Later
//! tables are of an older head, warm but for its free motion, which begins cold again. A lamp on the mains adds what a
//! dark slot before each exposure does not take away.

use std::f64::consts::TAU;

use slitpose_head::faults::EMITTER_PER_K;
use slitpose_model::{Cell, Pair};

use crate::chance::Chance;

/// By how much a head warms, kelvin, and within which time, seconds; each emitter by so much more or less, as a share.
const WARMER_K: [f64; 2] = [4.0, 12.0];
const WARMS_WITHIN_S: [f64; 2] = [300.0, 900.0];
const UNEVEN: f64 = 0.1;

/// Light that has been lost until the head is used: of all emitters, and what single ones deviate from that (1 σ).
const AGED: [f64; 2] = [0.0, 0.02];
const AGED_UNEVENLY: f64 = 0.003;

/// What a lamp leaves in a reading, amperes at each electrode.
const FLICKER_A: [f64; 2] = [0.5e-9, 2e-9];

/// Time that a row takes in which the tool is moved to its pose and rests, seconds.
pub(crate) const ROW_S: f64 = 10.0;

/// Of one head.
#[derive(Clone, Debug)]
pub(crate) struct Drift {
    within_s: f64,
    /// Of each cell's emitter: how much warmer it becomes, kelvin, and which share of its light it has lost later.
    warmer_k: Vec<f64>,
    aged: Vec<f64>,
    flicker_a: f64,
}

impl Drift {
    pub(crate) fn draw(cells: &[Cell], chance: &mut Chance) -> Self {
        let [warmer_k, within_s, aged] = [WARMER_K, WARMS_WITHIN_S, AGED].map(|range| chance.between(range));
        let flicker_a = chance.between(FLICKER_A);
        let mut of_emitters = |mean: f64, sigma: f64| {
            let drawn: Vec<f64> = cells.iter().map(|_| mean + sigma * chance.within_three_sigma()).collect();
            cells.iter().enumerate().map(|(number, cell)| drawn[cell.emitter(number)]).collect()
        };
        Self {
            within_s,
            warmer_k: of_emitters(warmer_k, UNEVEN * warmer_k),
            aged: of_emitters(aged, AGED_UNEVENLY),
            flicker_a,
        }
    }

    pub(crate) fn at(&self, instant: Instant, clean: &[Pair<f64>], chance: &mut Chance) -> Vec<Pair<f64>> {
        let flicker_a = self.flicker_a * (TAU * chance.between([0.0, 1.0])).sin();
        let of_cell = |(pair, (warmer_k, aged)): (&Pair<f64>, (&f64, &f64))| {
            let warm = -(-instant.on_s / self.within_s).exp_m1();
            let share = (1.0 + EMITTER_PER_K * warmer_k * warm) * if instant.is_later { 1.0 - aged } else { 1.0 };
            Pair { i_x1_a: share * pair.i_x1_a + flicker_a, i_x2_a: share * pair.i_x2_a + flicker_a }
        };
        clean.iter().zip(self.warmer_k.iter().zip(&self.aged)).map(of_cell).collect()
    }

    /// Of each cell: what its emitter has lost at last, as a share.
    pub(crate) fn lost(&self) -> Vec<f64> {
        self.warmer_k
            .iter()
            .zip(&self.aged)
            .map(|(warmer_k, aged)| 1.0 - (1.0 + EMITTER_PER_K * warmer_k) * (1.0 - aged))
            .collect()
    }
}

/// When a row is measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    /// Since the head was switched on, seconds.
    pub(crate) on_s: f64,
    /// Whether months have passed since the head was calibrated.
    pub(crate) is_later: bool,
}

impl Instant {
    /// Of a head in use that is warm.
    pub(crate) const LATER: Self = Self { on_s: f64::INFINITY, is_later: true };
}

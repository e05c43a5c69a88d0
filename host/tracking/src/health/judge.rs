//! Verdicts from the sums of a window.

use super::diagnosis::{CellHealth, Diagnosis, Fault, HeadHealth, Residuals, Shares, Verdict};
use super::window::{Bucket, CellSums};
use super::{Cell, Exchange, Health};
use slitpose_head::finding::Finding;

/// Least number of scans for a verdict.
const MIN_SCANS: u32 = 32;

const NEEDED: usize = 3;

/// Share of scans above which a condition is a fault. It may occur in fewer, at the edge of the workspace.
const OFTEN: f64 = 0.1;

/// Stray light has risen if its mean has by this many σ, more than chance gives in years of seconds …
const RISE_SIGMAS: f64 = 5.0;
/// … and by this share of an electrode's full scale, which costs range: offsets drift by less.
const RISE_OF_FULL_SCALE: f64 = 0.01;

/// Ratio of measured to specified noise from which on a cell is noisy. A second at 1 kHz measures noise to
/// a few per cent; front ends differ by their parts' tolerances.
const NOISY_FROM: f64 = 2.0;

/// Noise of a word, in its steps, from which on the word cannot stay constant for a second.
const LIVELY_STEPS: f64 = 0.5;

/// χ² by its expectation from which a calibration counts as stale. Model errors are part of the expectation, so that its
/// mean over [`super::diagnosis`] is near 1; a cell that has moved by 15 µm makes it 3.
const STALE: f64 = 2.5;

/// Share that stands for all scans, as the first one after a gap does not count.
const ALWAYS: f64 = 0.99;

impl Health {
    /// The health over the last second. Allocates; to be called a few times per second.
    pub fn report(&self) -> HeadHealth {
        let sum = self.window.sum();
        let judged = self.window.is_full() && sum.scans >= MIN_SCANS;
        let exchange = self.search.found.filter(|_| judged);
        let mut findings: Vec<Diagnosis> = exchange.map(of_exchange).into_iter().collect();
        let cells: Vec<CellHealth> = (0..self.cells.len())
            .map(|cell| {
                let mut health = self.measure(cell, &sum);
                if judged {
                    health.verdict = self.judge(cell, &health, &sum, exchange);
                    findings.extend(self.of_cell(&health, sum.cells[cell].looks > 0));
                }
                health
            })
            .collect();
        let faint = cells.iter().filter(|cell| cell.verdict == Verdict::Faint).count();
        let is_faint = |it: &Diagnosis| matches!(it.fault, Fault::Cell { verdict: Verdict::Faint, .. });
        if faint + NEEDED > cells.len() && findings.iter().any(is_faint) {
            findings.retain(|finding| !is_faint(finding));
            let text = format!("{faint} of {} cells see too little light", cells.len());
            let next_step = "bring the tool home; if it is there, check its emitters' plug";
            findings.push(Diagnosis { fault: Fault::TooDark, finding: Finding::failed("head", text, next_step) });
        }
        let unexplained = share(sum.troubled, sum.scans);
        if judged && unexplained > 0.5 && findings.is_empty() {
            let percent = 100.0 * unexplained;
            let text = format!("{percent:.0} % of the scans contradict the scene, and no single cell explains it");
            let next_step = "check that the scene is this head's, then calibrate it";
            findings.push(Diagnosis { fault: Fault::Unexplained, finding: Finding::failed("head", text, next_step) });
        }
        if judged && findings.is_empty() {
            findings.extend(self.stale());
        }
        HeadHealth { unexplained, cells, findings }
    }

    fn stale(&self) -> Option<Diagnosis> {
        let now_s = self.before.as_ref()?.tick as f64 * self.tick_s;
        let Residuals { chi2, shifts_m } = self.places.as_ref()?.residuals(now_s)?;
        if chi2 < STALE {
            return None;
        }
        let size = |cell: usize| shifts_m[cell].abs();
        let cell = (0..self.cells.len()).max_by(|&a, &b| size(a).total_cmp(&size(b)))?;
        let text = format!(
            "calibration_stale: residuals are {:.1} times as large as the calibration allows; cell {cell} deviates most, by \
             {:+.0} µm on its detector",
            chi2.sqrt(),
            shifts_m[cell] * 1e6
        );
        let next_step = "record some motion and give it to `slitpose calibrate --check`";
        let fault = Fault::CalibrationStale { cell, shift_m: shifts_m[cell], chi2 };
        Some(Diagnosis { fault, finding: Finding::failed("head", text, next_step) })
    }

    fn measure(&self, cell: usize, sum: &Bucket) -> CellHealth {
        let (known, sums) = (&self.cells[cell], &sum.cells[cell]);
        let step_a = self.step_a();
        let noise_a = sums.dark.variance().map(|variance| variance.sqrt() * step_a);
        CellHealth {
            cell,
            verdict: Verdict::Unknown,
            shares: Shares {
                saturated: share(sums.saturated, sum.scans),
                faint: share(sums.faint, sum.scans),
                dark: share(sums.missed, sums.looks),
                clipped: share(sums.clipped, sums.looks),
                excluded: share(sums.excluded, sum.scans),
                off: share(sums.missing, sum.scans),
            },
            light_a: (sums.measured > 0).then(|| sums.light_a / f64::from(sums.measured)),
            brightness: (sums.expected > 0).then(|| sums.compared_a / sums.expected_a),
            emitter_drift: None,
            emitter_drift_sigma: None,
            stray_a: self.stray_a(known, sums),
            stray_rise_a: self.rise(cell, sums).map(|(rise_a, _)| rise_a),
            noise_a,
            noise_lsb: noise_a.map(|noise_a| noise_a / self.scaling.amperes_per_code.abs()),
            promised_noise_a: known.promised_noise_a,
            totals: self.totals[cell],
        }
    }

    fn judge(&self, cell: usize, health: &CellHealth, sum: &Bucket, exchange: Option<Exchange>) -> Verdict {
        let (known, sums, shares) = (&self.cells[cell], &sum.cells[cell], &health.shares);
        let lively = known.promised_noise_a.is_some_and(|noise_a| noise_a >= LIVELY_STEPS * self.step_a());
        // Words at the end of their range do not change.
        let stuck = lively && sums.saturated == 0 && share(sums.still, sum.scans) > ALWAYS;
        let has_risen = self.rise(cell, sums).is_some_and(|(rise_a, sigma_a)| {
            let afterglow_a = known.afterglow * self.scaling.full_scale_a();
            rise_a > RISE_SIGMAS * sigma_a && rise_a > RISE_OF_FULL_SCALE * self.scaling.full_scale_a() + afterglow_a
        });
        let is_noisy = match (health.noise_a, known.promised_noise_a) {
            (Some(noise_a), Some(promised_a)) => promised_a > 0.0 && noise_a > NOISY_FROM * promised_a,
            _ => false,
        };
        let conditions = [
            (Verdict::Off, shares.off > OFTEN),
            (Verdict::Swapped, exchange.is_some_and(|exchange| exchange.concerns(cell))),
            (Verdict::Stuck, stuck),
            (Verdict::Saturated, shares.saturated > OFTEN),
            (Verdict::Dark, shares.dark > OFTEN),
            (Verdict::Excluded, shares.excluded > OFTEN && exchange.is_none()),
            (Verdict::Faint, shares.faint > OFTEN),
            (Verdict::StrayRising, has_risen),
            (Verdict::Noisy, is_noisy),
        ];
        conditions.into_iter().find(|(_, holds)| *holds).map_or(Verdict::Ok, |(verdict, _)| verdict)
    }

    /// The diagnosis of a cell; `None` without a fault, or if the exchange has its own diagnosis.
    fn of_cell(&self, health: &CellHealth, has_pose: bool) -> Option<Diagnosis> {
        let CellHealth { cell, verdict, shares, .. } = *health;
        let percent = |share: f64| 100.0 * share;
        let nanoamperes = |current_a: Option<f64>| current_a.unwrap_or(f64::NAN) * 1e9;
        let (text, next_step) = match verdict {
            Verdict::Unknown | Verdict::Swapped | Verdict::Ok => return None,
            // The pose predicts no light: the cell cannot see its emitter there.
            Verdict::Faint if has_pose => return None,
            Verdict::Off => ("its emitter is off".to_owned(), "give it a level above zero"),
            Verdict::Stuck => {
                ("its words never change".to_owned(), "reset the board, then check its converter's wiring")
            }
            Verdict::Saturated => (
                format!(
                    "saturated in {:.0} % of the scans (its converter at full scale, or its detector above \
                     saturation_a)",
                    percent(shares.saturated)
                ),
                "lower the level of its emitter, or shade it from other light",
            ),
            Verdict::Dark => (
                format!("no light in {:.0} % of the scans where the pose says it should", percent(shares.dark)),
                "check its emitter, its plugs, and what may cover its slit",
            ),
            Verdict::Excluded => (
                format!(
                    "contradicts the others in {:.0} % of the scans, with {:.0} % of the light it should have",
                    percent(shares.excluded),
                    percent(health.brightness.unwrap_or(f64::NAN))
                ),
                "clean its slit and emitter, then calibrate",
            ),
            Verdict::Faint => (
                format!(
                    "{:.0} nA of light, and {:.0} nA are needed",
                    nanoamperes(health.light_a),
                    nanoamperes(Some(self.cells[cell].faint_a))
                ),
                "bring the tool home; if it is there, check emitter, plugs and slit",
            ),
            Verdict::StrayRising => (
                format!(
                    "stray light has risen by {:.0} nA, {:.1} % of full scale",
                    nanoamperes(health.stray_rise_a),
                    percent(health.stray_rise_a.unwrap_or(f64::NAN) / self.scaling.full_scale_a())
                ),
                "look for a lamp or the sun, and shade the cell",
            ),
            Verdict::Noisy => (
                format!(
                    "{:.1} nA of noise in the dark, its front end promises {:.1} nA",
                    nanoamperes(health.noise_a),
                    nanoamperes(health.promised_noise_a)
                ),
                "look for light that flickers fast, a loose cable, or a noisy supply",
            ),
        };
        let finding = Finding::failed(format!("cell {cell}"), text, next_step);
        Some(Diagnosis { fault: Fault::Cell { cell, verdict }, finding })
    }

    /// Amperes for one step of a word.
    fn step_a(&self) -> f64 {
        self.scaling.amperes_per_code.abs() / f64::from(self.oversampling)
    }

    fn stray_a(&self, known: &Cell, sums: &CellSums) -> Option<f64> {
        let mean = sums.dark.mean()?;
        let codes = mean / f64::from(self.oversampling) - 2.0 * self.scaling.zero_code;
        Some(codes * self.scaling.amperes_per_code - known.dark_current_a)
    }

    /// Rise of the current in the dark slot since the start, and its σ, amperes.
    pub(super) fn rise(&self, cell: usize, sums: &CellSums) -> Option<(f64, f64)> {
        let known = &self.cells[cell];
        let start = &self.start.as_ref()?.cells[cell];
        // Variance of the sum of both electrodes.
        let variance = |sums: &CellSums| Some(2.0 * sums.dark.variance()? / sums.dark.count());
        let sigma = (variance(start)? + variance(sums)?).sqrt();
        Some((self.stray_a(known, sums)? - self.stray_a(known, start)?, sigma * self.step_a()))
    }
}

fn of_exchange(exchange: Exchange) -> Diagnosis {
    let (place, text, next_step) = match exchange {
        Exchange::Electrodes { cell } => (
            format!("cell {cell}"),
            "electrodes exchanged",
            "exchange the wires of its two anodes, or turn its x_axis round in the scene",
        ),
        Exchange::Cells { cells: [first, second] } => (
            format!("cells {first} and {second}"),
            "exchanged",
            "exchange the plugs of both, emitters and detectors, or their [[cell]] in the scene",
        ),
    };
    Diagnosis { fault: Fault::Exchange(exchange), finding: Finding::failed(place, text, next_step) }
}

fn share(part: u32, whole: u32) -> f64 {
    if whole > 0 { f64::from(part) / f64::from(whole) } else { 0.0 }
}

//! What a reference looks like with which poses disagree: its clock, its units, its axes.

use slitpose_calibration::{Reports, other_reading};
use slitpose_head::simulator::Trajectory;
use slitpose_model::{Estimate, Pose};

/// Poses that are kept at most.
const MAX_KEPT: usize = 8192;

/// Poses that are compared at each step of a search, and with other units and axes.
const TRIED: usize = 64;

/// How much nearer poses must be to another reading of the reference than to the reference, and than to a tool at rest.
const BETTER: f64 = 3.0;

/// Steps of the search for the clock to either side: a second; then each ten times as fine, down to a microsecond.
const STEP_S: f64 = 1e-3;
const STEPS: i64 = 1000;
const REFINEMENTS: i32 = 3;

/// Units that the time may be in instead of seconds.
const UNITS: [(f64, &str); 3] = [(1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")];

/// Poses spread evenly over all so far.
#[derive(Debug, Default)]
pub(super) struct Sample {
    kept: Vec<Kept>,
    count: usize,
    /// Every so many are kept, as a power of two.
    shift: u32,
}

#[derive(Clone, Copy, Debug)]
struct Kept {
    time_s: f64,
    estimate: Estimate,
    reference: Option<Pose>,
}

impl Sample {
    pub(super) fn add(&mut self, time_s: f64, estimate: Estimate, reference: Option<Pose>) {
        if self.count.is_multiple_of(1 << self.shift) {
            if self.kept.len() == MAX_KEPT {
                self.kept = self.kept.iter().copied().step_by(2).collect();
                self.shift += 1;
            }
            self.kept.push(Kept { time_s, estimate, reference });
        }
        self.count += 1;
    }

    /// What the reference of name `name` looks like, if poses agree much better with another reading of it; `path` is the
    /// reference by time, else that is made of the poses of scans.
    pub(super) fn suspicion(&self, name: &str, path: Option<&Trajectory>) -> Option<String> {
        let matched: Vec<(f64, Pose)> =
            self.kept.iter().filter_map(|kept| Some((kept.time_s, kept.reference?))).collect();
        let own_path;
        let path = match path {
            Some(path) => path,
            None => {
                own_path = Trajectory::through(matched);
                &own_path
            }
        };
        let [begin_s, end_s] = path.span_s()?;
        let (first_s, last_s) = (self.kept.first()?.time_s, self.kept.last()?.time_s);
        let tried: Vec<&Kept> = self.kept.iter().step_by(self.kept.len().div_ceil(TRIED)).collect();
        let as_given = miss(&tried, |kept| kept.reference);
        if as_given < BETTER {
            return None;
        }
        let at_rest = miss(&tried, |_| Some(Pose::HOME));
        let limit = as_given.min(at_rest) / BETTER;
        let reading = |scale: f64, ahead_s: f64| {
            let at = move |kept: &Kept| (kept.time_s + ahead_s) / scale;
            miss(&tried, |kept| Some(at(kept)).filter(|&time| path.covers(time)).map(|time| path.pose(time)))
        };
        let search = |scale: f64, centre_s: f64, steps: i64, step_s: f64| {
            let offsets = (-steps..=steps).map(|step| centre_s + step as f64 * step_s);
            offsets.map(|ahead_s| (reading(scale, ahead_s), ahead_s)).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let clock = |scale: f64| {
            // By one clock, or from the beginnings of both.
            let rough = [0.0, scale * begin_s - first_s]
                .into_iter()
                .filter_map(|centre_s| search(scale, centre_s, STEPS, STEP_S));
            let mut found = rough.min_by(|a, b| a.0.total_cmp(&b.0))?;
            for refinement in 1..=REFINEMENTS {
                found = search(scale, found.1, 10, STEP_S * 0.1_f64.powi(refinement))?;
            }
            Some(found).filter(|(found, _)| *found <= limit)
        };
        if let Some((found, ahead_s)) = clock(1.0) {
            let better = match as_given / found {
                f64::INFINITY => String::new(),
                better => format!(" {better:.0} times as well"),
            };
            let (late, next_step) = if ahead_s > 0.0 { ("late", "subtract") } else { ("early", "add") };
            let ahead_s = ahead_s.abs();
            return Some(format!(
                "{name}: the reference seems {ahead_s:.6} s {late}: poses then agree{better}; {next_step} \
                 that, or pair poses of the same instants"
            ));
        }
        let matched: Vec<&Kept> = self.kept.iter().filter(|kept| kept.reference.is_some()).collect();
        let matched: Vec<&Kept> = matched.iter().copied().step_by(matched.len().div_ceil(TRIED).max(1)).collect();
        let reports: Vec<Pose> = matched.iter().filter_map(|kept| kept.reference).collect();
        let of_rows = |reports: Reports<'_>| {
            median(matched.iter().enumerate().filter_map(|(row, kept)| distance(kept, &reports(row)?)).collect())
        };
        if let Some(other) = other_reading(name, &reports, limit * BETTER, &of_rows) {
            return Some(other.to_string());
        }
        let frame_s = (last_s - first_s) / (self.count.max(2) - 1) as f64;
        let mut units = UNITS.into_iter().chain([(frame_s, "numbers of rows")]);
        let is_other = |scale: f64| scale * (end_s - begin_s) > 0.0 && clock(scale).is_some();
        if let Some((_, unit)) = units.find(|&(scale, _)| is_other(scale)) {
            return Some(format!("{name}: time_s is seconds, but are these {unit}? Then poses agree; give seconds"));
        }
        (as_given > at_rest / BETTER && as_given.is_finite()).then(|| {
            format!(
                "{name}: poses agree with it hardly better than a tool at rest would; look for the motion of another instant, \
                 for other axes, and for columns in other units"
            )
        })
    }
}

/// Median distance of poses from `reference`, which has half of them at least, in standard deviations.
fn miss(tried: &[&Kept], reference: impl Fn(&Kept) -> Option<Pose>) -> f64 {
    let distances: Vec<f64> = tried.iter().filter_map(|kept| distance(kept, &reference(kept)?)).collect();
    if 2 * distances.len() >= tried.len() { median(distances) } else { f64::INFINITY }
}

fn distance(kept: &Kept, reference: &Pose) -> Option<f64> {
    kept.estimate.nees(reference).map(f64::sqrt)
}

/// Infinite of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
}

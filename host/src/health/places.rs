//! What readings and model differ by at places where the tool has been.
//!
//! A model's errors are the same at every visit of a place, so that a tool at rest shows one draw of them over and over. How
//! large they are shows from place to place.

use slitpose_model::{MAX_CELLS, Pose};

/// Distance and angle beyond which the tool is at another place: metres, radians. Model errors vary over such ways.
const APART: [f64; 2] = [1e-3, 0.05];

/// Places that are remembered, and for how long, seconds of device time.
const REMEMBERED: usize = 24;
const REMEMBERED_S: f64 = 60.0;

/// Places that a verdict needs, and the redundancy of each: that of a scan with five cells.
const LEAST_PLACES: usize = 8;
const LEAST_REDUNDANCY: f64 = 4.0;

/// Sums at one place.
#[derive(Clone, Debug)]
struct Place {
    anchor: Pose,
    seen_s: f64,
    chi2: f64,
    redundancy: f64,
    /// Of each cell: number, and sum of the deviations of the position of its light, metres.
    shifts: [(u32, f64); MAX_CELLS],
}

impl Place {
    fn new(anchor: Pose) -> Self {
        Self { anchor, seen_s: 0.0, chi2: 0.0, redundancy: 0.0, shifts: [(0, 0.0); MAX_CELLS] }
    }

    fn is_near(&self, pose: &Pose) -> bool {
        let (way, turn) = pose.displacement_from(&self.anchor);
        way.length() < APART[0] && turn.length() < APART[1]
    }
}

/// Residuals of the last places.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    /// The current one is last.
    places: Vec<Place>,
}

/// Residuals of all places.
#[derive(Clone, Debug)]
pub(super) struct Residuals {
    /// χ² by its expectation, mean of the places.
    pub(super) chi2: f64,
    /// Mean deviation of the position of the light of each cell, metres.
    pub(super) shifts_m: [f64; MAX_CELLS],
}

impl Places {
    /// Adds χ² and redundancy of a scan at `time_s`, with the tool at `pose`.
    pub(super) fn add(&mut self, time_s: f64, pose: &Pose, chi2: f64, redundancy: f64) {
        if !self.places.last().is_some_and(|place| place.is_near(pose)) {
            // A place is seen anew at every visit.
            self.places.retain(|place| !place.is_near(pose) && (0.0..REMEMBERED_S).contains(&(time_s - place.seen_s)));
            if self.places.len() >= REMEMBERED {
                self.places.remove(0);
            }
            self.places.push(Place::new(*pose));
        }
        if let Some(place) = self.places.last_mut() {
            place.seen_s = time_s;
            place.chi2 += chi2;
            place.redundancy += redundancy;
        }
    }

    /// Adds how far the light of `cell` is from where it is expected at the current place.
    pub(super) fn add_shift(&mut self, cell: usize, shift_m: f64) {
        if let Some(place) = self.places.last_mut() {
            place.shifts[cell].0 += 1;
            place.shifts[cell].1 += shift_m;
        }
    }

    /// What all places say; `None`: the tool has been at too few.
    pub(super) fn residuals(&self, now_s: f64) -> Option<Residuals> {
        let is_told = |place: &&Place| place.redundancy >= LEAST_REDUNDANCY && now_s - place.seen_s < REMEMBERED_S;
        let told: Vec<&Place> = self.places.iter().filter(is_told).collect();
        if told.len() < LEAST_PLACES {
            return None;
        }
        let chi2 = told.iter().map(|place| place.chi2 / place.redundancy).sum::<f64>() / told.len() as f64;
        let shifts_m = std::array::from_fn(|cell| {
            let of_cell = told.iter().map(|place| place.shifts[cell]).filter(|(count, _)| *count > 0);
            let (count, sum) = of_cell.fold((0, 0.0), |(count, sum), (n, of)| (count + 1, sum + of / f64::from(n)));
            sum / f64::from(count.max(1))
        });
        Some(Residuals { chi2, shifts_m })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn at(x_mm: f64) -> Pose {
        Pose::from_vectors(DVec3::X * x_mm * 1e-3, DVec3::ZERO)
    }

    #[test]
    fn a_tool_at_rest_tells_nothing_however_long_and_going_to_and_fro_hardly_more() {
        let mut places = Places::default();
        for second in 0..50 {
            for _ in 0..100 {
                places.add(f64::from(second), &at(f64::from(second % 2) * 3.0), 60.0, 6.0);
            }
            assert!(places.residuals(f64::from(second)).is_none(), "{second}");
        }
    }

    #[test]
    fn each_place_counts_once_and_is_forgotten_after_a_minute() {
        let mut places = Places::default();
        // Nine places: one of them with ten times the residuals and a hundred times the scans.
        for k in 0..9 {
            let (scans, chi2) = if k == 4 { (1000, 60.0) } else { (10, 6.0) };
            for _ in 0..scans {
                places.add(f64::from(k), &at(2.0 * f64::from(k)), chi2, 6.0);
                places.add_shift(3, 9e-6);
            }
        }
        let found = places.residuals(9.0).unwrap();
        assert!((found.chi2 - 2.0).abs() < 1e-12 && (found.shifts_m[3] - 9e-6).abs() < 1e-12, "{found:?}");
        assert_eq!(found.shifts_m[2], 0.0);
        assert!(places.residuals(61.5).is_none(), "two of nine are too old");
    }
}

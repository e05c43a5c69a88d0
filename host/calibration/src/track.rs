//! The poses that an instrument recorded over time, by a clock of its own.

use std::sync::Arc;

use glam::DVec3;
use slitpose_head::simulator::MAX_KNOTS;
use slitpose_head::table::{PoseColumns, TableReader};
use slitpose_model::Pose;

use crate::data::{Knowledge, Row, middle};
use crate::{CalibrateError, ClockError};

/// Intervals of the instrument beyond which poses are not interpolated, in units of its usual one.
const MAX_GAP: f64 = 3.5;

/// Instants at which the instrument's pose is averaged over the frames of a row.
const INSTANTS: usize = 9;

/// Equal poses in a row from which a moving instrument is frozen.
const FROZEN_ROWS: usize = 3;

/// Distance, in usual steps, of a pose from the middle of so many before and after it that no motion covers.
const LOST_STEPS: f64 = 50.0;
const AROUND: usize = 4;

/// The poses of a marker over time.
#[derive(Debug)]
pub(crate) struct Track {
    pub(crate) times_s: Vec<f64>,
    pub(crate) poses: Vec<Pose>,
    /// Usual interval, seconds.
    pub(crate) usual_s: f64,
    /// Numbers of the rows that were left out, from one: the instrument had no pose there.
    pub(crate) left_out: Vec<usize>,
}

impl Track {
    /// Reads a table of time_s and poses.
    pub(crate) fn open(table: &str) -> Result<Self, CalibrateError> {
        let mut reader = TableReader::open(table)?.of_at_most(MAX_KNOTS);
        let columns = PoseColumns::keyed(&reader, "time_s")?;
        let time = reader.column("time_s")?;
        let (mut times_s, mut poses): (Vec<f64>, Vec<Pose>) = (Vec::new(), Vec::new());
        let refuse = |text: String| Err(ClockError(table.to_owned(), text).into());
        while let Some(row) = reader.next_row()? {
            let time_s = row.number(time)?;
            if times_s.last().is_some_and(|&last| time_s <= last) {
                let row = times_s.len() + 1;
                return refuse(format!(": time_s does not ascend in row {row}; sort the rows by time, each once"));
            }
            times_s.push(time_s);
            poses.push(columns.pose(&row)?);
        }
        let mut intervals: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        intervals.sort_by(f64::total_cmp);
        match intervals.get(intervals.len() / 2) {
            Some(&usual_s) if times_s.len() >= 20 => {
                let left_out = lost(&poses);
                if 2 * left_out.len() > poses.len() {
                    let (rows, first) = (left_out.len(), left_out[0] + 1);
                    return refuse(format!(
                        ": in {rows} of {} rows, from row {first} on, the pose stands still or is far from those around: the \
                         instrument had lost its marker; record again with the marker in view",
                        poses.len()
                    ));
                }
                let is_kept = |row: &usize| left_out.binary_search(row).is_err();
                let (times_s, poses) = (0..poses.len()).filter(is_kept).map(|row| (times_s[row], poses[row])).unzip();
                Ok(Self { usual_s, times_s, poses, left_out: left_out.into_iter().map(|row| row + 1).collect() })
            }
            _ => refuse(format!(
                " has {} poses; an instrument that tracks a motion gives a hundred and more",
                times_s.len()
            )),
        }
    }

    /// The longest interval, and the number of the row that ends it.
    pub(crate) fn longest_gap(&self) -> (f64, usize) {
        let gaps = self.times_s.windows(2).map(|pair| pair[1] - pair[0]).enumerate();
        let (before, gap_s) = gaps.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default();
        let ends = self.left_out.iter().fold(before + 2, |row, &out| if out <= row { row + 1 } else { row });
        (gap_s, ends)
    }

    pub(crate) fn span_s(&self) -> [f64; 2] {
        [self.times_s[0], self.times_s[self.times_s.len() - 1]]
    }

    /// The greatest angle that the marker turns by within `apart_s`, radians.
    pub(crate) fn greatest_turn(&self, apart_s: f64) -> f64 {
        let apart = ((apart_s / self.usual_s).round() as usize).clamp(1, self.poses.len() - 1);
        let turns = self.poses.windows(apart + 1).map(|of| of[apart].displacement_from(&of[0]).1.length());
        turns.fold(0.0, f64::max)
    }

    /// How the marker moves around pose `i`: metres and radians per second.
    fn twist(&self, i: usize) -> [DVec3; 2] {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(self.poses.len() - 1));
        let (t, r) = self.poses[after].displacement_from(&self.poses[before]);
        let per_s = (self.times_s[after] - self.times_s[before]).recip();
        [t * per_s, r * per_s]
    }

    /// Pose and twist at `time_s`, by a cubic between its neighbours; `None` outside the record, and in its gaps.
    pub(crate) fn at(&self, time_s: f64) -> Option<(Pose, [DVec3; 2])> {
        let after = self.times_s.partition_point(|&at| at <= time_s);
        let before = after.checked_sub(1)?;
        let step_s = self.times_s.get(after)? - self.times_s[before];
        if step_s > MAX_GAP * self.usual_s {
            return None;
        }
        let (t, r) = self.poses[after].displacement_from(&self.poses[before]);
        let ends = [self.twist(before), self.twist(after)];
        let s = (time_s - self.times_s[before]) / step_s;
        // Hermite's basis for the displacement from the pose before, and its derivative.
        let weights = [s * s * (3.0 - 2.0 * s), s * (1.0 - s) * (1.0 - s), s * s * (s - 1.0)];
        let slopes = [6.0 * s * (1.0 - s), (1.0 - s) * (1.0 - 3.0 * s), s * (3.0 * s - 2.0)];
        let blend =
            |way: DVec3, k: usize, by: [f64; 3]| way * by[0] + (ends[0][k] * by[1] + ends[1][k] * by[2]) * step_s;
        let moved = self.poses[before].perturbed(blend(t, 0, weights), blend(r, 1, weights));
        Some((moved, [blend(t, 0, slopes) / step_s, blend(r, 1, slopes) / step_s]))
    }

    /// The mean pose from `first_s` to `last_s`, and the twist in the middle.
    fn mean(&self, [first_s, last_s]: [f64; 2]) -> Option<(Pose, [DVec3; 2])> {
        let (middle, twist) = self.at(0.5 * (first_s + last_s))?;
        let (mut shift, mut turn) = (DVec3::ZERO, DVec3::ZERO);
        for k in 0..INSTANTS {
            let share = (k as f64 + 0.5) / INSTANTS as f64;
            let (t, r) = self.at(first_s + share * (last_s - first_s))?.0.displacement_from(&middle);
            (shift, turn) = (shift + t, turn + r);
        }
        let per_instant = (INSTANTS as f64).recip();
        Some((middle.perturbed(shift * per_instant, turn * per_instant), twist))
    }
}

/// Rows, from zero, in which the instrument had lost its marker: poses that stand repeated while the tool moves on, and
/// translations far from those around.
fn lost(poses: &[Pose]) -> Vec<usize> {
    let step = |a: &Pose, b: &Pose| a.translation_m.distance(b.translation_m);
    let mut steps: Vec<f64> = poses.windows(2).filter(|of| of[0] != of[1]).map(|of| step(&of[0], &of[1])).collect();
    steps.sort_by(f64::total_cmp);
    let far_m = LOST_STEPS * steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    let mut lost = Vec::new();
    let mut first = 0;
    for run in poses.chunk_by(|a, b| a == b) {
        let next = first + run.len();
        let jump_m = poses.get(next).map_or(f64::INFINITY, |after| step(&run[0], after));
        // The first of them may be the last that was measured.
        if run.len() >= FROZEN_ROWS && jump_m * LOST_STEPS > far_m {
            lost.extend(first + 1..next);
        }
        first = next;
    }
    let kept: Vec<usize> = (0..poses.len()).filter(|row| lost.binary_search(row).is_err()).collect();
    for (k, &row) in kept.iter().enumerate() {
        let around = &kept[k.saturating_sub(AROUND)..(k + AROUND + 1).min(kept.len())];
        let near: Vec<DVec3> = around.iter().map(|&row| poses[row].translation_m).collect();
        let centre = middle(&near);
        if poses[row].translation_m.distance(centre) > far_m {
            lost.push(row);
        }
    }
    lost.sort_unstable();
    lost
}

/// An instrument's record by a clock of its own, and how that differs from the board's as far as it has been found.
#[derive(Clone, Debug)]
pub(crate) struct FoundClock {
    /// How far it is ahead at `centre_s` of the board's clock, seconds.
    pub(crate) ahead_s: f64,
    /// How much faster it is, as a share.
    pub(crate) faster: f64,
    pub(crate) centre_s: f64,
    pub(crate) track: Arc<Track>,
}

impl FoundClock {
    /// Gives `row` the pose that the instrument measured meanwhile; `false`: it measured none.
    pub(crate) fn tell(&self, row: &mut Row) -> bool {
        let Some(time_s) = row.time_s else { return false };
        let since_s = 0.5 * (time_s[0] + time_s[1]) - self.centre_s;
        let at = time_s.map(|time_s| time_s + self.ahead_s + self.faster * since_s);
        let Some((pose, twist)) = self.track.mean(at) else { return false };
        row.knowledge = Knowledge::Tracked { pose, twist, since_s };
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::tests::motion;

    #[test]
    fn poses_between_the_instruments_are_those_of_the_motion() {
        let of = |time_s: f64| motion(time_s, false);
        let track = Track {
            times_s: (0..200).map(|k| f64::from(k) * 5e-3).collect(),
            poses: (0..200).map(|k| of(f64::from(k) * 5e-3)).collect(),
            usual_s: 5e-3,
            left_out: Vec::new(),
        };
        for k in 1..180 {
            let time_s = f64::from(k) * 5.4e-3;
            let (pose, [linear, angular]) = track.at(time_s).unwrap();
            let (t, r) = pose.displacement_from(&of(time_s));
            // A cubic with slopes by differences: h³/16 of the third derivative, 1 m/s³ and 40 rad/s³.
            assert!(t.length() < 2e-8 && r.length() < 6e-7, "{t} {r}");
            let (t, r) = of(time_s + 1e-6).displacement_from(&of(time_s - 1e-6));
            assert!((t / 2e-6 - linear).length() < 2e-5 && (r / 2e-6 - angular).length() < 1e-3, "{linear} {angular}");
        }
        assert!(track.at(-1e-9).is_none() && track.at(0.9951).is_none());
    }

    #[test]
    fn rows_of_an_instrument_without_its_marker_are_found() {
        let sound: Vec<Pose> = (0..400).map(|k| motion(f64::from(k) * 5e-3, false)).collect();
        let far = |pose: Pose| Pose { translation_m: DVec3::new(-9.999, 0.0, 0.0), ..pose };
        type Spoil<'a> = &'a dyn Fn(usize) -> Pose;
        let cases: [(Spoil<'_>, Vec<usize>); 4] = [
            (&|k| sound[k], vec![]),
            (&|k| if k == 100 { far(sound[k]) } else { sound[k] }, vec![100]),
            (&|k| if (200..210).contains(&k) { far(sound[0]) } else { sound[k] }, (200..210).collect()),
            (&|k| sound[k.min(300)], (301..400).collect()),
        ];
        for (spoil, expected) in cases {
            assert_eq!(lost(&(0..400).map(spoil).collect::<Vec<_>>()), expected);
        }
    }
}

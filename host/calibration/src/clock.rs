//! An instrument that recorded poses by a clock of its own, while the board recorded readings.
//!
//! How far its clock is ahead follows from the motion alone: angles between the tool's orientations at two instants are
//! the same in all frames. A search over all shifts at which the records overlap finds those at which the motions turn
//! alike; of these, the one at which the poses agree best is right to some milliseconds. The adjustment finds the rest,
//! with the clock's rate: a short one first, for over milliseconds a motion is no straight line.

use std::sync::Arc;

use glam::DVec3;
use serde::Deserialize;
use slitpose_head::scene_file::SceneFile;
use slitpose_model::Pose;
use thiserror::Error;

use crate::data::{Constraint, Data, Row, compose, inverse, median};
use crate::plausibility::{BETTER, UNITS};
use crate::start::{align, first_poses, known_so_far};
use crate::tables::thinned;
use crate::track::{FoundClock, Track};
use crate::{CalibrateError, Calibration};

/// Rows between two orientations that are compared.
const APART: usize = 5;

/// Pairs of orientations, and poses, that the search compares.
const TRIED: usize = 150;

/// Shifts at which the motions turn alike whose poses are compared.
const CANDIDATES: usize = 6;

/// Steps of the search, seconds: motions of a hand take tenths of seconds.
const STEP_S: f64 = 0.01;

/// Longest usual interval of an instrument that follows a motion: of camera systems it is 2 to 40 ms.
const MAX_INTERVAL_S: f64 = 0.5;

/// Longest search, in steps: three hours.
const MAX_STEPS: f64 = 1.1e6;

/// Golden sections of the steps around a shift: to some microseconds.
const SECTIONS: usize = 18;
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Fewest pairs within the instrument's record, as a share of all.
const MIN_OVERLAP: f64 = 0.5;

/// Root-mean-square angle between the orientations below which the tool hardly turns, radians.
const MIN_TURN: f64 = 0.01;

/// Share of the variance of the angles that the right shift leaves at most. Heads as they come leave some hundredths,
/// the worst a half.
const MAX_LEFT: f64 = 0.7;

/// Angles greater than this multiple of the instrument's greatest are no turns of the tool: poses of an uncalibrated head
/// may jump between two minima.
const JUMP: f64 = 1.5;

/// Median square distance of the poses at the right shift, by the median square of the tool's motion, at most.
const MAX_APART: f64 = 0.3;

/// Factor by which the median square distance of the poses has to be greater at any other shift, and how far off that is
/// another one, seconds.
const DISTINCT: f64 = 3.0;
const ELSEWHERE_S: f64 = 0.2;

/// Intervals of the instrument between two rows: its poses between two samples err by what both do.
const INDEPENDENT: f64 = 2.0;

/// Why an instrument's record does not fit a capture: the table, what is wrong with it, and the next step.
#[derive(Debug, Error)]
#[error("{0}{1}")]
pub struct ClockError(pub(crate) String, pub(crate) String);

/// An instrument's clock beside the board's.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Clock {
    /// The instrument's table.
    pub file: String,
    /// How far it is ahead of the board's clock in the middle of the capture, seconds.
    pub ahead_s: f64,
    /// Its standard deviation.
    pub ahead_sigma_s: f64,
    /// How much faster it is, as a share.
    pub faster: f64,
    /// Its standard deviation.
    pub faster_sigma: f64,
}

/// Two instants by the board's clock, and by how much the tool turned between them.
#[derive(Clone, Copy)]
struct Turn {
    times_s: [f64; 2],
    angle: f64,
}

/// Share of the variance of `turns` that a line through those of `track` leaves if its clock is `ahead_s`; `None` if too few
/// lie within. A line: the angles of an uncalibrated head are off by some percent.
fn left(track: &Track, turns: &[Turn], ahead_s: f64) -> Option<f64> {
    let (mut count, mut sums, mut squares, mut product) = (0.0, [0.0; 2], [0.0; 2], 0.0);
    for turn in turns {
        let [Some((first, _)), Some((second, _))] = turn.times_s.map(|time_s| track.at(time_s + ahead_s)) else {
            continue;
        };
        let angles = [turn.angle, second.displacement_from(&first).1.length()];
        count += 1.0;
        product += angles[0] * angles[1];
        for k in 0..2 {
            sums[k] += angles[k];
            squares[k] += angles[k] * angles[k];
        }
    }
    let variances = [0, 1].map(|k| squares[k] - sums[k] * sums[k] / count);
    let covariance = product - sums[0] * sums[1] / count;
    let is_enough = count >= MIN_OVERLAP * turns.len() as f64 && variances.iter().all(|&variance| variance > 0.0);
    is_enough
        .then(|| if covariance > 0.0 { 1.0 - covariance * covariance / (variances[0] * variances[1]) } else { 1.0 })
}

/// A motion as the board saw it, by a head that is not calibrated.
struct Motion<'a> {
    /// Instants by the board's clock, and poses.
    poses: Vec<(f64, Pose)>,
    /// The frames of the instrument.
    constraint: Constraint,
    /// Its table and the capture.
    files: [&'a str; 2],
}

/// `most` of `all`, spread evenly.
fn some<T: Copy>(all: &[T], most: usize) -> Vec<T> {
    let count = most.min(all.len());
    (0..count).map(|k| all[k * all.len() / count]).collect()
}

impl Motion<'_> {
    /// How far the instrument's clock is ahead of the board's, seconds.
    fn ahead_s(&self, track: &Track) -> Result<f64, ClockError> {
        let [file, capture] = self.files;
        let refuse = |text: String| Err(ClockError(file.to_owned(), text));
        let still = ": the tool hardly turns, so that nothing tells how the two clocks differ; turn it back and forth by some \
                     degrees, at uneven speed";
        let no_match = |left: f64| {
            refuse(format!(
                ": its motion is not that of {capture}: at best {} % of it agrees; give records of the same minutes, \
                 rotations in radians",
                (100.0 * (1.0 - left)).max(0.0).round()
            ))
        };
        let [track_from_s, track_to_s] = track.span_s();
        let (Some((first_s, _)), Some((last_s, _))) = (self.poses.first(), self.poses.last()) else {
            return refuse(still.to_owned());
        };
        let capture_s = last_s - first_s;
        if track.usual_s > MAX_INTERVAL_S {
            let is_even = track.times_s.windows(2).all(|pair| pair[1] - pair[0] == 1.0);
            let likely = match track.usual_s {
                _ if is_even => "are these row numbers",
                usual_s if usual_s > 1e3 * MAX_INTERVAL_S => "are these microseconds",
                _ => "are these milliseconds",
            };
            return refuse(format!(": its rows are {:.3} s apart by time_s: {likely}? Give seconds", track.usual_s));
        }
        let (gap_s, row) = track.longest_gap();
        if gap_s > capture_s {
            return refuse(format!(
                ": time_s jumps by {gap_s:.1} s to row {row}, and all of {capture} takes {capture_s:.1} s; correct the times \
                 from there on, or give the rows of one side alone"
            ));
        }
        let from_s = track_from_s - last_s;
        let steps = (track_to_s - first_s - from_s) / STEP_S;
        if steps > MAX_STEPS {
            let span_s = track_to_s - track_from_s;
            return refuse(format!(
                " is {span_s:.0} s long, and {capture} {capture_s:.0} s: is its time_s in seconds? Else cut it to the same \
                 minutes"
            ));
        }
        let pairs = self.poses.windows(APART + 1).map(|of| (of[0], of[APART]));
        let mut turns: Vec<Turn> = pairs
            .map(|((first_s, first), (last_s, last))| Turn {
                times_s: [first_s, last_s],
                angle: last.displacement_from(&first).1.length(),
            })
            .collect();
        let apart_s = turns.first().map_or(0.0, |turn| turn.times_s[1] - turn.times_s[0]);
        let most = JUMP * track.greatest_turn(apart_s);
        turns.retain(|turn| turn.angle <= most);
        let mean_square = turns.iter().map(|turn| turn.angle * turn.angle).sum::<f64>() / turns.len().max(1) as f64;
        if mean_square.sqrt() <= MIN_TURN {
            return refuse(still.to_owned());
        }
        let turns_tried = some(&turns, TRIED);
        let steps = steps as usize;
        let shares: Vec<f64> =
            (0..=steps).map(|k| left(track, &turns_tried, from_s + k as f64 * STEP_S).unwrap_or(1.0)).collect();
        let is_low = |k: usize| {
            let around = &shares[k.saturating_sub(1)..(k + 2).min(shares.len())];
            around.iter().all(|&share| shares[k] <= share)
        };
        let mut low: Vec<(f64, f64)> =
            (0..shares.len()).filter(|&k| is_low(k)).map(|k| (shares[k], from_s + k as f64 * STEP_S)).collect();
        low.sort_by(|a, b| a.0.total_cmp(&b.0));
        match low.first() {
            Some((share, _)) if *share < MAX_LEFT => {}
            other => return no_match(other.map_or(1.0, |other| other.0)),
        }
        // The frames tell the rest: a motion that turns alike at two times is hardly at the same places then.
        let poses = some(&self.poses, TRIED);
        let alike = low.iter().take_while(|(share, _)| *share < MAX_LEFT);
        let mut found: Vec<(f64, f64)> =
            alike.take(CANDIDATES).map(|&(_, rough_s)| self.settled(track, &poses, rough_s)).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mean_m = poses.iter().map(|(_, pose)| pose.translation_m).sum::<DVec3>() / poses.len() as f64;
        let motion = median(poses.iter().map(|(_, pose)| pose.translation_m.distance_squared(mean_m)).collect());
        for (scale, unit) in UNITS {
            let longer = |pose: &Pose| Pose { translation_m: pose.translation_m * scale, ..*pose };
            let poses_of = track.poses.iter().map(longer).collect();
            let scaled =
                Track { times_s: track.times_s.clone(), poses: poses_of, left_out: Vec::new(), usual_s: track.usual_s };
            if found.iter().any(|(_, at_s)| BETTER * BETTER * self.misfit(&scaled, &poses, *at_s) < found[0].0) {
                return refuse(format!(
                    ": tx_mm, ty_mm and tz_mm are millimetres, but are these {unit}? Then the motion is that of the capture"
                ));
            }
        }
        if found[0].0 > MAX_APART * motion {
            return no_match((found[0].0 / motion).min(1.0));
        }
        match *found {
            [(best, first_s), (second, second_s), ..]
                if second < DISTINCT * best && (first_s - second_s).abs() > ELSEWHERE_S =>
            {
                refuse(format!(
                    ": its clock may be {first_s:.2} s or {second_s:.2} s ahead, for the motion is short or repeats itself; move \
                     the tool unevenly for ten seconds or more"
                ))
            }
            _ => Ok(found[0].1),
        }
    }

    /// The least misfit of the poses near `rough_s`, and where, by golden sections.
    fn settled(&self, track: &Track, poses: &[(f64, Pose)], rough_s: f64) -> (f64, f64) {
        let (mut low, mut high) = (rough_s - 2.0 * STEP_S, rough_s + 2.0 * STEP_S);
        for _ in 0..SECTIONS {
            let width = GOLDEN * (high - low);
            let is_lower = self.misfit(track, poses, high - width) < self.misfit(track, poses, low + width);
            if is_lower { high = low + width } else { low = high - width }
        }
        let found_s = 0.5 * (low + high);
        (self.misfit(track, poses, found_s), found_s)
    }

    /// Median square distance of the poses from the instrument's, metres squared.
    fn misfit(&self, track: &Track, poses: &[(f64, Pose)], ahead_s: f64) -> f64 {
        let pairs: Vec<(Pose, Pose)> =
            poses.iter().filter_map(|(time_s, pose)| Some((*pose, track.at(time_s + ahead_s)?.0))).collect();
        let frames = match self.constraint {
            Constraint::KnownInOwnFrames => align(&pairs),
            _ => Some([Pose::HOME; 2]),
        };
        let Some([x, y]) = frames.filter(|_| !pairs.is_empty()) else { return f64::INFINITY };
        let square = |(pose, marker): &(Pose, Pose)| {
            compose(&compose(&x, marker), &inverse(&y)).displacement_from(pose).0.length_squared()
        };
        median(pairs.iter().map(square).collect())
    }
}

/// Adds the frames of a capture, whose poses the instrument of `table` recorded by its own clock, to `data`; `start` is what
/// the head is known by if it has been calibrated before.
pub fn read_tracked(
    file: &SceneFile,
    start: Option<&Calibration>,
    [table, capture]: [&str; 2],
    frames: Vec<Row>,
    constraint: Constraint,
    sigmas: [f64; 2],
    data: &mut Data,
) -> Result<(), CalibrateError> {
    let track = Track::open(table)?;
    let mut rows = thinned(frames);
    rows.retain(|row| row.time_s.is_some());
    let middle = |row: &Row| row.time_s.map_or(0.0, |[first, last]| 0.5 * (first + last));
    let poses = first_poses(&known_so_far(file, start)?, start, capture, &rows)?;
    let seen = rows.iter().zip(poses).filter_map(|(row, pose)| Some((middle(row), pose?)));
    let ahead_s = Motion { poses: seen.collect(), constraint, files: [table, capture] }.ahead_s(&track)?;
    let centre_s = rows.first().zip(rows.last()).map_or(0.0, |(first, last)| 0.5 * (middle(first) + middle(last)));
    if let (Some(first), count) = (track.left_out.first(), track.left_out.len()) {
        let rows = track.times_s.len() + count;
        data.remarks.push(format!(
            "{table}: {count} of {rows} rows left out, from row {first} on: the pose stands still or is far from those around"
        ));
    }
    let clock = FoundClock { ahead_s, faster: 0.0, centre_s, track: Arc::new(track) };
    let mut next_s = f64::NEG_INFINITY;
    rows.retain_mut(|row| {
        if middle(row) < next_s {
            return false;
        }
        next_s = middle(row) + INDEPENDENT * clock.track.usual_s;
        clock.tell(row)
    });
    data.add(table, constraint, sigmas, rows);
    if let Some(group) = data.groups.last_mut() {
        group.clock = Some(clock);
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::DVec3;

    use super::*;

    const AHEAD_S: f64 = 123.456;

    /// A tool in a hand; with `is_even`, twice the same.
    pub(crate) fn motion(time_s: f64, is_even: bool) -> Pose {
        let rates = if is_even { [1.0, 2.0, 3.0] } else { [1.0, 2.37, 3.11] };
        let of = |k: usize, size: f64| size * (rates[k] * std::f64::consts::PI * time_s / 3.0 + k as f64).sin();
        Pose::from_vectors(
            DVec3::new(of(0, 4e-3), of(1, 3e-3), of(2, 4e-3)),
            DVec3::new(of(1, 0.2), of(2, 0.1), of(0, 0.2)),
        )
    }

    fn track(of: impl Fn(f64) -> Pose) -> Track {
        let [x, y] = [
            Pose::from_vectors(DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.5, 1.0, -0.4)),
            Pose::from_vectors(DVec3::X * 0.01, DVec3::Y),
        ];
        let times_s: Vec<f64> = (0..2400).map(|k| f64::from(k) * 5e-3).collect();
        let poses = times_s.iter().map(|time_s| compose(&compose(&inverse(&x), &of(*time_s)), &y)).collect();
        Track {
            times_s: times_s.iter().map(|time_s| time_s + AHEAD_S).collect(),
            poses,
            usual_s: 5e-3,
            left_out: Vec::new(),
        }
    }

    fn seen(of: impl Fn(f64) -> Pose) -> Motion<'static> {
        let times_s = (0..900).map(|k| 1.0 + f64::from(k) * 0.011);
        // An uncalibrated head is off by some percent.
        let off = |pose: Pose| Pose::from_vectors(pose.translation_m * 1.03, pose.rotation_rad() * 0.96);
        // Now and then its pose jumps to another minimum for a while.
        let jumps = |k: usize| k % 60 < 6;
        let far = |pose: Pose| pose.perturbed(DVec3::new(9e-3, 0.0, -5e-3), DVec3::new(0.0, 0.7, 0.3));
        let seen = |(k, time_s)| (time_s, if jumps(k) { far(off(of(time_s))) } else { off(of(time_s)) });
        let poses = times_s.enumerate().map(seen).collect();
        Motion { poses, constraint: Constraint::KnownInOwnFrames, files: ["poses.csv", "free.mcap"] }
    }

    #[test]
    fn a_clock_is_found_from_the_motion_in_whatever_frames() {
        let found_s = seen(|time_s| motion(time_s, false)).ahead_s(&track(|time_s| motion(time_s, false))).unwrap();
        // The step of the search, from which the adjustment goes on.
        assert!((found_s - AHEAD_S).abs() < STEP_S, "{found_s}");
    }

    #[test]
    fn motions_that_tell_nothing_are_named() {
        let error =
            |of: &dyn Fn(f64) -> Pose, by: &dyn Fn(f64) -> Pose| seen(of).ahead_s(&track(by)).unwrap_err().to_string();
        let even = |time_s: f64| motion(time_s, true);
        let uneven = |time_s: f64| motion(time_s, false);
        assert!(error(&even, &even).contains("the motion is short or repeats itself"));
        let milliseconds =
            Track { times_s: (0..2400).map(|k| f64::from(k) * 5.0).collect(), usual_s: 5.0, ..track(uneven) };
        let long = seen(uneven).ahead_s(&milliseconds).unwrap_err().to_string();
        assert!(long.contains("poses.csv: its rows are 5.000 s apart by time_s: are these milliseconds?"), "{long}");
        let jumps = |k: usize, time_s: f64| if k < 1000 { time_s } else { time_s + 3600.0 };
        let mut set = track(uneven);
        set.times_s = set.times_s.iter().enumerate().map(|(k, time_s)| jumps(k, *time_s)).collect();
        let set = seen(uneven).ahead_s(&set).unwrap_err().to_string();
        assert!(set.contains("time_s jumps by 3600.0 s to row 1001"), "{set}");
        // Translations that no lever on the rotations explains.
        let free = |time_s: f64| Pose { translation_m: uneven(1.7 * time_s).translation_m, ..uneven(time_s) };
        let in_metres = |time_s: f64| Pose { translation_m: 1e-3 * free(time_s).translation_m, ..free(time_s) };
        let metres = Track { poses: (0..2400).map(|k| in_metres(f64::from(k) * 5e-3)).collect(), ..track(uneven) };
        let metres = seen(free).ahead_s(&metres).unwrap_err().to_string();
        assert!(metres.contains("are these metres?"), "{metres}");
        assert!(error(&|_| Pose::HOME, &uneven).contains("the tool hardly turns"));
        // Another motion: the same backward.
        let backward = error(&uneven, &|time_s| motion(0.7 * (50.0 - time_s), false));
        assert!(backward.contains("its motion is not that of free.mcap"), "{backward}");
    }
}

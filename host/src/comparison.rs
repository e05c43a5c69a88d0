//! Errors of poses against a reference, axis by axis.

use slitpose_calibration::{Reports, median, other_reading};
use slitpose_head::simulator::{PathError, Trajectory};
use slitpose_head::table::{Column, PoseColumns, TableError, TableReader};
use slitpose_model::{Estimate, Pose};
use thiserror::Error;

use crate::terminal::{Line, WIDTH, layout};
use slitpose_tracking::pipeline::Record;

/// Errors of poses against a known truth.
#[derive(Clone, Debug, Default)]
pub(crate) struct Accuracy {
    count: u64,
    axes: [Axis; 6],
    square_m2: f64,
    square_rad2: f64,
    largest_m: f64,
    largest_rad: f64,
    nees_sum: f64,
    beyond_five_sigma: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    sum: f64,
    square: f64,
    largest: f64,
}

impl Accuracy {
    /// Adds a pose and the true pose of the same instant.
    pub(crate) fn add(&mut self, estimate: &Estimate, truth: &Pose) {
        let (dt, dr) = estimate.pose.displacement_from(truth);
        self.count += 1;
        self.square_m2 += dt.length_squared();
        self.square_rad2 += dr.length_squared();
        self.largest_m = self.largest_m.max(dt.length());
        self.largest_rad = self.largest_rad.max(dr.length());
        self.nees_sum += estimate.nees(truth).unwrap_or(f64::NAN);
        let error = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
        for (axis, error) in self.axes.iter_mut().zip(error) {
            axis.sum += error;
            axis.square += error * error;
            axis.largest = axis.largest.max(error.abs());
        }
        let beyond = error.iter().zip(estimate.sigma()).any(|(error, sigma)| error.abs() > 5.0 * sigma);
        self.beyond_five_sigma += u64::from(beyond);
    }

    /// The result in three lines for people; `against` names the source of the truth.
    pub(crate) fn lines(&self, against: &str) -> Vec<Line> {
        if self.count == 0 {
            return Vec::new();
        }
        let count = self.count as f64;
        let error = format!(
            "{:.2} um rms, {:.2} um largest; {:.1} urad rms, {:.1} urad largest",
            (self.square_m2 / count).sqrt() * 1e6,
            self.largest_m * 1e6,
            (self.square_rad2 / count).sqrt() * 1e6,
            self.largest_rad * 1e6,
        );
        let honesty = format!(
            "mean NEES {:.2} (6 is honest), {} poses beyond 5 sigma in an axis",
            self.nees_sum / count,
            self.beyond_five_sigma,
        );
        let mut lines =
            vec![Line::new("against", against), Line::new("  error", &error), Line::new("  honesty", &honesty)];
        for (line, rank) in lines.iter_mut().zip([3, 2, 2]) {
            line.rank(rank);
        }
        lines
    }
}

/// Names of the axes, and of a millionth of the unit along each.
const AXES: [(&str, &str); 6] = [("x", "um"), ("y", "um"), ("z", "um"), ("rx", "urad"), ("ry", "urad"), ("rz", "urad")];

pub(crate) struct Comparison {
    name: String,
    reference: Reference,
    accuracy: Accuracy,
    /// Scans without a pose, or without one in the reference.
    unmatched: u64,
    /// Some of the poses, whether the reference has them or not.
    sample: Sample,
    /// First and last number of a scan, and instant, of all poses.
    scans: Option<[(u64, f64); 2]>,
}

#[derive(Debug, Error)]
#[error(
    "{file}: nothing in it matches: its {column} runs from {:?} to {:?}, and that of {of} from {:?} to {:?}; {}",
    theirs[0],
    theirs[1],
    ours[0],
    ours[1],
    if *column == "seq" {
        "give the table of this session"
    } else if theirs[0] > EPOCH_S {
        "these look like stamps of an epoch: subtract the beginning, for the clock of a board begins at zero"
    } else {
        "give seconds by the clock of the board, which begins at zero"
    }
)]
pub(crate) struct NothingMatches {
    pub(crate) file: String,
    /// First and last value of its column.
    pub(crate) theirs: [f64; 2],
    /// The column: `seq`, or `time_s`.
    pub(crate) column: &'static str,
    pub(crate) of: &'static str,
    /// First and last value of that.
    pub(crate) ours: [f64; 2],
}

/// No board has run for so long, three years, seconds.
const EPOCH_S: f64 = 1e8;

enum Reference {
    /// By the number of the scan, in order.
    Scans(Box<Scans>),
    Path(Box<Trajectory>),
}

/// The rows of a table by the number of the scan.
struct Scans {
    table: TableReader,
    sequence: Column,
    poses: PoseColumns,
    next: Option<(u64, Pose)>,
    /// Read ahead, so that rows in another order are refused before anything is missed.
    following: Option<(u64, Pose)>,
    /// The first and the last read so far.
    span: Option<[u64; 2]>,
}

impl Comparison {
    /// Opens the reference, the CSV table `file`: the columns of a pose, and either `seq`, as `simulate --truth` and
    /// `replay --format csv` write it, or `time_s`, device seconds.
    pub(crate) fn open(file: &str) -> Result<Self, PathError> {
        let table = TableReader::open(file)?;
        let reference = match table.optional_column("seq")? {
            Some(sequence) => {
                let poses = PoseColumns::keyed(&table, "seq")?;
                let mut scans = Scans { table, sequence, poses, next: None, following: None, span: None };
                scans.advance()?;
                scans.advance()?;
                Reference::Scans(Box::new(scans))
            }
            None => Reference::Path(Box::new(Trajectory::through_rows(table)?)),
        };
        Ok(Self {
            name: file.to_owned(),
            reference,
            accuracy: Accuracy::default(),
            unmatched: 0,
            sample: Sample::default(),
            scans: None,
        })
    }

    pub(crate) fn add(&mut self, record: &Record) -> Result<(), TableError> {
        let reference = match &mut self.reference {
            Reference::Scans(scans) => scans.pose(record.sequence)?,
            Reference::Path(path) => path.covers(record.device_time_s).then(|| path.pose(record.device_time_s)),
        };
        if let Some(estimate) = record.solution.estimate {
            let scan = (record.sequence, record.device_time_s);
            self.scans = Some([self.scans.map_or(scan, |[first, _]| first), scan]);
            self.sample.add(record.device_time_s, estimate, reference);
        }
        let (Some(estimate), Some(reference)) = (record.solution.estimate, reference) else {
            self.unmatched += 1;
            return Ok(());
        };
        self.accuracy.add(&estimate, &reference);
        Ok(())
    }

    /// Refuses a reference without any counterpart of the poses.
    pub(crate) fn require_match(&mut self) -> Result<(), NothingMatches> {
        let Some([first, last]) = self.scans.filter(|_| self.accuracy.count == 0) else { return Ok(()) };
        let (column, theirs, ours) = match &mut self.reference {
            Reference::Scans(scans) => {
                // The rest counts only as far as it can be read.
                while scans.following.is_some() && scans.advance().is_ok() {}
                let theirs = scans.span.map_or([f64::NAN; 2], |span| span.map(|number| number as f64));
                ("seq", theirs, [first.0 as f64, last.0 as f64])
            }
            Reference::Path(path) => ("time_s", path.span_s().unwrap_or([f64::NAN; 2]), [first.1, last.1]),
        };
        Err(NothingMatches { file: self.name.clone(), theirs, column, of: "the poses", ours })
    }

    /// What the reference looks like, if poses agree much better with another reading of it, in words.
    pub(crate) fn suspicion(&self) -> Option<String> {
        let path = if let Reference::Path(path) = &self.reference { Some(&**path) } else { None };
        self.sample.suspicion(&self.name, path)
    }

    pub(crate) fn lines(&self) -> Vec<String> {
        let count = self.accuracy.count;
        let mut lines =
            vec![format!("{count} poses compared with {}, {} scans without a counterpart", self.name, self.unmatched)];
        if count == 0 {
            return lines;
        }
        lines.extend(layout(&self.accuracy.lines("the reference"), WIDTH));
        lines.push("axis          mean        rms    largest".to_owned());
        for ((name, unit), axis) in AXES.iter().zip(&self.accuracy.axes) {
            let (mean, rms) = (axis.sum / count as f64, (axis.square / count as f64).sqrt());
            lines.push(format!(
                "{name:<4} {:>13.3} {:>10.3} {:>10.3} {unit}",
                mean * 1e6,
                rms * 1e6,
                axis.largest * 1e6
            ));
        }
        lines
    }
}

impl Scans {
    /// The pose of scan `wanted`, which is no earlier one than before.
    fn pose(&mut self, wanted: u64) -> Result<Option<Pose>, TableError> {
        while self.next.is_some_and(|(number, _)| number < wanted) {
            self.advance()?;
        }
        Ok(self.next.filter(|(number, _)| *number == wanted).map(|(_, pose)| pose))
    }

    /// Goes on to the next scan that has a pose.
    fn advance(&mut self) -> Result<(), TableError> {
        self.next = self.following.take();
        while let Some(row) = self.table.next_row()? {
            if row.text(self.poses.first()).is_empty() {
                continue;
            }
            // Scan numbers are integers; a fractional one is truncated.
            let (value, pose) = (row.number(self.sequence)?, self.poses.pose(&row)?);
            let number = value as u64;
            if self.next.is_some_and(|(before, _)| number <= before) {
                let allowed = "scan numbers that ascend, of one session of a board: sort the rows";
                return Err(row.out_of_range(self.sequence, value, allowed));
            }
            self.span = Some([self.span.map_or(number, |[first, _]| first), number]);
            self.following = Some((number, pose));
            break;
        }
        Ok(())
    }
}

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
struct Sample {
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
    fn add(&mut self, time_s: f64, estimate: Estimate, reference: Option<Pose>) {
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
    fn suspicion(&self, name: &str, path: Option<&Trajectory>) -> Option<String> {
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

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn poses_beyond_five_sigma_count_on_either_side() {
        let covariance = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1e-12 } else { 0.0 }));
        let mut accuracy = Accuracy::default();
        for sigmas in [-6.0, -4.0, 4.0, 6.0] {
            let pose = Pose { translation_m: DVec3::X * (sigmas * 1e-6), ..Pose::HOME };
            accuracy.add(&Estimate { pose, covariance }, &Pose::HOME);
        }
        assert_eq!(accuracy.beyond_five_sigma, 2);
        assert!(accuracy.axes[0].sum.abs() < 1e-12, "errors to both sides have no mean");
    }
}

//! A summary for people: renewed in place on a terminal, printed once otherwise.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use slitpose_model::Estimate;
use slitpose_protocol::Severity;

use super::Sink;
use crate::pipeline::{Counts, Item, OUTCOMES, Record};

/// A person reads no faster.
const RENEWAL: Duration = Duration::from_millis(200);

/// How near poses are to the truth, where there is one.
#[derive(Clone, Debug, Default)]
pub struct Accuracy {
    count: u64,
    square_m2: f64,
    square_rad2: f64,
    largest_m: f64,
    largest_rad: f64,
    nees_sum: f64,
    beyond_five_sigma: u64,
}

impl Accuracy {
    /// Takes the next pose and where the tool really was.
    pub fn add(&mut self, estimate: &Estimate, truth: &slitpose_model::Pose) {
        let (dt, dr) = estimate.pose.displacement_from(truth);
        self.count += 1;
        self.square_m2 += dt.length_squared();
        self.square_rad2 += dr.length_squared();
        self.largest_m = self.largest_m.max(dt.length());
        self.largest_rad = self.largest_rad.max(dr.length());
        self.nees_sum += estimate.nees(truth).unwrap_or(f64::NAN);
        let error = [dt.x, dt.y, dt.z, dr.x, dr.y, dr.z];
        let beyond = error.iter().zip(estimate.sigma()).any(|(error, sigma)| error.abs() > 5.0 * sigma);
        self.beyond_five_sigma += u64::from(beyond);
    }
}

/// Writes the summary.
pub(super) struct Summary<W> {
    output: W,
    live: bool,
    shown: Option<Instant>,
    lines: usize,
    board: String,
    last: Option<Record>,
    first_device_time_s: Option<f64>,
    accuracy: Accuracy,
    seen: u64,
}

impl<W: Write> Summary<W> {
    pub(super) fn new(output: W, live: bool) -> Self {
        Self {
            output,
            live,
            shown: None,
            lines: 0,
            board: String::new(),
            last: None,
            first_device_time_s: None,
            accuracy: Accuracy::default(),
            seen: 0,
        }
    }

    fn note(&mut self, record: &Record) {
        self.seen += 1;
        self.first_device_time_s.get_or_insert(record.device_time_s);
        if let (Some(estimate), Some(truth)) = (&record.solution.estimate, &record.truth) {
            self.accuracy.add(estimate, truth);
        }
        self.last = Some(*record);
    }

    fn text(&self, counts: &Counts) -> Vec<String> {
        let mut lines = vec![self.board.clone()];
        let (Some(last), Some(first_s)) = (&self.last, self.first_device_time_s) else {
            lines.push("no scan yet".to_owned());
            return lines;
        };
        let span_s = last.device_time_s - first_s;
        let rate_hz = if span_s > 0.0 { (self.seen - 1) as f64 / span_s } else { 0.0 };
        lines.push(format!(
            "device time {:>9.3} s   {rate_hz:>7.1} scans/s   {} scans, {} lost, {} damaged packets",
            last.device_time_s,
            counts.scans,
            counts.scans_lost,
            counts.decoder.damaged(),
        ));
        let outcomes: Vec<String> = OUTCOMES
            .iter()
            .zip(counts.outcomes)
            .filter(|(_, count)| *count > 0)
            .map(|(name, count)| format!("{name} {count}"))
            .collect();
        lines.push(format!("outcomes    {}", outcomes.join(", ")));
        match &last.solution.estimate {
            Some(estimate) => {
                let (t, r) = (estimate.pose.translation_m * 1e3, estimate.pose.rotation_rad());
                let s = estimate.sigma();
                lines.push(format!("position    {:>+9.4} {:>+9.4} {:>+9.4} mm", t.x, t.y, t.z));
                lines.push(format!("  sigma     {:>9.2} {:>9.2} {:>9.2} um", s[0] * 1e6, s[1] * 1e6, s[2] * 1e6));
                let degrees = r * (180.0 / std::f64::consts::PI);
                lines.push(format!("rotation    {:>+9.4} {:>+9.4} {:>+9.4} deg", degrees.x, degrees.y, degrees.z));
                lines.push(format!("  sigma     {:>9.1} {:>9.1} {:>9.1} urad", s[3] * 1e6, s[4] * 1e6, s[5] * 1e6));
            }
            None => lines.push(format!("position    none: {}", last.solution.outcome.as_str())),
        }
        let accuracy = &self.accuracy;
        if accuracy.count > 0 {
            let count = accuracy.count as f64;
            lines.push(format!(
                "error       {:.2} um rms, {:.2} um largest; {:.1} urad rms, {:.1} urad largest (against the simulated truth)",
                (accuracy.square_m2 / count).sqrt() * 1e6,
                accuracy.largest_m * 1e6,
                (accuracy.square_rad2 / count).sqrt() * 1e6,
                accuracy.largest_rad * 1e6,
            ));
            lines.push(format!(
                "honesty     mean NEES {:.2} (6 is honest), {} poses beyond 5 sigma in an axis",
                accuracy.nees_sum / count,
                accuracy.beyond_five_sigma,
            ));
        }
        lines
    }

    fn show(&mut self, counts: &Counts) -> io::Result<()> {
        if self.live && self.lines > 0 {
            // Back to the first line of the last summary, and clear to the end of the screen.
            write!(self.output, "\x1b[{}A\x1b[J", self.lines)?;
        }
        let lines = self.text(counts);
        for line in &lines {
            writeln!(self.output, "{line}")?;
        }
        self.lines = lines.len();
        self.shown = Some(Instant::now());
        self.output.flush()
    }
}

impl<W: Write> Sink for Summary<W> {
    fn take(&mut self, item: &Item<'_>) -> io::Result<()> {
        match item {
            Item::Hello(hello) => {
                let id: String = hello.device_id.iter().map(|byte| format!("{byte:02x}")).collect();
                self.board = format!(
                    "board       {} ({:?}), id {id}, firmware {}, {:.0} frames/s",
                    hello.board,
                    hello.kind,
                    hello.firmware,
                    hello.schedule.frame_rate_hz()
                );
            }
            Item::Pose(record) => self.note(record),
            Item::Event { severity, device_time_s, text } if *severity != Severity::Info => {
                writeln!(self.output, "{severity:?} at {device_time_s:.3} s: {text}")?;
                self.lines = 0;
            }
            _ => {}
        }
        Ok(())
    }

    fn tick(&mut self, counts: &Counts) -> io::Result<()> {
        if self.live && self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            self.show(counts)?;
        }
        Ok(())
    }

    fn finish(&mut self, counts: &Counts) -> io::Result<()> {
        self.show(counts)
    }
}

//! A summary for people: renewed in place on a terminal, printed once otherwise.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use slitpose_model::Estimate;
use slitpose_protocol::Severity;

use super::{Accounts, Note, Sink};
use crate::device::DeviceId;
use crate::foreign::printable;
use crate::pipeline::Record;
use crate::telemetry::view;

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

    /// How many poses were taken.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Three lines for people; `against` names where the truth comes from.
    pub fn lines(&self, against: &str) -> Vec<String> {
        if self.count == 0 {
            return Vec::new();
        }
        let count = self.count as f64;
        vec![
            format!("against     {against}"),
            format!(
                "  error     {:.2} um rms, {:.2} um largest; {:.1} urad rms, {:.1} urad largest",
                (self.square_m2 / count).sqrt() * 1e6,
                self.largest_m * 1e6,
                (self.square_rad2 / count).sqrt() * 1e6,
                self.largest_rad * 1e6,
            ),
            format!(
                "  honesty   mean NEES {:.2} (6 is honest), {} poses beyond 5 sigma in an axis",
                self.nees_sum / count,
                self.beyond_five_sigma,
            ),
        ]
    }
}

/// What was seen of one board.
struct Seen {
    device: DeviceId,
    last: Record,
    accuracy: Accuracy,
}

impl Seen {
    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        match &self.last.solution.estimate {
            Some(estimate) => {
                let (t, r) = (estimate.pose.translation_m * 1e3, estimate.pose.rotation_rad());
                let s = estimate.sigma();
                lines.push(format!("position    {:>+9.4} {:>+9.4} {:>+9.4} mm", t.x, t.y, t.z));
                lines.push(format!("  sigma     {:>9.2} {:>9.2} {:>9.2} um", s[0] * 1e6, s[1] * 1e6, s[2] * 1e6));
                let degrees = r * (180.0 / std::f64::consts::PI);
                lines.push(format!("rotation    {:>+9.4} {:>+9.4} {:>+9.4} deg", degrees.x, degrees.y, degrees.z));
                lines.push(format!("  sigma     {:>9.1} {:>9.1} {:>9.1} urad", s[3] * 1e6, s[4] * 1e6, s[5] * 1e6));
            }
            None => lines.push(format!("position    none: {}", self.last.solution.outcome.as_str())),
        }
        lines.extend(self.accuracy.lines("the simulated truth"));
        lines
    }
}

/// Writes the summary.
pub(super) struct Summary<W> {
    output: W,
    live: bool,
    shown: Option<Instant>,
    lines: usize,
    boards: Vec<Seen>,
}

impl<W: Write> Summary<W> {
    pub(super) fn new(output: W, live: bool) -> Self {
        Self { output, live, shown: None, lines: 0, boards: Vec::new() }
    }

    fn text(&self, accounts: &Accounts<'_>) -> Vec<String> {
        let mut lines = Vec::new();
        for account in accounts() {
            if !lines.is_empty() {
                lines.push(String::new());
            }
            lines.extend(view::lines(&account));
            let seen = self.boards.iter().find(|seen| Some(seen.device) == account.device);
            lines.extend(seen.map(Seen::lines).into_iter().flatten());
        }
        lines
    }

    fn show(&mut self, accounts: &Accounts<'_>) -> io::Result<()> {
        if self.live && self.lines > 0 {
            // Back to the first line of the last summary, and clear to the end of the screen.
            write!(self.output, "\x1b[{}A\x1b[J", self.lines)?;
        }
        let lines = self.text(accounts);
        for line in &lines {
            writeln!(self.output, "{line}")?;
        }
        self.lines = lines.len();
        self.shown = Some(Instant::now());
        self.output.flush()
    }
}

impl<W: Write> Sink for Summary<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        let known = self.boards.iter().position(|seen| seen.device == record.device);
        let at = known.unwrap_or_else(|| {
            self.boards.push(Seen { device: record.device, last: *record, accuracy: Accuracy::default() });
            self.boards.len() - 1
        });
        let seen = &mut self.boards[at];
        seen.last = *record;
        if let (Some(estimate), Some(truth)) = (&record.solution.estimate, &record.truth) {
            seen.accuracy.add(estimate, truth);
        }
        Ok(())
    }

    fn needs_each(&self) -> bool {
        false
    }

    fn note(&mut self, note: &Note) -> io::Result<()> {
        match note {
            Note::Event { severity, device_time_s, text, .. } if *severity != Severity::Info => {
                writeln!(self.output, "{severity:?} at {device_time_s:.3} s: {}", printable(text))?;
                self.lines = 0;
            }
            Note::Event { .. } | Note::Hello { .. } => {}
        }
        Ok(())
    }

    fn tick(&mut self, accounts: &Accounts<'_>) -> io::Result<()> {
        if self.live && self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            self.show(accounts)?;
        }
        Ok(())
    }

    fn finish(&mut self, accounts: &Accounts<'_>) -> io::Result<()> {
        self.show(accounts)
    }
}

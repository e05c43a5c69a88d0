//! A summary for people: drawn in place on a terminal, and printed once at the end.

use std::io::{self, Write};
use std::time::{Duration, Instant};

use slitpose_protocol::Severity;

use super::{Account, Accounts, Note, Sink};
use crate::comparison::Accuracy;
use crate::telemetry::view;
use crate::terminal::{self, Line, Tone, WIDTH, layout};
use slitpose_head::foreign::printable;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;

/// Period of redrawing: a person reads no faster.
const RENEWAL: Duration = Duration::from_millis(200);

/// The rate of a recording is measured over this time, or up to twice this time.
const RATE_OVER: Duration = Duration::from_secs(2);

/// The lines of a pose, with their ranks in a low window.
const POSE_LINES: [(&str, u8); 4] = [("position", 0), ("  sigma", 1), ("rotation", 0), ("  sigma", 1)];

/// The last pose of a board, and the accuracy of all its poses.
struct Seen {
    device: DeviceId,
    last: Record,
    accuracy: Accuracy,
}

impl Seen {
    fn lines(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        match &self.last.solution.estimate {
            Some(estimate) => {
                let (t, r) = (estimate.pose.translation_m * 1e3, estimate.pose.rotation_rad());
                let s = estimate.sigma();
                let degrees = r * (180.0 / std::f64::consts::PI);
                let texts = [
                    format!("{:>+8.4} {:>+8.4} {:>+8.4} mm", t.x, t.y, t.z),
                    format!("{:>8.2} {:>8.2} {:>8.2} um", s[0] * 1e6, s[1] * 1e6, s[2] * 1e6),
                    format!("{:>+8.4} {:>+8.4} {:>+8.4} deg", degrees.x, degrees.y, degrees.z),
                    format!("{:>8.1} {:>8.1} {:>8.1} urad", s[3] * 1e6, s[4] * 1e6, s[5] * 1e6),
                ];
                for ((name, rank), text) in POSE_LINES.into_iter().zip(texts) {
                    let mut line = Line::new(name, &text);
                    line.rank(rank);
                    lines.push(line);
                }
            }
            None => {
                let mut line = Line::new("position", &format!("none: {}", self.last.solution.outcome.as_str()));
                line.tone(Tone::Wrong);
                lines.push(line);
            }
        }
        lines.extend(self.accuracy.lines("the simulated truth"));
        lines
    }
}

pub(super) struct Summary<W> {
    output: W,
    live: bool,
    shown: Option<Instant>,
    /// The capture's length at two instants, some seconds apart.
    recorded: [Option<(Instant, u64)>; 2],
    boards: Vec<Seen>,
}

impl<W: Write> Summary<W> {
    pub(super) fn new(output: W, live: bool) -> Self {
        Self { output, live, shown: None, recorded: [None; 2], boards: Vec::new() }
    }

    fn lines(&mut self, account: &Account) -> Vec<Line> {
        let mut lines = Vec::new();
        for board in &account.boards {
            if !lines.is_empty() {
                lines.push(Line::blank());
            }
            lines.extend(view::lines(board));
            let seen = self.boards.iter().find(|seen| Some(seen.device) == board.device);
            lines.extend(seen.map(Seen::lines).into_iter().flatten());
        }
        let bytes_per_s = self.bytes_per_s(account.recorder.bytes);
        lines.extend(view::recorder(&account.recorder, bytes_per_s));
        lines
    }

    /// The rate of growth of the capture.
    fn bytes_per_s(&mut self, bytes: u64) -> Option<f64> {
        let now = Instant::now();
        let [before, newest] = &mut self.recorded;
        if newest.is_none_or(|(at, _)| now.duration_since(at) >= RATE_OVER) {
            (*before, *newest) = (*newest, Some((now, bytes)));
        }
        let (at, before) = before.as_ref()?;
        Some(bytes.saturating_sub(*before) as f64 / now.duration_since(*at).as_secs_f64())
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
                let text = printable(text);
                terminal::print(&mut self.output, format_args!("{severity:?} at {device_time_s:.3} s: {text}"))
            }
            Note::Event { .. } | Note::Hello { .. } => Ok(()),
        }
    }

    fn tick(&mut self, accounts: &Accounts<'_>) -> io::Result<()> {
        if self.live && self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            let lines = self.lines(&accounts());
            terminal::show(lines)?;
            self.shown = Some(Instant::now());
        }
        Ok(())
    }

    fn finish(&mut self, accounts: &Accounts<'_>) -> io::Result<()> {
        let lines = self.lines(&accounts());
        if self.live {
            terminal::clear();
        }
        let width = if self.live { terminal::columns() } else { WIDTH };
        for line in layout(&lines, width) {
            writeln!(self.output, "{line}")?;
        }
        self.output.flush()
    }
}

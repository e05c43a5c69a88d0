//! Outputs for poses: NDJSON, CSV, or a summary for people.

use std::io;
use std::io::Write;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use serde::Serialize;
use slitpose_protocol::Severity;

use crate::comparison::Accuracy;
use crate::telemetry::view;
use crate::terminal;
use crate::terminal::{Line, Tone, WIDTH, layout};
use slitpose_head::foreign::printable;
use slitpose_tracking::columns::CsvRows;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{EdgeRecord, Item, Record};
use slitpose_tracking::telemetry::DaemonReport;

mod ndjson;

pub(crate) use ndjson::{EdgeLine, FaultLine, FrameLine};

/// How poses are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Rates, losses, health, pose and accuracy, renewed in place on a terminal
    Summary,
    /// One JSON object a scan
    Ndjson,
    /// One row a scan
    Csv,
    /// Nothing: for a daemon that is read by datagrams, or only records
    None,
}

/// Makes a report of the present state.
pub(crate) type Reports<'a> = dyn Fn() -> DaemonReport + 'a;

pub(crate) trait Sink {
    /// Writes the solution of the next scan.
    fn pose(&mut self, record: &Record) -> io::Result<()>;

    /// Whether each pose must be written, however late.
    fn needs_each(&self) -> bool {
        true
    }

    fn note(&mut self, _: &Note) -> io::Result<()> {
        Ok(())
    }

    /// Flushes or redraws; called regularly, even without poses.
    fn tick(&mut self, _: &Reports<'_>) -> io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, reports: &Reports<'_>) -> io::Result<()>;
}

/// The sink of a format, `None` for [`Format::None`]. `live`: `output` is a terminal that can be redrawn in place.
pub(crate) fn open<'a>(
    format: Format,
    output: impl Write + Send + 'a,
    live: bool,
) -> Option<Box<dyn Sink + Send + 'a>> {
    match format {
        Format::Summary => Some(Box::new(Summary::new(output, live))),
        Format::Ndjson => Some(Box::new(ndjson::Ndjson::new(output))),
        Format::Csv => Some(Box::new(Csv::new(output))),
        Format::None => None,
    }
}

/// What a board, or the pipeline, says between two poses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Note {
    Text {
        /// The board; `None` if it has not introduced itself.
        device: Option<DeviceId>,
        severity: Severity,
        /// Its time by the board's clock, seconds.
        device_time_s: f64,
        text: String,
    },
    Edge(EdgeRecord),
}

impl Note {
    /// What `item` of a board's pipeline says besides poses, if anything.
    pub(crate) fn of(device: Option<DeviceId>, item: &Item<'_>) -> Option<Self> {
        let (severity, device_time_s, text) = match item {
            Item::Event { severity, device_time_s, text } => (*severity, *device_time_s, (*text).to_owned()),
            Item::Oddity { device_time_s, oddity } => (Severity::Warning, *device_time_s, oddity.to_string()),
            Item::Edge(edge) => return Some(Self::Edge(*edge)),
            _ => return None,
        };
        Some(Self::Text { device, severity, device_time_s, text })
    }
}

/// Writes a value as JSON, in which numbers read back to the same bits.
fn json(out: &mut Vec<u8>, value: &impl Serialize) {
    // Writing numbers and words to memory cannot fail.
    let _ = serde_json::to_writer(out, value);
}

// CSV: one row per scan, with the columns of `solve` and those of a stream.

struct Csv<W: Write> {
    output: W,
    rows: CsvRows,
    line: Vec<u8>,
    has_begun: bool,
}

impl<W: Write> Csv<W> {
    fn new(output: W) -> Self {
        Self { output, rows: CsvRows::default(), line: Vec::new(), has_begun: false }
    }

    /// Puts the header into the line if it has not been written.
    fn begin(&mut self) {
        self.line.clear();
        if !std::mem::replace(&mut self.has_begun, true) {
            self.rows.header(&mut self.line);
        }
    }
}

impl<W: Write> Sink for Csv<W> {
    fn pose(&mut self, record: &Record) -> io::Result<()> {
        self.begin();
        self.rows.row(record, &mut self.line);
        self.output.write_all(&self.line)
    }

    fn tick(&mut self, _: &Reports<'_>) -> io::Result<()> {
        self.output.flush()
    }

    fn finish(&mut self, _: &Reports<'_>) -> io::Result<()> {
        self.begin();
        self.output.write_all(&self.line)?;
        self.output.flush()
    }
}

// A summary for people: drawn in place on a terminal, and printed once at the end.

/// Period of redrawing: a person reads no faster.
const RENEWAL: Duration = Duration::from_millis(200);

/// The rate of a recording is measured over this time, or up to twice this time.
const RATE_OVER: Duration = Duration::from_secs(2);

/// Three numbers, each behind the name of its axis, if it has one.
fn along(axes: [&str; 3], numbers: [f64; 3], decimals: usize, unit: &str) -> String {
    let number = |(axis, number): (&str, f64)| match axis {
        "" => format!("   {number:>8.decimals$}"),
        _ => format!("{axis:<2} {number:>+8.decimals$}"),
    };
    let numbers: Vec<String> = axes.into_iter().zip(numbers).map(number).collect();
    format!("{} {unit}", numbers.join("  "))
}

const NO_AXES: [&str; 3] = [""; 3];

/// The last pose of a board, and the accuracy of all its poses.
struct Seen {
    device: DeviceId,
    last: Record,
    accuracy: Accuracy,
}

impl Seen {
    fn lines(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        if let Some(view) = self.last.view {
            let [x, y, z] = (view.tip_m() * 1e3).to_array();
            lines.push(Line::new("frame", &format!("{}, tip at {x:.4} {y:.4} {z:.4} mm", view.name())));
        }
        match &self.last.solution.estimate {
            Some(estimate) => {
                let [tx, ty, tz, rx, ry, rz] = estimate.sigma().map(|sigma| sigma * 1e6);
                let twist = self.last.twist.ok().map(|estimate| estimate.twist);
                let mut put = |name, rank, text: String| {
                    let mut line = Line::new(name, &text);
                    line.rank(rank);
                    lines.push(line);
                };
                let position_mm = (estimate.pose.translation_m * 1e3).to_array();
                put("position", 0, along(["x", "y", "z"], position_mm, 4, "mm"));
                put("  sigma", 1, along(NO_AXES, [tx, ty, tz], 2, "um"));
                if let Some(twist) = twist {
                    put("  velocity", 2, along(NO_AXES, (twist.linear_m_per_s * 1e3).to_array(), 1, "mm/s"));
                }
                let rotation_deg = estimate.pose.rotation_rad().map(f64::to_degrees).to_array();
                put("rotation", 0, along(["rx", "ry", "rz"], rotation_deg, 4, "deg"));
                put("  sigma", 1, along(NO_AXES, [rx, ry, rz], 1, "urad"));
                if let Some(twist) = twist {
                    let rates = twist.angular_rad_per_s.map(f64::to_degrees).to_array();
                    put("  velocity", 2, along(NO_AXES, rates, 1, "deg/s"));
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

struct Summary<W> {
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

    fn lines(&mut self, report: &DaemonReport) -> Vec<Line> {
        let mut lines = Vec::new();
        for board in &report.boards {
            if !lines.is_empty() {
                lines.push(Line::blank());
            }
            let seen = self.boards.iter().find(|seen| Some(seen.device) == board.device);
            lines.extend(view::lines(board, seen.map(Seen::lines).unwrap_or_default()));
        }
        let bytes_per_s = self.bytes_per_s(report.recorder.bytes);
        lines.extend(view::recorder(&report.recorder, bytes_per_s));
        lines
    }

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
        let Note::Text { severity, device_time_s, text, .. } = note else { return Ok(()) };
        if *severity == Severity::Info {
            return Ok(());
        }
        terminal::print(&mut self.output, format_args!("{severity:?} at {device_time_s:.3} s: {}", printable(text)))
    }

    fn tick(&mut self, reports: &Reports<'_>) -> io::Result<()> {
        if self.live && self.shown.is_none_or(|shown| shown.elapsed() >= RENEWAL) {
            let lines = self.lines(&reports());
            terminal::show(lines)?;
            self.shown = Some(Instant::now());
        }
        Ok(())
    }

    fn finish(&mut self, reports: &Reports<'_>) -> io::Result<()> {
        let lines = self.lines(&reports());
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

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use slitpose_model::{Estimate, Outcome, Pose, Solution, Twist, TwistEstimate};

    use crate::comparison::Accuracy;
    use crate::samples;

    use super::{Format, Seen, WIDTH, layout, open};
    use slitpose_tracking::clock::{HostInstant, HostTime};
    use slitpose_tracking::pipeline::Record;
    use slitpose_tracking::telemetry::{DaemonReport, RecorderReport};

    #[test]
    fn host_times_are_written_only_where_they_are_known() {
        let time =
            HostTime { monotonic_ns: 90_000_250_000, utc_ns: 1_700_000_090_000_250_000, uncertainty_ns: 140_000 };
        let records = [None, Some(time)].map(|host_time| Record { host_time, ..samples::record() });
        let written = |format| {
            let mut output = Vec::new();
            let mut sink = open(format, &mut output, false).unwrap();
            for record in &records {
                sink.pose(record).unwrap();
            }
            let now = HostInstant::now();
            sink.finish(&|| DaemonReport::of(now, now, Vec::new(), RecorderReport::default())).unwrap();
            drop(sink);
            String::from_utf8(output).unwrap()
        };
        let [monotonic, utc, uncertainty] = [time.monotonic_ns, time.utc_ns, time.uncertainty_ns];
        let (ndjson, csv) = (written(Format::Ndjson), written(Format::Csv));
        let lines: Vec<&str> = ndjson.lines().collect();
        let device = r#""device":"73696d756c61746564000000""#;
        assert!(lines[0].contains(device) && !lines[0].contains("host_"), "{}", lines[0]);
        let times =
            format!(r#""host_monotonic_ns":{monotonic},"host_utc_ns":{utc},"host_uncertainty_ns":{uncertainty},"#);
        assert!(lines[1].contains(device) && lines[1].contains(&times), "{}", lines[1]);
        let lines: Vec<&str> = csv.lines().collect();
        assert!(lines[0].contains(",device,host_monotonic_ns,host_utc_ns,host_uncertainty_ns,"), "{csv}");
        assert!(lines[1].contains(",73696d756c61746564000000,,,,"), "{csv}");
        assert!(lines[2].contains(&format!(",{monotonic},{utc},{uncertainty},")), "{csv}");
    }

    #[test]
    fn a_summary_is_in_millimetres_and_degrees() {
        let record = samples::record();
        let pose = Pose::from_vectors(DVec3::X * 2e-3, DVec3::Y * 0.5);
        let covariance = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 9e-12 } else { 0.0 }));
        let twist = Twist { linear_m_per_s: DVec3::Z * 0.25, angular_rad_per_s: DVec3::X };
        let cells = record.solution.cells_used;
        let solution = Solution::reported(Outcome::Converged, Some(Estimate { pose, covariance }), 1.0, cells, cells);
        let last = Record { solution, twist: Ok(TwistEstimate { twist, covariance }), ..record };
        let lines = Seen { device: last.device, last, accuracy: Accuracy::default() }.lines();
        let text = layout(&lines, WIDTH).join("\n");
        for part in ["+2.0000", "3.00 um", "250.0 mm/s", "+28.6479", "3.0 urad", "57.3"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}

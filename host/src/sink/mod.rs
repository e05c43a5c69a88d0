//! Outputs for poses: NDJSON, CSV, Parquet, or a summary for people.

mod columns;
#[cfg(feature = "parquet")]
mod parquet;
mod summary;
mod text;

use std::io::{self, Write};

use clap::ValueEnum;
use slitpose_protocol::{BoardKind, Severity};

use crate::telemetry::{BoardReport, RecorderReport};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{Item, Record};

/// How poses are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Rates, losses, health, pose and accuracy, renewed in place on a terminal
    Summary,
    /// One JSON object a scan
    Ndjson,
    /// One row a scan
    Csv,
    /// One row a scan, in columns with types
    #[cfg(feature = "parquet")]
    Parquet,
    /// Nothing: for a daemon that is read by datagrams, or only records
    None,
}

impl Format {
    /// How names of files in this format end; `None`: it is for no file.
    pub(crate) fn ending(self) -> Option<&'static str> {
        match self {
            Self::Ndjson => Some(".ndjson"),
            Self::Csv => Some(".csv"),
            #[cfg(feature = "parquet")]
            Self::Parquet => Some(".parquet"),
            Self::Summary | Self::None => None,
        }
    }

    pub(crate) fn is_text(self) -> bool {
        #[cfg(feature = "parquet")]
        if self == Self::Parquet {
            return false;
        }
        true
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Account {
    pub boards: Vec<BoardReport>,
    pub recorder: RecorderReport,
}

pub(crate) type Accounts<'a> = dyn Fn() -> Account + 'a;

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
    fn tick(&mut self, _: &Accounts<'_>) -> io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, accounts: &Accounts<'_>) -> io::Result<()>;
}

/// The sink of a format, `None` for [`Format::None`]. `live`: `output` is a terminal that can be redrawn in place.
pub(crate) fn open<'a>(
    format: Format,
    output: impl Write + Send + 'a,
    live: bool,
) -> Option<Box<dyn Sink + Send + 'a>> {
    match format {
        Format::Summary => Some(Box::new(summary::Summary::new(output, live))),
        Format::Ndjson => Some(Box::new(text::Ndjson::new(output))),
        Format::Csv => Some(Box::new(text::Csv::new(output))),
        #[cfg(feature = "parquet")]
        Format::Parquet => Some(Box::new(parquet::Parquet::new(output))),
        Format::None => None,
    }
}

/// An event in the stream of poses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Note {
    Hello {
        device: DeviceId,
        board: String,
        /// Whether its photocurrents are measured or computed.
        kind: BoardKind,
        firmware: String,
        /// Frames a second of its schedule.
        frame_rate_hz: f64,
    },
    Event {
        /// The board; `None` if it has not introduced itself.
        device: Option<DeviceId>,
        severity: Severity,
        /// Its time by the board's clock, seconds.
        device_time_s: f64,
        text: String,
    },
}

impl Note {
    /// What `item` of a board's pipeline says besides poses, if anything.
    pub(crate) fn of(device: Option<DeviceId>, item: &Item<'_>) -> Option<Self> {
        let event = |severity, device_time_s, text| Self::Event { device, severity, device_time_s, text };
        match item {
            Item::Hello(hello) => Some(Self::Hello {
                device: DeviceId(hello.device_id),
                board: hello.board.to_owned(),
                kind: hello.kind,
                firmware: hello.firmware.to_owned(),
                frame_rate_hz: hello.schedule.frame_rate_hz(),
            }),
            Item::Event { severity, device_time_s, text } => Some(event(*severity, *device_time_s, (*text).to_owned())),
            Item::Oddity { device_time_s, oddity } => {
                Some(event(Severity::Warning, *device_time_s, oddity.to_string()))
            }
            // What a board was asked is history.
            Item::Pose(_) | Item::Scan(_) | Item::Status(_) | Item::Reply(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use slitpose_model::{MotionPrior, Photocurrents, Solver, Start};

    use super::{Account, Format, open};
    use slitpose_tracking::clock::HostTime;
    use slitpose_tracking::link::DeviceId;
    use slitpose_tracking::pipeline::Record;

    fn record(host_time: Option<HostTime>) -> Record {
        Record {
            device: DeviceId(*b"simulated\0\0\0"),
            sequence: 0,
            device_time_s: 0.0,
            host_time,
            arrival: None,
            solution: Solver::<f64>::empty().solve(&Photocurrents::default(), Start::Cold, &MotionPrior::AT_REST),
            twist: None,
            filtered: None,
            simulated: true,
            truth: None,
        }
    }

    #[test]
    fn host_times_are_written_only_where_they_are_known() {
        let time =
            HostTime { monotonic_ns: 90_000_250_000, utc_ns: 1_700_000_090_000_250_000, uncertainty_ns: 140_000 };
        let records = [record(None), record(Some(time))];
        let written = |format| {
            let mut output = Vec::new();
            let mut sink = open(format, &mut output, false).unwrap();
            for record in &records {
                sink.pose(record).unwrap();
            }
            sink.finish(&Account::default).unwrap();
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
        assert!(lines[0].ends_with(",device,host_monotonic_ns,host_utc_ns,host_uncertainty_ns"), "{csv}");
        assert!(lines[1].ends_with(",73696d756c61746564000000,,,"), "{csv}");
        assert!(lines[2].ends_with(&format!(",{monotonic},{utc},{uncertainty}")), "{csv}");
    }
}

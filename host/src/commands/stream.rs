//! What `run`, `replay` and `simulate` share.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use slitpose_model::Tier;
use slitpose_protocol::{MAX_REQUEST_BYTES, Rejection, Reply, Request, encode};
use thiserror::Error;

use super::options::TierOptions;
use super::{CommandError, Outcome};
use crate::pipeline::{Counts, Item, Pipeline, PipelineError};
use crate::scene_file::{SceneFile, SceneFileError, Shipped, WIDE};
use crate::simulator::{Trajectory, TrajectoryKind};
use crate::sink::{self, Format, Sink};
use crate::table::OutputError;

/// Streams are solved to what their noise is worth.
pub(super) const DEFAULT_TOLERANCE: f64 = 1e-6;

/// Why a stream cannot be followed.
#[derive(Debug, Error)]
pub enum StreamError {
    /// What came does not suit.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Writing the poses failed.
    #[error("writing to standard output failed")]
    Output(#[from] io::Error),
    /// The board does not do what it is asked.
    #[error("the board refused a command")]
    Refused(#[source] Rejection),
    /// A capture that cannot be read.
    #[error("cannot read {}; give a capture written by `run --record` or `simulate`", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file without a single scan.
    #[error(
        "{} holds no scan: {bytes} bytes, {packets} readable packets; \
         give a capture written by `run --record` or `simulate`", path.display()
    )]
    NoScan {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
        /// Packets in it.
        packets: u64,
    },
    /// A device that this version cannot open.
    #[error("device `{0}` cannot be opened: this version runs simulated boards only; give --device sim")]
    Device(String),
}

impl StreamError {
    pub(super) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }
}

/// How fast a stream goes, relative to device time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Speed {
    /// As fast as it can be solved.
    Max,
    /// This many device seconds a second.
    Times(f64),
}

impl std::str::FromStr for Speed {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            _ => match text.parse::<f64>() {
                Ok(times) if times > 0.0 && times.is_finite() => Ok(Self::Times(times)),
                _ => Err("give `max`, or how many device seconds pass a second, such as 1 or 0.5"),
            },
        }
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Max => f.write_str("max"),
            Self::Times(times) => write!(f, "{times}"),
        }
    }
}

/// A duration such as `10s`, `500ms` or `2m`.
pub(super) fn parse_duration(text: &str) -> Result<f64, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if duration > Duration::ZERO => Ok(duration.as_secs_f64()),
        Ok(_) => Err("give more than nothing, such as 10s".to_owned()),
        Err(error) => Err(format!("{error}; give a duration such as 10s, 500ms or 2m")),
    }
}

/// When a stream of poses ends, how it is written and how it is solved.
#[derive(clap::Args, Debug)]
pub(super) struct PoseOptions {
    /// End after this much device time, such as 10s; else at the end of the data, or an interrupt
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) duration: Option<f64>,
    /// [default: summary on a terminal, else ndjson]
    #[arg(long, value_enum)]
    format: Option<Format>,
    #[command(flatten)]
    tier: TierOptions,
}

impl PoseOptions {
    /// The tier to solve in.
    pub(super) fn tier(&self) -> Tier {
        self.tier.tier(DEFAULT_TOLERANCE)
    }
}

/// The tool in front of a simulated board.
#[derive(clap::Args, Debug)]
pub(super) struct ToolOptions {
    /// still, smooth, fast, contact, or a CSV table with time_s and the columns of a pose
    #[arg(long, value_name = "MOTION", default_value = "smooth")]
    trajectory: String,
    /// Seed of motion and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) seed: u64,
}

impl ToolOptions {
    pub(super) fn trajectory(&self, duration_s: f64) -> Result<Trajectory, CommandError> {
        use clap::ValueEnum;
        match TrajectoryKind::from_str(&self.trajectory, false) {
            Ok(kind) => Ok(Trajectory::of_kind(kind, self.seed, duration_s)),
            Err(_) => Ok(Trajectory::from_table(&self.trajectory)?),
        }
    }
}

/// The scene asked for, or the default one.
pub(super) fn open_scene(argument: Option<&str>) -> Result<SceneFile, SceneFileError> {
    match argument {
        Some(argument) => SceneFile::open(argument),
        None => WIDE.read(),
    }
}

/// The shipped scene of a hash.
pub(super) fn shipped_with_hash(hash: u64) -> Option<SceneFile> {
    crate::scene_file::SHIPPED.iter().filter_map(|shipped: &Shipped| shipped.read().ok()).find(|file| file.hash == hash)
}

/// The bytes of a command.
pub(super) fn request(number: u16, command: slitpose_protocol::Command) -> Vec<u8> {
    let mut buffer = [0; MAX_REQUEST_BYTES];
    encode(&Request { number, command }, &mut buffer).map(<[u8]>::to_vec).unwrap_or_default()
}

/// Poses on their way from a pipeline to standard output.
pub(super) struct Stream<'a> {
    pipeline: Pipeline,
    sink: Box<dyn Sink + 'a>,
    until_s: Option<f64>,
    first_s: Option<f64>,
    last_s: f64,
    stop: Arc<AtomicBool>,
}

impl Stream<'_> {
    /// Ends after the duration of `options` (device time, from the first scan), or when the user interrupts.
    pub(super) fn new(pipeline: Pipeline, options: &PoseOptions) -> Result<Self, StreamError> {
        let live = io::stdout().is_terminal();
        let format = options.format.unwrap_or(if live { Format::Summary } else { Format::Ndjson });
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            // A second signal ends the program the ordinary way.
            signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))?;
            signal_hook::flag::register(signal, Arc::clone(&stop))?;
        }
        let output = io::BufWriter::with_capacity(1 << 16, io::stdout().lock());
        Ok(Self {
            pipeline,
            sink: sink::open(format, output, live),
            until_s: options.duration,
            first_s: None,
            last_s: 0.0,
            stop,
        })
    }

    /// Takes bytes as they came.
    pub(super) fn push(&mut self, bytes: &[u8]) -> Result<(), StreamError> {
        let Self { pipeline, sink, until_s, first_s, last_s, .. } = self;
        pipeline.push(bytes, |item| {
            match &item {
                Item::Pose(record) => {
                    let first_s = *first_s.get_or_insert(record.device_time_s);
                    *last_s = record.device_time_s - first_s;
                    // Device times are exact to nanoseconds; frames are microseconds apart.
                    if until_s.is_some_and(|until_s| *last_s >= until_s - 1e-9) {
                        return Ok(());
                    }
                }
                Item::Reply(Reply { outcome: Err(rejection), .. }) => return Err(StreamError::Refused(*rejection)),
                _ => {}
            }
            Ok(sink.take(&item)?)
        })
    }

    /// Device time since the first scan, seconds.
    pub(super) fn elapsed_s(&self) -> f64 {
        self.last_s
    }

    /// Whether the end asked for has come, or the user has interrupted.
    pub(super) fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.until_s.is_some_and(|until_s| self.last_s >= until_s - 1e-9)
    }

    /// Shows what a live sink shows from time to time.
    pub(super) fn tick(&mut self) -> Result<(), StreamError> {
        Ok(self.sink.tick(&self.pipeline.counts())?)
    }

    /// Ends the output and says on standard error what was lost.
    pub(super) fn finish(mut self) -> Result<(Outcome, Counts), StreamError> {
        let counts = self.pipeline.counts();
        self.sink.finish(&counts)?;
        // A packet under way when the end was asked for is not lost: it was not waited for.
        let is_over = self.is_over();
        drop(self.sink);
        let lossless = if is_over { !counts.has_loss_before_end() } else { !counts.has_loss() };
        if lossless {
            return Ok((Outcome::Done, counts));
        }
        let decoder = counts.decoder;
        // Nobody is left to tell if even standard error is closed.
        let _ = writeln!(
            io::stderr(),
            "slitpose: data were damaged or lost: {} scans missing, {} damaged and {} unreadable packets \
             ({} bytes skipped), {} bytes of a packet that was cut off, {} batches without a hello",
            counts.scans_lost,
            decoder.damaged(),
            decoder.unknown + decoder.malformed + counts.batches_unreadable,
            decoder.bytes_skipped,
            counts.pending_bytes,
            counts.batches_without_hello,
        );
        Ok((Outcome::DataLost, counts))
    }
}

/// Holds a stream to a multiple of device time.
#[derive(Debug)]
pub(super) struct Pace {
    speed: Speed,
    started: Instant,
}

impl Pace {
    pub(super) fn new(speed: Speed) -> Self {
        Self { speed, started: Instant::now() }
    }

    /// Sleeps until `device_s` may have passed.
    pub(super) fn wait(&self, device_s: f64) {
        if let Speed::Times(times) = self.speed {
            let due = Duration::from_secs_f64(device_s / times);
            std::thread::sleep(due.saturating_sub(self.started.elapsed()));
        }
    }
}

impl From<StreamError> for CommandError {
    fn from(error: StreamError) -> Self {
        match error {
            StreamError::Output(source) => {
                Self::Output(OutputError::Write { target: "standard output".to_owned(), source })
            }
            error => Self::Stream(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_and_speeds_are_read_or_refused() {
        assert_eq!(parse_duration("10s"), Ok(10.0));
        assert_eq!(parse_duration("500ms"), Ok(0.5));
        for text in ["", "10", "0s", "-1s", "soon"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
        assert_eq!("max".parse(), Ok(Speed::Max));
        assert_eq!("2.5".parse(), Ok(Speed::Times(2.5)));
        for text in ["", "0", "-1", "inf", "nan", "fast"] {
            assert!(text.parse::<Speed>().is_err(), "{text}");
        }
    }
}

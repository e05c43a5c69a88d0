//! What `run`, `replay` and `simulate` share.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use slitpose_model::Tier;
use slitpose_protocol::{Rejection, Reply, Severity, Status};
use thiserror::Error;

use super::options::TierOptions;
use super::{CommandError, Outcome};
use crate::device::{DeviceError, SimulatedDevice};
use crate::front_end;
use crate::pace::Speed;
use crate::pipeline::{Counts, Following, Item, Pipeline, PipelineError};
use crate::scene_file::{SceneFile, SceneFileError, Shipped, WIDE};
use crate::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
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
    /// A board that cannot be used, or no longer.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl StreamError {
    pub(super) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
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
    /// Tell a pose from many scans, too: a parabola through those of about this long, such as 5ms
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    filter: Option<f64>,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    without_clipped: bool,
    #[command(flatten)]
    tier: TierOptions,
}

impl PoseOptions {
    /// How scans are followed.
    pub(super) fn following(&self) -> Following {
        Following { filter_s: self.filter, without_clipped: self.without_clipped }
    }

    /// The tier to solve in.
    pub(super) fn tier(&self) -> Tier {
        self.tier.tier(DEFAULT_TOLERANCE)
    }
}

/// The tool in front of a simulated board.
#[derive(clap::Args, Debug)]
pub(super) struct ToolOptions {
    /// still, smooth, fast, contact, or a CSV table with time_s and the columns of a pose
    /// [default: smooth]
    #[arg(long, value_name = "MOTION")]
    trajectory: Option<String>,
    /// Seed of motion and noise [default: 1]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

/// A motion that plans ahead for no end in sight does so for an hour.
const ENDLESS_PLAN_S: f64 = 3600.0;

impl ToolOptions {
    /// The first option that was given, if any.
    pub(super) fn given(&self) -> Option<&'static str> {
        self.trajectory.as_ref().map(|_| "--trajectory").or(self.seed.map(|_| "--seed"))
    }

    /// The simulated board with the head of `file` for `duration_s`, which may be infinite.
    pub(super) fn device(
        &self,
        file: &SceneFile,
        tier: Tier,
        duration_s: f64,
        speed: Speed,
    ) -> Result<SimulatedDevice, CommandError> {
        let frame_s = front_end::configuration(file)?.schedule.frame_rate_hz().recip();
        let trajectory = self.trajectory(duration_s)?;
        let board = SimulatedBoard::new(file, trajectory, tier, self.seed.unwrap_or(1))?;
        Ok(SimulatedDevice::new(board, frame_s, duration_s, speed))
    }

    /// The motion of the tool over `duration_s`, which may be infinite.
    pub(super) fn trajectory(&self, duration_s: f64) -> Result<Trajectory, CommandError> {
        use clap::ValueEnum;
        let name = self.trajectory.as_deref().unwrap_or("smooth");
        match TrajectoryKind::from_str(name, false) {
            Ok(kind) => {
                let plan_s = if duration_s.is_finite() { duration_s } else { ENDLESS_PLAN_S };
                Ok(Trajectory::of_kind(kind, self.seed.unwrap_or(1), plan_s))
            }
            Err(_) => Ok(Trajectory::from_table(name)?),
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

/// Says something on standard error.
pub(super) fn talk(text: fmt::Arguments<'_>) {
    // Nobody is left to tell if even standard error is closed.
    let _ = writeln!(io::stderr(), "slitpose: {text}");
}

/// Poses on their way from a pipeline to standard output.
pub(super) struct Stream<'a> {
    pipeline: Pipeline,
    sink: Box<dyn Sink + 'a>,
    stop: Arc<AtomicBool>,
    complaint: Option<String>,
}

impl Stream<'_> {
    /// Ends with the pipeline, or when the user interrupts.
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
        Ok(Self { pipeline, sink: sink::open(format, output, live), stop, complaint: None })
    }

    /// Takes bytes as they came, and gives how many were taken: all, unless the end has come.
    pub(super) fn push(&mut self, bytes: &[u8]) -> Result<usize, StreamError> {
        let Self { pipeline, sink, complaint, .. } = self;
        pipeline.push(bytes, |item| {
            match &item {
                Item::Reply(Reply { outcome: Err(rejection), .. }) => return Err(StreamError::Refused(*rejection)),
                Item::Event { severity, text, .. } if *severity != Severity::Info => {
                    *complaint = Some((*text).to_owned());
                }
                _ => {}
            }
            Ok(sink.take(&item)?)
        })
    }

    /// Device time since the first scan, seconds.
    pub(super) fn elapsed_s(&self) -> f64 {
        self.pipeline.elapsed_s()
    }

    /// Whether all scans asked for have come.
    pub(super) fn is_complete(&self) -> bool {
        self.pipeline.is_complete()
    }

    /// Whether the end asked for has come, or the user has interrupted.
    pub(super) fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.is_complete()
    }

    /// The board's latest account of itself.
    pub(super) fn board_status(&self) -> Option<Status> {
        self.pipeline.counts().board_status
    }

    /// The last warning or error of the board.
    pub(super) fn complaint(&self) -> Option<&str> {
        self.complaint.as_deref()
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
        talk(format_args!(
            "data were damaged or lost: {} scans missing, {} damaged and {} unreadable packets \
             ({} bytes skipped), {} bytes of a packet that was cut off, {} batches without a hello",
            counts.scans_lost,
            decoder.damaged(),
            decoder.unknown + decoder.malformed + counts.batches_unreadable,
            decoder.bytes_skipped,
            counts.pending_bytes,
            counts.batches_without_hello,
        ));
        Ok((Outcome::DataLost, counts))
    }
}

impl From<DeviceError> for CommandError {
    fn from(error: DeviceError) -> Self {
        Self::Stream(error.into())
    }
}

impl From<PipelineError> for CommandError {
    fn from(error: PipelineError) -> Self {
        Self::Stream(error.into())
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
    fn durations_are_read_or_refused() {
        assert_eq!(parse_duration("10s"), Ok(10.0));
        assert_eq!(parse_duration("500ms"), Ok(0.5));
        for text in ["", "10", "0s", "-1s", "soon"] {
            assert!(parse_duration(text).is_err(), "{text}");
        }
    }
}

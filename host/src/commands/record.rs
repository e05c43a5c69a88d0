//! The capture that `run` records.

use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{io, thread};

use super::CommandError;
use super::options::{PoseOptions, parse_duration, poses_hz};
use super::playback::{PlayOptions, Playback, Printing};
use super::player::{Orders, Player};
use crate::daemon::CapturePlan;
use crate::live::{Calibrate, Control, Input, LiveInput, Recordings, now_in_a_name};
use crate::platform::go_behind;
use crate::sink::Format;
use slitpose_head::causes::with_causes;
use slitpose_head::pace::Speed;
use slitpose_tracking::capture::{CaptureError, CaptureSeries, Existing, Limits};

/// Poses a device second in a capture: enough to look at it; all others follow from its bytes.
const RECORDED_HZ: f64 = 25.0;

/// The recording asked for.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct RecordOptions {
    /// Record all that comes, as it comes, in this capture (MCAP), from which `replay` finds the
    /// same poses again
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Replace a capture that is there already, as soon as something has come to be recorded
    #[arg(long)]
    overwrite: bool,
    /// Begin another file (FILE-0001, FILE-0002, …) when one is this long, such as 500MB or 2GiB
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    record_size: Option<u64>,
    /// Begin another file after this time, such as 1h
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    record_time: Option<f64>,
    /// Poses a second in the capture, for those who look at it without replaying; 0 for every scan
    #[arg(long, value_name = "HZ", value_parser = poses_hz(), default_value_t = RECORDED_HZ)]
    record_poses: f64,
}

impl RecordOptions {
    /// Begins the capture asked for. `later`: others may begin while the daemon runs.
    pub(super) fn open(&self, later: bool) -> Result<Option<CapturePlan>, CaptureError> {
        let existing = if self.overwrite { Existing::Replaced } else { Existing::Kept };
        let series = self.record.as_ref().map(|path| self.create(path, existing)).transpose()?;
        if series.is_none() && !later {
            return Ok(None);
        }
        let poses_hz = if self.record_poses > 0.0 { self.record_poses } else { f64::INFINITY };
        Ok(Some(CapturePlan { series, poses_hz }))
    }

    /// The captures beside the one asked for, else in the working directory.
    /// A head can be calibrated from them by `calibrate`.
    pub(super) fn recordings(&self, calibrate: Calibrate) -> Recordings {
        Recordings::new(self.folder(), Box::new(play), calibrate)
    }

    fn folder(&self) -> PathBuf {
        self.record.as_deref().and_then(Path::parent).map(Path::to_owned).unwrap_or_default()
    }

    /// Begins another capture, named by the time, beside the one asked for, else in the working directory.
    pub(super) fn another(&self) -> Result<CaptureSeries, CaptureError> {
        let path = self.folder().join(format!("slitpose-{}.mcap", now_in_a_name()));
        self.create(&path, Existing::Kept)
    }

    fn create(&self, path: &Path, existing: Existing) -> Result<CaptureSeries, CaptureError> {
        let limits = Limits {
            max_bytes: self.record_size,
            max_age: self.record_time.map(|time_s| Duration::try_from_secs_f64(time_s).unwrap_or(Duration::MAX)),
        };
        CaptureSeries::create(path, limits, existing)
    }
}

/// Plays a capture to the pages of `live`, on a thread of its own, until nobody looks any more.
fn play(path: PathBuf, live: LiveInput) -> io::Result<Control> {
    let orders = Orders::default();
    let control = orders.control();
    thread::Builder::new().name("play".to_owned()).spawn(move || {
        if let Err(error) = play_all(&path, orders, live.clone()) {
            live.show(Input::Failed(with_causes(error.as_ref()).to_string()));
        }
    })?;
    Ok(control)
}

fn play_all(path: &Path, orders: Orders, live: LiveInput) -> Result<(), CommandError> {
    let files = [path.to_owned()];
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    // The board that is followed goes first.
    go_behind();
    let Some(player) = Player::new(orders, live, name, &files, None)? else { return Ok(()) };
    let (play, poses) = (PlayOptions::default(), PoseOptions::default());
    let printing = Printing { sink: None, target: "", format: Format::None, is_terminal: false, is_silent: true };
    Playback::new(&files, &play, &poses, Vec::new(), Speed::Times(1.0), printing)?.played_by(player)?.run().map(drop)
}

/// No capture is shorter than its beginning.
const MIN_BYTES: u64 = 100_000;

fn parse_size(text: &str) -> Result<u64, &'static str> {
    let size = parse_size::parse_size(text.trim()).ok().filter(|&bytes| bytes >= MIN_BYTES);
    size.ok_or("give a size of 100kB at least, such as 500MB or 2GiB")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_rates_are_read_or_refused() {
        for (text, bytes) in [
            ("500MB", 500_000_000),
            ("2GiB", 2 << 30),
            ("123456", 123_456),
            (" 0.5 GB ", 500_000_000),
            ("200kB", 200_000),
        ] {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "1", "-5MB", "many", "nanGB", "99kB", "5 MBit"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
        assert_eq!((poses_hz()("0"), poses_hz()("12.5")), (Ok(0.0), Ok(12.5)));
        for text in ["", "-1", "inf", "often"] {
            assert!(poses_hz()(text).is_err(), "{text}");
        }
    }
}

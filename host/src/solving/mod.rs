//! How readings are solved: choices that commands and other programs offer.

mod board;
mod rows;

use std::path::Path;
use std::time::Duration;

use clap::{Args, ValueEnum};
use slitpose_calibration::{CalibrationFileError, Head};
use slitpose_model::Tier;

use crate::pipeline::Following;
pub(crate) use board::{compile, hashes};
pub use rows::{RowSolver, RowsOf};
use slitpose_head::scene_file::SceneFile;

/// Streams are solved to a tolerance below their noise.
pub const STREAM_TOLERANCE: f64 = 1e-6;

/// Tables of currents are made once and kept, so they get nearly all the digits there are.
pub const MODEL_TOLERANCE: f64 = 1e-10;

/// In place of a calibration: the head is as its scene says.
pub(crate) const NOT_CALIBRATED: &str = "none";

/// How exactly the optics are evaluated.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct TierOptions {
    /// Equations as printed in the source paper, or integrated over the spot
    #[arg(long, value_enum)]
    pub tier: Option<TierName>,
    /// Relative error of the exact tier's integrals; given alone it means the exact tier
    #[arg(long, value_name = "T", value_parser = parse_tolerance)]
    pub tolerance: Option<f64>,
}

/// A [`Tier`] without its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TierName {
    /// Equations (1) to (6) of De La Cruz et al. 2018
    Paper,
    /// Integrated over the spot
    Exact,
}

impl TierOptions {
    /// The tier asked for; exact to `default_tolerance` if nothing is asked.
    pub fn tier(self, default_tolerance: f64) -> Tier {
        self.tier_or(Tier::Exact { tolerance: default_tolerance })
    }

    /// The tier asked for; what is not asked for is as `usual`, or as usual for streams.
    pub fn tier_or(self, usual: Tier) -> Tier {
        let usual_tolerance = match usual {
            Tier::Exact { tolerance } => tolerance,
            Tier::Paper => STREAM_TOLERANCE,
        };
        match (self.tier, self.tolerance) {
            (Some(TierName::Paper), _) => Tier::Paper,
            (Some(TierName::Exact), tolerance) => Tier::Exact { tolerance: tolerance.unwrap_or(usual_tolerance) },
            (None, Some(tolerance)) => Tier::Exact { tolerance },
            (None, None) => usual,
        }
    }
}

/// Whether a tolerance of the exact tier is possible.
pub fn is_tolerance(tolerance: f64) -> bool {
    tolerance > 0.0 && tolerance < 1.0
}

fn parse_tolerance(text: &str) -> Result<f64, &'static str> {
    let tolerance = text.parse().ok().filter(|&tolerance| is_tolerance(tolerance));
    tolerance.ok_or("give a number between 0 and 1, such as 1e-10")
}

/// How scans are solved.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct Solving {
    /// Also estimate each pose from many scans, by a parabola through about this long, such as 5ms;
    /// or off
    #[arg(long, value_name = "TIME", value_parser = parse_filter)]
    pub filter: Option<Filter>,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    pub without_clipped: bool,
    /// How exactly the optics are evaluated.
    #[command(flatten)]
    pub tier: TierOptions,
}

/// Memory of the filter, seconds; `None`: no filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter(pub Option<f64>);

fn parse_filter(text: &str) -> Result<Filter, String> {
    Ok(Filter(if text == "off" { None } else { Some(parse_duration(text)?) }))
}

impl Solving {
    /// How scans are followed: as they were, unless asked otherwise.
    pub fn following_or(&self, recorded: Option<Following>) -> Following {
        let recorded = recorded.unwrap_or_default();
        Following {
            source: recorded.source,
            filter_s: match self.filter {
                Some(Filter(filter_s)) => filter_s,
                None => recorded.filter_s,
            },
            without_clipped: self.without_clipped || recorded.without_clipped,
        }
    }

    /// An option that was given for poses found by this program.
    pub(crate) fn for_this_program(&self) -> Option<&'static str> {
        [(matches!(self.filter, Some(Filter(Some(_)))), "--filter"), (self.without_clipped, "--without-clipped")]
            .into_iter()
            .find_map(|(is_given, option)| is_given.then_some(option))
    }

    /// The tier to solve in: as it was, unless asked otherwise.
    pub fn tier_or(&self, recorded: Option<Tier>) -> Tier {
        self.tier.tier_or(recorded.unwrap_or(Tier::Exact { tolerance: STREAM_TOLERANCE }))
    }
}

/// The head of `file` by the calibration at the path `calibration`, or as its scene says if that is `none`; without
/// either by `usual`.
///
/// # Errors
/// A calibration that cannot be read, or of another scene; and those of `usual`.
pub fn head_by<E: From<CalibrationFileError>>(
    calibration: Option<&Path>,
    file: SceneFile,
    usual: impl FnOnce(SceneFile) -> Result<Head, E>,
) -> Result<Head, E> {
    match calibration {
        None => usual(file),
        Some(path) if path == NOT_CALIBRATED => Ok(file.into()),
        Some(path) => Ok(Head::open_calibrated(file, path)?),
    }
}

/// A duration such as `10s`, `500ms` or `2m`.
pub(crate) fn parse_duration(text: &str) -> Result<f64, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if duration > Duration::ZERO => Ok(duration.as_secs_f64()),
        Ok(_) => Err("give more than nothing, such as 10s".to_owned()),
        Err(error) => Err(format!("{error}; give a duration such as 10s, 500ms or 2m")),
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
        assert_eq!(parse_filter("off"), Ok(Filter(None)));
        assert_eq!(parse_filter("5ms"), Ok(Filter(Some(0.005))));
    }

    #[test]
    fn a_tolerance_lies_between_zero_and_one() {
        assert_eq!(parse_tolerance("1e-6"), Ok(1e-6));
        for text in ["0", "1", "-1e-3", "nan", "tight"] {
            assert!(parse_tolerance(text).is_err(), "`{text}` was taken for a tolerance");
        }
    }
}

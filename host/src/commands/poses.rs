//! How a stream of poses is solved, where it ends, and how it is written.

use std::io::Write;
use std::time::Duration;

use slitpose_model::Tier;

use super::options::{DEFAULT_TOLERANCE, TierOptions};
use super::talk::talk;
use crate::pipeline::Following;
use crate::sink::{self, Format, Sink};

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
    /// End after this much time of the board's clock, such as 10s; else at the end of the data, or at an interrupt
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub(super) duration: Option<f64>,
    /// How poses are written
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Also estimate each pose from many scans, by a parabola through about this long, such as 5ms;
    /// or off
    #[arg(long, value_name = "TIME", value_parser = parse_filter)]
    filter: Option<Filter>,
    /// Leave out cells whose light falls on an end of the detector
    #[arg(long)]
    without_clipped: bool,
    #[command(flatten)]
    tier: TierOptions,
}

impl PoseOptions {
    /// The format to write in; `live` tells whether somebody looks.
    pub(super) fn format(&self, live: bool) -> Format {
        self.format_or(if live { Format::Summary } else { Format::Ndjson })
    }

    /// The format that was asked for.
    pub(super) fn asked_format(&self) -> Option<Format> {
        self.format
    }

    /// The format to write in, `usual` unless one was asked for.
    pub(super) fn format_or(&self, usual: Format) -> Format {
        self.format.unwrap_or(usual)
    }

    /// The sink of `format`. Says so if that leaves out what was asked for.
    pub(super) fn open_sink<'a>(
        &self,
        format: Format,
        output: impl Write + Send + 'a,
        live: bool,
    ) -> Option<Box<dyn Sink + Send + 'a>> {
        if format == Format::Csv && matches!(self.filter, Some(Filter(Some(_)))) {
            talk(format_args!("--filter: CSV has no columns for the filtered pose; --format ndjson has it"));
        }
        sink::open(format, output, live)
    }

    /// How scans are followed.
    pub(super) fn following(&self) -> Following {
        self.following_or(None)
    }

    /// How scans are followed: as they were, unless asked otherwise.
    pub(super) fn following_or(&self, recorded: Option<Following>) -> Following {
        let recorded = recorded.unwrap_or_default();
        Following {
            filter_s: match self.filter {
                Some(Filter(filter_s)) => filter_s,
                None => recorded.filter_s,
            },
            without_clipped: self.without_clipped || recorded.without_clipped,
        }
    }

    /// The tier to solve in.
    pub(super) fn tier(&self) -> Tier {
        self.tier_or(None)
    }

    /// The tier to solve in: as it was, unless asked otherwise.
    pub(super) fn tier_or(&self, recorded: Option<Tier>) -> Tier {
        self.tier.tier_or(recorded.unwrap_or(Tier::Exact { tolerance: DEFAULT_TOLERANCE }))
    }
}

/// Memory of the filter, seconds; `None`: no filter.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Filter(Option<f64>);

fn parse_filter(text: &str) -> Result<Filter, String> {
    Ok(Filter(if text == "off" { None } else { Some(parse_duration(text)?) }))
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
}

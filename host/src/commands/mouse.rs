//! The tool as a 6-DoF mouse, as `run` offers it.

use std::path::PathBuf;

use slitpose_head::scene_file::Workspace;

use super::options::parse_number;
use super::{CommandError, talk};
use crate::spacenav::{Axes, Feel, SpacenavServer};

/// The mouse asked for.
#[derive(clap::Args, Debug)]
pub(super) struct MouseOptions {
    /// Serve the tool as a 6-DoF mouse, as spacenavd does, at this socket; programs find it by SPNAV_SOCKET=PATH, or at
    /// /var/run/spnav.sock
    #[arg(long, value_name = "PATH")]
    spacenav: Option<PathBuf>,
    /// Full deflections at the edge of the workspace
    #[arg(long, value_name = "GAIN", default_value_t = 1.0, value_parser = parse_gain)]
    spacenav_gain: f64,
    /// Share of the workspace around zero in which an axis gives nothing
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, value_parser = parse_share)]
    spacenav_dead_zone: f64,
    /// Axes of the base that point to the right, up, and into the screen
    #[arg(long, value_name = "AXES", default_value = "x,z,y", allow_hyphen_values = true)]
    spacenav_axes: Axes,
}

impl MouseOptions {
    /// Serves the mouse, if asked, for a tool in `workspace`.
    pub(super) fn start(&self, workspace: Workspace) -> Result<Option<SpacenavServer>, CommandError> {
        let Some(path) = &self.spacenav else { return Ok(None) };
        let feel = Feel { gain: self.spacenav_gain, dead_zone: self.spacenav_dead_zone, axes: self.spacenav_axes };
        let server = SpacenavServer::start(path, feel, workspace)?;
        talk(format_args!("6-DoF mouse at {}", path.display()));
        Ok(Some(server))
    }
}

fn parse_gain(text: &str) -> Result<f64, &'static str> {
    parse_number(text, |gain| gain > 0.0 && gain <= 1e3, "give a number above 0, such as 1 or 2.5")
}

fn parse_share(text: &str) -> Result<f64, &'static str> {
    parse_number(text, |share| (0.0..=0.9).contains(&share), "give a number from 0 to 0.9, such as 0.05")
}

//! The tool as a 6-DoF mouse, for programs that use libspnav: Blender, FreeCAD, and others.
//!
//! Such programs connect to the Unix socket of spacenavd. This is its protocol of version 0, which all of them speak; a
//! client that asks for a later one is told so. A message to a client is an event of eight 32-bit integers in the host's byte
//! order: kind (0: motion), x, y, z, rx, ry, rz, and the milliseconds since the event before. A message of a client is a
//! 32-bit float, its sensitivity, or the request for another version, `0x7faa5500 | version`, which has an answer of the
//! same form. (Source: `proto.h`, `spnav.c` of libspnav 1.1.)
//!
//! Displacement from the zero pose gives the rate, as that of a 6-DoF mouse does: at rest, at zero, or without a pose
//! nothing moves.

mod server;

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use slitpose_head::scene_file::Workspace;
use slitpose_model::{Pose, rotation_log};
use thiserror::Error;

pub(crate) use server::{SpacenavInput, SpacenavServer};

/// Full deflection of the usual devices: ±350 steps.
const FULL: f64 = 350.0;

/// Which axes of the base point to the right, up, and into the screen, as libspnav's users take the three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axes([(usize, f64); 3]);

/// A text that does not name three axes.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{text}` does not name x, y and z once each; give the axes to the right, up and into the screen, such as x,z,y or y,z,-x"
)]
pub(crate) struct AxesError {
    pub text: String,
}

impl FromStr for Axes {
    type Err = AxesError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || AxesError { text: text.to_owned() };
        let axis = |name: &str| {
            let (sign, name) = name.strip_prefix('-').map_or((1.0, name), |name| (-1.0, name));
            ["x", "y", "z"].iter().position(|axis| *axis == name).map(|axis| (axis, sign))
        };
        let axes: Option<Vec<_>> = text.split(',').map(|name| axis(name.trim())).collect();
        let axes: [(usize, f64); 3] = axes.and_then(|axes| axes.try_into().ok()).ok_or_else(error)?;
        let mut named = axes.map(|(axis, _)| axis);
        named.sort_unstable();
        if named == [0, 1, 2] { Ok(Self(axes)) } else { Err(error()) }
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names =
            self.0.map(|(axis, sign)| format!("{}{}", if sign < 0.0 { "-" } else { "" }, ["x", "y", "z"][axis]));
        f.write_str(&names.join(","))
    }
}

/// How the tool feels as a mouse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Feel {
    /// Full deflections at the edge of the workspace.
    pub gain: f64,
    /// Share of the workspace around zero in which an axis gives nothing, 0 to 1.
    pub dead_zone: f64,
    pub axes: Axes,
}

impl Feel {
    /// The motion of a tool at `pose`, relative to `zero`, in steps.
    fn motion(&self, workspace: &Workspace, zero: &Pose, pose: &Pose) -> [i32; 6] {
        let moved = (pose.translation_m - zero.translation_m) / workspace.half_extent_m;
        let turned = rotation_log(pose.rotation * zero.rotation.inverse()) / workspace.half_extent_rad;
        let [x, y, z] = self.axes.0.map(|(axis, sign)| sign * self.shaped(moved, axis));
        // A mirrored frame turns the other way round: in one that is left-handed, a rotation about the axis to the right has
        // the sign that its users expect of the device.
        let [rx, ry, rz] = self.axes.0.map(|(axis, sign)| sign * self.shaped(turned, axis));
        [x, y, z, rx, ry, rz].map(|value| value.round() as i32)
    }

    fn shaped(&self, deflection: DVec3, axis: usize) -> f64 {
        // A workspace without extent along an axis has no motion along it.
        let deflection = Some(deflection[axis]).filter(|value| value.is_finite()).unwrap_or(0.0);
        let beyond = (deflection.abs() - self.dead_zone).max(0.0) / (1.0 - self.dead_zone);
        (FULL * self.gain * beyond).min(FULL).copysign(deflection)
    }
}

#[cfg(test)]
mod tests;

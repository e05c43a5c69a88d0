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

mod motion;
mod server;

pub(crate) use motion::{Axes, Feel};
pub(crate) use server::{SpacenavError, SpacenavInput, SpacenavServer};
#[cfg(test)]
mod tests;

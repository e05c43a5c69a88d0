//! Poses for other programs by their own protocols: 6-DoF mice.

mod spacenav;

pub(crate) use spacenav::{Axes, Feel, SpacenavInput, SpacenavServer};

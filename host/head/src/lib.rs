//! Sensor heads, and their simulation.
//!
//! * [`scene_file`] reads descriptions of heads;
//! * [`front_end`] converts counts to currents;
//! * [`simulator`] is a simulated board;
//! * [`table`] reads and writes CSV, and writes results;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`finding`] states a fault and its remedy;
//! * [`foreign`] escapes text of others for a terminal;
//! * [`special_file`] opens pipes and devices, [`replacement`] makes files that replace others when complete;
//! * [`interrupt`] handles Ctrl-C, [`threads`] panics of other threads.
//!
//! Inside, everything is SI. Millimetres and degrees appear in scene files, with the unit in the name.

#![forbid(unsafe_code)]

pub mod finding;
pub mod foreign;
pub mod front_end;
pub mod interrupt;
pub mod pace;
pub mod replacement;
pub mod scene_file;
pub mod simulator;
pub mod special_file;
pub mod table;
pub mod threads;

//! Sensor heads, and their simulation.
//!
//! * [`scene_file`] reads descriptions of heads;
//! * [`front_end`] converts counts to currents;
//! * [`simulator`] is a simulated board;
//! * [`table`] reads and writes CSV, and writes results;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`faults`] injects faults into boards, heads and links;
//! * [`finding`] states a fault and its remedy;
//! * [`foreign`] escapes text of others for a terminal;
//! * [`text_file`] opens texts, [`special_file`] pipes and devices for writing, [`replacement`] makes files that replace others when complete;
//! * [`interrupt`] handles Ctrl-C, [`threads`] panics of other threads, and work on all cores.
//!
//! [`platform`] has what differs between operating systems.
//!
//! Internally all units are SI. Millimetres and degrees appear in scene files, with the unit in the name.

#![forbid(unsafe_code)]

pub mod board_head;
pub mod causes;
pub mod faults;
pub mod finding;
pub mod foreign;
pub mod front_end;
pub mod interrupt;
pub mod pace;
pub mod platform;
pub mod replacement;
pub mod scene_file;
pub mod simulator;
pub mod special_file;
pub mod table;
pub mod text_file;
pub mod threads;

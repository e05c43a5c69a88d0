//! What a sensor head is, and how to fake one.
//!
//! * [`scene_file`] reads what describes a head;
//! * [`front_end`] stands between counts and currents;
//! * [`simulator`] is a board made of arithmetic;
//! * [`table`] reads and writes CSV, and is where results go;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`finding`] is what is wrong and what to do about it;
//! * [`foreign`] makes text of others fit for a terminal;
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

//! The host's side of a slit-and-detector tracker: scenes, tables, pictures and commands around
//! the optics of [`slitpose_model`].
//!
//! * [`scene_file`] reads what describes a sensor head;
//! * [`clock`] reads the clocks of the host;
//! * [`device`] carries bytes to boards and back, and speaks with them;
//! * [`front_end`] stands between counts and currents;
//! * [`identification`] finds an emitter's profile from currents;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`paper`] calculates the source paper's experiments;
//! * [`pipeline`] turns bytes into poses;
//! * [`plot`] draws;
//! * [`report`] studies error against run time;
//! * [`simulator`] is a board made of arithmetic;
//! * [`sink`] is where poses go;
//! * [`survey`] tells what a scene can do;
//! * [`table`] reads and writes CSV, and is where results go;
//! * [`commands`] has one file for each verb of the `slitpose` command.
//!
//! Inside, everything is SI. Millimetres and degrees appear in scene files, on the command line
//! and in pictures, with the unit in the name.

#![forbid(unsafe_code)]

pub mod clock;
pub mod commands;
pub mod device;
pub mod front_end;
pub mod identification;
pub mod pace;
pub mod paper;
pub mod pipeline;
pub mod plot;
pub mod report;
pub mod scene_file;
pub mod simulator;
pub mod sink;
pub mod survey;
pub mod table;

//! What the designer of a sensor head asks before anything is built.
//!
//! * [`survey`] tells what a scene can do;
//! * [`plot`] draws;
//! * [`paper`] calculates the source paper's experiments;
//! * [`identification`] finds an emitter's profile from currents;
//! * [`report`] studies error against run time.

#![forbid(unsafe_code)]

pub mod identification;
pub mod paper;
pub mod plot;
pub mod report;
pub mod survey;

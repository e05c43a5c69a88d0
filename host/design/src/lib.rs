//! Tools for the designer of a sensor head.
//!
//! * [`survey`] shows what a scene can do;
//! * [`map`] shows how accurate it is, and where;
//! * [`optimise`] looks for the best one within bounds;
//! * [`plot`] draws;
//! * [`paper`] calculates the source paper's experiments;
//! * [`identification`] finds an emitter's profile from currents;
//! * [`report`] studies error against run time.

#![forbid(unsafe_code)]

pub mod identification;
pub mod map;
pub mod optimise;
pub mod paper;
pub mod plot;
pub mod report;
pub mod survey;

pub use plot::{MaskFrame, mask_half_extents_m};

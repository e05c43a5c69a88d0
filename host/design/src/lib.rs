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

use slitpose_head::front_end::TimingError;
use slitpose_head::scene_file::SceneFileError;
use slitpose_model::SceneError;
use thiserror::Error;

pub use plot::{MaskFrame, mask_half_extents_m};

/// Why a head cannot be studied, or not be optimised.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum DesignError {
    #[error(transparent)]
    File(#[from] SceneFileError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Timing(#[from] TimingError),
    #[error("{0}")]
    Poses(String),
    #[error(
        "nothing is free to change; give each with --free, such as --free slit_width --free roll: {}",
        optimise::Quantity::names()
    )]
    NothingFree,
    #[error("{0}{1}")]
    Text(String, String),
}

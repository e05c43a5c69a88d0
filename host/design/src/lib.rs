//! Tools for the designer of a sensor head.
//!
//! * [`survey`] shows what a scene can do;
//! * [`map`] shows how accurate it is, and where;
//! * [`optimise`] looks for the best one within bounds;
//! * [`plot`] draws;
//! * [`paper`] calculates the source paper's experiments;
//! * [`identification`] finds an emitter's profile from currents;
//! * [`report`] studies error against run time.
//!
//! # Example
//! A head whose detectors all lie in the plane of the ring does not see motion out of that plane:
//! ```
//! use slitpose_design::survey::Survey;
//! use slitpose_head::scene_file::{SceneFile, WIDE};
//!
//! let rolled = Survey::of(&WIDE.read()?, 1000, |_| ())?;
//! assert_eq!((rolled.free_at_home.as_str(), rolled.mirror_images), ("", false));
//!
//! let mut flat = SceneFile::parse("flat.toml", WIDE.text)?;
//! for cell in &mut flat.scene.cells {
//!     let detector = &mut cell.detector;
//!     detector.x_axis_base.z = 0.0;
//!     detector.x_axis_base = detector.x_axis_base.normalize();
//! }
//! let flat = Survey::of(&flat, 1000, |_| ())?;
//! assert_eq!((flat.free_at_home.as_str(), flat.mirror_images), ("tz;rx;ry", true));
//! assert_eq!(flat.warnings[0].place, "home");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod identification;
pub mod map;
pub mod optimise;
pub mod paper;
pub mod plot;
pub mod report;
pub mod survey;

pub use plot::{MaskFrame, mask_half_extents_m};

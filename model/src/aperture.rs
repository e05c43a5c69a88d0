//! The slit in the mask, compiled: the faces that bound the beam.
//!
//! Cell frame, metres. Positions on the detector are kept relative to the emitter's foot point
//! (x − e_x, y − e_y): the optics depend on nothing else, and a far emitter causes no cancellation.

use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::pose::rotation_exp;
use crate::scalar::{Linear3, Number, Vector3};
use crate::scene::Slit;

#[derive(Clone, Debug)]
pub enum Aperture<S: Number> {
    /// A thin mask, slit sides parallel to the detector's.
    Thin(Face<S>),
    /// A thick mask, slit sides parallel to the detector's: lower and upper face.
    Thick(Face<S>, Face<S>),
    /// A slit rotated relative to the detector; the two faces of a thin mask coincide.
    Turned(Turned<S>),
    /// That of a cell with effects, by its number among those.
    Imperfect(usize),
}

/// A slit face parallel to the detector at height z.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Face<S> {
    pub z: S,
    pub x: Span<S>,
    pub y: Span<S>,
}

/// An interval and its length, stored because the difference of its ends cancels far from the origin.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Span<S> {
    pub low: S,
    pub high: S,
    pub length: S,
}

impl<S: Number> Span<S> {
    pub fn centred(centre: f64, length: f64) -> Self {
        Self { low: S::of(centre - 0.5 * length), high: S::of(centre + 0.5 * length), length: S::of(length) }
    }
}

/// A slit in general orientation.
#[derive(Clone, Debug)]
pub struct Turned<S: Number> {
    /// Corners of the faces, in order around the slit.
    pub faces: [[S::Vec3; 4]; 2],
    /// Number of distinct faces: 1 for a thin mask, else 2.
    pub face_count: usize,
    pub centre: S::Vec3,
    /// Normal of the mask, pointing away from the detector.
    pub normal: S::Vec3,
    pub half_thickness: S,
    /// Weight of the paper tier's definition for a tilted slit: 0 where the slit's sides are parallel to
    /// the detector's, rising to 1 at a rotation of [`TILTED_RAD`].
    pub skew: S,
}

/// Sine of a rotation that is only the rounding of degrees converted to radians.
const PARALLEL: f64 = 1e-14;

/// From this rotation on the paper tier treats a slit as tilted. Below it, the definition of the beam's
/// axis changes smoothly to that of a rectangle. The two differ by up to 3e-4 of the current, which
/// over 0.1° is no steeper than the current's own slope.
const TILTED_RAD: f64 = 0.1 * core::f64::consts::PI / 180.0;

impl<S: Number> Aperture<S> {
    pub fn compile(slit: &Slit) -> Self {
        let axes = DMat3::from_quat(rotation_exp(slit.tilt_rad));
        let centre = DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m);
        // Sine of the rotation from the nearest orientation with sides along x and y.
        let within = axes.x_axis.x.abs().min(axes.x_axis.y.abs());
        let turn = libm::sqrt(axes.z_axis.x * axes.z_axis.x + axes.z_axis.y * axes.z_axis.y + within * within);
        // No rotation beyond rounding, or a multiple of 90° about z: a rectangle.
        if turn <= PARALLEL {
            let is_across = axes.x_axis.y.abs() > axes.x_axis.x.abs();
            let [along_x, along_y] =
                if is_across { [slit.length_m, slit.width_m] } else { [slit.width_m, slit.length_m] };
            return Self::parallel(centre, DVec2::new(along_x, along_y), slit.thickness_m);
        }
        let share = (turn / TILTED_RAD).min(1.0);
        let skew = share * share * (3.0 - 2.0 * share);
        let half_thickness = 0.5 * slit.thickness_m;
        let normal = if axes.z_axis.z < 0.0 { -axes.z_axis } else { axes.z_axis };
        let face = |offset: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(i, j)| {
                S::Vec3::of(
                    centre
                        + normal * offset
                        + axes.x_axis * (0.5 * i * slit.width_m)
                        + axes.y_axis * (0.5 * j * slit.length_m),
                )
            })
        };
        Self::Turned(Turned {
            faces: [face(-half_thickness), face(half_thickness)],
            face_count: if half_thickness > 0.0 { 2 } else { 1 },
            centre: S::Vec3::of(centre),
            normal: S::Vec3::of(normal),
            half_thickness: S::of(half_thickness),
            skew: S::of(skew),
        })
    }

    pub fn skew(&self) -> S {
        match self {
            Self::Turned(turned) => turned.skew,
            Self::Thin(_) | Self::Thick(..) | Self::Imperfect(_) => S::zero(),
        }
    }

    fn parallel(centre: DVec3, size: DVec2, thickness: f64) -> Self {
        let face = |offset: f64| Face {
            z: S::of(centre.z + offset),
            x: Span::centred(centre.x, size.x),
            y: Span::centred(centre.y, size.y),
        };
        if thickness > 0.0 { Self::Thick(face(-0.5 * thickness), face(0.5 * thickness)) } else { Self::Thin(face(0.0)) }
    }

    /// The corners of the faces that bound the beam, for [`crate::polygon`].
    pub fn corners(&self) -> heapless::Vec<[S::Vec3; 4], 2> {
        let of_face = |face: &Face<S>| {
            [
                S::Vec3::new(face.x.low, face.y.low, face.z),
                S::Vec3::new(face.x.high, face.y.low, face.z),
                S::Vec3::new(face.x.high, face.y.high, face.z),
                S::Vec3::new(face.x.low, face.y.high, face.z),
            ]
        };
        match self {
            Self::Thin(face) => [of_face(face)].into_iter().collect(),
            Self::Thick(lower, upper) => [of_face(lower), of_face(upper)].into_iter().collect(),
            Self::Turned(turned) => turned.faces[..turned.face_count].iter().copied().collect(),
            Self::Imperfect(_) => heapless::Vec::new(),
        }
    }
}

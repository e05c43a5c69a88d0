//! The slit in the mask, compiled: the faces that bound the beam.
//!
//! Cell frame, metres. Positions on the detector are kept relative to the emitter's foot point
//! (x − e_x, y − e_y): the optics depend on nothing else, and a far emitter causes no cancellation.

use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::pose::rotation_exp;
use crate::scalar::{Number, Vector3};
use crate::scene::Slit;

#[derive(Clone, Debug)]
pub enum Aperture<S: Number> {
    /// A thin mask, slit sides parallel to the detector's.
    Thin(Face<S>),
    /// A thick mask, slit sides parallel to the detector's: lower and upper face.
    Thick(Face<S>, Face<S>),
    /// A slit rotated relative to the detector; the two faces of a thin mask coincide.
    Turned(Turned<S>),
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
    /// See [`slit_edges`].
    pub edges: [[[S::Vec3; 2]; 4]; 2],
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

/// Of both faces of a slit around `centre` in a mask with this `normal` a place on each edge and the edge's direction, in
/// order around it from an end: (place − emitter)×direction is the normal of the plane through both, towards the slit.
pub fn slit_edges<S: Number>(slit: &Slit, centre: DVec3, normal: DVec3, axes: DMat3) -> [[[S::Vec3; 2]; 4]; 2] {
    let (across, along) = (axes.x_axis, axes.y_axis);
    let outward = [(-along, slit.length_m), (across, slit.width_m), (along, slit.length_m), (-across, slit.width_m)];
    [-0.5, 0.5].map(|side| {
        let middle = centre + normal * (side * slit.thickness_m);
        outward.map(|(outward, size)| [middle + outward * (0.5 * size), outward.cross(normal)].map(S::Vec3::of))
    })
}

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
        Self::Turned(Turned {
            edges: slit_edges::<S>(slit, centre, normal, axes),
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
            Self::Thin(_) | Self::Thick(..) => S::zero(),
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
}

//! What an emitter has beyond its place, axis and profile: an extent, and an azimuth.

use crate::effects::{AZIMUTHAL_TERMS, Effects};
use crate::scalar::{Linear3, Number, Real, Vector3};

/// What an emitter has beyond its place, axis and profile; one per lane.
#[derive(Clone, Debug)]
pub struct ExtendedSource<R: Real> {
    /// Directions v and w across the axis, tool frame.
    pub across: [R::Vec3; 2],
    /// Coefficients of v² − w², 2vw, zv, zw; `None`: the profile has no azimuth.
    pub azimuthal: Option<[R; AZIMUTHAL_TERMS]>,
    /// Radius of the points of the source around its centre, metres; zero: a point.
    pub radius: R,
}

/// Points around the centre of a disc, in units of √⅔ of its radius: with the weights ⅛ and ¼ for the centre the rule
/// is exact to the fifth degree (Radon 1948).
pub const RING: [[f64; 2]; 6] = [
    [1.0, 0.0],
    [0.5, 0.866_025_403_784_438_6],
    [-0.5, 0.866_025_403_784_438_6],
    [-1.0, 0.0],
    [-0.5, -0.866_025_403_784_438_6],
    [0.5, -0.866_025_403_784_438_6],
];
pub const RING_WEIGHT: f64 = 0.125;
pub const CENTRE_WEIGHT: f64 = 0.25;

/// √⅔.
const RING_RADIUS: f64 = 0.816_496_580_927_726;

impl<S: Number> ExtendedSource<S> {
    pub fn compile(axis: glam::DVec3, effects: &Effects) -> Self {
        let reference = if axis.z.abs() > core::f64::consts::FRAC_1_SQRT_2 { glam::DVec3::X } else { glam::DVec3::Z };
        let v = (reference - axis * axis.dot(reference)).normalize_or_zero();
        let azimuthal = effects.profile.azimuthal;
        Self {
            across: [v, axis.cross(v)].map(S::Vec3::of),
            azimuthal: (azimuthal != [0.0; AZIMUTHAL_TERMS]).then(|| azimuthal.map(S::of)),
            radius: S::of(0.5 * RING_RADIUS * effects.source_diameter_m),
        }
    }
}

/// The factor 1 + Σ azimuthal of the ray along the unit vector `ray`, with the axes v, w and u of the emitter, and its
/// derivatives by the components of the ray along them, as one vector.
#[inline(always)]
pub fn azimuthal_factor<R: Real>(
    coefficients: &[R; AZIMUTHAL_TERMS],
    [v_axis, w_axis, axis]: [R::Vec3; 3],
    ray: R::Vec3,
) -> (R, R::Vec3) {
    let (v, w) = (v_axis.dot(ray), w_axis.dot(ray));
    let one = v.constant(1.0);
    let two = one + one;
    let z = one - axis.dot(ray);
    let [squares, product, along_v, along_w] = *coefficients;
    let value = one + squares * (v * v - w * w) + product * two * v * w + z * (along_v * v + along_w * w);
    let by_v = two * (squares * v + product * w) + z * along_v;
    let by_w = two * (product * v - squares * w) + z * along_w;
    let by_u = -(along_v * v + along_w * w);
    (value, v_axis * by_v + w_axis * by_w + axis * by_u)
}

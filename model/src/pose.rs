//! Where the tool is, and how fast it moves.
//!
//! Transforms are named `a_from_b`; a pose is `base_from_tool`: p_base = R·p_tool + t.
//! Perturbations follow the convention of the covariance: t' = t + δt, R' = exp(δθ)·R, both in
//! the base frame and independent of each other.

use glam::{DMat3, DQuat, DVec3};

use crate::scalar::{Scalar, Vector3};

/// A rigid transform, `f64`: rotation as a unit quaternion and translation in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// R, unit quaternion (components x, y, z, w).
    pub rotation: DQuat,
    /// t, metres.
    pub translation_m: DVec3,
}

impl Pose {
    /// Tool frame and base frame coincide: the home pose of every scene.
    pub const HOME: Self = Self { rotation: DQuat::IDENTITY, translation_m: DVec3::ZERO };

    /// From a translation in metres and a rotation vector in radians.
    pub fn from_vectors(translation_m: DVec3, rotation_rad: DVec3) -> Self {
        Self { rotation: rotation_exp(rotation_rad), translation_m }
    }

    /// The rotation as a rotation vector of length ≤ π, radians.
    pub fn rotation_rad(&self) -> DVec3 {
        rotation_log(self.rotation)
    }

    /// This pose with a small displacement of translation and rotation, in the base frame:
    /// t + δt, exp(δθ)·R.
    pub fn perturbed(&self, translation_m: DVec3, rotation_rad: DVec3) -> Self {
        Self {
            rotation: (rotation_exp(rotation_rad) * self.rotation).normalize(),
            translation_m: self.translation_m + translation_m,
        }
    }

    /// The displacement that leads from `other` to this pose:
    /// (t − t', log(R R'ᵀ)), metres and radians. The inverse of [`Self::perturbed`].
    pub fn displacement_from(&self, other: &Self) -> (DVec3, DVec3) {
        (self.translation_m - other.translation_m, rotation_log(self.rotation * other.rotation.conjugate()))
    }

    /// Whether every component is a finite number.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation_m.is_finite()
    }
}

/// Velocity of the tool in the base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Of the tool frame's origin, m/s.
    pub linear_m_per_s: DVec3,
    /// Angular velocity, rad/s.
    pub angular_rad_per_s: DVec3,
}

impl Twist {
    /// The pose after `duration_s` of this constant velocity.
    pub fn advance(&self, pose: &Pose, duration_s: f64) -> Pose {
        pose.perturbed(self.linear_m_per_s * duration_s, self.angular_rad_per_s * duration_s)
    }
}

/// Quaternion of a rotation vector, exact to rounding for any length.
pub fn rotation_exp(rotation_rad: DVec3) -> DQuat {
    let angle = rotation_rad.length();
    let half = 0.5 * angle;
    // sin(x)/x is 1 to rounding below x = 1e-8.
    let scale = if half < 1e-8 { 0.5 } else { libm::sin(half) / angle };
    let v = rotation_rad * scale;
    DQuat::from_xyzw(v.x, v.y, v.z, libm::cos(half)).normalize()
}

/// Rotation vector of a unit quaternion, of length ≤ π, exact to rounding also near 0 and π.
pub fn rotation_log(rotation: DQuat) -> DVec3 {
    // q and −q are the same rotation; w ≥ 0 selects the shorter way.
    let q = if rotation.w < 0.0 { -rotation } else { rotation };
    let v = DVec3::new(q.x, q.y, q.z);
    let sine = v.length();
    if sine == 0.0 {
        return DVec3::ZERO;
    }
    v * (2.0 * libm::atan2(sine, q.w) / sine)
}

/// A pose as the hot path wants it: rotation matrix and translation in the plan's number type.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transform<S: Scalar> {
    columns: [S::Vec3; 3],
    translation: S::Vec3,
}

impl<S: Scalar> Transform<S> {
    pub(crate) fn of(pose: &Pose) -> Self {
        let m = DMat3::from_quat(pose.rotation);
        Self { columns: [m.x_axis, m.y_axis, m.z_axis].map(S::Vec3::of), translation: S::Vec3::of(pose.translation_m) }
    }

    #[inline(always)]
    pub(crate) fn rotate(&self, v: S::Vec3) -> S::Vec3 {
        self.columns[0] * v.x() + self.columns[1] * v.y() + self.columns[2] * v.z()
    }

    /// This transform after a small displacement in the base frame. The rotation is Cayley's,
    /// R(a) = I + 2/(1+a²)·([a]ₓ + [a]ₓ²) with a = δθ/2: orthogonal like the exponential, equal to
    /// it up to |δθ|³/12, and free of trigonometry.
    #[inline]
    pub(crate) fn moved(&self, translation_m: S::Vec3, rotation_rad: S::Vec3) -> Self {
        let a = rotation_rad * S::half();
        let factor = S::two() / (S::one() + a.dot(a));
        let turn = |v: S::Vec3| {
            let across = a.cross(v);
            v + (across + a.cross(across)) * factor
        };
        Self { columns: self.columns.map(turn), translation: self.translation + translation_m }
    }

    /// Back to a pose; the rotation is normalised.
    pub(crate) fn to_pose(self) -> Pose {
        let [x, y, _] = self.columns.map(S::Vec3::as_dvec3);
        // Gram–Schmidt: what single precision left of orthogonality is not the rotation's fault.
        let x = x.normalize();
        let y = (y - x * x.dot(y)).normalize();
        let z = x.cross(y);
        Pose {
            rotation: DQuat::from_mat3(&DMat3::from_cols(x, y, z)).normalize(),
            translation_m: self.translation.as_dvec3(),
        }
    }

    #[inline(always)]
    pub(crate) fn translation(&self) -> S::Vec3 {
        self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;

    #[test]
    fn exp_and_log_are_inverse_from_zero_to_pi() {
        let axis = DVec3::new(0.36, -0.48, 0.8);
        for angle in [0.0, 1e-300, 1e-12, 1e-8, 1e-4, 1.0, 3.0, PI - 1e-4, PI - 1e-12] {
            let back = rotation_log(rotation_exp(axis * angle));
            // Rounding of the quaternion's components: a few units in the last place of π.
            assert!((back - axis * angle).length() <= 2e-15 * (1.0 + angle), "{angle}: {back}");
        }
    }

    #[test]
    fn a_displacement_leads_back() {
        let a = Pose::from_vectors(DVec3::new(1e-3, 2e-3, -4e-3), DVec3::new(0.2, -0.1, 3.0));
        let (dt, dr) = (DVec3::new(-2e-3, 0.0, 1e-4), DVec3::new(0.3, 0.2, -0.1));
        let (t, r) = a.perturbed(dt, dr).displacement_from(&a);
        assert!((t - dt).length() < 1e-17 && (r - dr).length() < 1e-15);
    }
}

//! Pose and velocity of the tool.
//!
//! Transforms are named `a_from_b`; a pose is `base_from_tool`: p_base = R·p_tool + t.
//! Perturbations, and hence covariances, follow t' = t + δt, R' = exp(δθ)·R, both in the base
//! frame and independent of each other.

use glam::{DQuat, DVec3};

use crate::scalar::{Linear3, Number, Real, Vector3, array, zero_half_one};

/// A rigid transform, `f64`: rotation as a unit quaternion and translation in metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// R, unit quaternion (components x, y, z, w).
    pub rotation: DQuat,
    /// t, metres.
    pub translation_m: DVec3,
}

impl Pose {
    /// The home pose of every scene: tool frame and base frame coincide.
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

    /// The displacement from `other`, (R', t'), to this pose: (t − t', log(R·R'ᵀ)), metres and radians.
    /// The inverse of [`Self::perturbed`].
    ///
    /// ```
    /// use glam::DVec3;
    /// use slitpose_model::Pose;
    ///
    /// let pose = Pose::from_vectors(DVec3::X, DVec3::new(0.0, 0.0, 1.5));
    /// let moved = pose.perturbed(DVec3::new(0.0, 1e-3, 0.0), DVec3::new(0.1, 0.0, 0.0));
    /// let (translation_m, rotation_rad) = moved.displacement_from(&pose);
    /// assert!((translation_m.y - 1e-3).abs() < 1e-15 && (rotation_rad - 0.1 * DVec3::X).length() < 1e-12);
    /// ```
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
    /// Velocity of the tool frame's origin, m/s.
    pub linear_m_per_s: DVec3,
    /// Angular velocity, rad/s.
    pub angular_rad_per_s: DVec3,
}

impl Twist {
    /// The pose after `duration_s` seconds at this constant velocity.
    pub fn advance(&self, pose: &Pose, duration_s: f64) -> Pose {
        pose.perturbed(self.linear_m_per_s * duration_s, self.angular_rad_per_s * duration_s)
    }
}

/// Quaternion of a rotation vector, exact to rounding for any length.
pub fn rotation_exp(rotation_rad: DVec3) -> DQuat {
    DQuat::from_array(exponential::<f64>(rotation_rad)).normalize()
}

/// Rotation vector of a unit quaternion, of length ≤ π, exact to rounding also near 0 and π.
pub fn rotation_log(rotation: DQuat) -> DVec3 {
    logarithm::<f64>(rotation.to_array())
}

/// Up to this square of an angle short series replace functions of the library.
const SMALL: f64 = 1.0 / 64.0;

/// Quaternion (x, y, z, w) of a rotation vector: (v·sin(|v|/2)/|v|, cos(|v|/2)).
fn exponential<S: Number>(rotation_rad: S::Vec3) -> [S; 4] {
    let half = rotation_rad * S::half();
    let square = half.dot(half);
    let (sinc, cosine) = if square <= S::of(SMALL) {
        // sin x/x and cos x: the first terms left out are x¹²/13! and x¹²/12!.
        let sum = |inverses: [f64; 5]| {
            inverses.into_iter().fold(S::one(), |sum, inverse: f64| S::one() - square * S::of(inverse) * sum)
        };
        (
            sum([1.0 / 110.0, 1.0 / 72.0, 1.0 / 42.0, 1.0 / 20.0, 1.0 / 6.0]),
            sum([1.0 / 90.0, 1.0 / 56.0, 1.0 / 30.0, 1.0 / 12.0, 1.0 / 2.0]),
        )
    } else {
        far(square)
    };
    let v = half * sinc;
    [v.x(), v.y(), v.z(), cosine]
}

/// sin x/x and cos x, by x².
#[cold]
#[inline(never)]
fn far<S: Number>(square: S) -> (S, S) {
    let angle = square.root();
    (angle.sine() / angle, angle.cosine())
}

/// Rotation vector of a unit quaternion.
fn logarithm<S: Number>(rotation: [S; 4]) -> S::Vec3 {
    let [x, y, z, w] = rotation;
    let v = <S::Vec3 as Linear3<S>>::new(x, y, z);
    // q and −q are the same rotation; w ≥ 0 selects the shorter way.
    let (v, w) = if w < S::zero() { (-v, -w) } else { (v, w) };
    let square = v.dot(v);
    if square <= S::of(SMALL) * (w * w) {
        // 2·arctan(t)/(t·w) of t = |v|/w: the first term left out is t²⁰/21.
        let t2 = square / (w * w);
        let sum = [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0]
            .into_iter()
            .fold(S::of(1.0 / 19.0), |sum, odd: f64| S::of(odd.recip()) - t2 * sum);
        return v * (S::two() * sum / w);
    }
    let sine = v.length();
    v * (S::two() * sine.angle_from(w) / sine)
}

/// A pose in the solver's numbers, without what [`Transform`] keeps besides.
#[derive(Clone, Copy, Debug)]
pub struct Rigid<S: Number> {
    /// Unit quaternion, x, y, z, w.
    rotation: [S; 4],
    translation: S::Vec3,
}

impl<S: Number> Rigid<S> {
    pub fn home() -> Self {
        Self { rotation: [S::zero(), S::zero(), S::zero(), S::one()], translation: S::Vec3::default() }
    }

    /// Translation, and rotation as x, y, z, w.
    pub fn numbers(&self) -> ([S; 3], [S; 4]) {
        let t = self.translation;
        ([t.x(), t.y(), t.z()], self.rotation)
    }

    /// Of [`Self::numbers`].
    pub fn of_numbers(([x, y, z], rotation): ([S; 3], [S; 4])) -> Self {
        Self { rotation, translation: S::Vec3::new(x, y, z) }
    }

    pub fn widened(&self) -> Rigid<f64> {
        Rigid { rotation: self.rotation.map(S::as_f64), translation: self.translation.as_dvec3() }
    }

    pub fn of(pose: &Pose) -> Self {
        Self { rotation: pose.rotation.to_array().map(S::of), translation: S::Vec3::of(pose.translation_m) }
    }

    pub fn to_pose(self) -> Pose {
        Pose { rotation: DQuat::from_array(self.rotation.map(S::as_f64)), translation_m: self.translation.as_dvec3() }
    }

    pub fn to_transform(self) -> Transform<S> {
        Transform::of_parts(self.rotation, self.translation)
    }

    /// As [`Pose::perturbed`].
    pub fn perturbed(&self, translation_m: S::Vec3, rotation_rad: S::Vec3) -> Self {
        let rotation = product(exponential::<S>(rotation_rad), self.rotation);
        let inverse = Real::inverse_root(rotation.iter().fold(S::zero(), |sum, &x| sum + x * x));
        Self { rotation: rotation.map(|x| x * inverse), translation: self.translation + translation_m }
    }

    /// As [`Pose::displacement_from`].
    pub fn displacement_from(&self, other: &Self) -> [S::Vec3; 2] {
        let [x, y, z, w] = other.rotation;
        [self.translation - other.translation, logarithm::<S>(product(self.rotation, [-x, -y, -z, w]))]
    }
}

fn product<S: Number>([ax, ay, az, aw]: [S; 4], [bx, by, bz, bw]: [S; 4]) -> [S; 4] {
    let (a, b) = (<S::Vec3 as Linear3<S>>::new(ax, ay, az), <S::Vec3 as Linear3<S>>::new(bx, by, bz));
    let v = b * aw + a * bw + a.cross(b);
    [v.x(), v.y(), v.z(), aw * bw - a.dot(b)]
}

/// A pose in the plan's number type, the same in all lanes, with its rotation also as a matrix.
#[derive(Clone, Copy, Debug)]
pub struct Transform<R: Real> {
    columns: [R::Vec3; 3],
    /// The same rotation as a unit quaternion, x, y, z, w.
    rotation: [R; 4],
    translation: R::Vec3,
}

impl<R: Real> Transform<R> {
    #[inline(always)]
    pub fn rotate(&self, v: R::Vec3) -> R::Vec3 {
        self.columns[0] * v.x() + self.columns[1] * v.y() + self.columns[2] * v.z()
    }

    #[inline(always)]
    pub fn translation(&self) -> R::Vec3 {
        self.translation
    }

    /// `coefficients`·n·sin θ of the rotation by an angle θ about n, and its derivatives by a small rotation in the base frame.
    #[inline(always)]
    pub fn turn(&self, coefficients: &[R; 3]) -> (R, R::Vec3) {
        let ([x, y, z, w], [a, b, c]) = (self.rotation, *coefficients);
        let (v, of) = (R::Vec3::new(x, y, z), R::Vec3::new(a, b, c));
        // n·sin θ = 2·w·v; by a rotation δ: dv = (w·δ + δ×v)/2, dw = −δ·v/2.
        let along = of.dot(v);
        ((w + w) * along, of * (w * w) - v * along + v.cross(of) * w)
    }

    /// From a quaternion of nearly unit length.
    #[inline(always)]
    pub fn of_parts(quaternion: [R; 4], translation: R::Vec3) -> Self {
        let [x, y, z, w] = quaternion;
        let inverse = Real::inverse_root(x * x + y * y + z * z + w * w);
        let rotation @ [x, y, z, w] = array(inverse, |i| quaternion[i] * inverse);
        let (one, two) = (w.constant(1.0), w.constant(2.0));
        let (x2, y2, z2) = (two * x, two * y, two * z);
        let (xx, yy, zz) = (x * x2, y * y2, z * z2);
        let (xy, xz, yz) = (x * y2, x * z2, y * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        Self {
            columns: [
                R::Vec3::new(one - (yy + zz), xy + wz, xz - wy),
                R::Vec3::new(xy - wz, one - (xx + zz), yz + wx),
                R::Vec3::new(xz + wy, yz - wx, one - (xx + yy)),
            ],
            rotation,
            translation,
        }
    }

    /// This transform after a small displacement in the base frame. The rotation is that of
    /// [`Self::small_turn`]: the quaternion (a, 1), normalised.
    #[inline(always)]
    pub fn moved(&self, translation_m: R::Vec3, rotation_rad: R::Vec3) -> Self {
        let a = rotation_rad * rotation_rad.x().constant(0.5);
        let [x, y, z, w] = self.rotation;
        let v = R::Vec3::new(x, y, z);
        let imaginary = v + a * w + a.cross(v);
        let real = w - a.dot(v);
        Self::of_parts([imaginary.x(), imaginary.y(), imaginary.z(), real], self.translation + translation_m)
    }

    /// The Cayley transform `R(a) = I + 2/(1+a²)·([a]ₓ + [a]ₓ²)` with a = δθ/2: orthogonal like the
    /// exponential, equal to it up to |δθ|³/12, without trigonometric functions.
    #[inline(always)]
    pub fn small_turn(rotation_rad: R::Vec3) -> impl Fn(R::Vec3) -> R::Vec3 {
        let [_, half, one] = zero_half_one(rotation_rad.x());
        let two = half.constant(2.0);
        let a = rotation_rad * half;
        let factor = two / (one + a.dot(a));
        move |v| {
            let across = a.cross(v);
            v + (across + a.cross(across)) * factor
        }
    }
}

impl<S: Number> Transform<S> {
    pub fn of(pose: &Pose) -> Self {
        Self::of_parts(pose.rotation.to_array().map(S::of), S::Vec3::of(pose.translation_m))
    }

    /// This transform in each lane of `like`.
    #[inline(always)]
    pub fn in_all_lanes<R: Real<Element = S>>(&self, like: R) -> Transform<R> {
        Transform {
            columns: self.columns.map(|column| like.splat3(column)),
            rotation: self.rotation.map(|component| like.splat(component)),
            translation: like.splat3(self.translation),
        }
    }

    pub fn is_finite(&self) -> bool {
        let t = self.translation;
        self.rotation.iter().chain(&[t.x(), t.y(), t.z()]).all(|component| component.is_finite())
    }

    pub fn to_pose(self) -> Pose {
        self.to_rigid().to_pose()
    }

    pub fn to_rigid(self) -> Rigid<S> {
        Rigid { rotation: self.rotation, translation: self.translation }
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
    fn light_turns_with_the_sine_about_the_axis() {
        let (axis, angle, coefficients) = (DVec3::new(0.36, -0.48, 0.8), 0.7_f64, [0.3, -0.2, 0.5]);
        let turn = |pose: &Pose| Transform::<f64>::of(pose).turn(&coefficients);
        let pose = Pose::from_vectors(DVec3::ZERO, axis * angle);
        let (value, by) = turn(&pose);
        assert!((value - DVec3::from_array(coefficients).dot(axis) * angle.sin()).abs() < 1e-15);
        for (k, along) in DVec3::AXES.into_iter().enumerate() {
            let at = |step: f64| turn(&pose.perturbed(DVec3::ZERO, along * step)).0;
            // Central difference: the third derivative by h²/6, below 1e-10.
            assert!(((at(1e-5) - at(-1e-5)) / 2e-5 - by[k]).abs() < 1e-9, "{along}");
        }
    }
}

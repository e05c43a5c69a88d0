//! Number types of the optics: `f32` on the board, `f64` on the host, and SIMD lanes ([`crate::lanes`]) for
//! code without branches.
//!
//! Elementary functions come from the `libm` crate on every platform, never from the platform's C
//! library: the same input gives the same pose, bit for bit, on any machine. Vectors are glam's.

use core::fmt::Debug;
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use glam::{DVec3, Vec3};
use num_traits::{Float, FloatConst, NumAssignOps};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A real number, or a SIMD vector of one per lane.
pub trait Real:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Number type of one lane.
    type Element: Number;
    /// Vector of three components.
    type Vec3: Linear3<Self>;
    /// Number of lanes.
    const LANES: usize;

    /// From the number of each lane: as many as `self` has, whose own do not count.
    fn fill_with(self, lane: impl FnMut(usize) -> Self::Element) -> Self;
    /// The number in lane `i`.
    fn lane(self, i: usize) -> Self::Element;
    /// √, within two units in the last place; for SIMD lanes, correctly rounded.
    fn root(self) -> Self;
    /// 1/√ of a positive, normal number, within two units in the last place.
    fn inverse_root(self) -> Self;
    /// Lane by lane: `yes` where a ≥ b, else `no`.
    fn select_ge(a: Self, b: Self, yes: Self, no: Self) -> Self;

    /// Lane by lane: `yes` where a > b, else `no`.
    fn select_gt(a: Self, b: Self, yes: Self, no: Self) -> Self;

    /// [`Self::select_ge`] of vectors.
    #[inline(always)]
    fn select3_ge(a: Self, b: Self, yes: Self::Vec3, no: Self::Vec3) -> Self::Vec3 {
        Self::Vec3::new(
            Self::select_ge(a, b, yes.x(), no.x()),
            Self::select_ge(a, b, yes.y(), no.y()),
            Self::select_ge(a, b, yes.z(), no.z()),
        )
    }

    /// The vector with this number for each component.
    #[inline(always)]
    fn vector(self) -> Self::Vec3 {
        Self::Vec3::new(self, self, self)
    }

    /// |x|, lane by lane.
    #[inline(always)]
    fn magnitude(self) -> Self {
        let zero = self.constant(0.0);
        // Of −0 as of 0.
        Self::select_gt(self, zero, self, zero - self)
    }

    /// The larger of two numbers, lane by lane; `self` where `other` is NaN.
    #[inline(always)]
    fn at_least(self, other: Self) -> Self {
        Self::select_ge(other, self, other, self)
    }

    /// The smaller of two numbers, lane by lane; `self` where `other` is NaN.
    #[inline(always)]
    fn at_most(self, other: Self) -> Self {
        Self::select_ge(self, other, other, self)
    }

    /// The same number in all lanes.
    #[inline(always)]
    fn splat(self, value: Self::Element) -> Self {
        self.fill_with(|_| value)
    }

    /// The same vector in all lanes.
    #[inline(always)]
    fn splat3(self, vector: <Self::Element as Real>::Vec3) -> Self::Vec3 {
        Self::Vec3::new(self.splat(vector.x()), self.splat(vector.y()), self.splat(vector.z()))
    }

    /// The nearest number to a constant, in all lanes.
    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        self.splat(Self::Element::of(value))
    }

    /// The inverse.
    #[inline(always)]
    fn inverse(self) -> Self {
        self.constant(1.0) / self
    }
}

/// `[of(0), of(1), …]`, of which `fill` is no part. Unlike `core::array::from_fn` and `map` it leaves no function of its
/// own behind, which would lack the instructions of wide lanes.
#[inline(always)]
pub fn array<T: Copy, const N: usize>(fill: T, mut of: impl FnMut(usize) -> T) -> [T; N] {
    let mut all = [fill; N];
    for (i, one) in all.iter_mut().enumerate() {
        *one = of(i);
    }
    all
}

/// The first three numbers of the optics, 0, ½ and 1, in the lanes of `like`.
#[inline(always)]
pub fn zero_half_one<R: Real>(like: R) -> [R; 3] {
    [like.constant(0.0), like.constant(0.5), like.constant(1.0)]
}

/// A real number the optics compute with, and the glam vector that goes with it.
pub trait Number:
    Real<Element = Self, Vec3: Vector3<Self>> + Default + Float + FloatConst + NumAssignOps + Serialize + DeserializeOwned
{
    /// Number of terms with which a binomial series in δ ≤ 1/64 reaches this type's precision, for
    /// exponents up to about 3.
    const POWER_TERMS: usize;

    /// The nearest representable number to an `f64`.
    fn of(value: f64) -> Self;

    /// This number as an `f64` (exact).
    fn as_f64(self) -> f64;

    /// This number to a real power.
    fn power(self, exponent: Self) -> Self;

    /// e to this power.
    fn exponential(self) -> Self;

    /// Arc tangent.
    fn arc_tangent(self) -> Self;

    /// Arc cosine.
    fn arc_cosine(self) -> Self;

    /// Cosine.
    fn cosine(self) -> Self;

    /// Sine.
    fn sine(self) -> Self;

    /// Angle of the point (`x`, self), in −π…π.
    fn angle_from(self, x: Self) -> Self;

    /// Significand in 1…2 and exponent of a positive, normal number.
    fn split(self) -> (Self, i32);

    /// √(x² + y²) of lengths, whose squares neither overflow nor underflow.
    #[inline(always)]
    fn norm(x: Self, y: Self) -> Self {
        (x * x + y * y).root()
    }

    /// One half.
    #[inline(always)]
    fn half() -> Self {
        Self::of(0.5)
    }

    /// Two.
    #[inline(always)]
    fn two() -> Self {
        Self::of(2.0)
    }
}

/// The operations on three-component vectors that branch-free optics need.
pub trait Linear3<S>:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<S, Output = Self>
    + Neg<Output = Self>
{
    /// From components.
    fn new(x: S, y: S, z: S) -> Self;
    /// First component.
    fn x(self) -> S;
    /// Second component.
    fn y(self) -> S;
    /// Third component.
    fn z(self) -> S;
    /// Scalar product.
    fn dot(self, other: Self) -> S;
    /// Vector product.
    fn cross(self, other: Self) -> Self;
    /// Euclidean length.
    fn length(self) -> S;
}

/// A three-component vector of one scalar, implemented by glam's types.
pub trait Vector3<S>: Linear3<S> + Default + PartialEq + Serialize + DeserializeOwned {
    /// From an `f64` vector, rounded.
    fn of(value: DVec3) -> Self;
    /// To an `f64` vector (exact).
    fn as_dvec3(self) -> DVec3;
}

/// 1/√x without a call: a core with single precision in hardware takes 20 cycles for this, 80 for the
/// library's root and a division. The first guess halves the exponent (Lomont 2003) and is right to
/// five bits; each Newton step doubles their number. Below zero, where there is no root, it is any number.
#[inline(always)]
fn single_inverse_root(x: f32) -> f32 {
    let half = 0.5 * x;
    let mut y = f32::from_bits(0x5f37_59df_u32.wrapping_sub(x.to_bits() >> 1));
    y = y * (1.5 - half * y * y);
    y = y * (1.5 - half * y * y);
    // The last step as a small correction, which keeps its rounding small.
    y + y * (0.5 - half * y * y)
}

/// √x as x·(1/√x); the library's root for zero, subnormal, negative and non-finite x.
#[inline(always)]
fn single_root(x: f32) -> f32 {
    if (f32::MIN_POSITIVE..f32::INFINITY).contains(&x) { x * single_inverse_root(x) } else { libm::sqrtf(x) }
}

macro_rules! implement_scalar {
    ($scalar:ty, $vec3:ty, $terms:expr, [$root:expr, $inverse_root:expr], $as_dvec3:expr, $of_dvec3:expr, [$pow:ident, $exp:ident, $atan:ident, $acos:ident, $cos:ident, $sin:ident, $atan2:ident]) => {
        impl Number for $scalar {
            const POWER_TERMS: usize = $terms;
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $scalar
            }
            #[inline(always)]
            fn as_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn power(self, exponent: Self) -> Self {
                libm::$pow(self, exponent)
            }
            #[inline(always)]
            fn split(self) -> (Self, i32) {
                let bits = self.to_bits();
                let exponent = (bits >> (<$scalar>::MANTISSA_DIGITS - 1)) as i32 - (<$scalar>::MAX_EXP - 1);
                let one = (1.0 as $scalar).to_bits();
                let fraction = bits & ((1 << (<$scalar>::MANTISSA_DIGITS - 1)) - 1);
                (<$scalar>::from_bits(one | fraction), exponent)
            }
            #[inline(always)]
            fn exponential(self) -> Self {
                libm::$exp(self)
            }
            #[inline(always)]
            fn arc_tangent(self) -> Self {
                libm::$atan(self)
            }
            #[inline(always)]
            fn arc_cosine(self) -> Self {
                libm::$acos(self)
            }
            #[inline(always)]
            fn cosine(self) -> Self {
                libm::$cos(self)
            }
            #[inline(always)]
            fn sine(self) -> Self {
                libm::$sin(self)
            }
            #[inline(always)]
            fn angle_from(self, x: Self) -> Self {
                libm::$atan2(self, x)
            }
        }

        impl Real for $scalar {
            type Element = Self;
            type Vec3 = $vec3;
            const LANES: usize = 1;

            #[inline(always)]
            fn fill_with(self, mut lane: impl FnMut(usize) -> Self) -> Self {
                lane(0)
            }
            #[inline(always)]
            fn lane(self, _: usize) -> Self {
                self
            }
            #[inline(always)]
            fn root(self) -> Self {
                $root(self)
            }
            #[inline(always)]
            fn inverse_root(self) -> Self {
                $inverse_root(self)
            }
            #[inline(always)]
            fn select_ge(a: Self, b: Self, yes: Self, no: Self) -> Self {
                if a >= b { yes } else { no }
            }
            #[inline(always)]
            fn select_gt(a: Self, b: Self, yes: Self, no: Self) -> Self {
                if a > b { yes } else { no }
            }
            #[inline(always)]
            fn select3_ge(a: Self, b: Self, yes: $vec3, no: $vec3) -> $vec3 {
                if a >= b { yes } else { no }
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
        }

        impl Linear3<$scalar> for $vec3 {
            #[inline(always)]
            fn new(x: $scalar, y: $scalar, z: $scalar) -> Self {
                <$vec3>::new(x, y, z)
            }
            #[inline(always)]
            fn x(self) -> $scalar {
                self.x
            }
            #[inline(always)]
            fn y(self) -> $scalar {
                self.y
            }
            #[inline(always)]
            fn z(self) -> $scalar {
                self.z
            }
            #[inline(always)]
            fn dot(self, other: Self) -> $scalar {
                <$vec3>::dot(self, other)
            }
            #[inline(always)]
            fn cross(self, other: Self) -> Self {
                <$vec3>::cross(self, other)
            }
            #[inline(always)]
            fn length(self) -> $scalar {
                <$vec3>::length(self)
            }
        }

        impl Vector3<$scalar> for $vec3 {
            #[inline(always)]
            fn of(value: DVec3) -> Self {
                $of_dvec3(value)
            }
            #[inline(always)]
            fn as_dvec3(self) -> DVec3 {
                $as_dvec3(self)
            }
        }
    };
}

implement_scalar!(
    f32,
    Vec3,
    4,
    [single_root, single_inverse_root],
    |v: Vec3| v.as_dvec3(),
    |v: DVec3| v.as_vec3(),
    [powf, expf, atanf, acosf, cosf, sinf, atan2f]
);
implement_scalar!(
    f64,
    DVec3,
    8,
    [Float::sqrt, |x: f64| Float::sqrt(x).recip()],
    |v| v,
    |v| v,
    [pow, exp, atan, acos, cos, sin, atan2]
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_roots_are_right_to_two_units_in_the_last_place() {
        let mut x = f32::MIN_POSITIVE;
        while x < 1e38 {
            let exact = f64::from(x).sqrt();
            assert!((f64::from(x.root()) / exact - 1.0).abs() < 2.0 * f64::from(f32::EPSILON), "{x:e}");
            assert!((f64::from(x.inverse_root()) * exact - 1.0).abs() < 2.0 * f64::from(f32::EPSILON), "{x:e}");
            x *= 1.000_37;
        }
        assert_eq!(0f32.root(), 0.0);
        assert_eq!(f32::INFINITY.root(), f32::INFINITY);
        assert!((-1f32).root().is_nan() && f32::NAN.root().is_nan());
        assert!((1e-42f32.root() / 1e-42f32.sqrt() - 1.0).abs() < 1e-6);
    }
}

//! Two `f64` in one SIMD register.
//!
//! Host processors do two `f64` operations in one instruction. Cells do not depend on each other, so code generic
//! over [`Real`] evaluates one cell or two at once. Both round alike: lanes use only operations that IEEE 754
//! defines to the last bit.

use core::ops::{Add, AddAssign, Mul, Neg, Sub};

use wide::{CmpGe, f64x2};

use crate::scalar::{Linear3, Real};

impl Real for f64x2 {
    type Element = f64;
    type Vec3 = PairVec3;
    const LANES: usize = 2;

    #[inline(always)]
    fn of_lanes(mut lane: impl FnMut(usize) -> f64) -> Self {
        Self::new([lane(0), lane(1)])
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        self.to_array()[i]
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn inverse_root(self) -> Self {
        Self::constant(1.0) / self.sqrt()
    }
    #[inline(always)]
    fn where_at_least(a: Self, b: Self, yes: Self, no: Self) -> Self {
        a.cmp_ge(b).blend(yes, no)
    }
}

/// Three components for each of two lanes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairVec3 {
    x: f64x2,
    y: f64x2,
    z: f64x2,
}

impl Linear3<f64x2> for PairVec3 {
    #[inline(always)]
    fn new(x: f64x2, y: f64x2, z: f64x2) -> Self {
        Self { x, y, z }
    }
    #[inline(always)]
    fn x(self) -> f64x2 {
        self.x
    }
    #[inline(always)]
    fn y(self) -> f64x2 {
        self.y
    }
    #[inline(always)]
    fn z(self) -> f64x2 {
        self.z
    }
    #[inline(always)]
    fn dot(self, other: Self) -> f64x2 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }
    #[inline(always)]
    fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }
    #[inline(always)]
    fn length(self) -> f64x2 {
        self.dot(self).sqrt()
    }
}

impl Add for PairVec3 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl AddAssign for PairVec3 {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for PairVec3 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl Mul<f64x2> for PairVec3 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64x2) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }
}

impl Neg for PairVec3 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z }
    }
}

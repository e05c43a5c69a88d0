//! Two `f64` in one SIMD register.
//!
//! Host processors do two `f64` operations in one instruction. Cells do not depend on each other, so code generic
//! over [`Real`] evaluates one cell or two at once. Both round alike: lanes use only operations that IEEE 754
//! defines to the last bit.

use core::ops::{Add, AddAssign, Mul, Neg, Sub};

use wide::{CmpGe, f64x2};

use crate::scalar::{Linear3, Real};

/// Most lanes of any processor.
#[cfg(feature = "batch")]
pub const MAX_LANES: usize = 8;

/// A number of each lane.
#[cfg(feature = "batch")]
pub type PerLane = [f64; MAX_LANES];

/// Stores the number of each lane.
#[cfg(feature = "batch")]
#[inline(always)]
pub fn set<R: Real<Element = f64>>(numbers: &mut PerLane, of: R) {
    for lane in 0..R::LANES {
        numbers[lane] = of.lane(lane);
    }
}

impl Real for f64x2 {
    type Element = f64;
    type Vec3 = Lanes3<Self>;
    const LANES: usize = 2;

    #[inline(always)]
    fn fill_with(self, mut lane: impl FnMut(usize) -> f64) -> Self {
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
        self.constant(1.0) / self.sqrt()
    }
    #[inline(always)]
    fn select_ge(a: Self, b: Self, yes: Self, no: Self) -> Self {
        a.cmp_ge(b).blend(yes, no)
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

/// Three components for each lane.
#[derive(Clone, Copy, Debug)]
pub struct Lanes3<R> {
    x: R,
    y: R,
    z: R,
}

impl<R: Real> Linear3<R> for Lanes3<R> {
    #[inline(always)]
    fn new(x: R, y: R, z: R) -> Self {
        Self { x, y, z }
    }
    #[inline(always)]
    fn x(self) -> R {
        self.x
    }
    #[inline(always)]
    fn y(self) -> R {
        self.y
    }
    #[inline(always)]
    fn z(self) -> R {
        self.z
    }
    #[inline(always)]
    fn dot(self, other: Self) -> R {
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
    fn length(self) -> R {
        self.dot(self).root()
    }
}

impl<R: Real> Add for Lanes3<R> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<R: Real> AddAssign for Lanes3<R> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<R: Real> Sub for Lanes3<R> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl<R: Real> Mul<R> for Lanes3<R> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: R) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }
}

impl<R: Real> Neg for Lanes3<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z }
    }
}

//! Numbers of as many `f64` lanes as a processor computes with at once.
//!
//! Lanes add, multiply, divide and take roots as IEEE 754 defines to the last bit, and nothing is fused: a lane has the
//! bits that the same operations on single numbers give, whatever the width.

use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use pulp::Simd;
use pulp::bytemuck::{cast_slice, cast_slice_mut};

use crate::scalar::{Linear3, Real};

/// Most lanes of any processor.
pub const MAX_LANES: usize = 8;

/// A number per lane. It carries the right to use the instructions, so that none must be asked for again.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<I: Simd> {
    vector: I::f64s,
    simd: I,
}

impl<I: Simd> Lanes<I> {
    pub fn zero(simd: I) -> Self {
        Self { vector: simd.splat_f64s(0.0), simd }
    }

    #[inline(always)]
    fn with(self, vector: I::f64s) -> Self {
        Self { vector, ..self }
    }
}

impl<I: Simd> Real for Lanes<I> {
    type Element = f64;
    type Vec3 = Lanes3<Self>;
    const LANES: usize = I::F64_LANES;

    #[inline(always)]
    fn fill_with(self, mut lane: impl FnMut(usize) -> f64) -> Self {
        let mut vector = [self.simd.splat_f64s(0.0)];
        for (i, number) in cast_slice_mut::<I::f64s, f64>(&mut vector).iter_mut().enumerate() {
            *number = lane(i);
        }
        self.with(vector[0])
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        cast_slice::<I::f64s, f64>(core::slice::from_ref(&self.vector))[i]
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.with(self.simd.sqrt_f64s(self.vector))
    }
    #[inline(always)]
    fn inverse_root(self) -> Self {
        self.constant(1.0) / self.root()
    }
    #[inline(always)]
    fn select_ge(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let is_ge = a.simd.greater_than_or_equal_f64s(a.vector, b.vector);
        a.with(a.simd.select_f64s(is_ge, yes.vector, no.vector))
    }
    #[inline(always)]
    fn select_gt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let is_gt = a.simd.greater_than_f64s(a.vector, b.vector);
        a.with(a.simd.select_f64s(is_gt, yes.vector, no.vector))
    }
    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        self.with(self.simd.splat_f64s(value))
    }
}

macro_rules! operators {
    ($($operator:ident $method:ident $of_vectors:ident)*) => {
        $(impl<I: Simd> $operator for Lanes<I> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(self.simd.$of_vectors(self.vector, other.vector))
            }
        })*
    };
}

operators! { Add add add_f64s Sub sub sub_f64s Mul mul mul_f64s Div div div_f64s }

impl<I: Simd> AddAssign for Lanes<I> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<I: Simd> Neg for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self.simd.neg_f64s(self.vector))
    }
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

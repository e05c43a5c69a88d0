//! How many `f64` a processor computes with at once, and numbers of so many lanes.
//!
//! Lanes add, multiply, divide and take roots as IEEE 754 defines to the last bit, and nothing is fused: a lane has the
//! bits that the same operations on single numbers give, whatever the width.

use core::fmt::{self, Debug};
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

#[cfg(target_arch = "x86_64")]
use pulp::{
    Simd,
    bytemuck::{cast_slice, cast_slice_mut},
    x86::{V3, V4},
};

use crate::scalar::{Linear3, Real};

/// Most lanes of any processor.
pub const MAX_LANES: usize = 8;

/// A width that this processor has.
#[derive(Clone, Copy)]
pub struct Width(Kind);

#[derive(Clone, Copy)]
enum Kind {
    /// AVX2: four.
    #[cfg(target_arch = "x86_64")]
    Avx2(V3),
    /// AVX-512: eight.
    #[cfg(target_arch = "x86_64")]
    Avx512(V4),
}

impl Width {
    /// The widths that this processor has, narrowest first; none without AVX2.
    pub fn all() -> impl Iterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let all = [V3::try_new().map(Kind::Avx2), V4::try_new().map(Kind::Avx512)];
        #[cfg(not(target_arch = "x86_64"))]
        let all = [None::<Kind>];
        all.into_iter().flatten().map(Self)
    }

    /// The widest.
    pub fn widest() -> Option<Self> {
        Self::all().last()
    }

    /// Cells at once.
    pub fn lanes(self) -> usize {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(_) => 4,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512(_) => 8,
        }
    }
}

/// What is done in lanes, in one function with their instructions.
pub trait Task {
    /// Does it. `#[inline(always)]`, as all that it calls.
    fn run<I: Instructions>(self, instructions: I);
}

impl Width {
    /// Does `task` in lanes of this width.
    #[inline(always)]
    pub fn run(self, task: impl Task) {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(instructions) => Simd::vectorize(instructions, Vectorised(task)),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512(instructions) => Simd::vectorize(instructions, Vectorised(task)),
        }
    }
}

#[cfg(target_arch = "x86_64")]
struct Vectorised<T>(T);

#[cfg(target_arch = "x86_64")]
impl<T: Task> pulp::WithSimd for Vectorised<T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, instructions: S) {
        self.0.run(instructions);
    }
}

impl Debug for Width {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} lanes", self.lanes())
    }
}

/// Instructions for several `f64` at once, which the processor has: who holds one may use them.
pub trait Instructions: Copy + Debug + Send + Sync + 'static {
    type Vector: Copy + Debug + Send + Sync + 'static;
    const LANES: usize;
    fn splat(self, value: f64) -> Self::Vector;
    fn fill_with(self, lane: impl FnMut(usize) -> f64) -> Self::Vector;
    fn lane(vector: &Self::Vector, i: usize) -> f64;
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn neg(self, a: Self::Vector) -> Self::Vector;
    fn sqrt(self, a: Self::Vector) -> Self::Vector;
    fn select_ge(self, a: Self::Vector, b: Self::Vector, yes: Self::Vector, no: Self::Vector) -> Self::Vector;
    fn select_gt(self, a: Self::Vector, b: Self::Vector, yes: Self::Vector, no: Self::Vector) -> Self::Vector;
    fn any_above(self, a: Self::Vector, b: Self::Vector) -> bool;
}

#[cfg(target_arch = "x86_64")]
impl<S: Simd> Instructions for S {
    type Vector = S::f64s;
    const LANES: usize = S::F64_LANES;

    #[inline(always)]
    fn splat(self, value: f64) -> S::f64s {
        self.splat_f64s(value)
    }
    #[inline(always)]
    fn fill_with(self, mut lane: impl FnMut(usize) -> f64) -> S::f64s {
        let mut vector = [self.splat_f64s(0.0)];
        for (i, number) in cast_slice_mut::<S::f64s, f64>(&mut vector).iter_mut().enumerate() {
            *number = lane(i);
        }
        vector[0]
    }
    #[inline(always)]
    fn lane(vector: &S::f64s, i: usize) -> f64 {
        cast_slice::<S::f64s, f64>(core::slice::from_ref(vector))[i]
    }
    #[inline(always)]
    fn add(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.add_f64s(a, b)
    }
    #[inline(always)]
    fn sub(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.sub_f64s(a, b)
    }
    #[inline(always)]
    fn mul(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.mul_f64s(a, b)
    }
    #[inline(always)]
    fn div(self, a: S::f64s, b: S::f64s) -> S::f64s {
        self.div_f64s(a, b)
    }
    #[inline(always)]
    fn neg(self, a: S::f64s) -> S::f64s {
        self.neg_f64s(a)
    }
    #[inline(always)]
    fn sqrt(self, a: S::f64s) -> S::f64s {
        self.sqrt_f64s(a)
    }
    #[inline(always)]
    fn select_ge(self, a: S::f64s, b: S::f64s, yes: S::f64s, no: S::f64s) -> S::f64s {
        self.select_f64s(self.greater_than_or_equal_f64s(a, b), yes, no)
    }
    #[inline(always)]
    fn select_gt(self, a: S::f64s, b: S::f64s, yes: S::f64s, no: S::f64s) -> S::f64s {
        self.select_f64s(self.greater_than_f64s(a, b), yes, no)
    }
    #[inline(always)]
    fn any_above(self, a: S::f64s, b: S::f64s) -> bool {
        self.first_true_m64s(self.greater_than_f64s(a, b)) < S::F64_LANES
    }
}

/// A number per lane. It carries the right to use the instructions, so that none must be asked for again.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<I: Instructions> {
    vector: I::Vector,
    instructions: I,
}

impl<I: Instructions> Lanes<I> {
    #[inline(always)]
    pub fn zero(instructions: I) -> Self {
        Self { vector: instructions.splat(0.0), instructions }
    }

    #[inline(always)]
    fn with(self, vector: I::Vector) -> Self {
        Self { vector, ..self }
    }
}

impl<I: Instructions> Real for Lanes<I> {
    type Element = f64;
    type Vec3 = Lanes3<Self>;
    const LANES: usize = I::LANES;

    #[inline(always)]
    fn fill_with(self, lane: impl FnMut(usize) -> f64) -> Self {
        self.with(self.instructions.fill_with(lane))
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        I::lane(&self.vector, i)
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.with(self.instructions.sqrt(self.vector))
    }
    #[inline(always)]
    fn inverse_root(self) -> Self {
        self.constant(1.0) / self.root()
    }
    #[inline(always)]
    fn select_ge(a: Self, b: Self, yes: Self, no: Self) -> Self {
        a.with(a.instructions.select_ge(a.vector, b.vector, yes.vector, no.vector))
    }
    #[inline(always)]
    fn select_gt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        a.with(a.instructions.select_gt(a.vector, b.vector, yes.vector, no.vector))
    }
    #[inline(always)]
    fn any_above(a: Self, b: Self) -> bool {
        a.instructions.any_above(a.vector, b.vector)
    }
    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        self.with(self.instructions.splat(value))
    }
}

impl<I: Instructions> Add for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(self.instructions.add(self.vector, other.vector))
    }
}

impl<I: Instructions> AddAssign for Lanes<I> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<I: Instructions> Sub for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(self.instructions.sub(self.vector, other.vector))
    }
}

impl<I: Instructions> Mul for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(self.instructions.mul(self.vector, other.vector))
    }
}

impl<I: Instructions> Div for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.with(self.instructions.div(self.vector, other.vector))
    }
}

impl<I: Instructions> Neg for Lanes<I> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self.instructions.neg(self.vector))
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

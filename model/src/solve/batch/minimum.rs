//! What goes into the lanes and what comes out of them, a number per lane.

use crate::lanes::{MAX_LANES, PerLane, array, set};
use crate::pose::{Pose, Rigid, Transform};
use crate::scalar::{Linear3, Real};
use crate::scene::MAX_CELLS;

use super::super::algebra::{Factor, Matrix6};
use super::super::readings::Sorted;

/// The frames to be solved at once.
#[derive(Clone, Debug)]
pub struct Frames {
    pairs: [[PerLane; 2]; MAX_CELLS],
    /// Expected poses: quaternions x, y, z, w, and translations.
    rotations: [PerLane; 4],
    translations: [PerLane; 3],
    /// Which lanes have a frame.
    pub is_present: [bool; MAX_LANES],
}

impl Frames {
    pub fn empty() -> Self {
        Self {
            pairs: [[[0.0; MAX_LANES]; 2]; MAX_CELLS],
            rotations: [[0.0; MAX_LANES]; 4],
            translations: [[0.0; MAX_LANES]; 3],
            is_present: [false; MAX_LANES],
        }
    }

    /// Without frames. What they have left is numbers like any, which lanes without a frame compute with.
    pub fn clear(&mut self) {
        self.is_present = [false; MAX_LANES];
    }

    /// Puts the readings of one frame, all of which count, into `lane`.
    pub fn set(&mut self, lane: usize, sorted: &Sorted<f64>, start: &Pose) {
        self.is_present[lane] = true;
        for reading in &sorted.usable {
            for (numbers, current) in self.pairs[reading.cell].iter_mut().zip(reading.pair) {
                numbers[lane] = current;
            }
        }
        for (numbers, component) in self.rotations.iter_mut().zip(start.rotation.to_array()) {
            numbers[lane] = component;
        }
        for (numbers, component) in self.translations.iter_mut().zip(start.translation_m.to_array()) {
            numbers[lane] = component;
        }
    }

    #[inline(always)]
    pub fn pair<R: Real<Element = f64>>(&self, cell: usize, like: R) -> [R; 2] {
        let [first, second] = &self.pairs[cell];
        [like.fill_with(|lane| first[lane]), like.fill_with(|lane| second[lane])]
    }

    #[inline(always)]
    pub fn start<R: Real<Element = f64>>(&self, like: R) -> Transform<R> {
        let [x, y, z]: [R; 3] = array(like, |i| like.fill_with(|lane| self.translations[i][lane]));
        let rotation = array(like, |i| like.fill_with(|lane| self.rotations[i][lane]));
        Transform::of_parts(rotation, R::Vec3::new(x, y, z))
    }

    /// One in lanes with a frame, else zero.
    #[inline(always)]
    pub fn presence<R: Real<Element = f64>>(&self, like: R) -> R {
        like.fill_with(|lane| if self.is_present[lane] { 1.0 } else { 0.0 })
    }
}

/// The minima that were found.
#[derive(Clone, Debug)]
pub struct Minima {
    /// Whether the frame of a lane took the common course to its end.
    pub is_found: [bool; MAX_LANES],
    rotations: [PerLane; 4],
    translations: [PerLane; 3],
    pub chi2: PerLane,
    pub iterations: PerLane,
    pub evaluations: PerLane,
    /// See [`Problem::least_visible`](super::super::normal_equations::Problem::least_visible).
    pub least_visible: PerLane,
    /// L of the information, its lower half row by row, and 1/L_ii.
    lower: [PerLane; 21],
    inverses: [PerLane; 6],
    /// The inverse of the information, its lower half row by row.
    inverse: [PerLane; 21],
}

/// Where the element (i, j), j ≤ i, of a lower half stands.
const fn place(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

impl Minima {
    pub fn empty() -> Self {
        let none = [0.0; MAX_LANES];
        Self {
            is_found: [false; MAX_LANES],
            rotations: [none; 4],
            translations: [none; 3],
            chi2: none,
            iterations: none,
            evaluations: none,
            least_visible: none,
            lower: [none; 21],
            inverses: [none; 6],
            inverse: [none; 21],
        }
    }

    #[inline(always)]
    pub fn set_pose<R: Real<Element = f64>>(&mut self, pose: &Transform<R>) {
        let t = pose.translation();
        set_each(&mut self.rotations, pose.rotation());
        set_each(&mut self.translations, [t.x(), t.y(), t.z()]);
    }

    #[inline(always)]
    pub fn set_factor<R: Real<Element = f64>>(&mut self, factor: &Factor<R>, inverse: &Matrix6<R>) {
        set_each(&mut self.inverses, factor.inverses());
        for i in 0..6 {
            for j in 0..=i {
                set(&mut self.lower[place(i, j)], factor.lower()[i][j]);
                set(&mut self.inverse[place(i, j)], inverse[i][j]);
            }
        }
    }

    pub fn rigid(&self, lane: usize) -> Rigid<f64> {
        let [x, y, z] = self.translations.each_ref().map(|numbers| numbers[lane]);
        Rigid::of_parts(self.rotations.each_ref().map(|numbers| numbers[lane]), glam::DVec3::new(x, y, z))
    }

    pub fn factor(&self, lane: usize) -> Factor<f64> {
        let lower = |i, j| if j <= i { self.lower[place(i, j)][lane] } else { 0.0 };
        Factor::of_parts(
            core::array::from_fn(|i| core::array::from_fn(|j| lower(i, j))),
            self.inverses.each_ref().map(|numbers| numbers[lane]),
        )
    }

    /// Inverse of the information, in scaled coordinates.
    pub fn inverse(&self, lane: usize) -> Matrix6<f64> {
        core::array::from_fn(|i| core::array::from_fn(|j| self.inverse[place(i.max(j), i.min(j))][lane]))
    }
}

#[inline(always)]
fn set_each<R: Real<Element = f64>, const N: usize>(numbers: &mut [PerLane; N], of: [R; N]) {
    for (numbers, of) in numbers.iter_mut().zip(of) {
        set(numbers, of);
    }
}

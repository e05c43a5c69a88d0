//! Mirror images: other poses that deliver nearly the same currents.
//!
//! The position of its light puts an emitter on a plane, and its current says how far off the slit's
//! middle it is along the slit, but not on which side. Where the planes alone fix the pose there is one
//! answer. Where they do not, an image has some emitters on the other side.

use arrayvec::ArrayVec;

use crate::entries::Scalar;
use crate::plan::{Optics, Plan};
use crate::pose::{Pose, Transform};
use crate::scalar::{Linear3, Number};
use crate::scene::MAX_CELLS;

use super::algebra::{Factor, Matrix6};
use super::compiled::{Compiled, Prior};
use super::levenberg_marquardt::{Minimum, Stopping};
use super::minima::are_distinct;
use super::normal_equations::Workspace;
use super::planes::{PlaneCell, settle};
use super::readings::{Sorted, Usable};
use super::starts;

/// Steps along the softest direction, both ways, each twice as long as the one before.
pub(super) const SOFT_STEPS: usize = 10;

/// The first of them, in radians or its equivalent in translation.
const SOFT_STEP: f64 = 0.03;

/// Least singular value of the planes' derivatives at which they fix a pose: directions of planes and
/// turns are counted in units of one, so that a head of six cells has some 1.4 if its planes are spread
/// evenly.
const FIXED: f64 = 0.1;

/// χ² of an image in noise-free data up to which a head counts as one that has images: between the
/// poses that are looked at, where an image runs into its pose, χ² falls to nothing. Rings of six rolled
/// alike have at most 2e4, alternately by 0.1 rad more and less 7e4; of 24 random heads the least had
/// 3.5e4 and the others 1e5 and more, or none.
const NEAR: f64 = 3e4;

/// Poses of the reach at which the planes are looked at when a scene is compiled, and home.
const LOOKS: usize = 32;

/// Steps that put three emitters on their other sides.
const STEPS: usize = 4;

/// Patterns of sides of three emitters, other than the one that is known.
const PATTERNS: usize = 7;

/// Most images that [`images`] gives: of two sets of three emitters.
pub(super) const IMAGES: usize = 2 * PATTERNS;

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// `minimum` moved along the direction that its data hold least: one of [`SOFT_STEPS`].
    pub(super) fn softened(&self, minimum: &Minimum<S>, index: usize) -> Option<Transform<S>> {
        let (_, direction) = minimum.factor.as_ref()?.singular()[0];
        let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let length = S::of(sign * SOFT_STEP * f64::from(1_u32 << (index / 2)));
        let [shift, turn] = [0, 3].map(|i| S::Vec3::new(direction[i], direction[i + 1], direction[i + 2]));
        Some(minimum.pose.moved(shift * (length * self.length_scale_m), turn * length))
    }
}

impl<S: Scalar> Compiled<S> {
    /// Whether there are images of poses over the reach of the head with as many cells lit as tell a
    /// pose apart from images, if the planes fix it.
    pub(super) fn may_have_images(&self) -> bool {
        let home = Transform::of(&Pose::HOME);
        core::iter::once(home).chain((0..LOOKS).map(starts::spread::<S>)).any(|pose| {
            let sorted = self.seen_at(&pose.to_pose());
            sorted.usable.len() >= <Plan<S> as Optics<S>>::UNIQUE_FROM
                && self.firmness_of_planes(&sorted, &pose) < S::of(FIXED)
                && self.has_image_near(&sorted, &pose)
        })
    }

    /// How firmly the planes of the readings fix `pose`: the least singular value of their derivatives.
    fn firmness_of_planes(&self, sorted: &Sorted<S>, pose: &Transform<S>) -> S {
        let mut matrix: Matrix6<S> = [[S::zero(); 6]; 6];
        for reading in &sorted.usable {
            let (row, _) = self.planes[reading.cell].row(reading, pose, self.length_scale_m);
            for i in 0..6 {
                for j in 0..6 {
                    matrix[i][j] += row[i] * row[j];
                }
            }
        }
        let factor = Factor::of_matrix(&matrix, S::zero(), S::epsilon());
        factor.map_or(S::zero(), |factor| factor.singular()[0].0)
    }

    /// Whether `pose`, which the readings are of, has an image that fits them nearly as well.
    fn has_image_near(&self, sorted: &Sorted<S>, pose: &Transform<S>) -> bool {
        let problem = self.problem(sorted, &Prior::at_rest());
        let (whiteners, workspace) = (problem.whiteners(), &mut Workspace::new());
        let here = problem.minimise(*pose, &whiteners, Stopping::rough(), workspace);
        (0..SOFT_STEPS)
            .map(|index| self.softened(&here, index))
            .chain((0..IMAGES).map(|index| image(&self.planes, &sorted.usable, pose, self.length_scale_m, index)))
            .flatten()
            .any(|start| {
                let there = problem.minimise(start, &whiteners, Stopping::rough(), workspace);
                there.converged && there.chi2 < S::of(NEAR) && are_distinct(&here, &there, self.length_scale_m)
            })
    }
}

/// Three of the `readings` whose emitters are not in `taken` and span the largest triangle.
fn widest<S: Number>(cells: &[PlaneCell<S>], readings: &[Usable<S>], taken: &[usize]) -> Option<[usize; 3]> {
    let numbers = readings.iter().map(|reading| reading.cell).filter(|cell| !taken.contains(cell));
    let free: ArrayVec<(usize, S::Vec3), MAX_CELLS> =
        numbers.filter_map(|cell| Some((cell, cells.get(cell)?.emitter_tool()))).collect();
    let mut best = None;
    let mut most = S::zero();
    for (n, &(i, a)) in free.iter().enumerate() {
        for (m, &(j, b)) in free.iter().enumerate().skip(n + 1) {
            for &(k, c) in free.iter().skip(m + 1) {
                let area = (b - a).cross(c - a).length();
                if area > most {
                    (best, most) = (Some([i, j, k]), area);
                }
            }
        }
    }
    best
}

/// Where a mirror image of `pose` may be, `index` below [`IMAGES`]: some of three emitters on their
/// other sides. `None` if there are not so many cells.
pub(super) fn image<S: Number>(
    cells: &[PlaneCell<S>],
    readings: &[Usable<S>],
    pose: &Transform<S>,
    length_scale_m: S,
    index: usize,
) -> Option<Transform<S>> {
    let mut three = widest(cells, readings, &[])?;
    if index >= PATTERNS {
        three = widest(cells, readings, &three)?;
    }
    // All of them first: a head that is its own mirror image.
    let pattern = PATTERNS - index % PATTERNS;
    let mut places = three.map(|cell| (cell, cells[cell].sides(pose)));
    places
        .iter_mut()
        .enumerate()
        .filter(|(i, _)| pattern & 1 << i == 0)
        .for_each(|(_, (_, sides))| sides[1] = sides[0]);
    let axes =
        [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].map(|(x, y, z)| S::Vec3::new(S::of(x), S::of(y), S::of(z)));
    let (places, axes) = (&places, &axes);
    Some(settle(*pose, length_scale_m, STEPS, |pose| {
        places.iter().flat_map(move |(cell, [_, beyond])| {
            axes.iter().map(move |axis| {
                let (row, distance) = cells[*cell].row_from(*beyond, *axis, &pose, length_scale_m);
                (row, distance, S::one())
            })
        })
    }))
}

//! Cells in SIMD lanes, for scenes whose cells are all of one kind: thin or thick masks parallel to
//! their detectors, cosine-power profiles, paper tier.

use heapless::Vec;

use crate::aperture::{Aperture, Face, Span};
use crate::paper;
use crate::pose::Transform;
use crate::power::PowerLanes;
use crate::profile::Falloff;
use crate::rectangle::{Rectangle, Visibility};
use crate::scalar::{Linear3, Real, Scalar};
use crate::scene::MAX_CELLS;

use super::optics::{Instant, Light, Receiver, Seen, Source, of_sides};
use super::{CellTerms, CompiledCell};

/// One cell per lane.
#[derive(Clone, Debug)]
pub(super) struct Pack<R: Real, E = PowerLanes<R>> {
    pub(super) receiver: Receiver<R>,
    pub(super) faces: Faces<R>,
    pub(super) source: Source<R>,
    pub(super) emission: E,
}

#[derive(Clone, Debug)]
pub(super) enum Faces<R> {
    Thin(Face<R>),
    Thick([Face<R>; 2]),
}

impl<R: Real> Span<R> {
    fn of_lanes(like: R, span: impl Fn(usize) -> Span<R::Element>) -> Self {
        Self {
            low: like.each(|i| span(i).low),
            high: like.each(|i| span(i).high),
            length: like.each(|i| span(i).length),
        }
    }
}

/// Packs the cells of a plan into `packs`, which stays empty if a cell is of another kind.
#[inline(never)]
pub(super) fn fill<S: Scalar>(packs: &mut Vec<Pack<S::Lanes>, MAX_CELLS>, cells: &[CompiledCell<S>]) {
    for cells in cells.chunks(<S::Lanes as Real>::LANES) {
        let Some(pack) = Pack::of(<S::Lanes as Default>::default(), cells) else {
            packs.clear();
            return;
        };
        // There are no more packs than cells.
        let _ = packs.push(pack);
    }
}

impl<R: Real> Pack<R> {
    /// From up to as many cells as there are lanes; the last cell fills the remaining lanes.
    fn of(like: R, cells: &[CompiledCell<R::Element>]) -> Option<Self> {
        let last = cells.len() - 1;
        let cell = |i: usize| &cells[i.min(last)];
        let number = |of: &dyn Fn(&CompiledCell<R::Element>) -> R::Element| like.each(|i| of(cell(i)));
        let vector = |of: &dyn Fn(&CompiledCell<_>) -> <R::Element as Real>::Vec3| {
            R::Vec3::new(number(&|c| of(c).x()), number(&|c| of(c).y()), number(&|c| of(c).z()))
        };
        let face = |of: &dyn Fn(&Aperture<_>) -> Option<Face<R::Element>>| {
            let faces: Vec<Face<_>, 2> = (0..R::LANES).map(|i| of(&cell(i).aperture)).collect::<Option<_>>()?;
            Some(Face {
                z: like.each(|i| faces[i].z),
                x: Span::of_lanes(like, |i| faces[i].x),
                y: Span::of_lanes(like, |i| faces[i].y),
            })
        };
        let thin = face(&|aperture| match aperture {
            Aperture::Thin(face) => Some(*face),
            _ => None,
        });
        let thick = |index: usize| {
            face(&|aperture| match aperture {
                Aperture::Thick(lower, upper) => Some([*lower, *upper][index]),
                _ => None,
            })
        };
        let powers: Vec<_, 2> =
            (0..R::LANES).map(|i| cell(i).emitter.profile.as_power().cloned()).collect::<Option<_>>()?;
        Some(Self {
            receiver: Receiver {
                axes: [0, 1, 2].map(|k| vector(&|cell| cell.receiver.axes[k])),
                centre: vector(&|cell| cell.receiver.centre),
                half: [0, 1].map(|k| number(&|cell| cell.receiver.half[k])),
                per_length: number(&|cell| cell.receiver.per_length),
                responsivity: number(&|cell| cell.receiver.responsivity),
                dark: number(&|cell| cell.receiver.dark),
            },
            faces: match thin {
                Some(face) => Faces::Thin(face),
                None => Faces::Thick([thick(0)?, thick(1)?]),
            },
            source: Source {
                position: vector(&|cell| cell.emitter.source.position),
                axis: vector(&|cell| cell.emitter.source.axis),
                intensity: number(&|cell| cell.emitter.source.intensity),
            },
            emission: PowerLanes::of(like, |i| powers[i].clone()),
        })
    }
}

impl<R: Real, E: Falloff<R>> Pack<R, E> {
    #[inline(always)]
    fn see(&self, first: usize, instant: &Instant<'_, R::Element>, pose: &Transform<R>) -> Seen<R> {
        if instant.offsets_s.is_empty() {
            return self.receiver.see(&self.source, pose);
        }
        let last = instant.offsets_s.len() - 1;
        let like = self.receiver.dark;
        let offset_s = like.each(|i| instant.offsets_s[(first + i).min(last)]);
        let twist = [like.all3(instant.linear), like.all3(instant.angular)];
        self.receiver.see_moved(&self.source, pose, twist, offset_s)
    }

    #[inline(always)]
    fn light<const GRADIENT: bool>(&self, seen: &Seen<R>) -> (Light<R>, Visibility<R>) {
        let (spot, visibility) = self.spot(seen);
        let light = paper::rectangle_light::<R, E, GRADIENT>(&spot, seen.axis, &self.emission);
        (of_sides::<R, GRADIENT>(&light, &spot, false), visibility)
    }
}

impl<R: Real, E> Pack<R, E> {
    #[inline(always)]
    pub(super) fn spot(&self, seen: &Seen<R>) -> (Rectangle<R>, Visibility<R>) {
        let emitter = [seen.position.x(), seen.position.y(), seen.position.z()];
        match &self.faces {
            Faces::Thin(face) => Rectangle::of_beam([*face], emitter, self.receiver.half),
            Faces::Thick(faces) => Rectangle::of_beam(*faces, emitter, self.receiver.half),
        }
    }
}

/// Passes the terms of all cells of `packs`, in order, to `sink`.
#[inline(always)]
pub(super) fn linearise<R: Real + Default>(
    packs: &[Pack<R>],
    count: usize,
    instant: &Instant<'_, R::Element>,
    mut sink: impl FnMut(usize, &CellTerms<R::Element>),
) {
    let pose = instant.pose.in_all_lanes(R::default());
    for (index, pack) in packs.iter().enumerate() {
        let first = index * R::LANES;
        let seen = pack.see(first, instant, &pose);
        let (light, visibility) = pack.light::<true>(&seen);
        let (pair, jacobian) = pack.receiver.linearise(&pack.source, &light, &seen, true);
        for lane in 0..R::LANES.min(count - first) {
            let status = visibility.status(lane);
            let terms = if status.has_spot() {
                CellTerms {
                    status,
                    pair: pair.map(|value| value.lane(lane)),
                    jacobian: jacobian.map(|row| row.map(|value| value.lane(lane))),
                    slack_m: visibility.slack_m(lane),
                    ..CellTerms::dark(status)
                }
            } else {
                CellTerms::dark(status)
            };
            sink(first + lane, &terms);
        }
    }
}

/// Passes the photocurrents of all cells of `packs`, in order, to `sink`.
#[inline(always)]
pub(super) fn currents<R: Real + Default>(
    packs: &[Pack<R>],
    count: usize,
    instant: &Instant<'_, R::Element>,
    mut sink: impl FnMut(usize, [R::Element; 2]),
) {
    let pose = instant.pose.in_all_lanes(R::default());
    for (index, pack) in packs.iter().enumerate() {
        let first = index * R::LANES;
        let seen = pack.see(first, instant, &pose);
        let (light, visibility) = pack.light::<false>(&seen);
        let gain = pack.receiver.responsivity * pack.source.intensity;
        let pair = pack.receiver.divide(gain * light.power.value, light.x_a.value(), true);
        for lane in 0..R::LANES.min(count - first) {
            let lit = visibility.status(lane).has_spot();
            sink(first + lane, if lit { pair.map(|value| value.lane(lane)) } else { Default::default() });
        }
    }
}

//! Cells in SIMD lanes, for scenes whose cells are all of one kind: thin or thick masks parallel to
//! their detectors, cosine-power profiles, paper tier.

use heapless::Vec;

use crate::aperture::{Aperture, Face, Span};
use crate::list::List;
use crate::paper;
use crate::pose::Transform;
use crate::power::PowerLanes;
use crate::profile::Falloff;
use crate::rectangle::{Rectangle, Visibility};
use crate::scalar::{Linear3, Number, Real};
use crate::scene::MAX_CELLS;

use super::optics::{Instant, Light, Receiver, Seen, Source, of_sides};
use super::{CellTerms, CompiledCell};

/// One cell per lane.
#[derive(Clone, Debug)]
pub struct Pack<R: Real, E = PowerLanes<R>> {
    pub receiver: Receiver<R>,
    pub faces: Faces<R>,
    pub source: Source<R>,
    pub emission: E,
}

#[derive(Clone, Debug)]
pub enum Faces<R> {
    Thin(Face<R>),
    Thick([Face<R>; 2]),
}

/// Where the numbers of cells come from, in the order in which [`Pack::of_numbers`] asks for them.
pub trait Numbers<R: Real> {
    /// The number `of` the cell of each lane. `#[inline(always)]`, as all that it calls.
    fn next(&mut self, of: impl Fn(&CompiledCell<R::Element>) -> R::Element) -> R;

    #[inline(always)]
    fn next3(&mut self, of: impl Fn(&CompiledCell<R::Element>) -> <R::Element as Real>::Vec3) -> R::Vec3 {
        let (x, y) = (self.next(|cell| of(cell).x()), self.next(|cell| of(cell).y()));
        R::Vec3::new(x, y, self.next(|cell| of(cell).z()))
    }

    #[inline(always)]
    fn next_span(&mut self, of: impl Fn(&CompiledCell<R::Element>) -> Span<R::Element>) -> Span<R> {
        let (low, high) = (self.next(|cell| of(cell).low), self.next(|cell| of(cell).high));
        Span { low, high, length: self.next(|cell| of(cell).length) }
    }

    /// The lower face, or the upper one of a thick mask.
    #[inline(always)]
    fn next_face(&mut self, upper: bool) -> Face<R> {
        let of = |cell: &CompiledCell<R::Element>| match &cell.aperture {
            Aperture::Thick(_, face) if upper => *face,
            Aperture::Thin(face) | Aperture::Thick(face, _) => *face,
            Aperture::Turned(_) | Aperture::Imperfect(_) => Face::default(),
        };
        let (z, x) = (self.next(|cell| of(cell).z), self.next_span(|cell| of(cell).x));
        Face { z, x, y: self.next_span(|cell| of(cell).y) }
    }
}

/// Numbers of up to as many cells as there are lanes; the last cell fills the remaining lanes.
struct Gathered<'a, R: Real> {
    like: R,
    cells: &'a [CompiledCell<R::Element>],
}

impl<R: Real> Gathered<'_, R> {
    fn cell(&self, lane: usize) -> &CompiledCell<R::Element> {
        &self.cells[lane.min(self.cells.len() - 1)]
    }
}

impl<R: Real> Numbers<R> for Gathered<'_, R> {
    #[inline(always)]
    fn next(&mut self, of: impl Fn(&CompiledCell<R::Element>) -> R::Element) -> R {
        self.like.fill_with(|lane| of(self.cell(lane)))
    }
}

/// What all masks of a plan are, if they are parallel to their detectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Masks {
    Thin,
    Thick,
}

impl Masks {
    /// `None` if a mask is of another kind than the first one, or turned.
    pub fn of<S: Number>(cells: &[CompiledCell<S>]) -> Option<Self> {
        let of = |cell: &CompiledCell<S>| match cell.aperture {
            Aperture::Thin(_) => Some(Self::Thin),
            Aperture::Thick(..) => Some(Self::Thick),
            Aperture::Turned(_) | Aperture::Imperfect(_) => None,
        };
        let first = of(cells.first()?)?;
        cells.iter().all(|cell| of(cell) == Some(first)).then_some(first)
    }
}

/// Packs the cells of a plan into `packs`, which stays empty if a cell is of another kind.
#[inline(never)]
pub fn fill<S: Number>(packs: &mut List<Pack<S::Lanes>, MAX_CELLS>, cells: &[CompiledCell<S>]) {
    let Some(masks) = Masks::of(cells) else { return };
    for cells in cells.chunks(<S::Lanes as Real>::LANES) {
        let Some(pack) = Pack::of(<S::Lanes as Default>::default(), masks, cells) else {
            packs.clear();
            return;
        };
        // There are no more packs than cells.
        let _ = packs.push(pack);
    }
}

impl<R: Real> Pack<R> {
    /// From up to as many cells as there are lanes; the last cell fills the remaining lanes.
    fn of(like: R, masks: Masks, cells: &[CompiledCell<R::Element>]) -> Option<Self> {
        let mut gathered = Gathered { like, cells };
        let power = |lane| gathered.cell(lane).emitter.profile.as_power().cloned();
        let powers: Vec<_, 2> = (0..R::LANES).map(power).collect::<Option<_>>()?;
        let Pack { receiver, faces, source, .. } = Pack::of_numbers(&mut gathered, masks);
        Some(Self { receiver, faces, source, emission: PowerLanes::of(like, |i| powers[i].clone()) })
    }
}

impl<R: Real> Pack<R, ()> {
    /// Cells without their profiles.
    #[inline(always)]
    pub fn of_numbers(numbers: &mut impl Numbers<R>, masks: Masks) -> Self {
        let axes = [
            numbers.next3(|cell| cell.receiver.axes[0]),
            numbers.next3(|cell| cell.receiver.axes[1]),
            numbers.next3(|cell| cell.receiver.axes[2]),
        ];
        Self {
            receiver: Receiver {
                axes,
                centre: numbers.next3(|cell| cell.receiver.centre),
                half: [numbers.next(|cell| cell.receiver.half[0]), numbers.next(|cell| cell.receiver.half[1])],
                per_length: numbers.next(|cell| cell.receiver.per_length),
                responsivity: numbers.next(|cell| cell.receiver.responsivity),
                dark: numbers.next(|cell| cell.receiver.dark),
            },
            source: Source {
                position: numbers.next3(|cell| cell.emitter.source.position),
                axis: numbers.next3(|cell| cell.emitter.source.axis),
                intensity: numbers.next(|cell| cell.emitter.source.intensity),
            },
            faces: match masks {
                Masks::Thin => Faces::Thin(numbers.next_face(false)),
                Masks::Thick => Faces::Thick([numbers.next_face(false), numbers.next_face(true)]),
            },
            emission: (),
        }
    }
}

impl<R: Real, E: Falloff<R>> Pack<R, E> {
    #[inline(always)]
    fn light<const GRADIENT: bool>(&self, seen: &Seen<R>) -> (Light<R>, Visibility<R>) {
        let (spot, visibility) = self.spot(seen);
        let light = paper::rectangle_light::<R, E, GRADIENT>(&spot, seen.axis, &self.emission);
        (of_sides::<R, GRADIENT>(&light, &spot, false), visibility)
    }
}

impl<R: Real, E> Pack<R, E> {
    /// The emitters of the cells from number `first` on.
    #[inline(always)]
    pub fn see(&self, first: usize, instant: &Instant<'_, R::Element>, pose: &Transform<R>) -> Seen<R> {
        let like = self.receiver.dark;
        let Some(offset_s) = instant.offsets_in_lanes(like, first) else {
            return self.receiver.see(&self.source, pose);
        };
        self.receiver.see_moved(&self.source, pose, instant.displacement(offset_s))
    }

    #[inline(always)]
    pub fn spot(&self, seen: &Seen<R>) -> (Rectangle<R>, Visibility<R>) {
        let emitter = [seen.position.x(), seen.position.y(), seen.position.z()];
        match &self.faces {
            Faces::Thin(face) => Rectangle::of_beam([*face], emitter, self.receiver.half),
            Faces::Thick(faces) => Rectangle::of_beam(*faces, emitter, self.receiver.half),
        }
    }
}

/// Passes the terms of all cells of `packs`, in order, to `sink`.
#[inline(always)]
pub fn linearise<R: Real + Default>(
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
pub fn currents<R: Real + Default>(
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

//! The exact tier for several cells at one pose, as many at once as the processor has lanes, if all are of one kind: bit
//! for bit what each cell gives alone.
//!
//! Lanes do what all cells do alike. What depends on a cell's own profile, the series that stands for it within the spot
//! and the number of nodes, is found for each lane by itself, and cells to which one tensor rule does not apply are
//! evaluated alone. So are extended sources, emitters that are lit together, other openings than slits on the base, and
//! slits turned without any effect.

extern crate alloc;

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::fmt::Debug;

use glam::DVec3;
use pulp::x86::{V3, V4};
use pulp::{Simd, WithSimd};

use crate::aperture::{Aperture, Face, Span};
use crate::exact::{self, Rules};
use crate::lanes::{Lanes, Lanes3, MAX_LANES};
use crate::rectangle::{Rectangle, RectangleLight, Visibility};
use crate::response::Status;
use crate::scalar::{Linear3, Real};

use super::imperfect::beam::{Beam, Face as BeamFace, Glass, Slot};
use super::imperfect::electrical::{CompiledConverters, CompiledStray, Electrical};
use super::imperfect::passage::{Passage, Way};
use super::imperfect::source::ExtendedSource;
use super::imperfect::{Imperfect, Sums};
use super::optics::{Instant, Receiver, Seen, Source, of_sides};
use super::{CellTerms, CellsAtOnce, CompiledCell, CompiledScene, NoLanes};

/// The cells of a plan, a cell per lane.
#[derive(Clone, Debug)]
pub enum CellsInLanes {
    Alone,
    Four(Packs<V3>),
    Eight(Packs<V4>),
}

/// As many cells each as there are lanes; the last cell fills the remaining lanes.
#[derive(Clone, Debug)]
pub struct Packs<I: Simd> {
    simd: I,
    packs: Arc<[Pack<Lanes<I>>]>,
}

/// Cells of one kind, one per lane.
#[derive(Clone, Debug)]
struct Pack<R: Real> {
    receiver: Receiver<R>,
    source: Source<R>,
    path: Path<R>,
}

/// What is between emitter and currents.
#[derive(Clone, Debug)]
enum Path<R: Real> {
    Thin(Face<R>),
    Thick([Face<R>; 2]),
    Imperfect(Beam<R>, ExtendedSource<R>, Electrical<R>),
}

#[derive(Clone, Copy)]
struct View<'a> {
    cell: &'a CompiledCell<f64>,
    effects: Option<(&'a Imperfect<f64>, &'a Beam<f64>)>,
}

impl<'a> View<'a> {
    /// `None`: the cell is evaluated alone.
    fn of(cell: &'a CompiledCell<f64>) -> Option<Self> {
        let effects = match (&cell.imperfect, &cell.aperture) {
            (Some(imperfect), _) => match &imperfect.passage {
                Passage::Beam(beam) if imperfect.source.radius <= 0.0 && imperfect.lit_together == 0 => {
                    Some((imperfect, beam))
                }
                _ => return None,
            },
            (None, Aperture::Turned(_)) => return None,
            (None, Aperture::Thin(_) | Aperture::Thick(..)) => None,
        };
        Some(Self { cell, effects })
    }

    /// What all cells of a plan have, or none.
    fn kind(&self) -> [bool; 8] {
        let is_thick = matches!(self.cell.aperture, Aperture::Thick(..));
        let Some((Imperfect { source, electrical, .. }, beam)) = self.effects else {
            return [false, is_thick, false, false, false, false, false, false];
        };
        let (window, azimuth) = (beam.slot.window.is_some(), source.azimuthal.is_some());
        let Electrical { nonlinearity, stray, converters, .. } = electrical;
        let turning = stray.as_ref().is_some_and(|stray| stray.turning.is_some());
        [true, beam.is_thick, window, azimuth, nonlinearity.is_some(), stray.is_some(), turning, converters.is_some()]
    }
}

/// What has a number for each lane, put together of one for each cell.
trait Gathered<I: Simd>: Sized {
    /// That of one cell.
    type One: 'static;

    /// `of`: that of the cell of each lane. All have the same optional parts.
    fn gather<'a>(like: Lanes<I>, of: impl Fn(usize) -> &'a Self::One) -> Self;
}

impl<I: Simd> Gathered<I> for Lanes<I> {
    type One = f64;

    fn gather<'a>(like: Self, of: impl Fn(usize) -> &'a f64) -> Self {
        like.fill_with(|lane| *of(lane))
    }
}

impl<I: Simd> Gathered<I> for Lanes3<Lanes<I>> {
    type One = DVec3;

    fn gather<'a>(like: Lanes<I>, of: impl Fn(usize) -> &'a DVec3) -> Self {
        Self::new(
            like.fill_with(|lane| of(lane).x),
            like.fill_with(|lane| of(lane).y),
            like.fill_with(|lane| of(lane).z),
        )
    }
}

impl<I: Simd> Gathered<I> for bool {
    type One = Self;

    fn gather<'a>(_: Lanes<I>, of: impl Fn(usize) -> &'a Self) -> Self {
        *of(0)
    }
}

impl<I: Simd, T: Gathered<I>, const N: usize> Gathered<I> for [T; N] {
    type One = [T::One; N];

    fn gather<'a>(like: Lanes<I>, of: impl Fn(usize) -> &'a Self::One) -> Self {
        core::array::from_fn(|i| T::gather(like, |lane| &of(lane)[i]))
    }
}

impl<I: Simd, T: Gathered<I>> Gathered<I> for Option<T> {
    type One = Option<T::One>;

    fn gather<'a>(like: Lanes<I>, of: impl Fn(usize) -> &'a Self::One) -> Self {
        of(0).as_ref().map(|first| T::gather(like, |lane| of(lane).as_ref().unwrap_or(first)))
    }
}

macro_rules! gathered {
    ($($name:ident { $($field:ident),* })*) => {
        $(impl<I: Simd> Gathered<I> for $name<Lanes<I>> {
            type One = $name<f64>;

            fn gather<'a>(like: Lanes<I>, of: impl Fn(usize) -> &'a Self::One) -> Self {
                Self { $($field: Gathered::gather(like, |lane| &of(lane).$field)),* }
            }
        })*
    };
}

gathered! {
    Receiver { axes, centre, half, per_length, responsivity, dark }
    Source { position, axis, intensity }
    Span { low, high, length }
    Face { z, x, y }
    BeamFace { moments, ends }
    Glass { thickness, index2, excess }
    Slot { across, along, half_sizes, centre, half_thickness, window }
    Beam { faces, is_thick, normal, slot }
    ExtendedSource { across, azimuthal, radius }
    CompiledStray { constant, linear, quadratic, turning }
    CompiledConverters { per_half_scale, curves }
    Electrical { per_half_length, nonlinearity, stray, gain, converters }
}

impl<I: Simd> Pack<Lanes<I>> {
    /// Of the `views` of the cell of each lane, which are of one kind.
    fn of(like: Lanes<I>, views: &[View<'_>]) -> Option<Self> {
        Some(Self {
            receiver: Gathered::gather(like, |lane| &views[lane].cell.receiver),
            source: Gathered::gather(like, |lane| &views[lane].cell.emitter.source),
            path: Path::of(like, views)?,
        })
    }
}

impl<I: Simd> Path<Lanes<I>> {
    fn of(like: Lanes<I>, views: &[View<'_>]) -> Option<Self> {
        if views[0].effects.is_some() {
            let effects: Vec<_> = views.iter().map(|view| view.effects).collect::<Option<_>>()?;
            return Some(Self::Imperfect(
                Gathered::gather(like, |lane| effects[lane].1),
                Gathered::gather(like, |lane| &effects[lane].0.source),
                Gathered::gather(like, |lane| &effects[lane].0.electrical),
            ));
        }
        let faces = views.iter().map(|view| match &view.cell.aperture {
            Aperture::Thin(face) => Some([face; 2]),
            Aperture::Thick(lower, upper) => Some([lower, upper]),
            Aperture::Turned(_) => None,
        });
        let faces: Vec<_> = faces.collect::<Option<_>>()?;
        let lower = Gathered::gather(like, |lane| faces[lane][0]);
        Some(match views[0].cell.aperture {
            Aperture::Thick(..) => Self::Thick([lower, Gathered::gather(like, |lane| faces[lane][1])]),
            _ => Self::Thin(lower),
        })
    }
}

/// What is found of the cell of each lane.
struct Found {
    statuses: [Status; MAX_LANES],
    /// NaN where the cell must be evaluated alone.
    pair: [[f64; MAX_LANES]; 2],
    jacobian: [[[f64; MAX_LANES]; 6]; 2],
    slack_m: [f64; MAX_LANES],
}

impl Found {
    const NOTHING: Self = Self {
        statuses: [Status::Lit; MAX_LANES],
        pair: [[f64::NAN; MAX_LANES]; 2],
        jacobian: [[[0.0; MAX_LANES]; 6]; 2],
        slack_m: [0.0; MAX_LANES],
    };

    #[inline(always)]
    fn set<R: Real<Element = f64>>(&mut self, visibility: &Visibility<R>, pair: [R; 2], jacobian: Option<[[R; 6]; 2]>) {
        for lane in 0..R::LANES {
            self.statuses[lane] = visibility.status(lane);
            self.slack_m[lane] = visibility.slack_m(lane);
            for row in 0..2 {
                self.pair[row][lane] = pair[row].lane(lane);
                if let Some(jacobian) = jacobian {
                    for axis in 0..6 {
                        self.jacobian[row][axis][lane] = jacobian[row][axis].lane(lane);
                    }
                }
            }
        }
    }

    /// `None` where the cell must be evaluated alone.
    fn terms(&self, lane: usize) -> Option<CellTerms<f64>> {
        let (status, pair) = (self.statuses[lane], self.pair.map(|current| current[lane]));
        if (pair[0] + pair[1]).is_nan() {
            return None;
        }
        let dark = CellTerms { pair, ..CellTerms::dark(status) };
        if !status.has_spot() {
            return Some(dark);
        }
        let jacobian = self.jacobian.map(|row| row.map(|value| value[lane]));
        Some(CellTerms { jacobian, slack_m: self.slack_m[lane], ..dark })
    }
}

impl CellsInLanes {
    /// In each width that the processor has, widest first; none if the cells of `plan` are not of one kind.
    pub(crate) fn all(plan: &CompiledScene<f64>) -> impl Iterator<Item = Self> {
        let eight = || Some(Self::Eight(Packs::of(plan, V4::try_new()?)?));
        let four = || Some(Self::Four(Packs::of(plan, V3::try_new()?)?));
        core::iter::once_with(eight).chain(core::iter::once_with(four)).flatten()
    }
}

impl CellsAtOnce<f64> for CellsInLanes {
    const ALONE: Self = Self::Alone;

    fn of(plan: &CompiledScene<f64>) -> Self {
        Self::all(plan).next().unwrap_or(Self::ALONE)
    }

    #[inline(always)]
    fn each<const SLOPES: bool>(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        sink: impl FnMut(usize, Option<CellTerms<f64>>),
    ) {
        match self {
            Self::Alone => NoLanes.each::<SLOPES>(plan, instant, wanted, sink),
            Self::Four(packs) => packs.each::<SLOPES>(plan, instant, wanted, sink),
            Self::Eight(packs) => packs.each::<SLOPES>(plan, instant, wanted, sink),
        }
    }
}

impl<I: Simd> Packs<I> {
    /// `None` if the cells of `plan` are not of one kind.
    fn of(plan: &CompiledScene<f64>, simd: I) -> Option<Self> {
        let views: Vec<_> = plan.cells.iter().map(View::of).collect::<Option<_>>()?;
        let kind = views.first()?.kind();
        if plan.is_paper || views.iter().any(|view| view.kind() != kind) {
            return None;
        }
        let of_lanes = |views: &[View<'_>]| {
            let last = views.len() - 1;
            let views: Vec<_> = (0..Lanes::<I>::LANES).map(|lane| views[lane.min(last)]).collect();
            Pack::of(Lanes::zero(simd), &views)
        };
        Some(Self { simd, packs: views.chunks(Lanes::<I>::LANES).map(of_lanes).collect::<Option<_>>()? })
    }

    /// See [`CellsAtOnce::each`].
    #[inline(always)]
    fn each<const SLOPES: bool>(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, Option<CellTerms<f64>>),
    ) {
        let (lanes, count) = (Lanes::<I>::LANES, plan.cell_count());
        let mut found = Found::NOTHING;
        for (pack, first) in self.packs.iter().zip((0..count).step_by(lanes)) {
            let wanted = || (first..count.min(first + lanes)).filter(|&cell| wanted(cell));
            let at_once = wanted().nth(1).is_some();
            if at_once {
                self.simd.vectorize(AtOnce::<I, SLOPES> { pack, plan, instant, first, found: &mut found });
            }
            wanted().for_each(|cell| sink(cell, if at_once { found.terms(cell - first) } else { None }));
        }
    }
}

/// The cells of a pack, from number `first` on; `SLOPES`: with derivatives.
struct AtOnce<'a, I: Simd, const SLOPES: bool> {
    pack: &'a Pack<Lanes<I>>,
    plan: &'a CompiledScene<f64>,
    instant: &'a Instant<'a, f64>,
    first: usize,
    found: &'a mut Found,
}

impl<I: Simd, const SLOPES: bool> WithSimd for AtOnce<'_, I, SLOPES> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { pack, plan, instant, first, found } = self;
        pack.evaluate::<SLOPES>(plan, instant, first, found);
    }
}

impl<R: Real<Element = f64>> Pack<R> {
    /// Puts what the cells give, which are those from number `first` on, into `found`.
    #[inline(always)]
    fn evaluate<const SLOPES: bool>(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        first: usize,
        found: &mut Found,
    ) {
        let Self { receiver, source, path } = self;
        let like = receiver.dark;
        let Some(rules) = &plan.rules else { return };
        let of = (plan, rules, first);
        let pose = instant.pose_in_lanes(like, first);
        let seen = receiver.see(source, &pose);
        let e = [seen.position.x(), seen.position.y(), seen.position.z()];
        let (beam, extended, electrical) = match path {
            Path::Thin(face) => {
                return self.ideal::<SLOPES>(of, &seen, Rectangle::of_beam([*face], e, receiver.half), found);
            }
            Path::Thick(faces) => {
                return self.ideal::<SLOPES>(of, &seen, Rectangle::of_beam(*faces, e, receiver.half), found);
            }
            Path::Imperfect(beam, extended, electrical) => (beam, extended, electrical),
        };
        let (zero, one) = (like.constant(0.0), like.constant(1.0));
        let (spot, visibility) = beam.spot::<SLOPES, SLOPES>(seen.position, receiver.half);
        let light = spot.of_sides::<SLOPES>(&light::<R, SLOPES>(of, &spot.rectangle, &visibility, seen.axis));
        let mut sums = Sums::none(zero);
        let way = Way { turn: None, raise: (spot.raise.height, spot.raise.by_position), to_hole: None };
        sums.add::<SLOPES>(receiver, source, &seen, &pose, Some(extended), electrical, &light, &way, one);
        sums.total = visibility.where_spot(sums.total, zero);
        sums.moment = visibility.where_spot(sums.moment, zero);
        let (pair, jacobian) = electrical.currents::<SLOPES>(receiver, false, &sums, one, (pose.translation(), &pose));
        found.set(&visibility, pair, SLOPES.then_some(jacobian));
    }

    /// [`Self::evaluate`] without effects.
    #[inline(always)]
    fn ideal<const SLOPES: bool>(
        &self,
        of: (&CompiledScene<f64>, &Rules<f64>, usize),
        seen: &Seen<R>,
        (spot, visibility): (Rectangle<R>, Visibility<R>),
        found: &mut Found,
    ) {
        let Self { receiver, source, .. } = self;
        let light = of_sides::<R, SLOPES>(&light::<R, SLOPES>(of, &spot, &visibility, seen.axis), &spot, true);
        let (pair, jacobian) = if SLOPES {
            let (pair, jacobian) = receiver.linearise(source, &light, seen, false);
            (pair, Some(jacobian))
        } else {
            let gain = receiver.responsivity * source.intensity;
            (receiver.divide(gain * light.power.value, light.x_a.value(), false), None)
        };
        let zero = pair[0].constant(0.0);
        let pair = [visibility.where_spot(pair[0], zero), visibility.where_spot(pair[1], zero)];
        found.set(&visibility, pair, jacobian);
    }
}

/// The light of the cell of each lane, from number `first` on; NaN where it must be evaluated alone.
#[inline(always)]
fn light<R: Real<Element = f64>, const SLOPES: bool>(
    (plan, rules, first): (&CompiledScene<f64>, &Rules<f64>, usize),
    spot: &Rectangle<R>,
    visibility: &Visibility<R>,
    axis: R::Vec3,
) -> RectangleLight<R> {
    exact::rectangle_light_lanes::<R, SLOPES>(spot, axis, rules, |lane| {
        let emitter = &plan.cells.get(first + lane).filter(|_| visibility.status(lane).has_spot())?.emitter;
        Some((&emitter.profile, emitter.orders.as_ref()?))
    })
}

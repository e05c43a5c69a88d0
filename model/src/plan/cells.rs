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

use crate::aperture::{Aperture, Face, Span};
use crate::exact;
use crate::lanes::MAX_LANES;
use crate::lanes::{Instructions, Lanes, Task, Width};
use crate::pose::Transform;
use crate::rectangle::{Rectangle, RectangleLight, SideGradient, Visibility};
use crate::response::{Pair, Status};
use crate::scalar::{Linear3, Real};
use crate::scene::MAX_CELLS;

use super::imperfect::beam::{self, Beam, Glass, Slot};
use super::imperfect::electrical::{CompiledConverters, CompiledStray, Electrical};
use super::imperfect::passage::{Passage, Way};
use super::imperfect::{ExtendedSource, Imperfect, Sums};
use super::optics::{Instant, Receiver, Source, of_sides};
use super::{CellTerms, CellsAtOnce, CompiledCell, CompiledScene, evaluate};

/// A number of each cell; the last one fills the remaining lanes.
type PerCell = [f64; MAX_CELLS];

const _: () = assert!(MAX_CELLS.is_multiple_of(MAX_LANES), "every group of cells fills all lanes");

/// The cells of a plan, number by number.
#[derive(Clone, Debug)]
pub struct CellsInLanes {
    width: Width,
    kind: Kind,
    numbers: Arc<[PerCell]>,
}

/// What all cells of a plan have.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Thin,
    Thick,
    Imperfect { is_thick: bool, window: bool, azimuth: bool, nonlinearity: bool, stray: bool, converters: bool },
}

/// A cell of the plan.
#[derive(Clone, Copy)]
struct View<'a> {
    cell: &'a CompiledCell<f64>,
    effects: Option<(&'a Imperfect<f64>, &'a Beam<f64>)>,
}

impl<'a> View<'a> {
    /// `None`: the cell is evaluated alone.
    fn of(plan: &'a CompiledScene<f64>, cell: &'a CompiledCell<f64>) -> Option<Self> {
        let effects = match (&cell.aperture, plan.imperfect_of(cell)) {
            (Aperture::Thin(_) | Aperture::Thick(..), _) => None,
            (Aperture::Turned(_), _) | (Aperture::Imperfect(_), None) => return None,
            (Aperture::Imperfect(_), Some(imperfect)) => match &imperfect.passage {
                Passage::Beam(beam) if imperfect.source.radius <= 0.0 && imperfect.lit_together == 0 => {
                    Some((imperfect, beam))
                }
                _ => return None,
            },
        };
        Some(Self { cell, effects })
    }

    fn kind(&self) -> Kind {
        match (&self.effects, &self.cell.aperture) {
            (Some((imperfect, beam)), _) => Kind::Imperfect {
                is_thick: beam.is_thick,
                window: beam.slot.window.is_some(),
                azimuth: imperfect.source.azimuthal.is_some(),
                nonlinearity: imperfect.electrical.nonlinearity.is_some(),
                stray: imperfect.electrical.stray.is_some(),
                converters: imperfect.electrical.converters.is_some(),
            },
            (None, Aperture::Thick(..)) => Kind::Thick,
            (None, _) => Kind::Thin,
        }
    }
}

/// Numbers of cells, in the order in which they are asked for. `#[inline(always)]`, as all that asks.
trait Numbers<R: Real> {
    /// The number `of` the cell of each lane.
    fn next(&mut self, of: impl Fn(&View<'_>) -> f64) -> R;

    #[inline(always)]
    fn next3(&mut self, of: impl Fn(&View<'_>) -> glam::DVec3) -> R::Vec3 {
        let (x, y) = (self.next(|view| of(view).x), self.next(|view| of(view).y));
        R::Vec3::new(x, y, self.next(|view| of(view).z))
    }

    #[inline(always)]
    fn next_all<const N: usize>(&mut self, of: impl Fn(&View<'_>) -> Option<[f64; N]>) -> [R; N] {
        let mut all = [self.next(|view| of(view).map_or(0.0, |all| all[0])); N];
        for i in 1..N {
            all[i] = self.next(|view| of(view).map_or(0.0, |all| all[i]));
        }
        all
    }

    #[inline(always)]
    fn next_span(&mut self, of: impl Fn(&View<'_>) -> Span<f64>) -> Span<R> {
        let (low, high) = (self.next(|view| of(view).low), self.next(|view| of(view).high));
        Span { low, high, length: self.next(|view| of(view).length) }
    }

    /// The lower face, or the upper one of a thick mask.
    #[inline(always)]
    fn next_face(&mut self, upper: bool) -> Face<R> {
        let of = |view: &View<'_>| match &view.cell.aperture {
            Aperture::Thick(_, face) if upper => *face,
            Aperture::Thin(face) | Aperture::Thick(face, _) => *face,
            Aperture::Turned(_) | Aperture::Imperfect(_) => Face::default(),
        };
        let (z, x) = (self.next(|view| of(view).z), self.next_span(|view| of(view).x));
        Face { z, x, y: self.next_span(|view| of(view).y) }
    }

    #[inline(always)]
    fn next_receiver(&mut self) -> Receiver<R> {
        let axes = [
            self.next3(|view| view.cell.receiver.axes[0]),
            self.next3(|view| view.cell.receiver.axes[1]),
            self.next3(|view| view.cell.receiver.axes[2]),
        ];
        Receiver {
            axes,
            centre: self.next3(|view| view.cell.receiver.centre),
            half: self.next_all(|view| Some(view.cell.receiver.half)),
            per_length: self.next(|view| view.cell.receiver.per_length),
            responsivity: self.next(|view| view.cell.receiver.responsivity),
            dark: self.next(|view| view.cell.receiver.dark),
        }
    }

    #[inline(always)]
    fn next_source(&mut self) -> Source<R> {
        Source {
            position: self.next3(|view| view.cell.emitter.source.position),
            axis: self.next3(|view| view.cell.emitter.source.axis),
            intensity: self.next(|view| view.cell.emitter.source.intensity),
        }
    }

    #[inline(always)]
    fn next_face_of_beam(&mut self, number: usize) -> beam::Face<R> {
        let of = |view: &View<'_>| view.effects.map(|(_, beam)| beam.faces[number]);
        let moment = |view: &View<'_>, i: usize| of(view).map_or(glam::DVec3::ZERO, |face| face.moments[i]);
        let end = |view: &View<'_>, i: usize| of(view).map_or(glam::DVec3::ZERO, |face| face.ends[i]);
        beam::Face {
            moments: [self.next3(|view| moment(view, 0)), self.next3(|view| moment(view, 1))],
            ends: [self.next3(|view| end(view, 0)), self.next3(|view| end(view, 1))],
        }
    }

    #[inline(always)]
    fn next_beam(&mut self, is_thick: bool, has_window: bool) -> Beam<R> {
        let slot = |view: &View<'_>| view.effects.map(|(_, beam)| beam.slot);
        let vector = |view: &View<'_>, of: &dyn Fn(&Beam<f64>) -> glam::DVec3| {
            view.effects.map_or(glam::DVec3::ZERO, |(_, beam)| of(beam))
        };
        let first = self.next_face_of_beam(0);
        let faces = [first, if is_thick { self.next_face_of_beam(1) } else { first }];
        Beam {
            faces,
            is_thick,
            normal: self.next3(|view| vector(view, &|beam| beam.normal)),
            slot: Slot {
                across: self.next3(|view| vector(view, &|beam| beam.slot.across)),
                along: self.next3(|view| vector(view, &|beam| beam.slot.along)),
                half_sizes: self.next_all(|view| slot(view).map(|slot| slot.half_sizes)),
                centre: self.next3(|view| vector(view, &|beam| beam.slot.centre)),
                half_thickness: self.next(|view| slot(view).map_or(0.0, |slot| slot.half_thickness)),
                window: if has_window {
                    let [thickness, index2, excess] = self
                        .next_all(|view| slot(view)?.window.map(|glass| [glass.thickness, glass.index2, glass.excess]));
                    Some(Glass { thickness, index2, excess })
                } else {
                    None
                },
            },
        }
    }

    #[inline(always)]
    fn next_extended(&mut self, has_azimuth: bool) -> Option<ExtendedSource<R>> {
        if !has_azimuth {
            return None;
        }
        let across = |view: &View<'_>, axis: usize| {
            view.effects.map_or(glam::DVec3::ZERO, |(imperfect, _)| imperfect.source.across[axis])
        };
        Some(ExtendedSource {
            across: [self.next3(|view| across(view, 0)), self.next3(|view| across(view, 1))],
            azimuthal: Some(self.next_all(|view| view.effects?.0.source.azimuthal)),
            radius: self.next(|_| 0.0),
        })
    }

    #[inline(always)]
    fn next_electrical(&mut self, [nonlinearity, stray, converters]: [bool; 3]) -> Electrical<R> {
        let of = |view: &View<'_>| view.effects.map(|(imperfect, _)| imperfect.electrical.clone());
        let stray_of = |view: &View<'_>| view.effects?.0.electrical.stray.clone();
        let converters_of = |view: &View<'_>| view.effects?.0.electrical.converters.clone();
        Electrical {
            per_half_length: self.next(|view| of(view).map_or(0.0, |of| of.per_half_length)),
            nonlinearity: if nonlinearity { Some(self.next_all(|view| of(view)?.nonlinearity)) } else { None },
            stray: if stray {
                Some(CompiledStray {
                    constant: self.next_all(|view| Some(stray_of(view)?.constant)),
                    linear: [
                        self.next_all(|view| Some(stray_of(view)?.linear[0])),
                        self.next_all(|view| Some(stray_of(view)?.linear[1])),
                    ],
                    quadratic: [
                        self.next_all(|view| Some(stray_of(view)?.quadratic[0])),
                        self.next_all(|view| Some(stray_of(view)?.quadratic[1])),
                    ],
                })
            } else {
                None
            },
            gain: self.next_all(|view| Some(of(view)?.gain)),
            converters: if converters {
                Some(CompiledConverters {
                    per_half_scale: self.next(|view| converters_of(view).map_or(0.0, |it| it.per_half_scale)),
                    curves: [
                        self.next_all(|view| Some(converters_of(view)?.curves[0])),
                        self.next_all(|view| Some(converters_of(view)?.curves[1])),
                    ],
                })
            } else {
                None
            },
        }
    }
}

/// Numbers of one cell, to be stored as those of cell `cell`.
struct Stored<'a> {
    view: View<'a>,
    cell: usize,
    next: usize,
    numbers: &'a mut Vec<PerCell>,
}

impl Numbers<f64> for Stored<'_> {
    fn next(&mut self, of: impl Fn(&View<'_>) -> f64) -> f64 {
        if self.next == self.numbers.len() {
            self.numbers.push([0.0; MAX_CELLS]);
        }
        let number = of(&self.view);
        self.numbers[self.next][self.cell] = number;
        self.next += 1;
        number
    }
}

/// Numbers of as many cells as there are lanes, from number `first` on.
struct Loaded<'a, R> {
    like: R,
    first: usize,
    numbers: core::slice::Iter<'a, PerCell>,
}

impl<R: Real<Element = f64>> Numbers<R> for Loaded<'_, R> {
    #[inline(always)]
    fn next(&mut self, _: impl Fn(&View<'_>) -> f64) -> R {
        match self.numbers.next() {
            Some(number) => {
                let number = &number[self.first..][..R::LANES];
                self.like.fill_with(|lane| number[lane])
            }
            None => self.like,
        }
    }
}

/// Cells of one kind, one per lane.
struct CellLanes<R: Real> {
    receiver: Receiver<R>,
    source: Source<R>,
    path: Path<R>,
}

/// What is between emitter and currents.
enum Path<R: Real> {
    Thin(Face<R>),
    Thick([Face<R>; 2]),
    Imperfect(Beam<R>, Option<ExtendedSource<R>>, Electrical<R>),
}

impl<R: Real> CellLanes<R> {
    #[inline(always)]
    fn of(kind: Kind, numbers: &mut impl Numbers<R>) -> Self {
        Self {
            receiver: numbers.next_receiver(),
            source: numbers.next_source(),
            path: match kind {
                Kind::Thin => Path::Thin(numbers.next_face(false)),
                Kind::Thick => Path::Thick([numbers.next_face(false), numbers.next_face(true)]),
                Kind::Imperfect { is_thick, window, azimuth, nonlinearity, stray, converters } => Path::Imperfect(
                    numbers.next_beam(is_thick, window),
                    numbers.next_extended(azimuth),
                    numbers.next_electrical([nonlinearity, stray, converters]),
                ),
            },
        }
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

    /// Photocurrents without dark current; `None` where the cell must be evaluated alone.
    fn pair(&self, lane: usize) -> Option<[f64; 2]> {
        let pair = self.pair.map(|current| current[lane]);
        (!(pair[0] + pair[1]).is_nan()).then_some(pair)
    }

    /// `None` where the cell must be evaluated alone.
    fn terms(&self, lane: usize) -> Option<CellTerms<f64>> {
        let (status, pair) = (self.statuses[lane], self.pair(lane)?);
        if !status.has_spot() {
            return Some(CellTerms { pair, ..CellTerms::dark(status) });
        }
        let jacobian = self.jacobian.map(|row| row.map(|value| value[lane]));
        Some(CellTerms { pair, jacobian, slack_m: self.slack_m[lane], ..CellTerms::dark(status) })
    }
}

impl CellsInLanes {
    /// `None` if the cells of `plan` are not of one kind.
    pub(crate) fn with_width(plan: &CompiledScene<f64>, width: Width) -> Option<Self> {
        let last = plan.cells.len().checked_sub(1)?;
        let view = |cell: usize| View::of(plan, &plan.cells[cell.min(last)]);
        let kind = view(0)?.kind();
        let mut numbers = Vec::new();
        for cell in 0..MAX_CELLS {
            let view = view(cell)?;
            if plan.is_paper || view.kind() != kind {
                return None;
            }
            CellLanes::of(kind, &mut Stored { view, cell, next: 0, numbers: &mut numbers });
        }
        Some(Self { width, kind, numbers: numbers.into() })
    }

    /// Passes what is found of each of the `wanted` cells to `sink`, in order: by `of_lane` where lanes serve, else by
    /// `alone`.
    #[inline(always)]
    fn each<const SLOPES: bool, T>(
        &self,
        (plan, instant): (&CompiledScene<f64>, &Instant<'_, f64>),
        wanted: impl Fn(usize) -> bool,
        of_lane: impl Fn(&Found, usize) -> Option<T>,
        alone: impl Fn(usize, &Transform<f64>) -> T,
        mut sink: impl FnMut(usize, T),
    ) {
        let (lanes, count) = (self.width.lanes(), plan.cell_count());
        let mut found = Found::NOTHING;
        for first in (0..count).step_by(lanes) {
            let wanted = || (first..count.min(first + lanes)).filter(|&cell| wanted(cell));
            let at_once = wanted().nth(1).is_some();
            if at_once {
                self.width.run(AtOnce::<SLOPES> { cells: self, plan, instant, first, found: &mut found });
            }
            for cell in wanted() {
                let of_lane = if at_once { of_lane(&found, cell - first) } else { None };
                sink(cell, of_lane.unwrap_or_else(|| alone(cell, &instant.pose_of(cell))));
            }
        }
    }
}

impl CellsAtOnce<f64> for CellsInLanes {
    fn of(plan: &CompiledScene<f64>) -> Option<Self> {
        Self::with_width(plan, Width::widest()?)
    }

    fn linearise(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, &CellTerms<f64>),
    ) {
        let alone = |cell, pose: &_| evaluate::linearise(plan, cell, pose);
        self.each::<true, _>((plan, instant), wanted, Found::terms, alone, |cell, terms| sink(cell, &terms));
    }

    fn currents(
        &self,
        plan: &CompiledScene<f64>,
        instant: &Instant<'_, f64>,
        wanted: impl Fn(usize) -> bool,
        sink: impl FnMut(usize, [f64; 2]),
    ) {
        let alone = |cell, pose: &_| {
            let Pair { i_x1_a, i_x2_a } = evaluate::photocurrents(plan, cell, pose);
            [i_x1_a, i_x2_a]
        };
        self.each::<false, _>((plan, instant), wanted, Found::pair, alone, sink);
    }
}

/// As many cells as there are lanes, from number `first` on; `SLOPES`: with derivatives.
struct AtOnce<'a, const SLOPES: bool> {
    cells: &'a CellsInLanes,
    plan: &'a CompiledScene<f64>,
    instant: &'a Instant<'a, f64>,
    first: usize,
    found: &'a mut Found,
}

impl<const SLOPES: bool> AtOnce<'_, SLOPES> {
    #[inline(always)]
    fn all<R: Real<Element = f64>>(self, like: R) {
        let Self { cells, plan, instant, first, found } = self;
        let mut numbers = Loaded { like, first, numbers: cells.numbers.iter() };
        let CellLanes { receiver, source, path } = CellLanes::of(cells.kind, &mut numbers);
        let pose = moved(instant, like, first);
        let seen = receiver.see(&source, &pose);
        let zero = like.constant(0.0);
        let (beam, extended, electrical) = match path {
            Path::Imperfect(beam, extended, electrical) => (beam, extended, electrical),
            Path::Thin(_) | Path::Thick(_) => {
                let e = [seen.position.x(), seen.position.y(), seen.position.z()];
                let (spot, visibility) = match path {
                    Path::Thick(faces) => Rectangle::of_beam(faces, e, receiver.half),
                    Path::Thin(face) => Rectangle::of_beam([face], e, receiver.half),
                    Path::Imperfect(..) => return,
                };
                let light =
                    of_sides::<R, SLOPES>(&light::<R, SLOPES>(plan, first, &spot, &visibility, seen.axis), &spot, true);
                let (pair, jacobian) = if SLOPES {
                    let (pair, jacobian) = receiver.linearise(&source, &light, &seen, false);
                    (pair, Some(jacobian))
                } else {
                    let gain = receiver.responsivity * source.intensity;
                    (receiver.divide(gain * light.power.value, light.x_a.value(), false), None)
                };
                let pair = [visibility.where_spot(pair[0], zero), visibility.where_spot(pair[1], zero)];
                return found.set(&visibility, pair, jacobian);
            }
        };
        let (spot, visibility) = beam.spot::<SLOPES, SLOPES>(seen.position, receiver.half);
        let light = spot.of_sides::<SLOPES>(&light::<R, SLOPES>(plan, first, &spot.rectangle, &visibility, seen.axis));
        let (mut sums, one) = (Sums::none(zero), like.constant(1.0));
        let way = Way { turn: None, raise: (spot.raise.height, spot.raise.by_position), to_hole: None };
        let extended = extended.as_ref();
        sums.add::<SLOPES>(&receiver, &source, &seen, &pose, extended, &electrical, &light, &way, one);
        sums.total = visibility.where_spot(sums.total, zero);
        sums.moment = visibility.where_spot(sums.moment, zero);
        let (pair, jacobian) = electrical.currents::<SLOPES>(&receiver, false, &sums, one, pose.translation());
        found.set(&visibility, pair, SLOPES.then_some(jacobian));
    }
}

/// The light of the cell of each lane, from number `first` on; NaN where it must be evaluated alone.
#[inline(always)]
fn light<R: Real<Element = f64>, const SLOPES: bool>(
    plan: &CompiledScene<f64>,
    first: usize,
    spot: &Rectangle<R>,
    visibility: &Visibility<R>,
    axis: R::Vec3,
) -> RectangleLight<R> {
    let Some(rules) = &plan.rules else {
        let nothing = SideGradient::of_value(spot.height.constant(f64::NAN));
        return RectangleLight { power: nothing, centroid: nothing };
    };
    exact::rectangle_light_lanes::<R, SLOPES>(spot, axis, rules, |lane| {
        let emitter = &plan.cells.get(first + lane).filter(|_| visibility.status(lane).has_spot())?.emitter;
        Some((&emitter.profile, emitter.orders.as_ref()?))
    })
}

/// [`Instant::pose_of`] the cell of each lane, from number `first` on.
#[inline(always)]
fn moved<R: Real<Element = f64>>(instant: &Instant<'_, f64>, like: R, first: usize) -> Transform<R> {
    let pose = instant.pose.in_all_lanes(like);
    match instant.offsets_in_lanes(like, first) {
        Some(offset_s) => {
            let [shift, turn] = instant.displacement(offset_s);
            pose.moved(shift, turn)
        }
        None => pose,
    }
}

impl<const SLOPES: bool> Task for AtOnce<'_, SLOPES> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        self.all(Lanes::zero(instructions));
    }
}

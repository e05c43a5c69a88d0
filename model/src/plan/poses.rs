//! Cells at several poses, a pose per lane: what [`pack`](super::pack) does for several cells at one pose, with the
//! same bits.
//!
//! Where one formula does not serve all poses, currents of the others are NaN.

use crate::aperture::{Aperture, Face, Span};
use crate::lanes::{MAX_LANES, PerLane, set};
use crate::pose::{Pose, Transform};
use crate::power::SharedPower;
use crate::rectangle::Visibility;
use crate::response::{Pair, Status};
use crate::scalar::{Linear3, Real, Scalar};
use crate::scene::MAX_CELLS;
use crate::width::{Instructions, Lanes, Task, Width};
use crate::{exact, paper};

use super::optics::{Light, Receiver, Seen, Source, of_sides};
use super::pack::{Faces, Pack};
use super::{CompiledCell, CompiledEmitter, CurrentsJacobian, Plan};

/// A cell's currents at the pose of each lane.
pub(crate) struct Currents<R> {
    /// Photocurrents without dark current, amperes; zero without a spot.
    pub(crate) pair: [R; 2],
    /// One where there is a spot, else zero.
    pub(crate) lit: R,
    visibility: Visibility<R>,
}

/// A cell's currents and derivatives at the pose of each lane.
pub(crate) struct Terms<R> {
    pub(crate) currents: Currents<R>,
    pub(crate) jacobian: [[R; 6]; 2],
    /// See [`CellTerms`](super::CellTerms).
    pub(crate) slack_m: R,
}

impl Plan<f64> {
    /// Whether its cells can be evaluated at several poses at once.
    pub(crate) fn has_lanes(&self) -> bool {
        let is_integrated_at_once = |cell: &CompiledCell<f64>| {
            matches!(cell.aperture, Aperture::Thin(_) | Aperture::Thick(..))
                && cell.emitter.profile.as_cosine().is_some()
                && cell.emitter.orders.as_ref().is_some_and(|orders| !orders.is_narrow())
        };
        !self.packs.is_empty() || self.rules.is_some() && self.cells.iter().all(is_integrated_at_once)
    }

    /// Passes the numbers of pose and cell, and what [`Self::linearise`] gives there, to `sink`, for each cell at each of
    /// `poses`, in order; bit for bit, but faster: as many poses at once as `width` has lanes.
    pub fn linearise_many(
        &self,
        poses: &[Pose],
        width: Width,
        mut sink: impl FnMut(usize, usize, (Status, Pair<f64>, CurrentsJacobian<f64>)),
    ) {
        let has_lanes = self.has_lanes();
        let mut found = [const { PerPose::DARK }; MAX_CELLS];
        for (group, poses) in poses.chunks(width.lanes()).enumerate() {
            if has_lanes {
                self.linearise_group(poses, width, &mut found);
            }
            for (lane, pose) in poses.iter().enumerate() {
                for cell in 0..self.cell_count() {
                    let at_once = if has_lanes { found[cell].terms(lane) } else { None };
                    let terms = at_once.unwrap_or_else(|| self.linearise(cell, pose));
                    sink(group * width.lanes() + lane, cell, terms);
                }
            }
        }
    }

    /// All cells at no more `poses` than `width` has lanes.
    fn linearise_group(&self, poses: &[Pose], width: Width, found: &mut [PerPose; MAX_CELLS]) {
        width.run(Linearise { plan: self, poses, found });
    }

    /// Whether it is of the exact tier.
    pub(crate) fn is_exact(&self) -> bool {
        !self.is_paper
    }

    /// Currents and derivatives of cell `cell`, which [has lanes](Self::has_lanes), at `pose`. `EXACT`: the plan is of the
    /// exact tier.
    #[inline(always)]
    pub(crate) fn linearise_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        cell: usize,
        pose: &Transform<R>,
    ) -> Option<Terms<R>> {
        let cell = &self.cells[cell];
        let pack = Pack::in_all_lanes(cell, pose.translation().x())?;
        let seen = pack.receiver.see(&pack.source, pose);
        let (light, visibility) = self.light_lanes::<R, EXACT, true>(cell, &pack, &seen)?;
        let (pair, jacobian) = pack.receiver.linearise(&pack.source, &light, &seen, !EXACT);
        Some(Terms { currents: Currents::of(pair, visibility), jacobian, slack_m: visibility.slacks_m() })
    }

    /// Currents of cell `cell`, which [has lanes](Self::has_lanes), at `pose`. `EXACT`: the plan is of the exact tier.
    #[inline(always)]
    pub(crate) fn currents_lanes<R: Real<Element = f64>, const EXACT: bool>(
        &self,
        cell: usize,
        pose: &Transform<R>,
    ) -> Option<Currents<R>> {
        let cell = &self.cells[cell];
        let pack = Pack::in_all_lanes(cell, pose.translation().x())?;
        let seen = pack.receiver.see(&pack.source, pose);
        let (light, visibility) = self.light_lanes::<R, EXACT, false>(cell, &pack, &seen)?;
        let gain = pack.receiver.responsivity * pack.source.intensity;
        let pair = pack.receiver.divide(gain * light.power.value, light.x_a.value(), !EXACT);
        Some(Currents::of(pair, visibility))
    }

    /// The light of `cell`, which is `pack` in all lanes.
    #[inline(always)]
    fn light_lanes<R: Real<Element = f64>, const EXACT: bool, const GRADIENT: bool>(
        &self,
        cell: &CompiledCell<f64>,
        pack: &Pack<R, ()>,
        seen: &Seen<R>,
    ) -> Option<(Light<R>, Visibility<R>)> {
        let (spot, visibility) = pack.spot(seen);
        let CompiledEmitter { profile, orders, .. } = &cell.emitter;
        let light = if EXACT {
            let (orders, rules) = (orders.as_ref()?, self.rules.as_ref()?);
            exact::rectangle_light_lanes::<R, GRADIENT>(&spot, seen.axis, profile.as_cosine()?, orders, rules)
        } else {
            let emission = SharedPower::of(spot.height, profile.as_power()?);
            paper::rectangle_light::<R, _, GRADIENT>(&spot, seen.axis, &emission)
        };
        Some((of_sides::<R, GRADIENT>(&light, &spot, EXACT), visibility))
    }

    /// From the tool's origin to the emitter of cell `cell`, base frame, metres.
    #[inline(always)]
    pub(crate) fn arm_lanes<R: Real<Element = f64>>(&self, cell: usize, pose: &Transform<R>) -> R::Vec3 {
        pose.rotate(pose.translation().x().all3(self.cells[cell].emitter.source.position))
    }
}

/// What is found of one cell at the pose of each lane.
struct PerPose {
    statuses: [Status; MAX_LANES],
    /// NaN where it must be evaluated alone.
    pair: [PerLane; 2],
    jacobian: [[PerLane; 6]; 2],
}

impl PerPose {
    const DARK: Self =
        Self { statuses: [Status::Dark; MAX_LANES], pair: [[0.0; MAX_LANES]; 2], jacobian: [[[0.0; MAX_LANES]; 6]; 2] };

    fn terms(&self, lane: usize) -> Option<(Status, Pair<f64>, CurrentsJacobian<f64>)> {
        let status = self.statuses[lane];
        if !status.has_spot() {
            return Some((status, Pair::default(), [[0.0; 6]; 2]));
        }
        let [i_x1_a, i_x2_a] = self.pair.map(|current| current[lane]);
        let jacobian = self.jacobian.map(|row| row.map(|value| value[lane]));
        (!(i_x1_a + i_x2_a).is_nan()).then_some((status, Pair { i_x1_a, i_x2_a }, jacobian))
    }
}

/// All cells of a plan that [has lanes](Plan::has_lanes), at a pose per lane.
struct Linearise<'a> {
    plan: &'a Plan<f64>,
    poses: &'a [Pose],
    found: &'a mut [PerPose; MAX_CELLS],
}

impl Linearise<'_> {
    #[inline(always)]
    fn all<R: Real<Element = f64>, const EXACT: bool>(self, like: R) {
        let last = self.poses.len() - 1;
        let of = |lane: usize| &self.poses[lane.min(last)];
        let rotation = [
            like.each(|lane| of(lane).rotation.x),
            like.each(|lane| of(lane).rotation.y),
            like.each(|lane| of(lane).rotation.z),
            like.each(|lane| of(lane).rotation.w),
        ];
        let translation = R::Vec3::new(
            like.each(|lane| of(lane).translation_m.x),
            like.each(|lane| of(lane).translation_m.y),
            like.each(|lane| of(lane).translation_m.z),
        );
        let pose = Transform::of_parts(rotation, translation);
        for (cell, found) in self.found.iter_mut().enumerate().take(self.plan.cell_count()) {
            let Some(terms) = self.plan.linearise_lanes::<R, EXACT>(cell, &pose) else { return };
            for lane in 0..R::LANES {
                found.statuses[lane] = terms.currents.visibility.status(lane);
            }
            for row in 0..2 {
                set(&mut found.pair[row], terms.currents.pair[row]);
                for axis in 0..6 {
                    set(&mut found.jacobian[row][axis], terms.jacobian[row][axis]);
                }
            }
        }
    }
}

impl Task for Linearise<'_> {
    #[inline(always)]
    fn run<I: Instructions>(self, instructions: I) {
        let like = Lanes::zero(instructions);
        if self.plan.is_exact() { self.all::<_, true>(like) } else { self.all::<_, false>(like) }
    }
}

impl<R: Real> Currents<R> {
    #[inline(always)]
    fn of(pair: [R; 2], visibility: Visibility<R>) -> Self {
        let (zero, one) = (pair[0].constant(0.0), pair[0].constant(1.0));
        let [first, second] = pair;
        let pair = [visibility.where_spot(first, zero), visibility.where_spot(second, zero)];
        Self { pair, lit: visibility.where_spot(one, zero), visibility }
    }
}

impl<S: Scalar> Span<S> {
    #[inline(always)]
    fn in_all_lanes<R: Real<Element = S>>(&self, like: R) -> Span<R> {
        Span { low: like.all(self.low), high: like.all(self.high), length: like.all(self.length) }
    }
}

impl<S: Scalar> Face<S> {
    #[inline(always)]
    fn in_all_lanes<R: Real<Element = S>>(&self, like: R) -> Face<R> {
        Face { z: like.all(self.z), x: self.x.in_all_lanes(like), y: self.y.in_all_lanes(like) }
    }
}

impl<R: Real> Pack<R, ()> {
    /// `cell` without its profile in all lanes of `like`; `None` if it is of another kind.
    #[inline(always)]
    fn in_all_lanes(cell: &CompiledCell<R::Element>, like: R) -> Option<Self> {
        let (receiver, source) = (&cell.receiver, &cell.emitter.source);
        Some(Self {
            receiver: Receiver {
                axes: [like.all3(receiver.axes[0]), like.all3(receiver.axes[1]), like.all3(receiver.axes[2])],
                centre: like.all3(receiver.centre),
                half: [like.all(receiver.half[0]), like.all(receiver.half[1])],
                per_length: like.all(receiver.per_length),
                responsivity: like.all(receiver.responsivity),
                dark: like.all(receiver.dark),
            },
            faces: match &cell.aperture {
                Aperture::Thin(thin) => Faces::Thin(thin.in_all_lanes(like)),
                Aperture::Thick(lower, upper) => Faces::Thick([lower.in_all_lanes(like), upper.in_all_lanes(like)]),
                Aperture::Turned(_) | Aperture::Imperfect(_) => return None,
            },
            source: Source {
                position: like.all3(source.position),
                axis: like.all3(source.axis),
                intensity: like.all(source.intensity),
            },
            emission: (),
        })
    }
}

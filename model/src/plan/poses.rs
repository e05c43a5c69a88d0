//! One cell at several poses, a pose per lane: what [`pack`](super::pack) does for several cells at one pose, with the
//! same bits.
//!
//! Where one formula does not serve all poses, currents of the others are NaN.

use crate::aperture::{Aperture, Face, Span};
use crate::pose::Transform;
use crate::power::SharedPower;
use crate::rectangle::Visibility;
use crate::scalar::{Linear3, Real, Scalar};
use crate::{exact, paper};

use super::optics::{Light, Receiver, Seen, Source, of_sides};
use super::pack::{Faces, Pack};
use super::{CompiledCell, CompiledEmitter, Plan};

/// A cell's currents at the pose of each lane.
pub(crate) struct Currents<R> {
    /// Photocurrents without dark current, amperes; zero without a spot.
    pub(crate) pair: [R; 2],
    /// One where there is a spot, else zero.
    pub(crate) lit: R,
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
        Some(Terms { currents: Currents::of(pair, &visibility), jacobian, slack_m: visibility.slacks_m() })
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
        Some(Currents::of(pair, &visibility))
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

impl<R: Real> Currents<R> {
    #[inline(always)]
    fn of(pair: [R; 2], visibility: &Visibility<R>) -> Self {
        let (zero, one) = (pair[0].constant(0.0), pair[0].constant(1.0));
        let [first, second] = pair;
        let pair = [visibility.where_spot(first, zero), visibility.where_spot(second, zero)];
        Self { pair, lit: visibility.where_spot(one, zero) }
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

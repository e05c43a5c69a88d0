//! A cell with effects ([`crate::Effects`]): from light to currents.
//!
//! Cells without effects never come here. The light of every emitter that is lit adds its power and its moment, power
//! times position, so that stray light, other emitters and the points of an extended source need no case of their own.

pub mod beam;
pub mod electrical;
mod opening;
pub mod passage;
pub mod source;

use heapless::Vec;

use crate::effects::Effects;
use crate::entries::Scalar;
use crate::paper;
use crate::polygon::MAX_CORNERS;
use crate::pose::Transform;
use crate::response::{Flags, Integration, Pair, Response, Status};
use crate::scalar::{Linear3, Number, Real, array};
use crate::scene::Cell;

use self::beam::Beam;
use self::electrical::Electrical;
use self::opening::Opening;
use self::passage::{Passage, Passed, Way, pass};
use self::source::{CENTRE_WEIGHT, ExtendedSource, RING, RING_WEIGHT, azimuthal_factor};
use super::optics::{Light, Place, Receiver, Seen, Source};
use super::{CellTerms, CompiledCell, CompiledEmitter, CompiledScene, CurrentsJacobian};

#[derive(Clone, Debug)]
pub struct Imperfect<S: Number> {
    pub passage: Passage<S>,
    pub electrical: Electrical<S>,
    pub source: ExtendedSource<S>,
    pub lit_together: u16,
    pub other_axis: Option<usize>,
}

impl<S: Number> Imperfect<S> {
    /// `None`: the slit on the base is turned too far. The profile's radial part is in the cell's [`CompiledProfile`].
    pub fn compile(cell: &Cell, effects: &Effects) -> Option<Self> {
        Some(Self {
            passage: match Opening::compile(cell, effects.opening) {
                Some(opening) => Passage::Opening(opening),
                None => Passage::Beam(Beam::compile(&cell.slit, effects.window)?),
            },
            electrical: Electrical::compile(effects, 0.5 * cell.detector.length_m),
            source: ExtendedSource::compile(cell.emitter.axis_tool, effects),
            lit_together: effects.lit_together,
            other_axis: effects.other_axis,
        })
    }

    /// Where the light of a slit on the tool lands with the tool at home, tool frame.
    pub fn landing(&self) -> Option<S::Vec3> {
        match &self.passage {
            Passage::Opening(Opening::Riding(slit)) => Some(slit.landing),
            _ => None,
        }
    }
}

/// Light on a detector: power and moment in amperes and ampere metres, with derivatives by the pose; one detector per
/// lane.
#[derive(Clone, Copy)]
pub struct Sums<R> {
    pub total: R,
    pub moment: R,
    pub total_by: [R; 6],
    pub moment_by: [R; 6],
}

impl<R: Real> Sums<R> {
    #[inline(always)]
    pub fn none(zero: R) -> Self {
        Self { total: zero, moment: zero, total_by: [zero; 6], moment_by: [zero; 6] }
    }

    /// Adds the `light` of the point that is `seen`, which came by `way`, with a `weight`; its photocurrent.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "one point of one emitter through one cell")]
    pub fn add<const GRADIENT: bool>(
        &mut self,
        receiver: &Receiver<R>,
        source: &Source<R>,
        seen: &Seen<R>,
        pose: &Transform<R>,
        extended: Option<&ExtendedSource<R>>,
        electrical: &Electrical<R>,
        light: &Light<R>,
        way: &Way<R>,
        weight: R,
    ) -> R {
        let zero = weight.constant(0.0);
        let x_a = light.x_a.value();
        let gain = receiver.responsivity * source.intensity;
        let (mut power, mut of_power) = (gain * light.power.value, light.power);
        let (mut turned_by, mut x_by) = (zero.vector(), [zero; 6]);
        let (mut power_turn, mut x_turn) = (zero.vector(), zero.vector());
        if let Some([by_power, by_x]) = way.turn {
            (power_turn, x_turn) = (receiver.to_base(by_power), receiver.to_base(by_x));
        }
        let mut turned_with = power_turn * gain;
        if let Some((extended, coefficients)) = extended.and_then(|it| Some((it, it.azimuthal.as_ref()?))) {
            // The ray to the spot's centre, base frame.
            let e = seen.position;
            let to_spot = match way.to_hole {
                Some(to_hole) => to_hole,
                None => R::Vec3::new(x_a - e.x(), -e.y(), way.raise.0 - e.z()),
            };
            let per_distance = to_spot.length().inverse();
            let ray = receiver.to_base(to_spot) * per_distance;
            let [v_axis, w_axis] = extended.across;
            let (v_axis, w_axis) = (pose.rotate(v_axis), pose.rotate(w_axis));
            let (factor, by_ray) = azimuthal_factor::<R>(coefficients, [v_axis, w_axis, seen.axis_base], ray);
            if GRADIENT {
                // The ray turns as its ends move, and the tool turns under it.
                let by_end = receiver.to_cell(by_ray - ray * ray.dot(by_ray)) * per_distance;
                let (mut by_position, mut by_axis) = (way.raise.1 * by_end.z() - by_end, zero.vector());
                if let (Place::Weighted(x_a), None) = (&light.x_a, way.to_hole) {
                    by_position += x_a.by_position * by_end.x();
                    by_axis = x_a.by_axis * by_end.x();
                }
                of_power.by_position = of_power.by_position * factor + by_position * light.power.value;
                of_power.by_axis = of_power.by_axis * factor + by_axis * light.power.value;
                turned_by = by_ray.cross(ray) * power;
                turned_with = turned_with * factor + x_turn * (by_end.x() * power);
            }
            power = power * factor;
        }
        let mut power_by = x_by;
        if GRADIENT {
            let by_pose = receiver.of_pose(&of_power, seen);
            power_by = array(zero, |i| gain * by_pose[i]);
            if let Place::Weighted(x_a) = &light.x_a {
                x_by = receiver.of_pose(x_a, seen);
            }
            for (by, turned) in [(&mut power_by, turned_by + turned_with), (&mut x_by, x_turn)] {
                by[3] += turned.x();
                by[4] += turned.y();
                by[5] += turned.z();
            }
        }
        let (x_m, slope) = electrical.measured(x_a);
        self.total += weight * power;
        self.moment += weight * power * x_m;
        if GRADIENT {
            for i in 0..6 {
                self.total_by[i] += weight * power_by[i];
                self.moment_by[i] += weight * (power_by[i] * x_m + power * slope * x_by[i]);
            }
        }
        power
    }
}

/// What is known besides of the spot of the cell's own emitter.
struct Own<S: Number> {
    status: Status,
    slack_m: S,
    photocurrent: S,
    x_a: Option<S>,
    integration: Option<Integration<S>>,
}

impl<S: Number> Own<S> {
    fn none() -> Self {
        Self { status: Status::Lit, slack_m: S::infinity(), photocurrent: S::zero(), x_a: None, integration: None }
    }

    /// Adds a point of the disc; `x_a` is the moment of the light.
    fn join(&mut self, point: &Result<Self, Status>, weight: S) {
        let Ok(point) = point else {
            self.status = Status::Clipped;
            return;
        };
        if point.status != Status::Lit {
            self.status = Status::Clipped;
        }
        let light = weight * point.photocurrent;
        self.photocurrent += light;
        if let Some(x_a) = point.x_a {
            self.x_a = Some(self.x_a.unwrap_or_default() + light * x_a);
        }
        self.slack_m = self.slack_m.min(point.slack_m);
        self.integration = point.integration;
    }
}

/// Adds the light of one point of the emitter of cell `of` to `sums`, with a `weight`.
#[allow(clippy::too_many_arguments, reason = "one point of one emitter through one cell")]
fn add_point<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    passage: &Passage<S>,
    emitter: &CompiledEmitter<S>,
    source: &Source<S>,
    extended: Option<&ExtendedSource<S>>,
    pose: &Transform<S>,
    weight: S,
    sums: &mut Sums<S>,
) -> Result<Own<S>, Status> {
    let receiver = &cell.receiver;
    let seen = receiver.see(source, pose);
    let passed = pass::<S, GRADIENT>(plan, cell, passage, emitter, source, &seen, pose)?;
    let Passed { light, way, integration, status, slack_m } = passed;
    let Some(light) = light else {
        return Ok(Own { status, slack_m, photocurrent: S::zero(), x_a: None, integration });
    };
    let electrical = &imperfect.electrical;
    let power = sums.add::<GRADIENT>(receiver, source, &seen, pose, extended, electrical, &light, &way, weight);
    Ok(Own { status, slack_m, photocurrent: power, x_a: Some(light.x_a.value()), integration })
}

/// Adds the light of the emitter of cell `of`; what is known of the spot of its centre.
fn add_emitter<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    of: &CompiledCell<S>,
    pose: &Transform<S>,
    sums: &mut Sums<S>,
) -> Result<Own<S>, Status> {
    let emitter = &of.emitter;
    let its = of.imperfect.as_ref();
    let extended = its.map(|imperfect| &imperfect.source);
    // Light passes the slit that rides with its emitter, else the opening of the cell.
    let rides = |it: &&Imperfect<S>| matches!(it.passage, Passage::Opening(Opening::Riding(_)));
    let passage = &its.filter(rides).unwrap_or(imperfect).passage;
    let mut add = |source: &Source<S>, weight: S| {
        add_point::<S, GRADIENT>(plan, cell, imperfect, passage, emitter, source, extended, pose, weight, sums)
    };
    let Some(disc) = extended.filter(|source| source.radius > S::zero()) else {
        return add(&emitter.source, S::one());
    };
    let mut whole = Own::none();
    let mut join = |point: &Source<S>, weight: S| {
        let point = add(point, weight);
        whole.join(&point, weight);
        point.err()
    };
    for [v, w] in RING {
        let offset = disc.across[0] * (disc.radius * S::of(v)) + disc.across[1] * (disc.radius * S::of(w));
        let point = Source { position: emitter.source.position + offset, ..emitter.source.clone() };
        join(&point, S::of(RING_WEIGHT));
    }
    let missing = join(&emitter.source, S::of(CENTRE_WEIGHT));
    let is_lit = whole.photocurrent > S::zero();
    whole.x_a = whole.x_a.filter(|_| is_lit).map(|moment| moment / whole.photocurrent);
    match missing {
        Some(status) if !is_lit => Err(status),
        Some(_) => Ok(Own { slack_m: S::zero(), ..whole }),
        None => Ok(whole),
    }
}

/// The currents of all light on the detector of `cell`, their derivatives, and what is known of the spot of its own emitter.
fn gather<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    pose: &Transform<S>,
) -> ([S; 2], CurrentsJacobian<S>, Result<Own<S>, Status>) {
    let mut sums = Sums::none(S::zero());
    let own = add_emitter::<S, GRADIENT>(plan, cell, imperfect, cell, pose, &mut sums);
    if imperfect.lit_together != 0 {
        for (number, other) in plan.cells.iter().enumerate() {
            if imperfect.lit_together >> number & 1 == 1 {
                // Light that does not reach the slit adds nothing.
                let _ = add_emitter::<S, GRADIENT>(plan, cell, imperfect, other, pose, &mut sums);
            }
        }
    }
    let at = (pose.translation(), pose);
    let (pair, jacobian) =
        imperfect.electrical.currents::<GRADIENT>(&cell.receiver, plan.is_paper, &sums, S::one(), at);
    (pair, jacobian, own)
}

#[cold]
#[inline(never)]
pub fn photocurrents<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    pose: &Transform<S>,
) -> Pair<S> {
    let ([i_x1_a, i_x2_a], ..) = gather::<S, false>(plan, cell, imperfect, pose);
    Pair { i_x1_a, i_x2_a }
}

#[cold]
#[inline(never)]
pub fn linearise<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    pose: &Transform<S>,
) -> CellTerms<S> {
    let (pair, jacobian, own) = gather::<S, true>(plan, cell, imperfect, pose);
    match own {
        Ok(Own { status, slack_m, .. }) => CellTerms { status, pair, jacobian, slack_m, wall_m: S::infinity() },
        // Without direct light, what is left says next to nothing of the pose.
        Err(status) => CellTerms { pair, ..CellTerms::dark(status) },
    }
}

#[cold]
#[inline(never)]
pub fn respond<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    pose: &Transform<S>,
) -> Response<S> {
    let receiver = &cell.receiver;
    let (pair, _, own) = gather::<S, false>(plan, cell, imperfect, pose);
    let half_dark = S::half() * receiver.dark;
    let currents = Pair { i_x1_a: pair[0] + half_dark, i_x2_a: pair[1] + half_dark };
    let i_o_a = currents.total_a();
    let saturated = cell.saturation.is_some_and(|limit| i_o_a > limit);
    let seen = receiver.see(&cell.emitter.source, pose);
    let beam = imperfect.middle_beam(plan.is_paper, cell, &seen, pose);
    let own = match own {
        Ok(own) => own,
        Err(status) => {
            let flags = Flags { saturated, faint: cell.faint > S::zero(), facing_away: false };
            return Response::without_spot(status, flags, currents);
        }
    };
    // Of a disc whose edge alone is seen, the centre has no beam.
    let beam = beam.ok();
    let cosine = beam.as_ref().map(|beam| beam.cosine);
    Response {
        status: own.status,
        flags: Flags {
            saturated,
            faint: own.photocurrent < cell.faint,
            facing_away: cosine.is_some_and(|cosine| cosine <= S::zero()),
        },
        x_a_m: own.x_a,
        gamma_rad: cosine.map(|cosine| cosine.max(-S::one()).min(S::one()).arc_cosine()),
        solid_angle_sr: beam.map_or(S::zero(), |beam| beam.solid_angle),
        i_o_a,
        currents,
        integration: own.integration,
    }
}

impl<S: Number> Imperfect<S> {
    /// Solid angle and angle of emission of the light of the emitter's centre.
    fn middle_beam(
        &self,
        is_paper: bool,
        cell: &CompiledCell<S>,
        seen: &Seen<S>,
        pose: &Transform<S>,
    ) -> Result<paper::Beam<S>, Status> {
        match &self.passage {
            Passage::Beam(beam) => {
                let (spot, visibility) = beam.spot::<false, false>(seen.position, cell.receiver.half);
                visibility.spot()?;
                let beam = paper::rectangle_beam(&spot.rectangle, seen.axis);
                if is_paper {
                    return Ok(beam);
                }
                Ok(paper::Beam { solid_angle: super::evaluate::rectangle_solid_angle(&spot.rectangle), ..beam })
            }
            Passage::Opening(opening) => {
                let spot = opening.spot(&cell.receiver, &cell.emitter.source, seen, pose)?;
                let ray = spot.middle();
                Ok(paper::Beam { solid_angle: spot.polygon.solid_angle(), cosine: seen.axis.dot(ray) / ray.length() })
            }
        }
    }
}

pub fn outline<S: Number>(
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    pose: &Transform<S>,
) -> Vec<[S; 2], MAX_CORNERS> {
    let seen = cell.receiver.see(&cell.emitter.source, pose);
    let beam = match &imperfect.passage {
        Passage::Beam(beam) => beam,
        Passage::Opening(opening) => {
            let spot = opening.spot(&cell.receiver, &cell.emitter.source, &seen, pose);
            return spot.map_or_else(|_| Vec::new(), |spot| spot.outline());
        }
    };
    let (spot, visibility) = beam.spot::<false, false>(seen.position, cell.receiver.half);
    if visibility.spot().is_err() {
        return Vec::new();
    }
    let corners = spot.rectangle.corners().into_iter();
    corners.map(|[x, y]| [x + seen.position.x(), y + seen.position.y()]).collect()
}

/// See [`CompiledScene::photocurrents_of`]; of the emitter of each cell in `lit`, at its level.
pub fn photocurrents_of_emitters<'a, S: Scalar>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    imperfect: &Imperfect<S>,
    lit: impl Iterator<Item = (&'a CompiledCell<S>, S)>,
    pose: &Transform<S>,
) -> Pair<S> {
    let (mut sums, mut own_level) = (Sums::none(S::zero()), S::zero());
    for (of, level) in lit {
        let mut light = Sums::none(S::zero());
        // Light that does not reach the slit adds nothing.
        let _ = add_emitter::<S, false>(plan, cell, imperfect, of, pose, &mut light);
        sums.total += level * light.total;
        sums.moment += level * light.moment;
        if core::ptr::eq(of, cell) {
            own_level = level;
        }
    }
    let ([i_x1_a, i_x2_a], _) = imperfect.electrical.currents::<false>(
        &cell.receiver,
        plan.is_paper,
        &sums,
        own_level,
        (pose.translation(), pose),
    );
    Pair { i_x1_a, i_x2_a }
}

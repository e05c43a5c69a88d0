//! The way of the light of one point through one cell, whatever stands in it: a slit on the base with or without a window,
//! or another opening.

use crate::entries::Scalar;
use crate::exact::{self, Method, Turn};
use crate::paper;
use crate::pose::Transform;
use crate::response::{Integration, Status};
use crate::scalar::{Number, Real};

use super::super::optics::{Light, Seen, Source};
use super::super::{CompiledCell, CompiledEmitter, CompiledScene};
use super::beam::{Beam, Spot};
use super::opening::Opening;

#[derive(Clone, Debug)]
pub enum Passage<S: Number> {
    /// A slit on the base.
    Beam(Beam<S>),
    Opening(Opening<S>),
}

/// The light of one point of an emitter through one cell.
pub struct Passed<S: Number> {
    pub light: Option<Light<S>>,
    pub way: Way<S>,
    pub integration: Option<Integration<S>>,
    pub status: Status,
    pub slack_m: S,
}

/// How light came to a detector; one per lane.
pub struct Way<R: Real> {
    /// What a turn of a slit on the tool adds to the derivatives.
    pub turn: Option<Turn<R>>,
    /// How far a window raises the detector, and its derivatives by the emitter's position.
    pub raise: (R, R::Vec3),
    /// From the emitter to the middle of a hole, which all light passes; `None`: light lands near the middle line.
    pub to_hole: Option<R::Vec3>,
}

/// Light of `emission` through what cell `cell` has in its way.
#[allow(clippy::too_many_arguments, reason = "one point of one emitter through one cell")]
pub fn pass<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    passage: &Passage<S>,
    emitter: &CompiledEmitter<S>,
    source: &Source<S>,
    seen: &Seen<S>,
    pose: &Transform<S>,
) -> Result<Passed<S>, Status> {
    match passage {
        Passage::Beam(beam) => {
            let (spot, visibility) = beam.spot::<GRADIENT, GRADIENT>(seen.position, cell.receiver.half);
            let status = visibility.spot()?;
            let (light, integration) = light::<S, GRADIENT>(plan, emitter, seen, &spot);
            let way = Way { turn: None, raise: (spot.raise.height, spot.raise.by_position), to_hole: None };
            Ok(Passed { light, way, integration, status, slack_m: visibility.slack_m(0) })
        }
        Passage::Opening(opening) => {
            let orders = emitter.orders.as_ref().or(cell.emitter.orders.as_ref());
            // A plan with an opening has rules, and its cell orders.
            let (Some(orders), Some(rules)) = (orders, &plan.rules) else { return Err(Status::Dark) };
            let method = Method { emission: &emitter.profile, orders, rules };
            opening.pass::<GRADIENT>(&cell.receiver, source, seen, pose, &method)
        }
    }
}

fn light<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    emitter: &CompiledEmitter<S>,
    seen: &Seen<S>,
    spot: &Spot<S>,
) -> (Option<Light<S>>, Option<Integration<S>>) {
    let (rectangle, emission) = (&spot.rectangle, &emitter.profile);
    let (Some(orders), Some(rules)) = (&emitter.orders, &plan.rules) else {
        let light = paper::rectangle_light::<S, _, GRADIENT>(rectangle, seen.axis, emission);
        return (Some(spot.of_sides::<GRADIENT>(&light)), None);
    };
    if exact::faces_away(rectangle, seen.axis) {
        return (None, None);
    }
    let method = Method { emission, orders, rules };
    if let Some((light, evaluations)) = exact::rectangle_light::<S, GRADIENT>(rectangle, seen.axis, &method) {
        let integration = Integration { evaluations, relative_error: orders.tolerance() };
        return (Some(spot.of_sides::<GRADIENT>(&light)), Some(integration));
    }
    let (light, integration) = exact::divided_light::<S, GRADIENT>(rectangle, || spot.motions(), seen.axis, &method);
    (light.map(|(light, _)| spot.of_polygon(light)), Some(integration))
}

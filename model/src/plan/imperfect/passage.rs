//! The way of the light of one point through one cell, whatever stands in it: a slit on the base with or without a window,
//! or another opening.

use crate::entries::Scalar;
use crate::exact::{self, Orders, Rules, Turn};
use crate::paper;
use crate::polygon::{EmitterGradient, Polygon};
use crate::pose::Transform;
use crate::profile::Emission;
use crate::rectangle::{Rectangle, RectangleLight, SideGradient};
use crate::response::{Integration, Status};
use crate::scalar::{Linear3, Number, Real};

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

/// Step of differences by the sides of a spot, in units of its half extent.
const STEP: f64 = 1e-4;

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
pub fn pass<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    passage: &Passage<S>,
    emitter: &CompiledEmitter<S>,
    emission: &E,
    source: &Source<S>,
    seen: &Seen<S>,
    pose: &Transform<S>,
) -> Result<Passed<S>, Status> {
    match passage {
        Passage::Beam(beam) => {
            let (spot, visibility) = beam.spot::<GRADIENT, GRADIENT>(seen.position, cell.receiver.half);
            let status = visibility.spot()?;
            let (light, integration) = light::<S, E, GRADIENT>(plan, emitter, emission, seen, &spot);
            let way = Way { turn: None, raise: (spot.raise.height, spot.raise.by_position), to_hole: None };
            Ok(Passed { light, way, integration, status, slack_m: visibility.slack_m(0) })
        }
        Passage::Opening(opening) => {
            let spot = opening.spot(&cell.receiver, source, seen, pose)?;
            let orders = emitter.orders.as_ref().or(cell.emitter.orders.as_ref());
            // A plan with an opening has rules, and its cell orders.
            let (Some(orders), Some(rules)) = (orders, &plan.rules) else { return Err(Status::Dark) };
            let (light, integration) = spot.light::<E, GRADIENT>(seen, emission, orders, rules);
            let (light, turn) = light.unzip();
            let raise = (S::zero(), S::Vec3::default());
            let integration = Some(integration);
            let to_hole = opening.hole_centre().map(|centre| centre - seen.position);
            let way = Way { turn, raise, to_hole };
            Ok(Passed { light, way, integration, status: spot.status, slack_m: S::zero() })
        }
    }
}

fn light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    emitter: &CompiledEmitter<S>,
    emission: &E,
    seen: &Seen<S>,
    spot: &Spot<S>,
) -> (Option<Light<S>>, Option<Integration<S>>) {
    let rectangle = &spot.rectangle;
    let (Some(orders), Some(rules)) = (&emitter.orders, &plan.rules) else {
        let light = paper::rectangle_light::<S, E, GRADIENT>(rectangle, seen.axis, emission);
        return (Some(spot.of_sides::<GRADIENT>(&light)), None);
    };
    if exact::faces_away(rectangle, seen.axis) {
        return (None, None);
    }
    if let Some((light, evaluations)) =
        exact::rectangle_light::<S, E, GRADIENT>(rectangle, seen.axis, emission, orders, rules)
    {
        let integration = Integration { evaluations, relative_error: orders.tolerance() };
        return (Some(spot.of_sides::<GRADIENT>(&light)), Some(integration));
    }
    divided::<S, E, GRADIENT>(spot, seen, emission, orders, rules)
}

/// The light of a spot that one tensor rule cannot integrate. Its derivatives by the sides are differences.
#[cold]
fn divided<S: Number, E: Emission<S>, const GRADIENT: bool>(
    spot: &Spot<S>,
    seen: &Seen<S>,
    emission: &E,
    orders: &Orders<S>,
    rules: &Rules<S>,
) -> (Option<Light<S>>, Option<Integration<S>>) {
    let of = |rectangle: &Rectangle<S>| {
        let polygon = Polygon::of_rectangle(rectangle);
        let (light, integration) = exact::polygon_light::<S, E, GRADIENT>(polygon, seen.axis, emission, orders, rules);
        // The centroid from the emitter's foot to the middle of the spot.
        let light = light.map(|(power, centroid)| {
            (power, EmitterGradient { value: centroid.value - rectangle.x.middle, ..centroid })
        });
        (light, integration)
    };
    let (light, integration) = of(&spot.rectangle);
    let Some((power, centroid)) = light else {
        return (None, Some(integration));
    };
    let quantity = |of: &EmitterGradient<S>| SideGradient {
        value: of.value,
        by_side: [S::zero(); 4],
        by_height: of.by_position.z(),
        by_axis: of.by_axis,
    };
    let mut light = RectangleLight { power: quantity(&power), centroid: quantity(&centroid) };
    if GRADIENT {
        let step = S::of(STEP) * spot.rectangle.x.half.min(spot.rectangle.y.half);
        let per_step = (S::two() * step).recip();
        for side in 0..4 {
            let [after, before] = [step, -step].map(|by| {
                let moved = spot.rectangle.with_side_moved(side, by);
                of(&moved).0.map(|(power, centroid)| [power.value, centroid.value + moved.x.middle])
            });
            if let (Some(after), Some(before)) = (after, before) {
                light.power.by_side[side] = (after[0] - before[0]) * per_step;
                light.centroid.by_side[side] = (after[1] - before[1]) * per_step;
            }
        }
    }
    (Some(spot.of_sides::<GRADIENT>(&light)), Some(integration))
}

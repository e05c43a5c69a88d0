//! The hot path: one cell, one pose.

use heapless::Vec;

use crate::aperture::Aperture;
use crate::entries::Scalar;
use crate::exact::{self, Method, Orders, PolygonLight};
use crate::paper;
use crate::polygon::{EmitterGradient, MAX_CORNERS, Polygon, fan_solid_angle};
use crate::pose::Transform;
use crate::rectangle::Rectangle;
use crate::response::{Flags, Integration, Pair, Response, Status};
use crate::scalar::{Linear3, Number};

use super::optics::{Light, Place, Seen, of_sides};
use super::{CellTerms, CompiledCell, CompiledEmitter, CompiledScene, imperfect};

impl<S: Number> CompiledCell<S> {
    #[inline(always)]
    fn spot(&self, seen: &Seen<S>) -> Result<(Spot<S>, Status, S), Status> {
        let e = seen.position;
        let (emitter, half) = ([e.x(), e.y(), e.z()], self.receiver.half);
        let (rectangle, verdict) = match &self.aperture {
            Aperture::Thin(face) => Rectangle::of_beam([*face], emitter, half),
            Aperture::Thick(lower, upper) => Rectangle::of_beam([*lower, *upper], emitter, half),
            Aperture::Turned(slit) => {
                return Polygon::of_beam(slit, e, half)
                    .map(|(polygon, status)| (Spot::Polygon(polygon), status, S::zero()));
            }
        };
        verdict.spot().map(|status| (Spot::Rectangle(rectangle), status, verdict.slack_m(0)))
    }
}

#[allow(clippy::large_enum_variant, reason = "lives on the stack for one evaluation")]
enum Spot<S: Number> {
    Rectangle(Rectangle<S>),
    Polygon(Polygon<S>),
}

/// The light of a spot, if any, and the cost and accuracy of its integrals, if any.
#[inline(always)]
fn light<S: Scalar, const GRADIENT: bool>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    emitter: &CompiledEmitter<S>,
    seen: &Seen<S>,
    spot: &Spot<S>,
) -> (Option<Light<S>>, Option<Integration<S>>) {
    let (axis, emission) = (seen.axis, &emitter.profile);
    if let Spot::Rectangle(rectangle) = spot
        && emitter.orders.is_some()
        && exact::faces_away(rectangle, axis)
    {
        return (None, None);
    }
    let (found, integration) = match (&emitter.orders, &plan.rules, spot) {
        (Some(orders), Some(rules), Spot::Rectangle(rectangle)) => {
            let method = Method { emission, orders, rules };
            if let Some((light, evaluations)) = exact::rectangle_light::<S, GRADIENT>(rectangle, axis, &method) {
                let integration = Integration { evaluations, relative_error: orders.tolerance() };
                return (Some(of_sides::<S, GRADIENT>(&light, rectangle, true)), Some(integration));
            }
            exact::divided_light::<S, GRADIENT>(rectangle, || rectangle.motions(), axis, &method)
        }
        (Some(orders), Some(rules), Spot::Polygon(polygon)) => {
            let method = Method { emission, orders, rules };
            exact::polygon_light::<S, GRADIENT>(polygon.clone(), axis, &method)
        }
        (_, _, Spot::Rectangle(rectangle)) => {
            let light = paper::rectangle_light::<S, _, GRADIENT>(rectangle, axis, emission);
            return (Some(of_sides::<S, GRADIENT>(&light, rectangle, false)), None);
        }
        (_, _, Spot::Polygon(polygon)) => {
            let light = paper::polygon_light::<S, _, GRADIENT>(polygon, axis, emission, cell.aperture.skew());
            return (Some(weighted(light, seen)), None);
        }
    };
    (found.map(|(light, _)| weighted(light, seen)), Some(integration))
}

fn weighted<S: Number>((power, centroid): PolygonLight<S>, seen: &Seen<S>) -> Light<S> {
    let x_a = EmitterGradient { value: seen.position.x() + centroid.value, ..centroid };
    Light { power, x_a: Place::Weighted(x_a) }
}

pub fn photocurrents<S: Scalar>(plan: &CompiledScene<S>, cell: usize, base_from_tool: &Transform<S>) -> Pair<S> {
    let cell = &plan.cells[cell];
    if let Some(imperfect) = &cell.imperfect {
        return imperfect::photocurrents(plan, cell, imperfect, base_from_tool);
    }
    photocurrents_of(plan, cell, &cell.emitter, base_from_tool)
}

#[inline(never)]
fn photocurrents_of<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: &CompiledCell<S>,
    emitter: &CompiledEmitter<S>,
    base_from_tool: &Transform<S>,
) -> Pair<S> {
    let seen = cell.receiver.see(&emitter.source, base_from_tool);
    let Ok((spot, ..)) = cell.spot(&seen) else {
        return Pair::default();
    };
    match light::<S, false>(plan, cell, emitter, &seen, &spot).0 {
        Some(light) => {
            let photocurrent = cell.receiver.responsivity * emitter.source.intensity * light.power.value;
            let [i_x1_a, i_x2_a] = cell.receiver.divide(photocurrent, light.x_a.value(), plan.is_paper);
            Pair { i_x1_a, i_x2_a }
        }
        None => Pair::default(),
    }
}

#[inline(never)]
pub fn linearise<S: Scalar>(plan: &CompiledScene<S>, cell: usize, base_from_tool: &Transform<S>) -> CellTerms<S> {
    let cell = &plan.cells[cell];
    if let Some(imperfect) = &cell.imperfect {
        return imperfect::linearise(plan, cell, imperfect, base_from_tool);
    }
    let seen = cell.receiver.see(&cell.emitter.source, base_from_tool);
    let (spot, status, slack_m) = match cell.spot(&seen) {
        Ok(spot) => spot,
        Err(status) => return CellTerms::dark(status),
    };
    let Some(light) = light::<S, true>(plan, cell, &cell.emitter, &seen, &spot).0 else {
        return CellTerms::dark(status);
    };
    let (pair, jacobian) = cell.receiver.linearise(&cell.emitter.source, &light, &seen, plan.is_paper);
    CellTerms { status, pair, jacobian, slack_m, wall_m: S::infinity() }
}

pub fn respond<S: Scalar>(plan: &CompiledScene<S>, cell: usize, base_from_tool: &Transform<S>) -> Response<S> {
    let cell = &plan.cells[cell];
    if let Some(imperfect) = &cell.imperfect {
        return imperfect::respond(plan, cell, imperfect, base_from_tool);
    }
    let CompiledCell { receiver, emitter, .. } = cell;
    let seen = receiver.see(&emitter.source, base_from_tool);
    let half_dark = S::half() * receiver.dark;
    let (spot, status, _) = match cell.spot(&seen) {
        Ok(spot) => spot,
        Err(status) => {
            let flags = Flags { faint: cell.faint > S::zero(), ..Flags::default() };
            return Response::without_spot(status, flags, Pair { i_x1_a: half_dark, i_x2_a: half_dark });
        }
    };
    let beam = match &spot {
        Spot::Rectangle(rectangle) => paper::rectangle_beam(rectangle, seen.axis),
        Spot::Polygon(polygon) => paper::polygon_beam(polygon, seen.axis, cell.aperture.skew()),
    };
    let (light, integration) = light::<S, false>(plan, cell, emitter, &seen, &spot);
    let rounding = emitter.orders.as_ref().map_or(S::zero(), Orders::rounding);
    let power = light.as_ref().map_or(S::zero(), |light| light.power.value);
    let photocurrent = receiver.responsivity * emitter.source.intensity * power;
    let x_a = light.as_ref().map(|light| light.x_a.value());
    let above_dark = receiver.divide(photocurrent, x_a.unwrap_or_default(), plan.is_paper);
    let i_o = photocurrent + receiver.dark;
    Response {
        status,
        flags: Flags {
            saturated: cell.saturation.is_some_and(|limit| i_o > limit),
            faint: photocurrent < cell.faint,
            facing_away: beam.cosine <= S::zero(),
        },
        x_a_m: x_a,
        gamma_rad: Some(beam.cosine.max(-S::one()).min(S::one()).arc_cosine()),
        solid_angle_sr: if plan.is_paper { beam.solid_angle } else { exact_solid_angle(&spot) },
        i_o_a: i_o,
        currents: Pair { i_x1_a: above_dark[0] + half_dark, i_x2_a: above_dark[1] + half_dark },
        integration: integration
            .map(|reached| Integration { relative_error: reached.relative_error.max(rounding), ..reached }),
    }
}

fn exact_solid_angle<S: Number>(spot: &Spot<S>) -> S {
    match spot {
        Spot::Rectangle(rectangle) => rectangle_solid_angle(rectangle),
        Spot::Polygon(polygon) => polygon.solid_angle(),
    }
}

pub fn rectangle_solid_angle<S: Number>(rectangle: &Rectangle<S>) -> S {
    let [a, b, c, d] = rectangle.corners();
    let half_area = S::of(4.0) * rectangle.x.half * rectangle.y.half;
    fan_solid_angle(a, [(half_area, b, c), (half_area, c, d)].into_iter(), rectangle.height)
}

pub fn outline<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: usize,
    base_from_tool: &Transform<S>,
) -> Vec<[S; 2], MAX_CORNERS> {
    let cell = &plan.cells[cell];
    if let Some(imperfect) = &cell.imperfect {
        return imperfect::outline(cell, imperfect, base_from_tool);
    }
    let seen = cell.receiver.see(&cell.emitter.source, base_from_tool);
    let on_detector = |[x, y]: [S; 2]| [x + seen.position.x(), y + seen.position.y()];
    match cell.spot(&seen) {
        Ok((Spot::Rectangle(rectangle), ..)) => rectangle.corners().into_iter().map(on_detector).collect(),
        Ok((Spot::Polygon(polygon), ..)) => polygon.corners().iter().copied().map(on_detector).collect(),
        Err(_) => Vec::new(),
    }
}

pub fn photocurrents_of_emitters<S: Scalar>(
    plan: &CompiledScene<S>,
    cell: usize,
    lit: impl Iterator<Item = (usize, S)>,
    base_from_tool: &Transform<S>,
) -> Pair<S> {
    let lit = lit.filter(|&(emitter, _)| plan.has_emitter(cell, emitter));
    let cell = &plan.cells[cell];
    let lit = lit.map(|(emitter, level)| (&plan.cells[emitter], level));
    if let Some(imperfect) = &cell.imperfect {
        return imperfect::photocurrents_of_emitters(plan, cell, imperfect, lit, base_from_tool);
    }
    lit.fold(Pair::default(), |sum: Pair<S>, (of, level)| {
        let pair = photocurrents_of(plan, cell, &of.emitter, base_from_tool);
        Pair { i_x1_a: sum.i_x1_a + level * pair.i_x1_a, i_x2_a: sum.i_x2_a + level * pair.i_x2_a }
    })
}

//! The hot path: one cell, one pose.

use heapless::Vec;

use crate::aperture::Aperture;
use crate::exact;
use crate::paper;
use crate::polygon::{EmitterGradient, MAX_CORNERS, Polygon};
use crate::pose::Transform;
use crate::profile::{CompiledProfile, Emission};
use crate::rectangle::{Rectangle, RectangleLight, SideGradient};
use crate::response::{Flags, Pair, Response, Status};
use crate::scalar::{Scalar, Vector3};
use crate::solid_angle;

use super::{CompiledCell, CompiledEmitter, CurrentsJacobian, Plan, Receiver};

/// An emitter as a cell sees it: cell frame.
struct Seen<S: Scalar> {
    position: S::Vec3,
    axis: S::Vec3,
}

impl<S: Scalar> Receiver<S> {
    #[inline(always)]
    fn to_cell(&self, base: S::Vec3) -> S::Vec3 {
        S::Vec3::new(self.axes[0].dot(base), self.axes[1].dot(base), self.axes[2].dot(base))
    }

    #[inline(always)]
    fn to_base(&self, cell: S::Vec3) -> S::Vec3 {
        self.axes[0] * cell.x() + self.axes[1] * cell.y() + self.axes[2] * cell.z()
    }

    #[inline(always)]
    fn see(&self, emitter: &CompiledEmitter<S>, base_from_tool: &Transform<S>) -> Seen<S> {
        let position = base_from_tool.rotate(emitter.position) + base_from_tool.translation();
        Seen { position: self.to_cell(position - self.centre), axis: self.to_cell(base_from_tool.rotate(emitter.axis)) }
    }

    #[inline(always)]
    fn spot(&self, seen: &Seen<S>) -> Result<(Spot<S>, Status), Status> {
        let e = seen.position;
        let emitter = [e.x(), e.y(), e.z()];
        match &self.aperture {
            Aperture::Thin(face) => rectangle(Rectangle::of_beam([*face], emitter, self.half)),
            Aperture::Thick(lower, upper) => rectangle(Rectangle::of_beam([*lower, *upper], emitter, self.half)),
            Aperture::Turned(_) => {
                Polygon::of_beam(&self.aperture, e, self.half).map(|(polygon, status)| (Spot::Polygon(polygon), status))
            }
        }
    }
}

#[inline(always)]
fn rectangle<S: Scalar>(spot: Result<(Rectangle<S>, Status), Status>) -> Result<(Spot<S>, Status), Status> {
    spot.map(|(rectangle, status)| (Spot::Rectangle(rectangle), status))
}

/// The spot's geometry.
#[allow(clippy::large_enum_variant, reason = "lives on the stack for one evaluation")]
enum Spot<S: Scalar> {
    Rectangle(Rectangle<S>),
    Polygon(Polygon<S>),
}

/// Power per axial intensity (∫ I_rel dΩ, steradians) and X_A (metres, cell frame), with
/// derivatives by the emitter in the cell frame.
struct Light<S: Scalar> {
    power: EmitterGradient<S>,
    x_a: EmitterGradient<S>,
}

/// The light of a spot; `None` if the emitter faces away from all of it.
#[inline(always)]
fn light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    plan: &Plan<S>,
    receiver: &Receiver<S>,
    emitter: &CompiledEmitter<S>,
    emission: &E,
    seen: &Seen<S>,
    spot: &Spot<S>,
) -> Option<Light<S>> {
    let axis = seen.axis;
    if let Spot::Rectangle(rectangle) = spot
        && emitter.orders.is_some()
        && exact::faces_away(rectangle, axis)
    {
        return None;
    }
    let (power, centroid) = match (&emitter.orders, &plan.rules, spot) {
        (Some(orders), Some(rules), Spot::Rectangle(rectangle)) => {
            match exact::rectangle_light::<S, E, GRADIENT>(rectangle, axis, emission, orders, rules) {
                Some(light) => return Some(of_sides::<S, GRADIENT>(&light, rectangle, seen)),
                None => divided::<S, E, GRADIENT>(plan, receiver, emitter, emission, seen)?,
            }
        }
        (Some(orders), Some(rules), Spot::Polygon(polygon)) => {
            exact::polygon_light::<S, E, GRADIENT>(polygon.clone(), axis, emission, orders, rules)?
        }
        (_, _, Spot::Rectangle(rectangle)) => {
            let light = paper::rectangle_light::<S, E, GRADIENT>(rectangle, axis, emission);
            return Some(of_sides::<S, GRADIENT>(&light, rectangle, seen));
        }
        (_, _, Spot::Polygon(polygon)) => paper::polygon_light::<S, E, GRADIENT>(polygon, axis, emission),
    };
    let x_a = EmitterGradient { value: seen.position.x() + centroid.value, ..centroid };
    Some(Light { power, x_a })
}

/// The exact light of a rectangular spot that one tensor rule cannot do.
#[cold]
fn divided<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    plan: &Plan<S>,
    receiver: &Receiver<S>,
    emitter: &CompiledEmitter<S>,
    emission: &E,
    seen: &Seen<S>,
) -> Option<(EmitterGradient<S>, EmitterGradient<S>)> {
    let (polygon, _) = Polygon::of_beam(&receiver.aperture, seen.position, receiver.half).ok()?;
    let (orders, rules) = (emitter.orders.as_ref()?, plan.rules.as_ref()?);
    exact::polygon_light::<S, E, GRADIENT>(polygon, seen.axis, emission, orders, rules)
}

/// From derivatives by the sides of a rectangle to derivatives by the emitter: ∂X/∂e = −k,
/// ∂X/∂e_z = −X·(k − 1)/e_z (see [`crate::rectangle::Edge`]).
#[inline(always)]
fn of_sides<S: Scalar, const GRADIENT: bool>(
    light: &RectangleLight<S>,
    spot: &Rectangle<S>,
    seen: &Seen<S>,
) -> Light<S> {
    let x_a = seen.position.x() + light.centroid.value;
    if !GRADIENT {
        return Light { power: EmitterGradient::of_value(light.power.value), x_a: EmitterGradient::of_value(x_a) };
    }
    let edges = [spot.x.low, spot.x.high, spot.y.low, spot.y.high];
    let per_height = spot.height.recip();
    let chain = |side: &SideGradient<S>| {
        let along = |i: usize| -(side.by_side[i] * edges[i].magnification);
        let rise = |i: usize| side.by_side[i] * edges[i].position * (edges[i].magnification - S::one());
        let z = side.by_height - (rise(0) + rise(1) + rise(2) + rise(3)) * per_height;
        S::Vec3::new(along(0) + along(1), along(2) + along(3), z)
    };
    Light {
        power: EmitterGradient {
            value: light.power.value,
            by_position: chain(&light.power),
            by_axis: light.power.by_axis,
        },
        x_a: EmitterGradient {
            value: x_a,
            by_position: chain(&light.centroid) + S::Vec3::new(S::one(), S::zero(), S::zero()),
            by_axis: light.centroid.by_axis,
        },
    }
}

impl<S: Scalar> CompiledEmitter<S> {
    #[inline(always)]
    fn light_on<const GRADIENT: bool>(
        &self,
        plan: &Plan<S>,
        receiver: &Receiver<S>,
        seen: &Seen<S>,
        spot: &Spot<S>,
    ) -> Option<Light<S>> {
        match &self.profile {
            CompiledProfile::Cosine(cosine) => light::<S, _, GRADIENT>(plan, receiver, self, cosine, seen, spot),
            CompiledProfile::Table(table) => light::<S, _, GRADIENT>(plan, receiver, self, table, seen, spot),
        }
    }
}

impl<S: Scalar> Plan<S> {
    /// The photocurrents above dark of `light` on `receiver`.
    #[inline(always)]
    fn above_dark(&self, receiver: &Receiver<S>, photocurrent: S, x_a: S) -> Pair<S> {
        let mut pair = Pair::divide(photocurrent, x_a, receiver.length);
        if self.rules.is_none() {
            // As printed, the paper's equation (1) divides I_O with I_D in it.
            let shift = receiver.dark * x_a / receiver.length;
            pair.i_x1_a -= shift;
            pair.i_x2_a += shift;
        }
        pair
    }
}

pub(super) fn photocurrents<S: Scalar>(plan: &Plan<S>, cell: usize, base_from_tool: &Transform<S>) -> Pair<S> {
    let CompiledCell { receiver, emitter } = &plan.cells[cell];
    photocurrents_of(plan, receiver, emitter, base_from_tool)
}

#[inline(always)]
fn photocurrents_of<S: Scalar>(
    plan: &Plan<S>,
    receiver: &Receiver<S>,
    emitter: &CompiledEmitter<S>,
    base_from_tool: &Transform<S>,
) -> Pair<S> {
    let seen = receiver.see(emitter, base_from_tool);
    let Ok((spot, _)) = receiver.spot(&seen) else {
        return Pair::default();
    };
    match emitter.light_on::<false>(plan, receiver, &seen, &spot) {
        Some(light) => {
            let photocurrent = receiver.responsivity * emitter.intensity * light.power.value;
            plan.above_dark(receiver, photocurrent, light.x_a.value)
        }
        None => Pair::default(),
    }
}

#[inline]
pub(super) fn linearise<S: Scalar>(
    plan: &Plan<S>,
    cell: usize,
    base_from_tool: &Transform<S>,
) -> (Status, Pair<S>, CurrentsJacobian<S>) {
    let CompiledCell { receiver, emitter } = &plan.cells[cell];
    let none = [[S::zero(); 6]; 2];
    let seen = receiver.see(emitter, base_from_tool);
    let (spot, status) = match receiver.spot(&seen) {
        Ok(spot) => spot,
        Err(status) => return (status, Pair::default(), none),
    };
    let Some(light) = emitter.light_on::<true>(plan, receiver, &seen, &spot) else {
        return (status, Pair::default(), none);
    };
    let gain = receiver.responsivity * emitter.intensity;
    let photocurrent = gain * light.power.value;
    let pair = plan.above_dark(receiver, photocurrent, light.x_a.value);

    // I_X1,2 = I/2 ∓ (I + I_D')·X_A/Lx, with I_D' = I_D in the paper tier and 0 in the exact one.
    let divided = if plan.rules.is_none() { photocurrent + receiver.dark } else { photocurrent };
    let per_length = receiver.length.recip();
    let share = light.x_a.value * per_length;
    let of_power = [S::half() - share, S::half() + share];
    let of_position = divided * per_length;
    let arm = base_from_tool.rotate(emitter.position);
    let axis = base_from_tool.rotate(emitter.axis);
    let jacobian = [0, 1].map(|electrode| {
        let sign = if electrode == 0 { -of_position } else { of_position };
        let factor = gain * of_power[electrode];
        let by_position = receiver.to_base(light.power.by_position * factor + light.x_a.by_position * sign);
        let by_axis = receiver.to_base(light.power.by_axis * factor + light.x_a.by_axis * sign);
        // A turn δθ about the tool's origin moves the emitter by δθ × arm and its axis by δθ × axis.
        let turn = arm.cross(by_position) + axis.cross(by_axis);
        [by_position.x(), by_position.y(), by_position.z(), turn.x(), turn.y(), turn.z()]
    });
    (status, pair, jacobian)
}

pub(super) fn respond<S: Scalar>(plan: &Plan<S>, cell: usize, base_from_tool: &Transform<S>) -> Response<S> {
    let CompiledCell { receiver, emitter } = &plan.cells[cell];
    let seen = receiver.see(emitter, base_from_tool);
    let half_dark = S::half() * receiver.dark;
    let (spot, status) = match receiver.spot(&seen) {
        Ok(spot) => spot,
        Err(status) => {
            return Response {
                status,
                flags: Flags { faint: receiver.faint > S::zero(), ..Flags::default() },
                x_a_m: None,
                gamma_rad: None,
                solid_angle_sr: S::zero(),
                i_o_a: receiver.dark,
                currents: Pair { i_x1_a: half_dark, i_x2_a: half_dark },
            };
        }
    };
    let beam = match &spot {
        Spot::Rectangle(rectangle) => paper::rectangle_beam(rectangle, seen.axis),
        Spot::Polygon(polygon) => paper::polygon_beam(polygon, seen.axis),
    };
    let light = emitter.light_on::<false>(plan, receiver, &seen, &spot);
    let power = light.as_ref().map_or(S::zero(), |light| light.power.value);
    let photocurrent = receiver.responsivity * emitter.intensity * power;
    let x_a = light.as_ref().map(|light| light.x_a.value);
    let above_dark = plan.above_dark(receiver, photocurrent, x_a.unwrap_or_default());
    let i_o = photocurrent + receiver.dark;
    Response {
        status,
        flags: Flags {
            saturated: receiver.saturation.is_some_and(|limit| i_o > limit),
            faint: photocurrent < receiver.faint,
            facing_away: beam.cosine <= S::zero(),
        },
        x_a_m: x_a,
        gamma_rad: Some(beam.cosine.max(-S::one()).min(S::one()).arc_cosine()),
        solid_angle_sr: if plan.rules.is_some() { exact_solid_angle(&spot) } else { beam.solid_angle },
        i_o_a: i_o,
        currents: Pair { i_x1_a: above_dark.i_x1_a + half_dark, i_x2_a: above_dark.i_x2_a + half_dark },
    }
}

fn exact_solid_angle<S: Scalar>(spot: &Spot<S>) -> S {
    match spot {
        Spot::Rectangle(rectangle) => {
            let [a, b, c, d] = rectangle.corners();
            let half_area = S::of(4.0) * rectangle.x.half * rectangle.y.half;
            solid_angle::of_fan(a, [(half_area, b, c), (half_area, c, d)].into_iter(), rectangle.height)
        }
        Spot::Polygon(polygon) => solid_angle::of_fan(polygon.corners()[0], polygon.fan(), polygon.height()),
    }
}

pub(super) fn outline<S: Scalar>(
    plan: &Plan<S>,
    cell: usize,
    base_from_tool: &Transform<S>,
) -> Vec<[S; 2], MAX_CORNERS> {
    let CompiledCell { receiver, emitter } = &plan.cells[cell];
    let seen = receiver.see(emitter, base_from_tool);
    let on_detector = |[x, y]: [S; 2]| [x + seen.position.x(), y + seen.position.y()];
    match receiver.spot(&seen) {
        Ok((Spot::Rectangle(rectangle), _)) => rectangle.corners().into_iter().map(on_detector).collect(),
        Ok((Spot::Polygon(polygon), _)) => polygon.corners().iter().copied().map(on_detector).collect(),
        Err(_) => Vec::new(),
    }
}

pub(super) fn crosstalk<S: Scalar>(
    plan: &Plan<S>,
    cell: usize,
    emitter: usize,
    base_from_tool: &Transform<S>,
) -> Pair<S> {
    photocurrents_of(plan, &plan.cells[cell].receiver, &plan.cells[emitter].emitter, base_from_tool)
}

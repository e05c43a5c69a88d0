//! The spot of an imperfect cell: a slit turned by little, and a window on the detector.
//!
//! The plane through the emitter e and a slit edge from q along a meets the detector's mid-line, y = z = 0, at
//! X = m·e/(m_x − e_y·a_z + e_z·a_y) with m = q × a. Between these points the spot counts as a rectangle: an edge
//! turned by ε moves its side by ε·y, whose mean over the detector's width is zero. The power-weighted centroid errs
//! by ε·(Ly²/12)·∂ln g/∂y, g the power per area: 0.15 µm for 1° in the shipped scenes.
//!
//! A window of thickness t and index n shifts light by t·(tan θ − tan θ_g), as if the detector were nearer to the slit
//! by δ(θ) = t·(1 − tan θ_g/tan θ) = t·(1 − (n² + (n² − 1)·tan²θ)^(−½)) (Snell's law). δ is taken at the middle ray of
//! the slit; its variation over the spot moves the centroid by less than 0.1 µm, most of which is added
//! ([`Raise::bend`]).

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::effects::Window;
use crate::exact::PolygonLight;
use crate::polygon::EmitterGradient;
use crate::pose::rotation_exp;
use crate::rectangle::{DETECTOR, Edge, Extent, Rectangle, RectangleLight, SideGradient, Visibility, WALL_SLACK};
use crate::scalar::{Linear3, Number, Real, Vector3, zero_half_one};
use crate::scene::Slit;

use super::super::optics::{Light, Place};

/// Sine of the greatest turn of a slit for which this geometry stands.
const MAX_TURN: f64 = 0.18;

/// A slit before a detector; one per lane.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "R: Number", from = "Slot<R>", into = "Slot<R>")]
pub struct Beam<R: Real> {
    pub faces: [Face<R>; 2],
    /// Whether the mask has two faces: in all lanes, or in none.
    pub is_thick: bool,
    /// Normal of the mask, away from the detector.
    pub normal: R::Vec3,
    pub slot: Slot<R>,
}

/// What a beam is made of.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(bound = "R: Number")]
pub struct Slot<R: Real> {
    /// Directions along the width and the length of the slit, and half of both.
    pub across: R::Vec3,
    pub along: R::Vec3,
    pub half_sizes: [R; 2],
    pub centre: R::Vec3,
    pub half_thickness: R,
    pub window: Option<Glass<R>>,
}

/// One face of the slit: q × a of its two long edges, and the middles of its short ones.
#[derive(Clone, Copy, Debug)]
pub struct Face<R: Real> {
    pub moments: [R::Vec3; 2],
    pub ends: [R::Vec3; 2],
}

/// A window: t, n², n² − 1.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Glass<R> {
    pub thickness: R,
    pub index2: R,
    pub excess: R,
}

impl<R: Real> Glass<R> {
    /// δ, and its first three derivatives, at tan²θ.
    #[inline(always)]
    fn raise(&self, tangent2: R) -> (R, [R; 3]) {
        let root = (self.index2 + self.excess * tangent2).inverse_root();
        let ratio = self.excess * root * root;
        let first = tangent2.constant(0.5) * self.thickness * ratio * root;
        let second = -tangent2.constant(1.5) * first * ratio;
        let third = -tangent2.constant(2.5) * second * ratio;
        (self.thickness * (tangent2.constant(1.0) - root), [first, second, third])
    }
}

impl<S: Number> From<Slot<S>> for Beam<S> {
    fn from(slot: Slot<S>) -> Self {
        let Slot { across, along, half_sizes: [half_width, half_length], centre, half_thickness, .. } = slot;
        let normal = across.cross(along);
        let face = |offset: S| {
            let middle = centre + normal * offset;
            let moment = |half: S| (middle + across * half).cross(along);
            let end = |half: S| middle + along * half;
            Face { moments: [-half_width, half_width].map(moment), ends: [-half_length, half_length].map(end) }
        };
        let is_thick = half_thickness > S::zero();
        Self { faces: [-half_thickness, half_thickness].map(face), is_thick, normal, slot }
    }
}

impl<S: Number> From<Beam<S>> for Slot<S> {
    fn from(beam: Beam<S>) -> Self {
        beam.slot
    }
}

/// How far the detector appears raised, at the middle ray of the beam.
#[derive(Clone, Copy, Debug)]
pub struct Raise<R: Real> {
    pub height: R,
    pub by_position: R::Vec3,
    /// tan θ along x and along y, and their derivatives by the emitter's position.
    tangents: [R; 2],
    tangent_by: [R::Vec3; 2],
    /// First, second and third derivative of δ by tan²θ.
    slopes: [R; 3],
}

impl<R: Real> Raise<R> {
    #[inline(always)]
    fn none(zero: R) -> Self {
        let nowhere = zero.vector();
        Self { height: zero, by_position: nowhere, tangents: [zero; 2], tangent_by: [nowhere; 2], slopes: [zero; 3] }
    }

    /// What the variation of δ over a spot adds to its centroid, and its derivatives by the emitter's position.
    ///
    /// With the derivatives f, g, … of δ by tan²θ, rays spread by ε along x about tan θ = (τ, υ) add
    /// −⟨ε²⟩·τ·(3f + 2τ²g), those spread along y −⟨ε²⟩·τ·(f + 2υ²g); ⟨ε²⟩ is a third of the square of half extent over
    /// height.
    #[inline(always)]
    fn bend(&self, spot: &Rectangle<R>, sides: &[R::Vec3; 4]) -> (R, R::Vec3) {
        let ([f, g, g_slope], [along, across]) = (self.slopes, self.tangents);
        let like = spot.height;
        let ([zero, _, one], two, three) = (zero_half_one(like), like.constant(2.0), like.constant(3.0));
        let (along2, across2) = (along * along, across * across);
        let per_height = spot.height.inverse();
        let (ratio_x, ratio_y) = (spot.x.half * per_height, spot.y.half * per_height);
        let (spread_x, spread_y) = (ratio_x * ratio_x / three, ratio_y * ratio_y / three);
        let (of_x, of_y) = (three * f + two * along2 * g, f + two * across2 * g);
        let sum = spread_x * of_x + spread_y * of_y;
        // By tan²θ, τ and υ, and by the spreads.
        let by_square = spread_x * (three * g + two * along2 * g_slope) + spread_y * (g + two * across2 * g_slope);
        let by_along = sum + along * (two * along * by_square + like.constant(4.0) * spread_x * along * g);
        let by_across = along * (two * across * by_square + like.constant(4.0) * spread_y * across * g);
        let by_height = R::Vec3::new(zero, zero, one) - self.by_position;
        let rise = by_height * (two * per_height);
        let widened_x = (sides[1] - sides[0]) * spot.x.half.inverse() - rise;
        let widened_y = (sides[3] - sides[2]) * spot.y.half.inverse() - rise;
        let by_position = self.tangent_by[0] * by_along
            + self.tangent_by[1] * by_across
            + (widened_x * (spread_x * of_x) + widened_y * (spread_y * of_y)) * along;
        (-(along * sum), -by_position)
    }
}

/// The spot as a rectangle in the plane of the raised detector, and how its sides move with the emitter.
pub struct Spot<R: Real> {
    pub rectangle: Rectangle<R>,
    sides: [R::Vec3; 4],
    pub raise: Raise<R>,
    /// How far the spot may change before an edge of the detector bounds it, or bounds it no more, metres.
    pub slack: R,
    /// How far the emitter may move before the other face of a thick mask bounds the spot, metres.
    pub wall: R,
}

/// A long edge, projected: the side X = m·e/(m_x − e_y·a_z + e_z·a_y) of the spot, m about the middle of the raised
/// detector, and one over the denominator.
#[derive(Clone, Copy)]
struct Projected<R: Real> {
    at: R,
    moment: R::Vec3,
    per: R,
}

/// The sides of the spot that one face bounds.
#[derive(Clone, Copy)]
struct FaceSides<R: Real> {
    edges: [Projected<R>; 2],
    ends: [R; 2],
}

impl<R: Real> FaceSides<R> {
    /// Of side `k`: x low and high, y low and high.
    #[inline(always)]
    fn at(&self, k: usize) -> R {
        if k < 2 { self.edges[k].at } else { self.ends[k - 2] }
    }
}

/// A side of the spot: its place on the detector, and the number of the face that bounds it, or [`DETECTOR`].
#[derive(Clone, Copy)]
struct Side<R> {
    at: R,
    face: R,
}

impl<R: Real> Side<R> {
    /// This side `k` (x low and high, y low and high), or that at `other` of the face `number` if it is nearer to the
    /// spot's middle.
    #[inline(always)]
    fn bounded(self, k: usize, other: R, number: R) -> Self {
        let (above, below) = if k.is_multiple_of(2) { (other, self.at) } else { (self.at, other) };
        Self { at: R::select_gt(above, below, other, self.at), face: R::select_gt(above, below, number, self.face) }
    }

    /// Of the spot between two sides, with the emitter at `e`.
    #[inline(always)]
    fn extent(low: Self, high: Self, e: R) -> Extent<R> {
        let [_, half, one] = zero_half_one(e);
        let landing = half * (low.at + high.at);
        Extent {
            low: Edge { position: low.at - e, magnification: one },
            high: Edge { position: high.at - e, magnification: one },
            middle: landing - e,
            landing,
            half: half * (high.at - low.at),
        }
    }
}

impl<S: Number> Beam<S> {
    /// `None`: the slit is turned too far for this geometry.
    pub fn compile(slit: &Slit, window: Option<Window>) -> Option<Self> {
        let axes = DMat3::from_quat(rotation_exp(slit.tilt_rad));
        if axes.y_axis.y < libm::sqrt(1.0 - MAX_TURN * MAX_TURN) || axes.x_axis.x < 0.0 || axes.z_axis.z < 0.0 {
            return None;
        }
        let slot = Slot {
            across: S::Vec3::of(axes.x_axis),
            along: S::Vec3::of(axes.y_axis),
            half_sizes: [S::of(0.5 * slit.width_m), S::of(0.5 * slit.length_m)],
            centre: S::Vec3::of(DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m)),
            half_thickness: S::of(0.5 * slit.thickness_m),
            window: window.filter(|window| window.thickness_m > 0.0).map(|window| {
                let index2 = window.refractive_index * window.refractive_index;
                Glass { thickness: S::of(window.thickness_m), index2: S::of(index2), excess: S::of(index2 - 1.0) }
            }),
        };
        Some(slot.into())
    }
}

impl<R: Real> Beam<R> {
    /// δ for an emitter at `e`.
    #[inline(always)]
    fn raise(&self, e: R::Vec3) -> Raise<R> {
        let zero = e.x().constant(0.0);
        let Some(glass) = &self.slot.window else {
            return Raise::none(zero);
        };
        let centre = self.slot.centre;
        let per_height = (e.z() - centre.z()).inverse();
        let along = (e.x() - centre.x()) * per_height;
        let per_distance = e.z().inverse();
        let across = e.y() * per_distance;
        let by_along = R::Vec3::new(per_height, zero, -along * per_height);
        let by_across = R::Vec3::new(zero, per_distance, -across * per_distance);
        let (height, slopes) = glass.raise(along * along + across * across);
        Raise {
            height,
            by_position: (by_along * along + by_across * across) * (zero.constant(2.0) * slopes[0]),
            tangents: [along, across],
            tangent_by: [by_along, by_across],
            slopes,
        }
    }

    /// The side that the detector's edge at y = `edge` cuts off, and its derivatives by the emitter's position. Light
    /// lands there at an angle of its own, where the detector appears raised by another height.
    #[inline(always)]
    fn detector_side<const GRADIENT: bool>(&self, edge: R, e: R::Vec3, raise: &Raise<R>) -> (R, R::Vec3) {
        let [zero, _, one] = zero_half_one(edge);
        let nowhere = zero.vector();
        let Some(glass) = &self.slot.window else {
            return (edge, nowhere);
        };
        let height = e.z() - raise.height;
        let per_height = height.inverse();
        let away = edge - e.y();
        let tangent = away * per_height;
        let [along, _] = raise.tangents;
        let (own_raise, [slope, ..]) = glass.raise(along * along + tangent * tangent);
        let per_own = (e.z() - own_raise).inverse();
        let ratio = height * per_own;
        let mut by_position = nowhere;
        if GRADIENT {
            let by_height = R::Vec3::new(zero, zero, one) - raise.by_position;
            let by_tangent = (R::Vec3::new(zero, one, zero) + by_height * tangent) * -per_height;
            let by_own = (raise.tangent_by[0] * along + by_tangent * tangent) * (zero.constant(2.0) * slope);
            let by_own_height = R::Vec3::new(zero, zero, one) - by_own;
            by_position =
                R::Vec3::new(zero, one - ratio, zero) + (by_height - by_own_height * ratio) * (away * per_own);
        }
        (e.y() + away * ratio, by_position)
    }

    /// The side of the spot that the long edge with this moment bounds, for the `raised` detector's emitter.
    #[inline(always)]
    fn projected(&self, moment: R::Vec3, raised: R::Vec3, delta: R) -> Projected<R> {
        let a = self.slot.along;
        let moment = R::Vec3::new(moment.x() + delta * a.y(), moment.y() - delta * a.x(), moment.z());
        let per = (moment.x() - raised.y() * a.z() + raised.z() * a.y()).inverse();
        Projected { at: moment.dot(raised) * per, moment, per }
    }

    #[inline(always)]
    fn sides_of(&self, face: &Face<R>, e: R::Vec3, raised: R::Vec3, delta: R) -> FaceSides<R> {
        let [low, high] = face.moments;
        let ends = [Self::end(face.ends[0], e, delta), Self::end(face.ends[1], e, delta)];
        FaceSides { edges: [self.projected(low, raised, delta), self.projected(high, raised, delta)], ends }
    }

    #[inline(always)]
    fn edge_slope(&self, Projected { at, moment: m, per }: Projected<R>, e: R::Vec3, raise: &Raise<R>) -> R::Vec3 {
        let a = self.slot.along;
        let by_raise = (a.y() * e.x() - a.x() * e.y() - m.z()) * per;
        R::Vec3::new(m.x(), m.y() + at * a.z(), m.z() - at * a.y()) * per + raise.by_position * by_raise
    }

    /// The side of the spot that the end q of the slit bounds.
    #[inline(always)]
    fn end(q: R::Vec3, e: R::Vec3, delta: R) -> R {
        q.y() + (q.y() - e.y()) * (q.z() - delta) * (e.z() - q.z()).inverse()
    }

    /// How the side that the end q of the slit bounds moves with the emitter.
    #[inline(always)]
    fn end_slope(q: R::Vec3, e: R::Vec3, raise: &Raise<R>) -> R::Vec3 {
        let per = (e.z() - q.z()).inverse();
        let (height, to_emitter) = (q.z() - raise.height, q.y() - e.y());
        R::Vec3::new(e.x().constant(0.0), -height * per, -to_emitter * height * per * per)
            - raise.by_position * (to_emitter * per)
    }

    /// The spot of an emitter at `e`, on a detector of half extents `half`, and its visibility. Without a spot the
    /// rectangle is meaningless. `CUTS`: with how a window moves the sides that the detector's edges cut off, 10⁻³ of the
    /// emitter's way.
    #[inline(always)]
    pub fn spot<const GRADIENT: bool, const CUTS: bool>(&self, e: R::Vec3, half: [R; 2]) -> (Spot<R>, Visibility<R>) {
        let Slot { across, along, half_sizes, centre, half_thickness, .. } = self.slot;
        let from_centre = e - centre;
        let ([zero, _, one], detector) = (zero_half_one(e.x()), e.x().constant(DETECTOR));
        let behind = R::select_ge(half_thickness, from_centre.dot(self.normal), one, zero);
        let raise = self.raise(e);
        let delta = raise.height;
        let raised = R::Vec3::new(e.x(), e.y(), e.z() - delta);
        let cuts = [self.detector_side::<CUTS>(-half[1], e, &raise), self.detector_side::<CUTS>(half[1], e, &raise)];
        let of_detector = |at: R| Side { at, face: detector };
        // x low and high, y low and high.
        let mut sides = [of_detector(-half[0]), of_detector(half[0]), of_detector(cuts[0].0), of_detector(cuts[1].0)];
        let infinity = zero.constant(f64::INFINITY);
        let (mut slack, mut wall) = (infinity, infinity);
        let (place_x, place_y) = (from_centre.dot(across), from_centre.dot(along));
        let walls =
            [place_x + half_sizes[0], half_sizes[0] - place_x, place_y + half_sizes[1], half_sizes[1] - place_y];
        let first = self.sides_of(&self.faces[0], e, raised, delta);
        for (k, side) in sides.iter_mut().enumerate() {
            slack = slack.at_most((side.at - first.at(k)).magnitude());
            *side = side.bounded(k, first.at(k), zero);
        }
        let mut second = first;
        if self.is_thick {
            second = self.sides_of(&self.faces[1], e, raised, delta);
            for (k, side) in sides.iter_mut().enumerate() {
                let apart = (side.at - second.at(k)).magnitude();
                slack = slack.at_most(R::select_ge(side.face, zero, infinity, apart));
                wall = wall.at_most(R::select_ge(side.face, zero, walls[k].magnitude(), infinity));
                *side = side.bounded(k, second.at(k), one);
            }
        }
        let [x_low, x_high, y_low, y_high] = sides;
        let (x, y) = (Side::extent(x_low, x_high, e.x()), Side::extent(y_low, y_high, e.y()));
        let cut = R::select_ge(x_low.face, zero, R::select_ge(x_high.face, zero, zero, one), one);
        let visibility = Visibility::of(behind, cut, [x.half, y.half], slack.at_most(zero.constant(WALL_SLACK) * wall));
        let rectangle = Rectangle { x, y, height: raised.z() };
        let motionless = zero.vector();
        let mut slopes = [motionless; 4];
        if GRADIENT {
            for (k, side) in sides.into_iter().enumerate() {
                let end = k % 2;
                slopes[k] = if k < 2 {
                    let (first, second) = (first.edges[end], second.edges[end]);
                    let bounding = Projected {
                        at: side.at,
                        moment: R::select3_ge(side.face, one, second.moment, first.moment),
                        per: R::select_ge(side.face, one, second.per, first.per),
                    };
                    R::select3_ge(side.face, zero, self.edge_slope(bounding, e, &raise), motionless)
                } else {
                    let q = R::select3_ge(side.face, one, self.faces[1].ends[end], self.faces[0].ends[end]);
                    R::select3_ge(side.face, zero, Self::end_slope(q, e, &raise), cuts[end].1)
                };
            }
        }
        (Spot { rectangle, sides: slopes, raise, slack, wall }, visibility)
    }
}

impl<R: Real> Spot<R> {
    /// Power and position of the light in terms of the emitter, from those in terms of the sides.
    #[inline(always)]
    pub fn of_sides<const GRADIENT: bool>(&self, light: &RectangleLight<R>) -> Light<R> {
        let (bend, bend_by) = self.raise.bend(&self.rectangle, &self.sides);
        let x_a = self.rectangle.x.landing + light.centroid.value + bend;
        if !GRADIENT {
            return Light {
                power: EmitterGradient::of_value(light.power.value),
                x_a: Place::Weighted(EmitterGradient::of_value(x_a)),
            };
        }
        let [zero, _, one] = zero_half_one(x_a);
        Light {
            power: self.of_emitter(&light.power),
            x_a: Place::Weighted(EmitterGradient {
                value: x_a,
                by_position: self.of_emitter(&light.centroid).by_position + R::Vec3::new(one, zero, zero) + bend_by,
                by_axis: light.centroid.by_axis,
            }),
        }
    }

    /// A quantity in terms of the emitter, from that in terms of the sides.
    #[inline(always)]
    fn of_emitter(&self, quantity: &SideGradient<R>) -> EmitterGradient<R> {
        let [zero, _, one] = zero_half_one(quantity.value);
        let (along, across) = (R::Vec3::new(one, zero, zero), R::Vec3::new(zero, one, zero));
        let height = R::Vec3::new(zero, zero, one) - self.raise.by_position;
        let by = quantity.by_side;
        let by_position = (self.sides[0] - along) * by[0]
            + (self.sides[1] - along) * by[1]
            + (self.sides[2] - across) * by[2]
            + (self.sides[3] - across) * by[3]
            + height * quantity.by_height;
        EmitterGradient { value: quantity.value, by_position, by_axis: quantity.by_axis }
    }
}

impl<S: Number> Spot<S> {
    /// How the sides move, seen from an emitter that rises as the detector sinks: what moves by m with the emitter moves with
    /// that one by m + r·m_z/(1 − r_z), r that of the raise.
    pub fn motions(&self) -> [S::Vec3; 4] {
        let raise = self.raise.by_position;
        let per_rise = (S::one() - raise.z()).recip();
        self.sides.map(|side| side + raise * (side.z() * per_rise))
    }

    /// Power and position of the light in terms of the emitter, from those with sides that move by [`Self::motions`].
    pub fn of_polygon(&self, (power, centroid): PolygonLight<S>) -> Light<S> {
        let of_emitter = |quantity: EmitterGradient<S>| EmitterGradient {
            by_position: quantity.by_position - self.raise.by_position * quantity.by_position.z(),
            ..quantity
        };
        let (bend, bend_by) = self.raise.bend(&self.rectangle, &self.sides);
        let (x, mut x_a) = (&self.rectangle.x, of_emitter(centroid));
        x_a.value += x.landing - x.middle + bend;
        x_a.by_position += bend_by;
        Light { power: of_emitter(power), x_a: Place::Weighted(x_a) }
    }

    /// Power, and place with its derivatives by the emitter's position, of the light of a narrow spot: see
    /// [`crate::exact::narrow_light`], of which `drift` is what comes second. What bends the light in a window counts, and
    /// how that changes, by 10⁻⁴ of the emitter's way, does not.
    #[inline(always)]
    pub fn of_narrow(&self, light: &RectangleLight<S>, drift: S) -> (EmitterGradient<S>, S, S::Vec3) {
        let mut x_a = self.rectangle.x.landing + light.centroid.value;
        if self.raise.height > S::zero() {
            x_a += self.raise.bend(&self.rectangle, &self.sides).0;
        }
        let middle = (self.sides[0] + self.sides[1]) * S::half();
        let from_emitter = middle - S::Vec3::new(S::one(), S::zero(), S::zero());
        (self.of_emitter(&light.power), x_a, middle + from_emitter * drift)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::aperture::Aperture;

    /// A mask parallel to its detector is that of an ideal cell, from wherever the emitter lights it: sides, what bounds
    /// the spot next, and the walls of a thick mask.
    #[test]
    fn a_slit_that_is_not_turned_has_the_spot_of_an_ideal_cell() {
        let half = [6e-3, 0.5e-3];
        let mut seen = [0; 3];
        for thickness_m in [0.0, 0.3e-3] {
            let (offset_m, tilt_rad) = (DVec2::new(0.2e-3, -0.1e-3), DVec3::ZERO);
            let slit = Slit { distance_m: 5e-3, width_m: 0.6e-3, length_m: 1.2e-3, offset_m, tilt_rad, thickness_m };
            let beam = Beam::<f64>::compile(&slit, None).expect("a slit that is not turned");
            for i in 0..2000 {
                let along = |frequency: f64| libm::sin(f64::from(i) * frequency);
                let e = DVec3::new(9e-3 * along(0.7), 2e-3 * along(1.3), 15e-3 + 9.9e-3 * along(2.1));
                let (spot, visibility) = beam.spot::<true, true>(e, half);
                let (ideal, of_ideal) = match Aperture::compile(&slit) {
                    Aperture::Thick(lower, upper) => Rectangle::of_beam([lower, upper], e.to_array(), half),
                    Aperture::Thin(face) => Rectangle::of_beam([face], e.to_array(), half),
                    _ => unreachable!("not turned"),
                };
                assert_eq!(visibility.status(0), of_ideal.status(0), "{e}");
                seen[usize::from(visibility.spot().is_ok()) + usize::from(thickness_m > 0.0)] += 1;
                if visibility.spot().is_err() {
                    continue;
                }
                for (a, b) in spot.rectangle.corners().into_iter().flatten().zip(ideal.corners().into_iter().flatten())
                {
                    assert!((a - b).abs() < 1e-15, "{e}: {a} {b}");
                }
                let [slack_m, expected_m] = [&visibility, &of_ideal].map(|visibility| visibility.slack_m(0));
                assert!((slack_m - expected_m).abs() < 1e-14, "{e}: {slack_m} {expected_m}");
            }
        }
        assert!(seen.iter().all(|&count| count > 300), "{seen:?}");
    }
}

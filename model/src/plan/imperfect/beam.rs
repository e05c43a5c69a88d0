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
use crate::pose::rotation_exp;
use crate::rectangle::{Edge, Extent, Rectangle, RectangleLight, SideGradient};
use crate::response::Status;
use crate::scalar::{Linear3, Number, Vector3};
use crate::scene::Slit;

use super::super::optics::{Light, Place};
use crate::polygon::EmitterGradient;

/// Sine of the greatest turn of a slit for which this geometry stands.
const MAX_TURN: f64 = 0.18;

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "", from = "Parts<S>", into = "Parts<S>")]
pub struct Beam<S: Number> {
    faces: [Face<S>; 2],
    face_count: usize,
    /// Normal of the mask, away from the detector.
    normal: S::Vec3,
    parts: Parts<S>,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
struct Parts<S: Number> {
    /// Directions along the width and the length of the slit, and half of both.
    across: S::Vec3,
    along: S::Vec3,
    half_sizes: [S; 2],
    centre: S::Vec3,
    half_thickness: S,
    window: Option<Glass<S>>,
}

/// One face of the slit: q × a of its two long edges, and the middles of its short ones.
#[derive(Clone, Copy, Debug)]
struct Face<S: Number> {
    moments: [S::Vec3; 2],
    ends: [S::Vec3; 2],
}

/// A window: t, n², n² − 1.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Glass<S> {
    thickness: S,
    index2: S,
    excess: S,
}

impl<S: Number> Glass<S> {
    /// δ, and its first three derivatives, at tan²θ.
    #[inline(always)]
    fn raise(&self, tangent2: S) -> (S, [S; 3]) {
        let root = (self.index2 + self.excess * tangent2).inverse_root();
        let ratio = self.excess * root * root;
        let first = S::half() * self.thickness * ratio * root;
        let second = -S::of(1.5) * first * ratio;
        (self.thickness * (S::one() - root), [first, second, -S::of(2.5) * second * ratio])
    }
}

impl<S: Number> From<Parts<S>> for Beam<S> {
    fn from(parts: Parts<S>) -> Self {
        let Parts { across, along, half_sizes: [half_width, half_length], centre, half_thickness, .. } = parts;
        let normal = across.cross(along);
        let face = |offset: S| {
            let middle = centre + normal * offset;
            let moment = |half: S| (middle + across * half).cross(along);
            let end = |half: S| middle + along * half;
            Face { moments: [-half_width, half_width].map(moment), ends: [-half_length, half_length].map(end) }
        };
        Self {
            faces: [-half_thickness, half_thickness].map(face),
            face_count: if half_thickness > S::zero() { 2 } else { 1 },
            normal,
            parts,
        }
    }
}

impl<S: Number> From<Beam<S>> for Parts<S> {
    fn from(beam: Beam<S>) -> Self {
        beam.parts
    }
}

/// How far the detector appears raised, at the middle ray of the beam.
#[derive(Clone, Copy, Debug)]
pub struct Raise<S: Number> {
    height: S,
    by_position: S::Vec3,
    /// tan θ along x and along y, and their derivatives by the emitter's position.
    tangents: [S; 2],
    tangent_by: [S::Vec3; 2],
    /// First, second and third derivative of δ by tan²θ.
    slopes: [S; 3],
}

impl<S: Number> Raise<S> {
    fn none() -> Self {
        let zero = S::zero();
        Self {
            height: zero,
            by_position: S::Vec3::default(),
            tangents: [zero; 2],
            tangent_by: [S::Vec3::default(); 2],
            slopes: [zero; 3],
        }
    }

    /// What the variation of δ over a spot adds to its centroid, and its derivatives by the emitter's position.
    ///
    /// With the derivatives f, g, … of δ by tan²θ, rays spread by ε along x about tan θ = (τ, υ) add
    /// −⟨ε²⟩·τ·(3f + 2τ²g), those spread along y −⟨ε²⟩·τ·(f + 2υ²g); ⟨ε²⟩ is a third of the square of half extent over
    /// height.
    #[inline(always)]
    fn bend(&self, spot: &Rectangle<S>, sides: &[S::Vec3; 4]) -> (S, S::Vec3) {
        let ([f, g, g_slope], [along, across]) = (self.slopes, self.tangents);
        let (two, three) = (S::two(), S::of(3.0));
        let (along2, across2) = (along * along, across * across);
        let per_height = spot.height.recip();
        let [spread_x, spread_y] = [spot.x.half, spot.y.half].map(|half| {
            let ratio = half * per_height;
            ratio * ratio / three
        });
        let (of_x, of_y) = (three * f + two * along2 * g, f + two * across2 * g);
        let sum = spread_x * of_x + spread_y * of_y;
        // By tan²θ, τ and υ, and by the spreads.
        let by_square = spread_x * (three * g + two * along2 * g_slope) + spread_y * (g + two * across2 * g_slope);
        let by_along = sum + along * (two * along * by_square + S::of(4.0) * spread_x * along * g);
        let by_across = along * (two * across * by_square + S::of(4.0) * spread_y * across * g);
        let by_height = S::Vec3::new(S::zero(), S::zero(), S::one()) - self.by_position;
        let widened =
            |low: usize, half: S| (sides[low + 1] - sides[low]) * half.recip() - by_height * (two * per_height);
        let by_position = self.tangent_by[0] * by_along
            + self.tangent_by[1] * by_across
            + (widened(0, spot.x.half) * (spread_x * of_x) + widened(2, spot.y.half) * (spread_y * of_y)) * along;
        (-(along * sum), -by_position)
    }
}

/// The spot as a rectangle in the plane of the raised detector, and how its sides move with the emitter.
pub struct Spot<S: Number> {
    pub rectangle: Rectangle<S>,
    sides: [S::Vec3; 4],
    raise: Raise<S>,
    /// How far the spot may change before an edge of the detector bounds it, or bounds it no more.
    pub slack_m: S,
    /// How far the emitter may move before the other face of a thick mask bounds the spot.
    pub wall_m: S,
}

/// A long edge, projected: the side X = m·e/(m_x − e_y·a_z + e_z·a_y) of the spot, m about the middle of the raised
/// detector, and one over the denominator.
#[derive(Clone, Copy)]
struct Projected<S: Number> {
    at: S,
    moment: S::Vec3,
    per: S,
}

/// A side of the spot: its place on the detector, and the face that bounds it; `None`: the detector does.
#[derive(Clone, Copy)]
struct Side<S: Number> {
    at: S,
    face: Option<usize>,
}

impl<S: Number> Beam<S> {
    /// `None`: the slit is turned too far for this geometry.
    pub fn compile(slit: &Slit, window: Option<Window>) -> Option<Self> {
        let axes = DMat3::from_quat(rotation_exp(slit.tilt_rad));
        if axes.y_axis.y < libm::sqrt(1.0 - MAX_TURN * MAX_TURN) || axes.x_axis.x < 0.0 || axes.z_axis.z < 0.0 {
            return None;
        }
        let parts = Parts {
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
        Some(parts.into())
    }

    /// δ for an emitter at `e`.
    fn raise(&self, e: S::Vec3) -> Raise<S> {
        let Some(glass) = &self.parts.window else {
            return Raise::none();
        };
        let centre = self.parts.centre;
        let per_height = (e.z() - centre.z()).recip();
        let along = (e.x() - centre.x()) * per_height;
        let per_distance = e.z().recip();
        let across = e.y() * per_distance;
        let zero = S::zero();
        let by_along = S::Vec3::new(per_height, zero, -along * per_height);
        let by_across = S::Vec3::new(zero, per_distance, -across * per_distance);
        let (height, slopes) = glass.raise(along * along + across * across);
        Raise {
            height,
            by_position: (by_along * along + by_across * across) * (S::two() * slopes[0]),
            tangents: [along, across],
            tangent_by: [by_along, by_across],
            slopes,
        }
    }

    /// The side that the detector's edge at y = `edge` cuts off, and its derivatives by the emitter's position. Light
    /// lands there at an angle of its own, where the detector appears raised by another height.
    fn detector_side<const GRADIENT: bool>(&self, edge: S, e: S::Vec3, raise: &Raise<S>) -> (S, S::Vec3) {
        let Some(glass) = &self.parts.window else {
            return (edge, S::Vec3::default());
        };
        let height = e.z() - raise.height;
        let per_height = height.recip();
        let away = edge - e.y();
        let tangent = away * per_height;
        let [along, _] = raise.tangents;
        let (own_raise, [slope, ..]) = glass.raise(along * along + tangent * tangent);
        let per_own = (e.z() - own_raise).recip();
        let ratio = height * per_own;
        let mut by_position = S::Vec3::default();
        if GRADIENT {
            let (zero, one, two) = (S::zero(), S::one(), S::two());
            let by_height = S::Vec3::new(zero, zero, one) - raise.by_position;
            let by_tangent = (S::Vec3::new(zero, one, zero) + by_height * tangent) * -per_height;
            let by_own = (raise.tangent_by[0] * along + by_tangent * tangent) * (two * slope);
            let by_own_height = S::Vec3::new(zero, zero, one) - by_own;
            by_position =
                S::Vec3::new(zero, one - ratio, zero) + (by_height - by_own_height * ratio) * (away * per_own);
        }
        (e.y() + away * ratio, by_position)
    }

    /// The side of the spot that the long edge with this moment bounds, for the `raised` detector's emitter.
    #[inline(always)]
    fn projected(&self, moment: S::Vec3, raised: S::Vec3, delta: S) -> Projected<S> {
        let a = self.parts.along;
        let moment = S::Vec3::new(moment.x() + delta * a.y(), moment.y() - delta * a.x(), moment.z());
        let per = (moment.x() - raised.y() * a.z() + raised.z() * a.y()).recip();
        Projected { at: moment.dot(raised) * per, moment, per }
    }

    #[inline(always)]
    fn edge_slope(&self, Projected { at, moment: m, per }: Projected<S>, e: S::Vec3, raise: &Raise<S>) -> S::Vec3 {
        let a = self.parts.along;
        let by_raise = (a.y() * e.x() - a.x() * e.y() - m.z()) * per;
        S::Vec3::new(m.x(), m.y() + at * a.z(), m.z() - at * a.y()) * per + raise.by_position * by_raise
    }

    /// How the side that the end q of the slit bounds moves with the emitter.
    fn end_slope(q: S::Vec3, e: S::Vec3, raise: &Raise<S>) -> S::Vec3 {
        let per = (e.z() - q.z()).recip();
        let (height, to_emitter) = (q.z() - raise.height, q.y() - e.y());
        S::Vec3::new(S::zero(), -height * per, -to_emitter * height * per * per)
            - raise.by_position * (to_emitter * per)
    }

    /// The spot of an emitter at `e`, on a detector of half extents `half`. `CUTS`: with how a window moves the sides that
    /// the detector's edges cut off, 10⁻³ of the emitter's way.
    pub fn spot<const GRADIENT: bool, const CUTS: bool>(
        &self,
        e: S::Vec3,
        half: [S; 2],
    ) -> Result<(Spot<S>, Status), Status> {
        let Parts { across, along, half_sizes, centre, half_thickness, .. } = self.parts;
        let from_centre = e - centre;
        if from_centre.dot(self.normal) <= half_thickness {
            return Err(Status::Behind);
        }
        let raise = self.raise(e);
        let delta = raise.height;
        let raised = S::Vec3::new(e.x(), e.y(), e.z() - delta);
        let cut = [-half[1], half[1]].map(|edge| self.detector_side::<CUTS>(edge, e, &raise));
        let detector = |at: S| Side { at, face: None };
        let [mut x_low, mut x_high] = [-half[0], half[0]].map(detector);
        let [mut y_low, mut y_high] = cut.map(|(at, _)| detector(at));
        let (mut slack_m, mut wall_m) = (S::infinity(), S::infinity());
        let walls = [(across, half_sizes[0]), (along, half_sizes[1])].map(|(direction, half)| {
            let place = from_centre.dot(direction);
            [place + half, half - place].map(|distance| distance.abs())
        });
        let nowhere = Projected { at: S::zero(), moment: raised, per: S::zero() };
        let mut edges = [[nowhere; 2]; 2];
        for (number, face) in self.faces[..self.face_count].iter().enumerate() {
            edges[number] = face.moments.map(|moment| self.projected(moment, raised, delta));
            let sides = edges[number].map(|edge| edge.at);
            let ends = face.ends.map(|q| q.y() + (q.y() - e.y()) * (q.z() - delta) * (e.z() - q.z()).recip());
            let axes = [(&mut x_low, &mut x_high, sides, walls[0]), (&mut y_low, &mut y_high, ends, walls[1])];
            for (low, high, [first, second], walls) in axes {
                for (side, other, wall) in [(&*low, first, walls[0]), (&*high, second, walls[1])] {
                    if side.face.is_none() {
                        slack_m = slack_m.min((side.at - other).abs());
                    } else {
                        wall_m = wall_m.min(wall);
                    }
                }
                if first > low.at {
                    *low = Side { at: first, face: Some(number) };
                }
                if second < high.at {
                    *high = Side { at: second, face: Some(number) };
                }
            }
        }
        let extent = |low: Side<S>, high: Side<S>, e: S| {
            let landing = S::half() * (low.at + high.at);
            let edge = |side: Side<S>| Edge { position: side.at - e, magnification: S::one() };
            Extent {
                low: edge(low),
                high: edge(high),
                middle: landing - e,
                landing,
                half: S::half() * (high.at - low.at),
            }
        };
        let (x, y) = (extent(x_low, x_high, e.x()), extent(y_low, y_high, e.y()));
        // With a pose that is NaN both half extents are NaN, and the spot is dark.
        if !(x.half > S::zero() && y.half > S::zero()) {
            return Err(Status::Dark);
        }
        let status = if x_low.face.is_none() || x_high.face.is_none() { Status::Clipped } else { Status::Lit };
        let rectangle = Rectangle { x, y, height: raised.z() };
        let mut sides = [S::Vec3::default(); 4];
        if GRADIENT {
            for (end, side) in [x_low, x_high].into_iter().enumerate() {
                if let Some(face) = side.face {
                    sides[end] = self.edge_slope(edges[face][end], e, &raise);
                }
            }
            for (end, side) in [y_low, y_high].into_iter().enumerate() {
                sides[2 + end] = match side.face {
                    Some(face) => Self::end_slope(self.faces[face].ends[end], e, &raise),
                    None => cut[end].1,
                };
            }
        }
        Ok((Spot { rectangle, sides, raise, slack_m, wall_m }, status))
    }
}

impl<S: Number> Spot<S> {
    /// Power and position of the light in terms of the emitter, from those in terms of the sides.
    pub fn of_sides<const GRADIENT: bool>(&self, light: &RectangleLight<S>) -> Light<S> {
        let (bend, bend_by) = self.raise.bend(&self.rectangle, &self.sides);
        let x_a = self.rectangle.x.landing + light.centroid.value + bend;
        if !GRADIENT {
            return Light {
                power: EmitterGradient::of_value(light.power.value),
                x_a: Place::Weighted(EmitterGradient::of_value(x_a)),
            };
        }
        let along = S::Vec3::new(S::one(), S::zero(), S::zero());
        Light {
            power: self.of_emitter(&light.power),
            x_a: Place::Weighted(EmitterGradient {
                value: x_a,
                by_position: self.of_emitter(&light.centroid).by_position + along + bend_by,
                by_axis: light.centroid.by_axis,
            }),
        }
    }

    /// A quantity in terms of the emitter, from that in terms of the sides.
    #[inline(always)]
    fn of_emitter(&self, quantity: &SideGradient<S>) -> EmitterGradient<S> {
        let (zero, one) = (S::zero(), S::one());
        let (along, across) = (S::Vec3::new(one, zero, zero), S::Vec3::new(zero, one, zero));
        let height = S::Vec3::new(zero, zero, one) - self.raise.by_position;
        let by = quantity.by_side;
        let by_position = (self.sides[0] - along) * by[0]
            + (self.sides[1] - along) * by[1]
            + (self.sides[2] - across) * by[2]
            + (self.sides[3] - across) * by[3]
            + height * quantity.by_height;
        EmitterGradient { value: quantity.value, by_position, by_axis: quantity.by_axis }
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

    /// The raised plane's height above the detector, and its derivatives by the emitter's position.
    pub fn raise(&self) -> (S, S::Vec3) {
        (self.raise.height, self.raise.by_position)
    }
}

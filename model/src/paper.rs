//! The paper tier: equations (3) to (5) of De La Cruz, Gosselin, Bachta, Morel 2018, as printed
//! but in forms that do not cancel.
//!
//! The spot is seen as a rectangular plate of a × b at distance d, perpendicular to the beam's
//! central axis. With α, β the tangents of the half angles under which the spot's mid-lines
//! appear, equation (3), Ω = 4·arccos √((1+α²+β²)/((1+α²)(1+β²))), equals
//! Ω = 4·atan(αβ/√(1+α²+β²)), which keeps all digits for small plates.

use crate::polygon::{EmitterGradient, Polygon};
use crate::profile::Emission;
use crate::rectangle::{Rectangle, RectangleLight, SideGradient};
use crate::scalar::{Scalar, Vector3};

/// Tangent of half the angle under which a straight segment appears, with derivatives.
///
/// The segment runs from `low` to `high` on a line whose squared distance from the emitter is
/// `distance2`, both ends measured from the foot of the perpendicular. With r₀, r₁ the distances
/// of its ends: tan(θ/2) = |a×b|/(|a||b| + a·b) = (high − low)·√distance2/(r₀r₁ + low·high + distance2).
#[derive(Clone, Copy)]
struct HalfAngle<S> {
    tangent: S,
    by_low: S,
    by_high: S,
    by_distance2: S,
}

impl<S: Scalar> HalfAngle<S> {
    #[inline(always)]
    fn of_segment(low: S, high: S, length: S, distance2: S) -> Self {
        let distance = distance2.sqrt();
        let r0 = (low * low + distance2).sqrt();
        let r1 = (high * high + distance2).sqrt();
        let denominator = r0 * r1 + low * high + distance2;
        let inverse = denominator.recip();
        let tangent = length * distance * inverse;
        let ratio = r1 / r0;
        let inverse_ratio = r0 / r1;
        let scaled = tangent * inverse;
        Self {
            tangent,
            by_low: -distance * inverse - scaled * (ratio * low + high),
            by_high: distance * inverse - scaled * (inverse_ratio * high + low),
            by_distance2: S::half() * length / distance * inverse
                - scaled * (S::half() * (ratio + inverse_ratio) + S::one()),
        }
    }
}

/// Equation (3) and its derivatives by α and β.
#[inline(always)]
fn plate_solid_angle<S: Scalar>(alpha: S, beta: S) -> (S, S, S) {
    let (a2, b2) = (alpha * alpha, beta * beta);
    let root = (S::one() + a2 + b2).sqrt();
    let four = S::of(4.0);
    let omega = four * (alpha * beta / root).arc_tangent();
    (omega, four * beta / ((S::one() + a2) * root), four * alpha / ((S::one() + b2) * root))
}

/// What the paper tier says of a spot whose geometry alone is asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beam<S> {
    /// Ω of the plate, steradians.
    pub(crate) solid_angle: S,
    /// cos γ of the beam's central axis.
    pub(crate) cosine: S,
}

/// Ω and cos γ of a rectangular spot, without derivatives.
pub(crate) fn rectangle_beam<S: Scalar>(spot: &Rectangle<S>, axis: S::Vec3) -> Beam<S> {
    let (alpha, beta) = plate_of_rectangle(spot);
    let (sum, _) = central_axis(spot);
    Beam { solid_angle: plate_solid_angle(alpha.tangent, beta.tangent).0, cosine: axis.dot(sum) / sum.length() }
}

#[inline(always)]
fn plate_of_rectangle<S: Scalar>(spot: &Rectangle<S>) -> (HalfAngle<S>, HalfAngle<S>) {
    let h2 = spot.height * spot.height;
    let (xm, ym) = (spot.x.middle, spot.y.middle);
    let of = |extent: &crate::rectangle::Extent<S>, distance2| {
        HalfAngle::of_segment(extent.low.position, extent.high.position, S::two() * extent.half, distance2)
    };
    (of(&spot.x, h2 + ym * ym), of(&spot.y, h2 + xm * xm))
}

/// Sum of the unit vectors to the four edge mid-points, and those vectors with their lengths' inverses.
#[inline(always)]
fn central_axis<S: Scalar>(spot: &Rectangle<S>) -> (S::Vec3, [(S::Vec3, S); 4]) {
    let (x, y, z) = (&spot.x, &spot.y, -spot.height);
    let rays = [
        S::Vec3::new(x.low.position, y.middle, z),
        S::Vec3::new(x.high.position, y.middle, z),
        S::Vec3::new(x.middle, y.low.position, z),
        S::Vec3::new(x.middle, y.high.position, z),
    ]
    .map(|ray| {
        let inverse = ray.length().recip();
        (ray * inverse, inverse)
    });
    (rays[0].0 + rays[1].0 + rays[2].0 + rays[3].0, rays)
}

/// Power Ω·I_rel(γ) and geometric centre of a rectangular spot.
#[inline(always)]
pub(crate) fn rectangle_light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    emission: &E,
) -> RectangleLight<S> {
    let (zero, half) = (S::zero(), S::half());
    let centroid = SideGradient { value: spot.x.middle, by_side: [half, half, zero, zero], ..SideGradient::default() };
    let (sum, rays) = central_axis(spot);
    let inverse = sum.length().recip();
    let direction = sum * inverse;
    let cosine = axis.dot(direction);
    if cosine <= zero {
        return RectangleLight { power: SideGradient::default(), centroid };
    }
    let (alpha, beta) = plate_of_rectangle(spot);
    let (omega, by_alpha, by_beta) = plate_solid_angle(alpha.tangent, beta.tangent);
    if !GRADIENT {
        let power = SideGradient { value: omega * emission.relative(cosine), ..SideGradient::default() };
        return RectangleLight { power, centroid };
    }
    let (relative, slope) = emission.with_slope(cosine);
    let weight = omega * slope;

    // d cos γ = w·d(sum) with w = (u − cos γ·direction)/|sum|; each unit vector turns by the part
    // of its ray's motion across the ray: v_i = (w − (w·â_i)â_i)/r_i.
    let w = (axis + direction * (-cosine)) * inverse;
    let v = rays.map(|(unit, inverse)| (w + unit * (-w.dot(unit))) * inverse);
    let x_middle = half * (v[2].x() + v[3].x());
    let y_middle = half * (v[0].y() + v[1].y());
    let z_sum = v[0].z() + v[1].z() + v[2].z() + v[3].z();

    let (oa, ob) = (by_alpha * relative, by_beta * relative);
    // ½·∂(distance²)/∂side of the mid-line across: the mid-line of x runs at y.middle.
    let (xm, ym) = (spot.x.middle, spot.y.middle);
    let by_side = [
        oa * alpha.by_low + ob * beta.by_distance2 * xm + weight * (v[0].x() + x_middle),
        oa * alpha.by_high + ob * beta.by_distance2 * xm + weight * (v[1].x() + x_middle),
        ob * beta.by_low + oa * alpha.by_distance2 * ym + weight * (v[2].y() + y_middle),
        ob * beta.by_high + oa * alpha.by_distance2 * ym + weight * (v[3].y() + y_middle),
    ];
    let two_h = S::two() * spot.height;
    RectangleLight {
        power: SideGradient {
            value: omega * relative,
            by_side,
            by_height: (oa * alpha.by_distance2 + ob * beta.by_distance2) * two_h - weight * z_sum,
            by_axis: direction * weight,
        },
        centroid,
    }
}

/// The plate that stands for a polygonal spot: a is the chord through the centroid along x,
/// b = area/a, centred on the centroid along y; the central axis passes through the centroid.
struct PolygonPlate<S: Scalar> {
    alpha: HalfAngle<S>,
    beta: HalfAngle<S>,
    left: usize,
    right: usize,
    chord: S,
    across: S,
    ray: S::Vec3,
}

impl<S: Scalar> PolygonPlate<S> {
    fn of(polygon: &Polygon<S>) -> Self {
        let [xc, yc] = polygon.centroid();
        let ((left, x_left), (right, x_right)) = polygon.chord(yc);
        let chord = x_right - x_left;
        let across = polygon.area() / chord;
        let h2 = polygon.height() * polygon.height();
        let half = S::half() * across;
        Self {
            alpha: HalfAngle::of_segment(x_left, x_right, chord, h2 + yc * yc),
            beta: HalfAngle::of_segment(yc - half, yc + half, across, h2 + xc * xc),
            left,
            right,
            chord,
            across,
            ray: S::Vec3::new(xc, yc, -polygon.height()),
        }
    }
}

/// Ω and cos γ of a polygonal spot, without derivatives.
pub(crate) fn polygon_beam<S: Scalar>(polygon: &Polygon<S>, axis: S::Vec3) -> Beam<S> {
    let plate = PolygonPlate::of(polygon);
    Beam {
        solid_angle: plate_solid_angle(plate.alpha.tangent, plate.beta.tangent).0,
        cosine: axis.dot(plate.ray) / plate.ray.length(),
    }
}

/// Power and centroid (relative to the emitter's foot) of a polygonal spot, with derivatives by
/// the emitter's position (foot fixed) and axis.
pub(crate) fn polygon_light<S: Scalar, E: Emission<S>, const GRADIENT: bool>(
    polygon: &Polygon<S>,
    axis: S::Vec3,
    emission: &E,
) -> (EmitterGradient<S>, EmitterGradient<S>) {
    let plate = PolygonPlate::of(polygon);
    let mut centroid = EmitterGradient::of_value(plate.ray.x());
    let (area_moved, x_moved, y_moved) = if GRADIENT { polygon.motion() } else { Default::default() };
    centroid.by_position = x_moved;
    let inverse = plate.ray.length().recip();
    let direction = plate.ray * inverse;
    let cosine = axis.dot(direction);
    if cosine <= S::zero() {
        return (EmitterGradient::of_value(S::zero()), centroid);
    }
    let (omega, by_alpha, by_beta) = plate_solid_angle(plate.alpha.tangent, plate.beta.tangent);
    let (relative, slope) = emission.with_slope(cosine);
    let mut power = EmitterGradient::of_value(omega * relative);
    if !GRADIENT {
        return (power, centroid);
    }
    // Everything below is relative to the moving emitter: positions on the detector shift by
    // minus the foot's motion.
    let ex = S::Vec3::new(S::one(), S::zero(), S::zero());
    let ey = S::Vec3::new(S::zero(), S::one(), S::zero());
    let ez = S::Vec3::new(S::zero(), S::zero(), S::one());
    let (xc, yc) = (x_moved - ex, y_moved - ey);
    let left = polygon.chord_motion(plate.left, y_moved) - ex;
    let right = polygon.chord_motion(plate.right, y_moved) - ex;
    let chord = right - left;
    let across = (area_moved + chord * (-plate.across)) * plate.chord.recip();
    let half_across = across * S::half();
    let two = S::two();
    let height2 = ez * (two * polygon.height());
    let alpha = left * plate.alpha.by_low
        + right * plate.alpha.by_high
        + (yc * (two * plate.ray.y()) + height2) * plate.alpha.by_distance2;
    let beta = (yc - half_across) * plate.beta.by_low
        + (yc + half_across) * plate.beta.by_high
        + (xc * (two * plate.ray.x()) + height2) * plate.beta.by_distance2;
    let turn = (axis + direction * (-cosine)) * inverse;
    power.by_position = (alpha * by_alpha + beta * by_beta) * relative
        + (xc * turn.x() + yc * turn.y() + ez * (-turn.z())) * (omega * slope);
    power.by_axis = direction * (omega * slope);
    (power, centroid)
}

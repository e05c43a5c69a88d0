//! The paper tier: equations (3) to (5) of De La Cruz, Gosselin, Bachta, Morel 2018, in equivalent
//! forms without cancellation.
//!
//! The spot is taken as a rectangular plate of a × b at distance d, perpendicular to the beam's
//! central axis. With α, β the tangents of half the angles that the spot's mid-lines subtend,
//! equation (3), Ω = 4·arccos √((1+α²+β²)/((1+α²)(1+β²))), equals
//! Ω = 4·atan(αβ/√(1+α²+β²)), which keeps all digits for small plates.

use crate::polygon::{EmitterGradient, Polygon};
use crate::profile::Falloff;
use crate::rectangle::{Extent, Rectangle, RectangleLight, SideGradient};
use crate::scalar::{Linear3, Number, array, zero_half_one};

/// Half the angle θ that a straight segment subtends at the emitter.
///
/// The segment runs from `low` to `high`, measured from the foot of the perpendicular, on a line at
/// squared distance d² from the emitter. With r₀, r₁ the distances of its ends from the emitter:
/// tan(θ/2) = |a×b|/(|a||b| + a·b) = (high − low)·d/D, D = r₀r₁ + low·high + d².
#[derive(Clone, Copy)]
struct HalfAngle<S> {
    low: S,
    high: S,
    length: S,
    distance2: S,
    /// r₁/r₀ and r₀/r₁.
    ratios: [S; 2],
    /// 1/D.
    inverse: S,
    /// tan²(θ/2).
    tangent2: S,
}

impl<S: Number> HalfAngle<S> {
    /// `rays`: r₀ and r₁, `inverses`: 1/r₀ and 1/r₁.
    #[inline(always)]
    fn new([low, high]: [S; 2], length: S, distance2: S, rays: [S; 2], inverses: [S; 2]) -> Self {
        let inverse = (rays[0] * rays[1] + low * high + distance2).inverse();
        let sine = length * inverse;
        let ratios = [rays[1] * inverses[0], rays[0] * inverses[1]];
        Self { low, high, length, distance2, ratios, inverse, tangent2: sine * sine * distance2 }
    }

    fn of_segment(low: S, high: S, length: S, distance2: S) -> Self {
        let rays = [low, high].map(|end| (end * end + distance2).root());
        Self::new([low, high], length, distance2, rays, rays.map(S::inverse))
    }

    /// Derivatives of ln tan(θ/2) with respect to `low`, `high` and d².
    #[inline(always)]
    fn slopes(&self) -> [S; 3] {
        let (one, half) = (self.length.constant(1.0), self.length.constant(0.5));
        // 1/length and 1/d² from one division.
        let both = (self.length * self.distance2).inverse();
        let (per_length, per_distance2) = (both * self.distance2, both * self.length);
        [
            -per_length - (self.ratios[0] * self.low + self.high) * self.inverse,
            per_length - (self.ratios[1] * self.high + self.low) * self.inverse,
            half * per_distance2 - (half * (self.ratios[0] + self.ratios[1]) + one) * self.inverse,
        ]
    }
}

/// Equation (3) and its derivatives with respect to ln α and ln β.
#[inline(always)]
fn plate_solid_angle<S: Number>(alpha2: S, beta2: S) -> (S, S, S) {
    let (one, four) = (alpha2.constant(1.0), alpha2.constant(4.0));
    let (alpha, beta) = (one + alpha2, one + beta2);
    // tan(Ω/4) = αβ/√(1 + α² + β²).
    let tangent = (alpha2 * beta2 / (alpha + beta2)).root();
    let slope = four * tangent / (alpha * beta);
    (four * quarter_angle(tangent), slope * beta, slope * alpha)
}

/// Below this tangent, the terms of the arc tangent's series that are left out are less than rounding.
const SMALL_TANGENT: f64 = 0.03;

/// arctan of a tangent ≥ 0.
#[inline(always)]
fn quarter_angle<S: Number>(tangent: S) -> S {
    if tangent > S::of(SMALL_TANGENT) {
        return tangent.arc_tangent();
    }
    let square = tangent * tangent;
    // t⁰/1 − t²/3 + t⁴/5 − …: the first term left out is t¹²/13, 4e-20 of the first.
    let mut sum = tangent.constant(1.0 / 11.0);
    for odd in [9.0, 7.0, 5.0, 3.0, 1.0_f64] {
        sum = tangent.constant(odd.recip()) - square * sum;
    }
    tangent * sum
}

/// Solid angle and angle of emission of a spot in the paper tier.
#[derive(Clone, Copy, Debug)]
pub struct Beam<S> {
    /// Ω of the plate, steradians.
    pub solid_angle: S,
    /// cos γ of the beam's central axis.
    pub cosine: S,
}

/// Ω and cos γ of a rectangular spot, without derivatives.
pub fn rectangle_beam<S: Number>(spot: &Rectangle<S>, axis: S::Vec3) -> Beam<S> {
    let rays = Rays::of(spot);
    let (alpha, beta) = rays.plate(spot);
    let sum = rays.sum(spot);
    Beam { solid_angle: plate_solid_angle(alpha.tangent2, beta.tangent2).0, cosine: axis.dot(sum) / sum.length() }
}

/// Lengths of the rays to the mid-points of a rectangle's sides (x low, x high, y low, y high), and
/// their inverses. The plate's mid-lines end at the same points.
struct Rays<S> {
    lengths: [S; 4],
    inverses: [S; 4],
}

impl<S: Number> Rays<S> {
    #[inline(always)]
    fn of(spot: &Rectangle<S>) -> Self {
        let h2 = spot.height * spot.height;
        let (x2, y2) = (spot.x.middle * spot.x.middle, spot.y.middle * spot.y.middle);
        let [x0, x1] = [spot.x.low.position, spot.x.high.position];
        let [y0, y1] = [spot.y.low.position, spot.y.high.position];
        let squares = [x0 * x0 + y2, x1 * x1 + y2, y0 * y0 + x2, y1 * y1 + x2];
        let squares: [S; 4] = array(h2, |i| squares[i] + h2);
        let inverses = array(h2, |i| squares[i].inverse_root());
        Self { lengths: array(h2, |i| squares[i] * inverses[i]), inverses }
    }

    /// The two half angles of the plate: along x and along y.
    #[inline(always)]
    fn plate(&self, spot: &Rectangle<S>) -> (HalfAngle<S>, HalfAngle<S>) {
        let h2 = spot.height * spot.height;
        (self.half_angle(&spot.x, h2, spot.y.middle, 0), self.half_angle(&spot.y, h2, spot.x.middle, 2))
    }

    /// Of the mid-line along `extent`, which ends with the rays `i` and i + 1.
    #[inline(always)]
    fn half_angle(&self, extent: &Extent<S>, h2: S, across: S, i: usize) -> HalfAngle<S> {
        HalfAngle::new(
            [extent.low.position, extent.high.position],
            extent.half.constant(2.0) * extent.half,
            h2 + across * across,
            [self.lengths[i], self.lengths[i + 1]],
            [self.inverses[i], self.inverses[i + 1]],
        )
    }

    /// Sum of the unit vectors along the rays.
    #[inline(always)]
    fn sum(&self, spot: &Rectangle<S>) -> S::Vec3 {
        let [i0, i1, i2, i3] = self.inverses;
        let (along_x, along_y) = (i0 + i1, i2 + i3);
        S::Vec3::new(
            spot.x.low.position * i0 + spot.x.high.position * i1 + spot.x.middle * along_y,
            spot.y.low.position * i2 + spot.y.high.position * i3 + spot.y.middle * along_x,
            -(spot.height * (along_x + along_y)),
        )
    }
}

/// Power Ω·I_rel(γ) and geometric centre of a rectangular spot.
#[inline(always)]
pub fn rectangle_light<S: Number, E: Falloff<S>, const GRADIENT: bool>(
    spot: &Rectangle<S>,
    axis: S::Vec3,
    emission: &E,
) -> RectangleLight<S> {
    let [zero, half, one] = zero_half_one(spot.height);
    let centroid = SideGradient { by_side: [half, half, zero, zero], ..SideGradient::of_value(zero) };
    let rays = Rays::of(spot);
    let sum = rays.sum(spot);
    let inverse = sum.dot(sum).inverse_root();
    let direction = sum * inverse;
    let cosine = axis.dot(direction);
    // Behind the horizon there is no light, and the profile is not defined.
    let in_front = |value| S::select_ge(zero, cosine, zero, value);
    let front = S::select_ge(zero, cosine, one, cosine);
    let (alpha, beta) = rays.plate(spot);
    let (omega, by_alpha, by_beta) = plate_solid_angle(alpha.tangent2, beta.tangent2);
    if !GRADIENT {
        let power = SideGradient::of_value(in_front(omega * emission.relative(front)));
        return RectangleLight { power, centroid };
    }
    let (relative, slope) = emission.with_slope(front);
    let (relative, slope) = (in_front(relative), in_front(slope));
    let weight = omega * slope;

    // d cos γ = w·d(sum) with w = (u − cos γ·direction)/|sum|; a unit vector â_i changes by the component
    // of its ray's motion across the ray, over r_i: v_i = (w − (w·â_i)â_i)/r_i.
    let w = (axis - direction * cosine) * inverse;
    let z = -spot.height;
    let (xm, ym) = (spot.x.middle, spot.y.middle);
    let ends =
        [[spot.x.low.position, ym], [spot.x.high.position, ym], [xm, spot.y.low.position], [xm, spot.y.high.position]];
    let mut v = [w; 4];
    for (i, across) in v.iter_mut().enumerate() {
        let inverse = rays.inverses[i];
        let unit = S::Vec3::new(ends[i][0] * inverse, ends[i][1] * inverse, z * inverse);
        *across = (w - unit * w.dot(unit)) * inverse;
    }
    let x_middle = half * (v[2].x() + v[3].x());
    let y_middle = half * (v[0].y() + v[1].y());
    let z_sum = v[0].z() + v[1].z() + v[2].z() + v[3].z();

    let (oa, ob) = (by_alpha * relative, by_beta * relative);
    let ([a_low, a_high, a_distance2], [b_low, b_high, b_distance2]) = (alpha.slopes(), beta.slopes());
    // ½·∂(distance²)/∂side of the other mid-line: the mid-line along x lies at y.middle.
    let (across_x, across_y) = (ob * b_distance2 * xm, oa * a_distance2 * ym);
    let by_side = [
        oa * a_low + across_x + weight * (v[0].x() + x_middle),
        oa * a_high + across_x + weight * (v[1].x() + x_middle),
        ob * b_low + across_y + weight * (v[2].y() + y_middle),
        ob * b_high + across_y + weight * (v[3].y() + y_middle),
    ];
    let two_h = spot.height.constant(2.0) * spot.height;
    RectangleLight {
        power: SideGradient {
            value: omega * relative,
            by_side,
            by_height: (oa * a_distance2 + ob * b_distance2) * two_h - weight * z_sum,
            by_axis: direction * weight,
        },
        centroid,
    }
}

/// The plate equivalent to a polygonal spot: a is the chord through the centroid along x,
/// b = area/a, centred on the centroid along y.
struct PolygonPlate<S: Number> {
    alpha: HalfAngle<S>,
    beta: HalfAngle<S>,
    left: usize,
    right: usize,
    chord: S,
    across: S,
    beam: CentralAxis<S>,
}

impl<S: Number> PolygonPlate<S> {
    fn of(polygon: &Polygon<S>, skew: S) -> Self {
        let [xc, yc] = polygon.centroid();
        let ((left, x_left), (right, x_right)) = polygon.chord(yc);
        let chord = x_right - x_left;
        let across = polygon.area() / chord;
        let h2 = polygon.height() * polygon.height();
        let half = S::half() * across;
        let ray = |x, y| S::Vec3::new(x, y, -polygon.height());
        let ends = [ray(x_left, yc), ray(x_right, yc), ray(xc, yc - half), ray(xc, yc + half)];
        Self {
            alpha: HalfAngle::of_segment(x_left, x_right, chord, h2 + yc * yc),
            beta: HalfAngle::of_segment(yc - half, yc + half, across, h2 + xc * xc),
            left,
            right,
            chord,
            across,
            beam: CentralAxis::of(ends, ray(xc, yc), skew),
        }
    }
}

/// The beam's central axis: for a tilted slit, the ray to the spot's centroid; for a rectangle, the sum
/// of the unit vectors to the mid-points of the plate's edges. `skew` blends the two definitions.
struct CentralAxis<S: Number> {
    ends: [S::Vec3; 4],
    centroid: S::Vec3,
    skew: S,
    sum: S::Vec3,
    /// Weighted sum of both definitions, before normalisation.
    blend: S::Vec3,
    direction: S::Vec3,
}

impl<S: Number> CentralAxis<S> {
    fn of(ends: [S::Vec3; 4], centroid: S::Vec3, skew: S) -> Self {
        let unit = |v: S::Vec3| v * v.length().recip();
        let sum = ends.into_iter().map(unit).fold(S::Vec3::default(), |sum, end| sum + end);
        let blend = unit(sum) * (S::one() - skew) + unit(centroid) * skew;
        Self { ends, centroid, skew, sum, blend, direction: unit(blend) }
    }

    /// Derivative of cos γ with respect to the emitter's position, given those of x and y of the edge
    /// mid-points (`ends`) and of the centroid.
    fn turn(&self, axis: S::Vec3, ends: [[S::Vec3; 2]; 4], centroid: [S::Vec3; 2]) -> S::Vec3 {
        // A unit vector changes by the component of the motion across it, over the vector's length.
        let across = |v: S::Vec3, of: S::Vec3| {
            let inverse = of.length().recip();
            let unit = of * inverse;
            (v - unit * unit.dot(v)) * inverse
        };
        // Relative to the emitter all points have z = −height: z falls as the emitter rises.
        let along = |weight: S::Vec3, [x, y]: [S::Vec3; 2]| {
            x * weight.x() + y * weight.y() - S::Vec3::new(S::zero(), S::zero(), weight.z())
        };
        let of_blend = across(axis, self.blend);
        let of_sum = across(of_blend, self.sum) * (S::one() - self.skew);
        let of_ends = self.ends.into_iter().zip(ends).map(|(end, moved)| along(across(of_sum, end), moved));
        let of_centroid = along(across(of_blend, self.centroid) * self.skew, centroid);
        of_ends.fold(of_centroid, |sum, end| sum + end)
    }
}

/// Ω and cos γ of a polygonal spot, without derivatives. `skew`: see [`Turned`](crate::aperture::Turned).
pub fn polygon_beam<S: Number>(polygon: &Polygon<S>, axis: S::Vec3, skew: S) -> Beam<S> {
    let plate = PolygonPlate::of(polygon, skew);
    Beam {
        solid_angle: plate_solid_angle(plate.alpha.tangent2, plate.beta.tangent2).0,
        cosine: axis.dot(plate.beam.direction),
    }
}

/// Power and centroid (relative to the emitter's foot) of a polygonal spot, with derivatives with respect
/// to the emitter's position (foot fixed) and axis. `skew`: see [`Turned`](crate::aperture::Turned).
pub fn polygon_light<S: Number, E: Falloff<S>, const GRADIENT: bool>(
    polygon: &Polygon<S>,
    axis: S::Vec3,
    emission: &E,
    skew: S,
) -> (EmitterGradient<S>, EmitterGradient<S>) {
    let plate = PolygonPlate::of(polygon, skew);
    let [x_centre, y_centre] = [plate.beam.centroid.x(), plate.beam.centroid.y()];
    let mut centroid = EmitterGradient::of_value(x_centre);
    let (area_moved, x_moved, y_moved) = if GRADIENT { polygon.motion() } else { Default::default() };
    centroid.by_position = x_moved;
    let cosine = axis.dot(plate.beam.direction);
    if cosine <= S::zero() {
        return (EmitterGradient::of_value(S::zero()), centroid);
    }
    let (omega, by_alpha, by_beta) = plate_solid_angle(plate.alpha.tangent2, plate.beta.tangent2);
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
    let ([a_low, a_high, a_distance2], [b_low, b_high, b_distance2]) = (plate.alpha.slopes(), plate.beta.slopes());
    let alpha = left * a_low + right * a_high + (yc * (two * y_centre) + height2) * a_distance2;
    let beta =
        (yc - half_across) * b_low + (yc + half_across) * b_high + (xc * (two * x_centre) + height2) * b_distance2;
    let ends = [[left, yc], [right, yc], [xc, yc - half_across], [xc, yc + half_across]];
    power.by_position =
        (alpha * by_alpha + beta * by_beta) * relative + plate.beam.turn(axis, ends, [xc, yc]) * (omega * slope);
    power.by_axis = plate.beam.direction * (omega * slope);
    (power, centroid)
}

/// The relative radiant intensity that gives a measured photocurrent, I_rel = I_Om/(S·Ω·I_e):
/// equation (6) of De La Cruz, Gosselin, Bachta, Morel 2018.
///
/// `i_om_a` is the measured photocurrent without dark current (amperes), `solid_angle_sr` the
/// spot's Ω (steradians), `radiant_intensity_w_per_sr` the axial I_e, `responsivity_a_per_w` the
/// detector's S. `None` if the model expects no light: S·Ω·I_e is not positive, or so small that the
/// quotient is not finite.
pub fn identified_relative_intensity(
    i_om_a: f64,
    solid_angle_sr: f64,
    radiant_intensity_w_per_sr: f64,
    responsivity_a_per_w: f64,
) -> Option<f64> {
    let full = responsivity_a_per_w * solid_angle_sr * radiant_intensity_w_per_sr;
    (full > 0.0).then(|| i_om_a / full).filter(|relative| relative.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_equation_5_gives_equation_6_takes_back() {
        // I_O = Ω·I_e·I_rel·S of the bench: 3.5523 msr, 3.16 mW/sr, 0.54 A/W, I_rel = ½.
        let i_o_a = 3.5523e-3 * 3.16e-3 * 0.5 * 0.54;
        let relative = identified_relative_intensity(i_o_a, 3.5523e-3, 3.16e-3, 0.54);
        assert!((relative.expect("light") - 0.5).abs() < 1e-15);
        for dark in [[0.0, 3.16e-3, 0.54], [3.5523e-3, 0.0, 0.54], [3.5523e-3, 3.16e-3, 0.0]] {
            assert_eq!(identified_relative_intensity(i_o_a, dark[0], dark[1], dark[2]), None);
        }
        assert_eq!(identified_relative_intensity(i_o_a, 1e-312, 3.16e-3, 0.54), None);
    }
}

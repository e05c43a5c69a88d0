//! The polygonal spot of a turned slit, or of a spot that the emitter's horizon (γ = 90°) cuts.
//!
//! The detector's rectangle is clipped by the planes through the emitter and each slit edge. No
//! slit corner is projected, so corners beside or above the emitter need no special case.
//! Positions are relative to the emitter's foot point. Each edge carries its motion with the emitter.

use heapless::Vec;

use crate::aperture::Turned;
use crate::rectangle::Rectangle;
use crate::response::Status;
use crate::scalar::{Linear3, Number, Real};

/// Four sides of the detector, four of each of the two slit faces, the mask plane and the horizon make 14; the ten sides
/// of a round hole, four of the detector and the horizon 15.
pub const MAX_CORNERS: usize = 16;

/// A line in the detector plane, F(X, Y) = normal·(X, Y) + offset, positive inside.
#[derive(Clone, Copy, Debug)]
pub struct Line<S: Number> {
    pub normal: [S; 2],
    pub offset: S,
    pub motion: Motion<S>,
}

#[derive(Clone, Copy, Debug)]
pub enum Motion<S: Number> {
    /// Shadow of the slit edge from `corner` (relative to the emitter) along `edge`.
    Shadow { corner: S::Vec3, edge: S::Vec3 },
    /// The emitter's horizon, perpendicular to its `axis`.
    Horizon { axis: S::Vec3 },
    /// Shadow of an edge that rides with the emitter, in the plane with this normal.
    Riding { normal: S::Vec3 },
    /// With this ∂F/∂e all along; `is_end`: a side of the detector across x.
    Moved { by_position: S::Vec3, is_end: bool },
}

impl<S: Number> Motion<S> {
    pub fn is_still(&self) -> bool {
        matches!(self, Self::Moved { by_position, .. } if *by_position == S::Vec3::default())
    }
}

impl<S: Number> Line<S> {
    #[inline(always)]
    fn at(&self, point: [S; 2]) -> S {
        self.normal[0] * point[0] + self.normal[1] * point[1] + self.offset
    }

    /// The plane through the emitter and the `edge` of a slit from `corner`, relative to the emitter: see [`Turned::edges`].
    fn shadow(corner: S::Vec3, edge: S::Vec3, height: S) -> Self {
        Self { motion: Motion::Shadow { corner, edge }, ..Self::riding(corner.cross(edge), height) }
    }

    /// The plane with this `normal` through an emitter at `height`, of an edge that rides with it.
    fn riding(normal: S::Vec3, height: S) -> Self {
        Self { normal: [normal.x(), normal.y()], offset: -normal.z() * height, motion: Motion::Riding { normal } }
    }

    /// Outward motion of the line at `point` per motion of the emitter, per change of its axis, and per turn about it of all
    /// that rides with it: ∂F/∂e, ∂F/∂u and ∂F/∂ω over |∇F|.
    ///
    /// With F = (p − q)·((q − e)×E): ∂F/∂e = −E×(p − q). With F = p·N and dN = ω×N: ∂F/∂e = −N, ∂F/∂ω = N×p.
    pub fn speeds(&self, point: S::Vec3) -> [S::Vec3; 3] {
        let (none, inverse) = (S::Vec3::default(), self.inverse_gradient());
        let slopes = match self.motion {
            Motion::Shadow { corner, edge } => [-edge.cross(point - corner), none, none],
            Motion::Horizon { axis } => [-axis, point, none],
            Motion::Riding { normal } => [-normal, none, normal.cross(point)],
            Motion::Moved { by_position, .. } => [by_position, none, none],
        };
        slopes.map(|slope| slope * inverse)
    }

    fn inverse_gradient(&self) -> S {
        S::norm(self.normal[0], self.normal[1]).recip()
    }
}

/// A quantity and its derivatives with respect to the emitter's position (at fixed detector
/// coordinates) and axis, cell frame.
#[derive(Clone, Copy, Debug)]
pub struct EmitterGradient<R: Real> {
    pub value: R,
    pub by_position: R::Vec3,
    pub by_axis: R::Vec3,
}

impl<R: Real> EmitterGradient<R> {
    #[inline(always)]
    pub fn of_value(value: R) -> Self {
        let zero = value.constant(0.0);
        let none = R::Vec3::new(zero, zero, zero);
        Self { value, by_position: none, by_axis: none }
    }
}

impl<S: Number> Default for EmitterGradient<S> {
    fn default() -> Self {
        Self::of_value(S::zero())
    }
}

/// A convex spot; edge i runs from corner i to corner i + 1 on line i.
#[derive(Clone, Debug)]
pub struct Polygon<S: Number> {
    corners: Vec<[S; 2], MAX_CORNERS>,
    lines: Vec<Line<S>, MAX_CORNERS>,
    height: S,
}

impl<S: Number> Polygon<S> {
    /// The spot of the beam through a turned slit from an emitter at `emitter` (cell frame).
    pub fn of_beam(slit: &Turned<S>, emitter: S::Vec3, detector_half: [S; 2]) -> Result<(Self, Status), Status> {
        if (emitter - slit.centre).dot(slit.normal) <= slit.half_thickness {
            return Err(Status::Behind);
        }
        let mut polygon = Self::detector(emitter, detector_half);
        // Where a tilted mask dips below the detector surface, light reaches the detector in front of the mask and has
        // not passed the slit: only points behind the mask count.
        let below = slit.centre - emitter + slit.normal * -slit.half_thickness;
        polygon.clip(Line {
            normal: [-slit.normal.x(), -slit.normal.y()],
            offset: slit.normal.dot(below) + slit.normal.z() * emitter.z(),
            motion: Motion::Moved { by_position: Default::default(), is_end: false },
        });
        for [corner, edge] in slit.edges[..slit.face_count].as_flattened() {
            polygon.clip(Line::shadow(*corner - emitter, *edge, emitter.z()));
        }
        polygon.with_status()
    }

    /// The spot of an emitter at `emitter` between `planes` through it that ride with it, their normals towards the inside.
    pub fn of_riding(planes: &[S::Vec3], emitter: S::Vec3, detector_half: [S; 2]) -> Result<(Self, Status), Status> {
        let mut polygon = Self::detector(emitter, detector_half);
        for &normal in planes {
            polygon.clip(Line::riding(normal, polygon.height));
        }
        polygon.with_status()
    }

    /// The part of a hole with these `corners`, in a plane at `height` below the emitter, within `sides`.
    pub fn of_hole(
        corners: impl IntoIterator<Item = [S; 2]>,
        height: S,
        sides: impl IntoIterator<Item = Line<S>>,
    ) -> Result<(Self, Status), Status> {
        let corners: Vec<[S; 2], MAX_CORNERS> = corners.into_iter().collect();
        // They stay where they are, and what stays needs no normal.
        let still = Line {
            normal: [S::zero(); 2],
            offset: S::zero(),
            motion: Motion::Moved { by_position: Default::default(), is_end: false },
        };
        let lines = corners.iter().map(|_| still).collect();
        let mut polygon = Self { corners, lines, height };
        sides.into_iter().for_each(|side| polygon.clip(side));
        polygon.with_status()
    }

    fn with_status(self) -> Result<(Self, Status), Status> {
        if !self.has_area() {
            return Err(Status::Dark);
        }
        let is_end = |line: &Line<S>| matches!(line.motion, Motion::Moved { is_end: true, .. });
        let status = if self.lines.iter().any(is_end) { Status::Clipped } else { Status::Lit };
        Ok((self, status))
    }

    /// A rectangular spot within the ends of a detector, whose sides (x low, x high, y low, y high) move on it with the
    /// emitter.
    pub fn of_rectangle(spot: &Rectangle<S>, motions: [S::Vec3; 4]) -> Self {
        let [[x0, y0], _, [x1, y1], _] = spot.corners();
        let [low_x, high_x, low_y, high_y] = motions;
        let line = |is_end: bool, sign: S, at: S, motion: S::Vec3| Line {
            normal: if is_end { [-sign, S::zero()] } else { [S::zero(), -sign] },
            offset: sign * at,
            motion: Motion::Moved { by_position: motion * sign, is_end },
        };
        let (low, high) = (-S::one(), S::one());
        let lines = [
            line(false, low, y0, low_y),
            line(true, high, x1, high_x),
            line(false, high, y1, high_y),
            line(true, low, x0, low_x),
        ];
        Self { corners: spot.corners().into(), lines: lines.into(), height: spot.height }
    }

    fn detector(emitter: S::Vec3, [x, y]: [S; 2]) -> Self {
        let (ex, ey) = (emitter.x(), emitter.y());
        Self::of_rectangle(&Rectangle::between([-x - ex, x - ex], [-y - ey, y - ey], emitter.z()), Default::default())
    }

    /// Clips the spot to the emitter's front half-space, u·(p − e) > 0; whether any area is left.
    pub fn clip_horizon(&mut self, axis: S::Vec3) -> bool {
        self.clip(Line {
            normal: [axis.x(), axis.y()],
            offset: -axis.z() * self.height,
            motion: Motion::Horizon { axis },
        });
        self.has_area()
    }

    /// Clips the spot to the side where `line` is positive (Sutherland and Hodgman 1974).
    fn clip(&mut self, line: Line<S>) {
        let count = self.corners.len();
        let values: Vec<S, MAX_CORNERS> = self.corners.iter().map(|&corner| line.at(corner)).collect();
        let zero = S::zero();
        if values.iter().all(|&value| value >= zero) {
            return;
        }
        let (mut corners, mut lines) = (Vec::new(), Vec::new());
        let mut push = |corner, line| {
            // A convex polygon gains at most one corner per cut; the capacity covers all cuts.
            let _ = corners.push(corner);
            let _ = lines.push(line);
        };
        for i in 0..count {
            let j = (i + 1) % count;
            let (a, b) = (self.corners[i], self.corners[j]);
            let (fa, fb) = (values[i], values[j]);
            let crossing = || {
                let t = fa / (fa - fb);
                [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
            };
            match (fa >= zero, fb >= zero) {
                (true, true) => push(a, self.lines[i]),
                (true, false) => {
                    push(a, self.lines[i]);
                    push(crossing(), line);
                }
                (false, true) => push(crossing(), self.lines[i]),
                (false, false) => {}
            }
        }
        self.corners = corners;
        self.lines = lines;
    }

    /// Whether the area exceeds the rounding of its corners, which grows with their distance from the
    /// emitter's foot.
    fn has_area(&self) -> bool {
        let perimeter = (0..self.corners.len()).fold(S::zero(), |sum, i| sum + self.edge_length(i));
        let farthest = self.corners.as_flattened().iter().fold(S::zero(), |most, x| most.max(x.abs()));
        self.corners.len() >= 3
            && self.area() > S::of(64.0) * S::epsilon() * perimeter * (perimeter + S::of(0.1) * farthest)
    }

    pub fn height(&self) -> S {
        self.height
    }

    pub fn corners(&self) -> &[[S; 2]] {
        &self.corners
    }

    /// Edges as (line, from, to).
    pub fn edges(&self) -> impl Iterator<Item = (&Line<S>, [S; 2], [S; 2])> {
        let count = self.corners.len();
        self.lines.iter().enumerate().map(move |(i, line)| (line, self.corners[i], self.corners[(i + 1) % count]))
    }

    /// The greatest cos γ of a ray to the spot, for an emitter with this axis.
    pub fn greatest_cosine(&self, axis: S::Vec3) -> S {
        // Inside the spot if the axis itself points down and meets it: cos γ = 1.
        let down = -axis.z();
        let lands = [axis.x() * self.height / down, axis.y() * self.height / down];
        let is_left_of = |([ax, ay], [bx, by]): ([S; 2], [S; 2])| {
            (bx - ax) * (lands[1] - ay) - (by - ay) * (lands[0] - ax) >= S::zero()
        };
        if down > S::zero() && self.edges().all(|(_, a, b)| is_left_of((a, b))) {
            return S::one();
        }
        // Along an edge a + τ(b − a), cos γ = (f + gτ)/√(r² + 2mτ + l²τ²) is greatest at
        // τ = (g·r² − f·m)/(f·l² − g·m), or at an end.
        let ray = |[x, y]: [S; 2]| S::Vec3::new(x, y, -self.height);
        let cosine = |ray: S::Vec3| axis.dot(ray) / ray.length();
        self.edges().fold(S::zero(), |greatest, (_, a, b)| {
            let (start, along) = (ray(a), ray(b) - ray(a));
            let (f, g) = (axis.dot(start), axis.dot(along));
            let (r2, m, l2) = (start.dot(start), start.dot(along), along.dot(along));
            let tau = ((g * r2 - f * m) / (f * l2 - g * m)).max(S::zero()).min(S::one());
            let between = if tau.is_nan() { greatest } else { cosine(start + along * tau) };
            greatest.max(cosine(start)).max(between)
        })
    }

    fn edge_length(&self, i: usize) -> S {
        let (a, b) = (self.corners[i], self.corners[(i + 1) % self.corners.len()]);
        S::norm(b[0] - a[0], b[1] - a[1])
    }

    /// Triangles of the fan around corner 0, as (twice the area, second corner, third corner).
    fn fan(&self) -> impl Iterator<Item = (S, [S; 2], [S; 2])> {
        let [x0, y0] = self.corners.first().copied().unwrap_or_default();
        self.corners.windows(2).skip(1).map(move |pair| {
            ((pair[0][0] - x0) * (pair[1][1] - y0) - (pair[1][0] - x0) * (pair[0][1] - y0), pair[0], pair[1])
        })
    }

    /// The exact solid angle at the emitter, steradians.
    pub fn solid_angle(&self) -> S {
        fan_solid_angle(self.corners[0], self.fan(), self.height)
    }

    pub fn area(&self) -> S {
        S::half() * self.fan().fold(S::zero(), |sum, (twice, ..)| sum + twice)
    }

    /// Centre of the area, relative to the emitter's foot.
    pub fn centroid(&self) -> [S; 2] {
        let origin = self.corners[0];
        let mut sums = [S::zero(); 3];
        for (twice, b, c) in self.fan() {
            sums[0] += twice;
            sums[1] += twice * (b[0] + c[0] - S::two() * origin[0]);
            sums[2] += twice * (b[1] + c[1] - S::two() * origin[1]);
        }
        let third = (S::of(3.0) * sums[0]).recip();
        [origin[0] + sums[1] * third, origin[1] + sums[2] * third]
    }

    /// The chord at height y: (edge, x) of its left and its right end.
    pub fn chord(&self, y: S) -> ((usize, S), (usize, S)) {
        let mut left = (0, S::infinity());
        let mut right = (0, S::neg_infinity());
        for (i, (_, a, b)) in self.edges().enumerate() {
            let (below, above) = (a[1].min(b[1]), a[1].max(b[1]));
            if y < below || y > above || below == above {
                continue;
            }
            let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            if x < left.1 {
                left = (i, x);
            }
            if x > right.1 {
                right = (i, x);
            }
        }
        (left, right)
    }

    /// Derivatives of the area and of the centroid's x and y with respect to the emitter's position,
    /// at fixed detector coordinates.
    ///
    /// An edge that moves outward by δ adds ∫δ ds of area and ∫pδ ds of first moment; δ is linear
    /// along an edge, so both integrals are exact.
    pub fn motion(&self) -> (S::Vec3, S::Vec3, S::Vec3) {
        let [xc, yc] = self.centroid();
        let (third, sixth) = (S::of(1.0 / 3.0), S::of(1.0 / 6.0));
        let (mut area, mut x, mut y) = (S::Vec3::default(), S::Vec3::default(), S::Vec3::default());
        for (i, (line, a, b)) in self.edges().enumerate() {
            let length = self.edge_length(i);
            let speed = |p: [S; 2]| line.speeds(S::Vec3::new(p[0], p[1], -self.height))[0] * length;
            let (da, db) = (speed(a), speed(b));
            let moment = |pa: S, pb: S| da * (pa * third + pb * sixth) + db * (pb * third + pa * sixth);
            area += (da + db) * S::half();
            x += moment(a[0] - xc, b[0] - xc);
            y += moment(a[1] - yc, b[1] - yc);
        }
        let inverse = self.area().recip();
        (area, x * inverse, y * inverse)
    }

    /// Derivative of x of the centroid chord's end on edge `i` with respect to the emitter's position,
    /// given that of the centroid's y, `y_moved`: on the line, F_x·dx + F_y·dy + ∂F/∂e·de = 0.
    pub fn chord_motion(&self, i: usize, y_moved: S::Vec3) -> S::Vec3 {
        let line = &self.lines[i];
        let [_, yc] = self.centroid();
        let (a, b) = (self.corners[i], self.corners[(i + 1) % self.corners.len()]);
        let x = a[0] + (yc - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
        let by_position = line.speeds(S::Vec3::new(x, yc, -self.height))[0] * line.inverse_gradient().recip();
        (by_position + y_moved * line.normal[1]) * -(line.normal[0].recip())
    }
}

/// Solid angle of the triangle with corners `a`, `b`, `c` (relative to the foot point of an
/// observer at `height`), given twice its area (Van Oosterom and Strackee 1983):
/// tan(Ω/2) = a·(b×c)/(abc + (a·b)c + (b·c)a + (c·a)b). The triple product is computed without
/// cancellation as the height times twice the area.
fn triangle_solid_angle<S: Number>(twice_area: S, a: [S; 2], b: [S; 2], c: [S; 2], height: S) -> S {
    let h2 = height * height;
    let dot = |p: [S; 2], q: [S; 2]| p[0] * q[0] + p[1] * q[1] + h2;
    let (ra, rb, rc) = (dot(a, a).root(), dot(b, b).root(), dot(c, c).root());
    let denominator = ra * rb * rc + dot(a, b) * rc + dot(b, c) * ra + dot(c, a) * rb;
    S::two() * (height * twice_area).angle_from(denominator)
}

/// Solid angle of a convex polygon given as a fan: its first corner, and for each triangle twice
/// its area and the two other corners.
pub fn fan_solid_angle<S: Number>(first: [S; 2], fan: impl Iterator<Item = (S, [S; 2], [S; 2])>, height: S) -> S {
    // The sum is negative only for a sliver thinner than its corners' rounding.
    fan.fold(S::zero(), |sum, (twice, b, c)| sum + triangle_solid_angle(twice, first, b, c, height)).max(S::zero())
}

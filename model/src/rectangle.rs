//! The rectangular spot of a slit parallel to its detector.

use crate::aperture::{Face, Span};
use crate::response::Status;
use crate::scalar::{Linear3, Number, Real, zero_half_one};

/// One side of the spot along one axis, with its motion.
///
/// A slit edge q at height q_z lands at X = (q − e)·k relative to the emitter's foot, with the
/// magnification k = e_z/(e_z − q_z). An edge of the detector is a slit edge at height 0: k = 1.
/// Hence ∂X/∂e = −k and ∂X/∂e_z = −X·(k − 1)/e_z for both.
#[derive(Clone, Copy, Debug)]
pub struct Edge<S> {
    pub position: S,
    pub magnification: S,
}

/// The spot along one axis, relative to the emitter's foot point.
#[derive(Clone, Copy, Debug)]
pub struct Extent<S> {
    pub low: Edge<S>,
    pub high: Edge<S>,
    pub middle: S,
    /// The middle relative to the detector's centre. For an emitter far to the side, adding the foot
    /// point to `middle` would cost digits.
    pub landing: S,
    pub half: S,
}

/// A rectangular spot, relative to the emitter's foot point, and the emitter's height above it.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle<S> {
    pub x: Extent<S>,
    pub y: Extent<S>,
    pub height: S,
}

/// Slack per distance of the emitter from a wall of a thick mask, where the other face begins to bound the beam. Nothing
/// magnifies the emitter's motion there, while [`MAX_MAGNIFICATION`] is allowed for elsewhere; √17 is that of an
/// emitter on the longest arm that one of sixteen can have, four length scales.
pub const WALL_SLACK: f64 = MAX_MAGNIFICATION / 4.124;

/// Bound on how far the side of a spot moves per motion of its emitter, including rotations of long tools.
pub const MAX_MAGNIFICATION: f64 = 10.0;

/// Origin of a side that is an edge of the detector; else the index of its face.
pub const DETECTOR: f64 = -1.0;

impl<R: Real> Extent<R> {
    /// Intersection of the beam through `spans` (with their magnifications) and the detector, empty if
    /// its half length is not positive; 1 if an end of the detector cuts the beam, else 0; distance of
    /// the nearest other edge from becoming a side of the spot.
    #[inline(always)]
    fn of_beam<const N: usize>(spans: [(Span<R>, [R; 2]); N], e: R, detector_half: R) -> (Self, R, R) {
        let [zero, half, one] = zero_half_one(e);
        // Relative to the detector's centre, q·k − e·m with m = q_z/(e_z − q_z) does not cancel.
        let mut low = Edge { position: -detector_half, magnification: one };
        let mut high = Edge { position: detector_half, magnification: one };
        let (mut from_low, mut from_high) = (e.constant(DETECTOR), e.constant(DETECTOR));
        let mut length = zero;
        let mut slack = e.constant(f64::MAX);
        for (index, (span, [k, m])) in spans.into_iter().enumerate() {
            let index = e.constant(index as f64);
            let shift = e * m;
            let (a, b) = (span.low * k - shift, span.high * k - shift);
            for (apart, wall, from) in
                [(a - low.position, span.low, from_low), (high.position - b, span.high, from_high)]
            {
                let mut apart = apart.magnitude();
                if N > 1 {
                    let from_wall = e.constant(WALL_SLACK) * (e - wall).magnitude();
                    apart = R::select_ge(from, zero, from_wall, apart);
                }
                slack = R::select_ge(slack, apart, apart, slack);
            }
            let from = low.position;
            low.position = R::select_ge(a, from, a, from);
            low.magnification = R::select_ge(a, from, k, low.magnification);
            from_low = R::select_ge(a, from, index, from_low);
            length = R::select_ge(a, from, span.length * k, length);
            let to = high.position;
            high.position = R::select_ge(to, b, b, to);
            high.magnification = R::select_ge(to, b, k, high.magnification);
            from_high = R::select_ge(to, b, index, from_high);
        }
        let cut = R::select_ge(from_low, zero, R::select_ge(from_high, zero, zero, one), one);
        // If both sides are of one face, its magnified length replaces the difference, which may cancel.
        let difference = high.position - low.position;
        let one_face = R::select_ge(from_low, from_high, length, difference);
        let extent = R::select_ge(from_high, from_low, one_face, difference);
        let extent = R::select_ge(zero, cut, extent, difference);
        let landing = half * (low.position + high.position);
        let low = Edge { position: low.position - e, ..low };
        let high = Edge { position: high.position - e, ..high };
        (Self { low, high, middle: landing - e, landing, half: half * extent }, cut, slack)
    }
}

impl<R: Real> Rectangle<R> {
    /// The spot of the beam from `emitter` that passes all `faces`, and its visibility per lane. In lanes
    /// without a spot the rectangle is meaningless.
    #[inline(always)]
    pub fn of_beam<const N: usize>(
        faces: [Face<R>; N],
        emitter: [R; 3],
        detector_half: [R; 2],
    ) -> (Self, Visibility<R>) {
        let [ex, ey, ez] = emitter;
        let (zero, one) = (ez.constant(0.0), ez.constant(1.0));
        let mut behind = zero;
        let (mut along_x, mut along_y) = ([(faces[0].x, [one; 2]); N], [(faces[0].y, [one; 2]); N]);
        for (i, face) in faces.into_iter().enumerate() {
            behind = R::select_ge(face.z, ez, one, behind);
            let inverse = (ez - face.z).inverse();
            let by = [ez * inverse, face.z * inverse];
            (along_x[i], along_y[i]) = ((face.x, by), (face.y, by));
        }
        let (x, cut, slack_x) = Extent::of_beam(along_x, ex, detector_half[0]);
        let (y, _, slack_y) = Extent::of_beam(along_y, ey, detector_half[1]);
        let slack = R::select_ge(slack_x, slack_y, slack_y, slack_x);
        let visibility = Visibility::of(behind, cut, [x.half, y.half], slack);
        (Self { x, y, height: ez }, visibility)
    }

    /// The rectangle between these sides, which do not move on the detector, of an emitter at `height` above its foot.
    pub fn between(x: [R; 2], y: [R; 2], height: R) -> Self {
        let [_, half, one] = zero_half_one(height);
        let extent = |[low, high]: [R; 2]| {
            let side = |position| Edge { position, magnification: one };
            let middle = half * (low + high);
            Extent { low: side(low), high: side(high), middle, landing: middle, half: half * (high - low) }
        };
        Self { x: extent(x), y: extent(y), height }
    }

    /// How the sides (x low, x high, y low, y high) move on the detector with the emitter.
    pub fn motions(&self) -> [R::Vec3; 4] {
        let [zero, _, one] = zero_half_one(self.height);
        let motion = |side: Edge<R>, [x, y]: [R; 2]| {
            R::Vec3::new(x, y, side.position / self.height) * (one - side.magnification)
        };
        let (along, across) = ([one, zero], [zero, one]);
        [motion(self.x.low, along), motion(self.x.high, along), motion(self.y.low, across), motion(self.y.high, across)]
    }

    /// Corners in order around the spot, relative to the emitter's foot point.
    pub fn corners(&self) -> [[R; 2]; 4] {
        let (x0, x1) = (self.x.low.position, self.x.high.position);
        let (y0, y1) = (self.y.low.position, self.y.high.position);
        [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    }
}

/// The quantities that decide the status, lane by lane.
#[derive(Clone, Copy, Debug)]
pub struct Visibility<R> {
    /// 1 where the emitter is at or behind a face.
    behind: R,
    /// 1 where an end of the detector cuts the spot along x.
    cut: R,
    /// The smaller half extent.
    narrower: R,
    /// Least motion of the spot's sides after which another edge bounds the spot, metres on the
    /// detector: the derivatives jump there.
    slack: R,
}

impl<R: Real> Visibility<R> {
    /// See the fields; the half extents along x and y decide which is the smaller.
    #[inline(always)]
    pub fn of(behind: R, cut: R, [x, y]: [R; 2], slack: R) -> Self {
        // With a pose that is NaN both half extents are NaN, and the spot is dark.
        Self { behind, cut, narrower: R::select_ge(x, y, y, x), slack }
    }

    #[inline(always)]
    pub fn slack_m(&self, lane: usize) -> R::Element {
        self.slack.lane(lane)
    }

    /// `yes` in lanes with a spot, else `no`.
    #[cfg(all(feature = "lanes", target_arch = "x86_64"))]
    #[inline(always)]
    pub fn where_spot(&self, yes: R, no: R) -> R {
        let zero = self.behind.constant(0.0);
        R::select_gt(self.behind, zero, no, R::select_gt(self.narrower, zero, yes, no))
    }

    #[inline(always)]
    pub fn status(&self, lane: usize) -> Status {
        let zero = R::Element::default();
        if self.behind.lane(lane) > zero {
            Status::Behind
        } else if self.narrower.lane(lane) > zero {
            if self.cut.lane(lane) > zero { Status::Clipped } else { Status::Lit }
        } else {
            Status::Dark
        }
    }
}

impl<S: Number> Visibility<S> {
    /// The status of the one lane.
    ///
    /// # Errors
    /// The status without a spot.
    #[inline(always)]
    pub fn spot(&self) -> Result<Status, Status> {
        let status = self.status(0);
        if status.has_spot() { Ok(status) } else { Err(status) }
    }
}

/// Power and centroid of the light on a rectangular spot, with derivatives with respect to the spot's
/// sides (x low, x high, y low, y high), the emitter's height and its axis. The value of the centroid is
/// relative to the middle of the spot; its derivatives include those of the middle.
#[derive(Clone, Copy, Debug)]
pub struct RectangleLight<R: Real> {
    pub power: SideGradient<R>,
    pub centroid: SideGradient<R>,
}

/// A quantity and its derivatives with respect to sides, height and axis.
#[derive(Clone, Copy, Debug)]
pub struct SideGradient<R: Real> {
    pub value: R,
    pub by_side: [R; 4],
    pub by_height: R,
    pub by_axis: R::Vec3,
}

impl<R: Real> SideGradient<R> {
    #[inline(always)]
    pub fn of_value(value: R) -> Self {
        let zero = value.constant(0.0);
        Self { value, by_side: [zero; 4], by_height: zero, by_axis: R::Vec3::new(zero, zero, zero) }
    }
}

//! The rectangular spot of a slit parallel to its detector.

use crate::aperture::{Face, Span};
use crate::response::Status;
use crate::scalar::Scalar;

/// One side of the spot along one axis, and how it moves.
///
/// A slit edge q at height q_z lands at X = (q − e)·k relative to the emitter's foot, with the
/// magnification k = e_z/(e_z − q_z). An edge of the detector is a slit edge at height 0: k = 1.
/// Hence ∂X/∂e = −k and ∂X/∂e_z = −X·(k − 1)/e_z for both.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge<S> {
    pub(crate) position: S,
    pub(crate) magnification: S,
}

/// The spot along one axis, relative to the emitter's foot point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent<S> {
    pub(crate) low: Edge<S>,
    pub(crate) high: Edge<S>,
    pub(crate) middle: S,
    pub(crate) half: S,
}

/// A rectangular spot, relative to the emitter's foot point, and the emitter's height above it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rectangle<S> {
    pub(crate) x: Extent<S>,
    pub(crate) y: Extent<S>,
    pub(crate) height: S,
}

impl<S: Scalar> Extent<S> {
    /// Intersection of the beam through `spans` (with their magnifications) and the detector.
    /// `None` if empty. The flag tells whether an end of the detector cuts the beam.
    #[inline(always)]
    fn of_beam<const N: usize>(spans: [(Span<S>, S); N], e: S, detector_half: S) -> Option<(Self, bool)> {
        let mut low = Edge { position: -detector_half - e, magnification: S::one() };
        let mut high = Edge { position: detector_half - e, magnification: S::one() };
        let (mut from_low, mut from_high) = (N, N);
        for (index, (span, k)) in spans.into_iter().enumerate() {
            let (a, b) = ((span.low - e) * k, (span.high - e) * k);
            if a >= low.position {
                low = Edge { position: a, magnification: k };
                from_low = index;
            }
            if b <= high.position {
                high = Edge { position: b, magnification: k };
                from_high = index;
            }
        }
        let half = if from_low == from_high && from_low < N {
            // Both sides of one face: its length survives where the difference would cancel.
            S::half() * spans[from_low].0.length * low.magnification
        } else {
            S::half() * (high.position - low.position)
        };
        if half > S::zero() {
            let middle = S::half() * (low.position + high.position);
            Some((Self { low, high, middle, half }, from_low == N || from_high == N))
        } else {
            None
        }
    }
}

impl<S: Scalar> Rectangle<S> {
    /// The spot of the beam that passes all `faces`, for an emitter at (`ex`, `ey`, `ez`).
    #[inline(always)]
    pub(crate) fn of_beam<const N: usize>(
        faces: [Face<S>; N],
        emitter: [S; 3],
        detector_half: [S; 2],
    ) -> Result<(Self, Status), Status> {
        let [ex, ey, ez] = emitter;
        if faces.iter().any(|face| ez <= face.z) {
            return Err(Status::Behind);
        }
        let magnified = faces.map(|face| (face, ez / (ez - face.z)));
        let (x, cut) =
            Extent::of_beam(magnified.map(|(face, k)| (face.x, k)), ex, detector_half[0]).ok_or(Status::Dark)?;
        let (y, _) =
            Extent::of_beam(magnified.map(|(face, k)| (face.y, k)), ey, detector_half[1]).ok_or(Status::Dark)?;
        let status = if cut { Status::Clipped } else { Status::Lit };
        Ok((Self { x, y, height: ez }, status))
    }

    /// Corners in order around the spot, relative to the emitter's foot point.
    pub(crate) fn corners(&self) -> [[S; 2]; 4] {
        let (x0, x1) = (self.x.low.position, self.x.high.position);
        let (y0, y1) = (self.y.low.position, self.y.high.position);
        [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    }
}

/// What a rectangular spot delivers, and its derivatives by the spot's sides
/// (x low, x high, y low, y high), by the emitter's height and by its axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RectangleLight<S: Scalar> {
    pub(crate) power: SideGradient<S>,
    pub(crate) centroid: SideGradient<S>,
}

/// A quantity and its derivatives by sides, height and axis.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SideGradient<S: Scalar> {
    pub(crate) value: S,
    pub(crate) by_side: [S; 4],
    pub(crate) by_height: S,
    pub(crate) by_axis: S::Vec3,
}

//! The part of a spot that a narrow lobe lights: the rays within a cone around the emitter's axis.
//!
//! The cone u·d = c·|d| meets the detector plane, at z = −h from the emitter, in a conic. A line of constant y is lit
//! between x = (u_x·w ± c·√(w² − (y² + h²)·a))/a, w = u_y·y − u_z·h, a = c² − u_x². The planes through the emitter,
//! parallel to y and tangent to the cone, are at x = h·(u_x·q ∓ u_z·s)/(−u_z·q ∓ u_x·s), s = sin γ,
//! q² = u_x² + u_z² − s².

use crate::scalar::Number;

/// The cone cos γ ≥ `cosine` around an axis, above the plane at `height` below the emitter.
pub(super) struct Cone<S> {
    /// Components of the axis along the two directions of the plane, and along its normal.
    pub(super) axis: [S; 3],
    pub(super) height: S,
    pub(super) cosine: S,
}

impl<S: Number> Cone<S> {
    /// The part of the box `ranges` that contains the cone within it; the box itself without a known bound.
    pub(super) fn within(&self, ranges: [[S; 2]; 2]) -> [[S; 2]; 2] {
        let [x, y] = ranges;
        let [ux, uy, uz] = self.axis;
        let across = Self { axis: [uy, ux, uz], ..*self };
        let y = across.narrowed(y, x);
        let x = self.narrowed(x, y);
        [x, across.narrowed(y, x)]
    }

    /// The part of `range` along the first direction that contains the cone over `strip` along the second.
    fn narrowed(&self, range: [S; 2], strip: [S; 2]) -> [S; 2] {
        let lit = [S::one(), -S::one()].map(|side| self.end(side, strip));
        let [Some(high), Some(low)] = lit else { return range };
        let narrowed = [range[0].max(low), range[1].min(high)];
        if narrowed[0] < narrowed[1] { narrowed } else { range }
    }

    /// The farthest lit point over `strip` in the direction `side`, +1 or −1; `None` without a known bound.
    fn end(&self, side: S, strip: [S; 2]) -> Option<S> {
        let ([ux, uy, uz], h, c) = (self.axis, self.height, self.cosine);
        let sine2 = (S::one() - c * c).max(S::zero());
        let q2 = ux * ux + uz * uz - sine2;
        let a = c * c - ux * ux;
        let b = c * c - uy * uy;
        if !(q2 > S::zero() && a > S::zero() && b > S::zero()) {
            return None;
        }
        let (q, sine) = (q2.root(), sine2.root() * side);
        let down = -uz * q - ux * sine;
        if down <= S::zero() {
            return None;
        }
        let farthest = h * (ux * q - uz * sine) / down;
        let touches = uy * (ux * farthest - uz * h) / b;
        if strip[0] <= touches && touches <= strip[1] {
            return Some(farthest);
        }
        let at = |y: S| {
            let w = uy * y - uz * h;
            let root2 = w * w - (y * y + h * h) * a;
            (root2 >= S::zero()).then(|| (ux * w + side * c * root2.root()) / a)
        };
        // Lines that miss the cone are skipped.
        strip.into_iter().filter_map(at).reduce(|one, other| if (one - other) * side > S::zero() { one } else { other })
    }
}

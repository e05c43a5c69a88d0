//! The exact solid angle of a plane polygon.

use crate::scalar::Number;

/// Solid angle of the triangle with corners `a`, `b`, `c` (relative to the foot point of an
/// observer at `height`), given twice its area (Van Oosterom and Strackee 1983):
/// tan(Ω/2) = a·(b×c)/(abc + (a·b)c + (b·c)a + (c·a)b). The triple product is computed without
/// cancellation as the height times twice the area.
fn triangle<S: Number>(twice_area: S, a: [S; 2], b: [S; 2], c: [S; 2], height: S) -> S {
    let h2 = height * height;
    let dot = |p: [S; 2], q: [S; 2]| p[0] * q[0] + p[1] * q[1] + h2;
    let (ra, rb, rc) = (dot(a, a).root(), dot(b, b).root(), dot(c, c).root());
    let denominator = ra * rb * rc + dot(a, b) * rc + dot(b, c) * ra + dot(c, a) * rb;
    S::two() * (height * twice_area).angle_from(denominator)
}

/// Solid angle of a convex polygon given as a fan: its first corner, and for each triangle twice
/// its area and the two other corners.
pub(crate) fn of_fan<S: Number>(first: [S; 2], fan: impl Iterator<Item = (S, [S; 2], [S; 2])>, height: S) -> S {
    // The sum is negative only for a sliver thinner than its corners' rounding.
    fan.fold(S::zero(), |sum, (twice, b, c)| sum + triangle(twice, first, b, c, height)).max(S::zero())
}

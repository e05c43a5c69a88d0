//! Poses at some instants, and motion with a constant twist between them.

use slitpose_model::{Pose, Twist};

/// The pose at `time_s` of `knots`, seconds and poses in the order of time; before the first and after the last the
/// tool is at rest.
pub(super) fn on_path(knots: &[(f64, Pose)], time_s: f64) -> Pose {
    let after = knots.partition_point(|&(knot_s, _)| knot_s <= time_s);
    match (after.checked_sub(1).map(|before| knots[before]), knots.get(after)) {
        (Some((start_s, start)), Some(&(end_s, end))) => {
            let (dt, dr) = end.displacement_from(&start);
            let per_second = (end_s - start_s).recip();
            let twist = Twist { linear_m_per_s: dt * per_second, angular_rad_per_s: dr * per_second };
            twist.advance(&start, time_s - start_s)
        }
        (Some((_, pose)), None) | (None, Some(&(_, pose))) => pose,
        (None, None) => Pose::HOME,
    }
}

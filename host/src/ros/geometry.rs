//! Poses and velocities as ROS 2 messages.

use glam::DVec3;
use slitpose_model::{Estimate, Pose, TwistEstimate};

use super::cdr::Encoder;

/// The reference frame of poses, velocities and what stands still of a head.
pub(super) const BASE: &str = "base";

/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
pub(crate) fn encode_pose(stamp_ns: u64, estimate: &Estimate, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, BASE);
    pose(&mut encoder, &estimate.pose);
    covariance(&mut encoder, &estimate.covariance);
}

/// `geometry_msgs/msg/PoseStamped`.
pub(crate) fn encode_pose_stamped(stamp_ns: u64, of: &Pose, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, BASE);
    pose(&mut encoder, of);
}

/// `tf2_msgs/msg/TFMessage` with one transform; `child` is the name of the tool's frame.
pub(crate) fn encode_transform(stamp_ns: u64, child: &str, of: &Pose, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    encoder.length(1);
    header(&mut encoder, stamp_ns, BASE);
    encoder.text(child);
    pose(&mut encoder, of);
}

/// `geometry_msgs/msg/TwistWithCovarianceStamped`.
pub(crate) fn encode_twist(stamp_ns: u64, estimate: &TwistEstimate, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, BASE);
    vector(&mut encoder, estimate.twist.linear_m_per_s);
    vector(&mut encoder, estimate.twist.angular_rad_per_s);
    covariance(&mut encoder, &estimate.covariance);
}

pub(crate) fn header(encoder: &mut Encoder<'_>, stamp_ns: u64, frame: &str) {
    const S: u64 = 1_000_000_000;
    encoder.i32(i32::try_from(stamp_ns / S).unwrap_or(i32::MAX));
    encoder.u32((stamp_ns % S) as u32);
    encoder.text(frame);
}

/// Translation, then rotation as x, y, z, w: poses and transforms alike.
pub(super) fn pose(encoder: &mut Encoder<'_>, pose: &Pose) {
    vector(encoder, pose.translation_m);
    for value in pose.rotation.to_array() {
        encoder.f64(value);
    }
}

pub(super) fn vector(encoder: &mut Encoder<'_>, vector: DVec3) {
    for value in vector.to_array() {
        encoder.f64(value);
    }
}

/// A row-major covariance, in the solver's order and meaning, which are those of ROS 2: rotations about the
/// fixed axes of the frame.
fn covariance(encoder: &mut Encoder<'_>, matrix: &[[f64; 6]; 6]) {
    for value in matrix.as_flattened() {
        encoder.f64(*value);
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use slitpose_model::{Pose, Twist};

    use super::*;

    /// The numbers of a message, behind its header: 12 bytes and "base" with its zero, then padding.
    fn numbers(bytes: &[u8]) -> Vec<f64> {
        let (numbers, rest) = bytes[4 + 24..].as_chunks();
        assert_eq!(rest.len(), 0);
        numbers.iter().map(|number| f64::from_le_bytes(*number)).collect()
    }

    #[test]
    fn values_stand_in_the_order_of_the_definitions() {
        let covariance = std::array::from_fn(|row| std::array::from_fn(|column| (10 * row + column) as f64));
        let flat = covariance.as_flattened();
        let pose = Pose { translation_m: DVec3::new(1.0, 2.0, 3.0), rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5) };
        let mut bytes = Vec::new();
        encode_pose(1_750_000_000_123_456_789, &Estimate { pose, covariance }, &mut bytes);
        assert_eq!(bytes[4..8], 1_750_000_000_i32.to_le_bytes());
        assert_eq!(bytes[8..12], 123_456_789_u32.to_le_bytes());
        assert_eq!(bytes[12..21], *b"\x05\0\0\0base\0");
        assert_eq!(numbers(&bytes), [&[1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5], flat].concat());

        encode_pose_stamped(1_750_000_000_123_456_789, &pose, &mut bytes);
        assert_eq!(bytes[12..21], *b"\x05\0\0\0base\0");
        assert_eq!(numbers(&bytes), [1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5]);
        encode_transform(1_750_000_000_123_456_789, "tool", &pose, &mut bytes);
        assert_eq!(bytes[4..8], 1_u32.to_le_bytes());
        assert_eq!(bytes[8..12], 1_750_000_000_i32.to_le_bytes());
        assert_eq!(bytes[16..25], *b"\x05\0\0\0base\0");
        assert_eq!(bytes[28..37], *b"\x05\0\0\0tool\0");
        // Behind the names: padding to a multiple of 8 from the end of the first four bytes.
        let (found, rest) = bytes[4 + 40..].as_chunks();
        let found: Vec<f64> = found.iter().map(|number| f64::from_le_bytes(*number)).collect();
        assert_eq!((found, rest.len()), (vec![1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5], 0));

        let twist = Twist { linear_m_per_s: DVec3::new(4.0, 5.0, 6.0), angular_rad_per_s: DVec3::new(7.0, 8.0, 9.0) };
        encode_twist(0, &TwistEstimate { twist, covariance }, &mut bytes);
        assert_eq!(numbers(&bytes), [&[4.0, 5.0, 6.0, 7.0, 8.0, 9.0], flat].concat());
    }
}

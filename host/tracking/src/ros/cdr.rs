//! CDR as used by ROS 2: four bytes that name the encoding, then values in little-endian order,
//! each aligned to its size from the end of those four bytes.
//!
//! Written here because only six kinds of value are needed and the bulk of a capture is one long `uint8[]`,
//! which the existing crates, through serde, would copy byte by byte.

use glam::DVec3;
use slitpose_calibration::inverse;
use slitpose_model::{Estimate, Pose, TwistEstimate};

use crate::frame::{BASE, View};

/// Plain CDR, little endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Methods that write a number of the type of their name.
macro_rules! numbers {
    ($($number:ident),*) => {$(
        pub fn $number(&mut self, value: $number) {
            self.put(value.to_le_bytes());
        }
    )*};
}

/// Writes one message into a reused buffer.
pub struct Encoder<'a> {
    bytes: &'a mut Vec<u8>,
}

#[allow(missing_docs, reason = "numbers are named by their types")]
impl<'a> Encoder<'a> {
    /// Begins a message; clears `bytes`.
    pub fn new(bytes: &'a mut Vec<u8>) -> Self {
        bytes.clear();
        bytes.extend_from_slice(&ENCAPSULATION);
        Self { bytes }
    }

    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let behind_header = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(ENCAPSULATION.len() + behind_header.next_multiple_of(N), 0);
        self.bytes.extend_from_slice(&value);
    }

    pub fn bool(&mut self, value: bool) {
        self.u8(value.into());
    }

    numbers!(u8, i32, u32, u64, f32, f64);

    /// The number of elements of a sequence, which follow one by one.
    pub fn length(&mut self, length: usize) {
        debug_assert!(u32::try_from(length).is_ok(), "a sequence of {length} elements");
        self.u32(length as u32);
    }

    /// `uint8[]`.
    pub fn bytes(&mut self, value: &[u8]) {
        self.length(value.len());
        self.bytes.extend_from_slice(value);
    }

    /// A text; its length includes a final zero.
    pub fn text(&mut self, value: &str) {
        self.length(value.len() + 1);
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(0);
    }
}

/// Reads one message; all methods return `None` if it ends too soon.
pub struct Decoder<'a> {
    body: &'a [u8],
    at: usize,
}

#[allow(missing_docs, reason = "numbers are named by their types")]
impl<'a> Decoder<'a> {
    /// `None` if the message is in another encoding.
    pub fn new(bytes: &'a [u8]) -> Option<Self> {
        let (header, body) = bytes.split_first_chunk::<4>()?;
        // The last two bytes are options, which plain CDR does not use.
        (header[..2] == ENCAPSULATION[..2]).then_some(Self { body, at: 0 })
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let taken = self.body.get(self.at..)?.get(..length)?;
        self.at += length;
        Some(taken)
    }

    fn get<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.at = self.at.next_multiple_of(N);
        self.take(N)?.first_chunk().copied()
    }

    pub fn bool(&mut self) -> Option<bool> {
        self.get().map(|[value]: [u8; 1]| value != 0)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.get().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.get().map(u64::from_le_bytes)
    }

    /// `uint8[]`.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.length::<1>()?;
        self.take(length)
    }

    /// The number of elements, of `SIZE` bytes each, of a sequence. Limited by the length of the message, so
    /// that it is safe for allocation.
    fn length<const SIZE: usize>(&mut self) -> Option<usize> {
        let length = usize::try_from(self.u32()?).ok()?;
        (length.checked_mul(SIZE)? <= self.body.len() - self.at).then_some(length)
    }

    /// `uint32[]`, element by element.
    pub fn each_u32(&mut self, mut take: impl FnMut(u32)) -> Option<usize> {
        let length = self.length::<4>()?;
        for _ in 0..length {
            take(self.u32()?);
        }
        Some(length)
    }

    /// `uint64[]` and `int64[]`, element by element.
    pub fn each_u64(&mut self, mut take: impl FnMut(usize, u64)) -> Option<usize> {
        let length = self.length::<8>()?;
        for index in 0..length {
            take(index, self.u64()?);
        }
        Some(length)
    }
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped` in `frame`.
pub fn encode_pose(stamp_ns: u64, frame: &str, estimate: &Estimate, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, frame);
    pose(&mut encoder, &estimate.pose);
    covariance(&mut encoder, &estimate.covariance);
}

/// `geometry_msgs/msg/PoseStamped`.
pub fn encode_pose_stamped(stamp_ns: u64, of: &Pose, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, BASE);
    pose(&mut encoder, of);
}

/// `tf2_msgs/msg/TFMessage` of a pose in `view`: the tool in the base, then the frame of the user in the base, and the tip
/// in the tool, if there are. `tool` is the name of the tool's frame.
pub fn encode_transform(stamp_ns: u64, tool: &str, of: &Pose, view: Option<&View>, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    let put = |encoder: &mut Encoder<'_>, parent: &str, child: &str, of: &Pose| {
        header(encoder, stamp_ns, parent);
        encoder.text(child);
        pose(encoder, of);
    };
    let user = view.filter(|view| view.name() != BASE);
    let tip_m = view.map(View::tip_m).filter(|tip_m| *tip_m != DVec3::ZERO);
    encoder.length(1 + usize::from(user.is_some()) + usize::from(tip_m.is_some()));
    put(&mut encoder, BASE, tool, &view.map_or(*of, |view| view.base_from_tool(of)));
    if let Some(view) = user {
        put(&mut encoder, BASE, view.name(), &inverse(view.user_from_base()));
    }
    if let Some(translation_m) = tip_m {
        put(&mut encoder, tool, &format!("{tool}_tip"), &Pose { translation_m, ..Pose::HOME });
    }
}

/// `geometry_msgs/msg/TwistWithCovarianceStamped`.
pub fn encode_twist(stamp_ns: u64, frame: &str, estimate: &TwistEstimate, bytes: &mut Vec<u8>) {
    let mut encoder = Encoder::new(bytes);
    header(&mut encoder, stamp_ns, frame);
    vector(&mut encoder, estimate.twist.linear_m_per_s);
    vector(&mut encoder, estimate.twist.angular_rad_per_s);
    covariance(&mut encoder, &estimate.covariance);
}

/// `std_msgs/msg/Header`: the stamp in nanoseconds and the frame.
pub fn header(encoder: &mut Encoder<'_>, stamp_ns: u64, frame: &str) {
    time(encoder, stamp_ns);
    encoder.text(frame);
}

const S: u64 = 1_000_000_000;

fn time(encoder: &mut Encoder<'_>, stamp_ns: u64) {
    encoder.i32(i32::try_from(stamp_ns / S).unwrap_or(i32::MAX));
    encoder.u32((stamp_ns % S) as u32);
}

/// `rcl_interfaces/msg/Log` of a person's `text`.
pub fn encode_note(stamp_ns: u64, text: &str, bytes: &mut Vec<u8>) {
    /// `INFO` in that type.
    const INFO: u8 = 20;
    let mut encoder = Encoder::new(bytes);
    time(&mut encoder, stamp_ns);
    encoder.u8(INFO);
    ["slitpose", text, "", ""].into_iter().for_each(|text| encoder.text(text));
    encoder.u32(0);
}

/// Stamp in nanoseconds and text of `rcl_interfaces/msg/Log`.
pub fn decode_note(message: &[u8]) -> Option<(u64, String)> {
    let mut decoder = Decoder::new(message)?;
    let (seconds, nanoseconds) = (u64::from(decoder.u32()?), u64::from(decoder.u32()?));
    decoder.get::<1>()?;
    let _name = decoder.bytes()?;
    let text = std::str::from_utf8(decoder.bytes()?).ok()?;
    Some((seconds * S + nanoseconds, text.trim_end_matches('\0').to_owned()))
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

    #[test]
    fn values_are_aligned_from_the_end_of_the_header() {
        let mut bytes = vec![9; 9];
        let mut encoder = Encoder::new(&mut bytes);
        encoder.bool(true);
        encoder.u32(0x0403_0201);
        encoder.text("ab");
        encoder.length(0);
        encoder.u64(5);
        // By hand, from the rules of OMG CORBA 3.4, part 2, 9.3.
        let expected = [
            &[0, 1, 0, 0][..],
            &[1, 0, 0, 0],
            &[1, 2, 3, 4],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[0, 0, 0, 0, 0, 0, 0, 0],
            &[5, 0, 0, 0, 0, 0, 0, 0],
        ];
        assert_eq!(bytes, expected.concat()[..bytes.len()]);
        assert_eq!(bytes.len(), 36);
    }

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
        encode_pose(1_750_000_000_123_456_789, BASE, &Estimate { pose, covariance }, &mut bytes);
        assert_eq!(bytes[4..8], 1_750_000_000_i32.to_le_bytes());
        assert_eq!(bytes[8..12], 123_456_789_u32.to_le_bytes());
        assert_eq!(bytes[12..21], *b"\x05\0\0\0base\0");
        assert_eq!(numbers(&bytes), [&[1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5], flat].concat());

        encode_pose_stamped(1_750_000_000_123_456_789, &pose, &mut bytes);
        assert_eq!(bytes[12..21], *b"\x05\0\0\0base\0");
        assert_eq!(numbers(&bytes), [1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5]);
        encode_transform(1_750_000_000_123_456_789, "tool", &pose, None, &mut bytes);
        assert_eq!(bytes[4..8], 1_u32.to_le_bytes());
        assert_eq!(bytes[8..12], 1_750_000_000_i32.to_le_bytes());
        assert_eq!(bytes[16..25], *b"\x05\0\0\0base\0");
        assert_eq!(bytes[28..37], *b"\x05\0\0\0tool\0");
        // Behind the names: padding to a multiple of 8 from the end of the first four bytes.
        let (found, rest) = bytes[4 + 40..].as_chunks();
        let found: Vec<f64> = found.iter().map(|number| f64::from_le_bytes(*number)).collect();
        assert_eq!((found, rest.len()), (vec![1.0, 2.0, 3.0, 0.5, -0.5, 0.5, 0.5], 0));

        let twist = Twist { linear_m_per_s: DVec3::new(4.0, 5.0, 6.0), angular_rad_per_s: DVec3::new(7.0, 8.0, 9.0) };
        encode_twist(0, BASE, &TwistEstimate { twist, covariance }, &mut bytes);
        assert_eq!(numbers(&bytes), [&[4.0, 5.0, 6.0, 7.0, 8.0, 9.0], flat].concat());
    }
}

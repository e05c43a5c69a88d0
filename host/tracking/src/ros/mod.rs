//! Poses, velocities and heads as messages of ROS 2, for captures and live servers.
//!
//! Frames: `base`, and `tool` for the tool in front of the first board. Lengths are in metres.

pub mod cdr;
mod head;

pub use cdr::header as encode_header;
pub use cdr::{encode_pose, encode_pose_stamped, encode_transform, encode_twist};
pub use head::encode_head;

use crate::link::DeviceId;
use crate::pipeline::Record;

const TOPICS: &str = "/slitpose/";

/// A topic of a board. No part of a name of ROS may begin with a digit, as numbers of boards do.
pub fn topic(device: DeviceId, name: &str) -> String {
    format!("{TOPICS}board_{device}/{name}")
}

/// The board of a topic, and the name in it; of older captures, too, which have the number alone.
pub fn board_of(topic: &str) -> Option<(DeviceId, &str)> {
    let (board, name) = topic.strip_prefix(TOPICS)?.split_once('/')?;
    Some((board.strip_prefix("board_").unwrap_or(board).parse().ok()?, name))
}

/// Name of the tool's frame: the tools in front of other boards than the first have the number of theirs in it.
pub fn tool_frame(device: DeviceId, is_first: bool) -> String {
    if is_first { "tool".to_owned() } else { format!("tool_{device}") }
}

/// The instant of a scan: UTC, or the board's time since its start while that is unknown; nanoseconds.
pub fn stamp_ns(record: &Record) -> u64 {
    // Saturates; times are never negative.
    record.host_time.map_or((record.device_time_s * 1e9) as u64, |time| time.utc_ns)
}

// A definition has the fields of the message, then the types of these, each once.

/// A message type: its name and its definition in the syntax of ROS 2 (`ros2msg`).
#[derive(Clone, Copy, Debug)]
pub struct RosType {
    /// Package, `msg` and type.
    pub name: &'static str,
    /// Its fields, then the types of these.
    pub definition: &'static str,
}

/// A pose `base_from_tool` with the covariance of (translation, rotation) in the base frame.
pub const POSE: RosType = RosType {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: include_str!("msg/PoseWithCovarianceStamped.msg"),
};

/// The velocity of the tool in the base frame with the covariance of (linear, angular).
pub const TWIST: RosType = RosType {
    name: "geometry_msgs/msg/TwistWithCovarianceStamped",
    definition: include_str!("msg/TwistWithCovarianceStamped.msg"),
};

/// The same pose without covariance.
pub const POSE_STAMPED: RosType =
    RosType { name: "geometry_msgs/msg/PoseStamped", definition: include_str!("msg/PoseStamped.msg") };

/// The same pose as a transform from the tool's frame to the base frame.
pub const TRANSFORMS: RosType =
    RosType { name: "tf2_msgs/msg/TFMessage", definition: include_str!("msg/TFMessage.msg") };

/// A head as shapes.
pub const MARKERS: RosType =
    RosType { name: "visualization_msgs/msg/MarkerArray", definition: include_str!("msg/MarkerArray.msg") };

/// A report, as JSON text in CDR: ROS tools refuse files with messages in other encodings.
pub const REPORT: RosType = RosType { name: "std_msgs/msg/String", definition: "string data\n" };

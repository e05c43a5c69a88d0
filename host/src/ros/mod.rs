//! Poses, velocities and heads as messages of ROS 2, for captures and live servers.
//!
//! Frames: `base`, and `tool` for the tool in front of the first board. Lengths are in metres.

pub(crate) mod cdr;
mod head;

#[cfg(feature = "zenoh")]
pub(crate) use cdr::header as encode_header;
pub(crate) use cdr::{encode_pose, encode_pose_stamped, encode_transform, encode_twist};
pub(crate) use head::encode_head;

use crate::link::DeviceId;
use crate::pipeline::Record;

const TOPICS: &str = "/slitpose/";

/// A topic of a board. No part of a name of ROS may begin with a digit, as numbers of boards do.
pub(crate) fn topic(device: DeviceId, name: &str) -> String {
    format!("{TOPICS}board_{device}/{name}")
}

/// The board of a topic, and the name in it; of older captures, too, which have the number alone.
pub(crate) fn board_of(topic: &str) -> Option<(DeviceId, &str)> {
    let (board, name) = topic.strip_prefix(TOPICS)?.split_once('/')?;
    Some((board.strip_prefix("board_").unwrap_or(board).parse().ok()?, name))
}

/// Name of the tool's frame: the tools in front of other boards than the first have the number of theirs in it.
pub(crate) fn tool_frame(device: DeviceId, is_first: bool) -> String {
    if is_first { "tool".to_owned() } else { format!("tool_{device}") }
}

/// The instant of a scan: UTC, or the board's time since its start while that is unknown; nanoseconds.
pub(crate) fn stamp_ns(record: &Record) -> u64 {
    // Saturates; times are never negative.
    record.host_time.map_or((record.device_time_s * 1e9) as u64, |time| time.utc_ns)
}

// A definition has the fields of the message, then the types of these, each once.

/// A message type: its name and its definition in the syntax of ROS 2 (`ros2msg`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct RosType {
    pub(crate) name: &'static str,
    pub(crate) definition: &'static str,
}

/// The definition of a type that others use.
macro_rules! part {
    (header) => {
        "\
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"
    };
    (time) => {
        "\
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"
    };
    (duration) => {
        "\
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"
    };
    (point) => {
        "\
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"
    };
    (quaternion) => {
        "\
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"
    };
    (pose) => {
        "\
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
"
    };
    (pose_with_covariance) => {
        "\
MSG: geometry_msgs/PoseWithCovariance
Pose pose
float64[36] covariance
"
    };
    (vector3) => {
        "\
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"
    };
    (twist) => {
        "\
MSG: geometry_msgs/Twist
Vector3 linear
Vector3 angular
"
    };
    (twist_with_covariance) => {
        "\
MSG: geometry_msgs/TwistWithCovariance
Twist twist
float64[36] covariance
"
    };
    (transform) => {
        "\
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
"
    };
    (transform_stamped) => {
        "\
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
"
    };
    (colour) => {
        "\
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a
"
    };
    (marker) => {
        "\
MSG: visualization_msgs/Marker
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
"
    };
    (uv_coordinate) => {
        "\
MSG: visualization_msgs/UVCoordinate
float32 u
float32 v
"
    };
    (mesh_file) => {
        "\
MSG: visualization_msgs/MeshFile
string filename
uint8[] data
"
    };
    (compressed_image) => {
        "\
MSG: sensor_msgs/CompressedImage
std_msgs/Header header
string format
uint8[] data
"
    };
}

/// The definition of a message with these fields and the types that they need.
macro_rules! definition {
    ($fields:literal, $($part:ident)*) => {
        concat!($fields, $("================================================================================\n", part!($part)),*)
    };
}

/// A pose `base_from_tool` with the covariance of (translation, rotation) in the base frame.
pub(crate) const POSE: RosType = RosType {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: definition!("std_msgs/Header header\nPoseWithCovariance pose\n", pose_with_covariance pose point quaternion header time),
};

/// The velocity of the tool in the base frame with the covariance of (linear, angular).
pub(crate) const TWIST: RosType = RosType {
    name: "geometry_msgs/msg/TwistWithCovarianceStamped",
    definition: definition!("std_msgs/Header header\nTwistWithCovariance twist\n", twist_with_covariance twist vector3 header time),
};

pub(crate) const POSE_STAMPED: RosType = RosType {
    name: "geometry_msgs/msg/PoseStamped",
    definition: definition!("std_msgs/Header header\nPose pose\n", pose point quaternion header time),
};

/// The same pose as a transform from the tool's frame to the base frame.
pub(crate) const TRANSFORMS: RosType = RosType {
    name: "tf2_msgs/msg/TFMessage",
    definition: definition!("geometry_msgs/TransformStamped[] transforms\n", transform_stamped transform vector3 quaternion header time),
};

/// A report, as JSON text in CDR: ROS tools refuse files with messages in other encodings.
pub(crate) const REPORT: RosType = RosType { name: "std_msgs/msg/String", definition: "string data\n" };

pub(crate) const MARKERS: RosType = RosType {
    name: "visualization_msgs/msg/MarkerArray",
    definition: definition!("visualization_msgs/Marker[] markers\n", marker uv_coordinate mesh_file compressed_image pose point quaternion vector3 colour header time duration),
};

//! Schemas of the messages, as written into every capture.

/// A message type: its name and its definition in the syntax of ROS 2 (`ros2msg`).
#[derive(Clone, Copy, Debug)]
pub(super) struct RosType {
    pub(super) name: &'static str,
    pub(super) definition: &'static str,
}

/// The bytes of a link: a type of this project, as no standard type keeps the time of each read.
pub(super) const LINK_BYTES: RosType = RosType {
    name: "slitpose_msgs/msg/LinkBytes",
    definition: "\
# Bytes as a host read them from a board, and when. All `data` of a topic one after the other are the
# byte stream of the board: packets that end with a zero byte, COBS-stuffed, with a CRC-32.
# A message usually holds some 20 ms and ends with a packet.

# The link was opened anew ahead of these bytes, or the recorder was too slow and left some out:
# half a packet before, if any, is lost.
bool opened
uint8[] data

# How `data` came: how many bytes each read gave (together: all of `data`), and when it returned.
# Monotonic: since some instant in the past, never set (CLOCK_MONOTONIC).
# 18446744073709551615: no time, as from a simulated board that does not go at the pace of time.
# UTC = monotonic + difference, since 1970 began, without leap seconds.
uint32[] read_bytes
uint64[] read_monotonic_ns
int64[] read_utc_minus_monotonic_ns

# Pings sent since the message before: token, and when each was about to be sent. The answers are in `data`.
uint32[] ping_token
uint64[] ping_monotonic_ns
int64[] ping_utc_minus_monotonic_ns
",
};

/// A pose `base_from_tool` with the covariance of (translation, rotation) in the base frame.
pub(super) const POSE: RosType = RosType {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: "\
std_msgs/Header header
PoseWithCovariance pose
================================================================================
MSG: geometry_msgs/PoseWithCovariance
Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
",
};

/// The velocity of the tool in the base frame with the covariance of (linear, angular).
pub(super) const TWIST: RosType = RosType {
    name: "geometry_msgs/msg/TwistWithCovarianceStamped",
    definition: "\
std_msgs/Header header
TwistWithCovariance twist
================================================================================
MSG: geometry_msgs/TwistWithCovariance
Twist twist
float64[36] covariance
================================================================================
MSG: geometry_msgs/Twist
Vector3 linear
Vector3 angular
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
",
};

/// The same pose without covariance.
pub(super) const POSE_STAMPED: RosType = RosType {
    name: "geometry_msgs/msg/PoseStamped",
    definition: "\
std_msgs/Header header
Pose pose
================================================================================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
",
};

/// The same pose as a transform from the tool's frame to the base frame.
pub(super) const TRANSFORMS: RosType = RosType {
    name: "tf2_msgs/msg/TFMessage",
    definition: "\
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
================================================================================
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
",
};

/// A report, as JSON text in CDR: ROS tools refuse files with messages in other encodings.
pub(super) const REPORT: RosType = RosType { name: "std_msgs/msg/String", definition: "string data\n" };

/// Name of the attachment with the JSON schema of reports.
pub(super) const REPORT_SCHEMA: &str = "report.schema.json";

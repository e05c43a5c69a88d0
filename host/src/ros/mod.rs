//! Poses, velocities and heads as messages of ROS 2, for captures and live servers.
//!
//! Frames: `base`, and `tool` for the tool in front of the first board. Lengths are in metres.

pub(crate) mod cdr;
mod geometry;
mod head;
mod schemas;

#[cfg(feature = "zenoh")]
pub(crate) use geometry::header as encode_header;
pub(crate) use geometry::{encode_pose, encode_pose_stamped, encode_transform, encode_twist};
pub(crate) use head::encode_head;
pub(crate) use schemas::{MARKERS, POSE, POSE_STAMPED, REPORT, RosType, TRANSFORMS, TWIST};

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

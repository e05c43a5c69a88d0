//! What captures alone hold.

use crate::ros::RosType;

/// The bytes of a link: a type of this project, as no standard type keeps the time of each read.
pub(crate) const LINK_BYTES: RosType = RosType {
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

/// Name of the attachment with the JSON schema of reports.
pub(super) const REPORT_SCHEMA: &str = "report.schema.json";

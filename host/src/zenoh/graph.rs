//! Names and numbers by which ROS 2 recognises publishers: those of rmw_zenoh
//! (<https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md>) with Zenoh 1.

use twox_hash::XxHash3_128;

use crate::capture::LINK_BYTES;
use crate::ros::{MARKERS, POSE, RosType, TRANSFORMS, TWIST};

/// `diagnostic_msgs/msg/DiagnosticArray`.
const DIAGNOSTICS: &str = "diagnostic_msgs/msg/DiagnosticArray";

/// Quality of service: reliable, volatile, the last 10; empty is the default of rmw_zenoh.
const QUALITY: &str = "::,10:,:,:,,";

/// A type: its name in key expressions, and its hash by REP 2016.
#[derive(Clone, Copy, Debug)]
pub(super) struct Type {
    name: &'static str,
    hash: &'static str,
}

impl Type {
    const fn of(ros: RosType, hash: &'static str) -> Self {
        Self { name: ros.name, hash }
    }

    pub(super) const POSE: Self =
        Self::of(POSE, "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e");
    pub(super) const TWIST: Self =
        Self::of(TWIST, "RIHS01_77b67434531e6529b7a0091357b186b6ebdb17fd9ffd3e0c7ce9d3fb11a44563");
    pub(super) const TRANSFORMS: Self =
        Self::of(TRANSFORMS, "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087");
    pub(super) const MARKERS: Self =
        Self::of(MARKERS, "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf");
    pub(super) const DIAGNOSTICS: Self =
        Self { name: DIAGNOSTICS, hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e" };
    pub(super) const LINK_BYTES: Self =
        Self::of(LINK_BYTES, "RIHS01_d42b7daf965e87d943da60b43503be72bd329ab866e60057efdb38941e9540d3");

    /// Its part of a key: the name that DDS gives it, and its hash.
    fn key(self) -> String {
        let (package, name) = self.name.split_once("/msg/").unwrap_or(("", self.name));
        format!("{package}::msg::dds_::{name}_/{}", self.hash)
    }
}

/// The key expression of a topic, which begins with a slash.
pub(super) fn topic_key(domain: u8, topic: &str, of: Type) -> String {
    format!("{domain}{topic}/{}", of.key())
}

/// Number of a publisher's ROS 2 node in its session.
const NODE: u32 = 0;

/// The node that publishes, in one session.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) domain: u8,
    session: String,
    /// Numbers given so far.
    entities: u32,
}

impl Node {
    pub(super) fn new(domain: u8, session: String) -> Self {
        Self { domain, session, entities: NODE }
    }

    /// The node's name: nodes of one name are taken for one.
    fn name(&self) -> String {
        format!("slitpose_{}", self.session)
    }

    /// Its liveliness token: enclave and namespace are none.
    pub(super) fn token(&self) -> String {
        format!("@ros2_lv/{}/{}/{NODE}/{NODE}/NN/%/%/{}", self.domain, self.session, self.name())
    }

    /// The liveliness token of its next publisher.
    pub(super) fn publisher_token(&mut self, topic: &str, of: Type) -> String {
        self.entities += 1;
        let (domain, session, number, name) = (self.domain, &self.session, self.entities, self.name());
        let topic = topic.replace('/', "%");
        format!("@ros2_lv/{domain}/{session}/{NODE}/{number}/MP/%/%/{name}/{topic}/{}/{QUALITY}", of.key())
    }
}

/// What stands beside each message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Attachment {
    /// Counts the messages of a publisher, from 1.
    pub(super) sequence: i64,
    /// When it was published, UTC, nanoseconds.
    pub(super) stamp_ns: i64,
    /// The publisher.
    pub(super) gid: [u8; 16],
}

/// Two numbers of 8 bytes, the length of an array, and its bytes.
const ATTACHMENT_BYTES: usize = 8 + 8 + 1 + 16;

impl Attachment {
    /// Little endian, as Zenoh's serializer has it.
    pub(super) fn encode(&self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.stamp_ns.to_le_bytes());
        bytes[16] = self.gid.len() as u8;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk()?;
        let (stamp_ns, rest) = rest.split_first_chunk()?;
        let (length, gid) = rest.split_first()?;
        let gid = gid.try_into().ok().filter(|_| *length == 16)?;
        Some(Self { sequence: i64::from_le_bytes(*sequence), stamp_ns: i64::from_le_bytes(*stamp_ns), gid })
    }
}

/// The number of a publisher: a hash of its token, the lower half first.
pub(super) fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attachments_come_back() {
        let attachment = Attachment { sequence: 7, stamp_ns: -1, gid: gid("token") };
        let bytes = attachment.encode();
        assert_eq!(Attachment::decode(&bytes), Some(attachment));
        for length in 0..bytes.len() {
            assert_eq!(Attachment::decode(&bytes[..length]), None);
        }
    }
}

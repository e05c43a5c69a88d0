//! Boards over Zenoh: poses and more for ROS 2, as rmw_zenoh sees it, and all bytes for daemons on other machines.

mod far_board;
mod publisher;

use std::env;
use std::ffi::OsString;
use std::sync::{Arc, Mutex};

use ::zenoh::key_expr::KeyExpr;
use ::zenoh::{Config, Session, Wait};
use anyhow::{Result, anyhow, bail};
use twox_hash::XxHash3_128;

use self::far_board::FarBoardOpener;
use self::publisher::Publisher;
use crate::bridges::{Bridge, DEFAULT_ROUTER};
use crate::daemon::{Opener, StreamPlan};
use crate::live::LiveBoard;
use crate::telemetry::DaemonReport;
use crate::terminal::say;
use slitpose_head::threads::lock;
use slitpose_tracking::capture::LINK_BYTES;
use slitpose_tracking::ros::{MARKERS, POSE, RosType, TRANSFORMS, TWIST};

/// A session of Zenoh, which begins as soon as its router is there, and reaches that again whenever it was away.
#[derive(Clone)]
pub(crate) struct ZenohSession {
    what: String,
    config: Config,
    pub(super) domain: u8,
    session: Arc<Mutex<Option<Session>>>,
}

impl ZenohSession {
    /// A session by the router at `endpoint`, or by the file that ZENOH_SESSION_CONFIG_URI names, as ROS 2 does.
    pub(crate) fn open(endpoint: &str) -> Result<Self> {
        let domain = domain(env::var_os("ROS_DOMAIN_ID"))?;
        let (what, config) = match env::var_os("ZENOH_SESSION_CONFIG_URI") {
            Some(path) => (path.display().to_string(), Config::from_file(&path)),
            None => (endpoint.to_owned(), by_router(endpoint)),
        };
        match config {
            Ok(config) => Ok(Self { what, config, domain, session: Arc::default() }),
            Err(error) => {
                let reason = reason_of(&*error);
                bail!(
                    "Zenoh refuses {what} ({reason}); give an endpoint such as {DEFAULT_ROUTER}, or a file of Zenoh's own \
                     settings"
                )
            }
        }
    }

    /// The session, once its router is there. Takes a second at most.
    pub(super) fn get(&self) -> Result<Session> {
        let mut session = lock(&self.session);
        if let Some(session) = &*session {
            return Ok(session.clone());
        }
        let opened = ::zenoh::open(self.config.clone()).wait();
        let opened = opened.map_err(|error| {
            let (what, reason) = (&self.what, reason_of(&*error));
            anyhow!("no router of Zenoh by {what} ({reason}); start one, or give its endpoint with --zenoh-router")
        })?;
        Ok(session.insert(opened).clone())
    }
}

impl Bridge for ZenohSession {
    fn publisher(
        &self,
        boards: Vec<LiveBoard>,
        pose_every_s: f64,
        report: Box<dyn Fn() -> DaemonReport + Send>,
    ) -> StreamPlan {
        say(format_args!("boards by Zenoh at {}", self.what));
        StreamPlan { taker: Box::new(Publisher::new(self.clone(), boards, report)), pose_every_s }
    }

    fn opener(&self, key: &str) -> Result<Box<dyn Opener>> {
        Ok(Box::new(FarBoardOpener { session: self.clone(), topic: topic_of(key)? }))
    }
}

/// What the topics of one board begin with.
fn topic_of(key: &str) -> Result<String> {
    let topic = key.trim_start_matches('/');
    // Of several boards at once nothing could be solved.
    if KeyExpr::new(topic).is_err() || topic.contains(['*', '$']) {
        bail!("`zenoh:{key}` names no board; give zenoh:slitpose/board_SERIAL, with the serial number of the board");
    }
    Ok(topic.to_owned())
}

/// The number of the ROS 2 graph, from its environment variable.
fn domain(variable: Option<OsString>) -> Result<u8> {
    let text = variable.unwrap_or_default().to_string_lossy().into_owned();
    match text.parse() {
        Ok(domain @ 0..=232) => Ok(domain),
        _ if text.is_empty() => Ok(0),
        _ => bail!("ROS_DOMAIN_ID is `{text}`; give a number from 0 to 232"),
    }
}

/// What Zenoh says, without the place in its source where it says so.
fn reason_of(error: &dyn std::error::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or(&text).trim_end_matches(['!', ' ', '.']).to_owned()
}

/// A client of one router: it listens nowhere, and looks for a router that has gone for ever.
fn by_router(endpoint: &str) -> Result<Config, ::zenoh::Error> {
    let mut config = Config::default();
    let endpoint = serde_json::to_string(endpoint)?;
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &format!("[{endpoint}]")),
        ("connect/timeout_ms", "1000"),
        ("connect/retry", "{period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2}"),
        ("scouting/multicast/enabled", "false"),
    ] {
        config.insert_json5(key, value)?;
    }
    Ok(config)
}

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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Attachment {
    /// Counts the messages of a publisher, from 1.
    pub(super) sequence: i64,
    /// When it was published, UTC, nanoseconds.
    pub(super) stamp_ns: i64,
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

/// The session by the router at `endpoint`.
pub(crate) fn open_zenoh(endpoint: &str) -> Result<Box<dyn Bridge>> {
    Ok(Box::new(ZenohSession::open(endpoint)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_are_read_or_refused() {
        for (key, topic) in
            [("slitpose/board_1", "slitpose/board_1"), ("/lab/slitpose/board_1", "lab/slitpose/board_1")]
        {
            assert_eq!(topic_of(key).unwrap(), topic);
        }
        for key in ["", "/", "slitpose/*", "slitpose/**", "slitpose/board_$*", "slitpose//board_1", "slitpose/board_1/"]
        {
            assert!(topic_of(key).is_err(), "{key}");
        }
        for (variable, number) in [(None, 0), (Some(""), 0), (Some("0"), 0), (Some("232"), 232)] {
            assert_eq!(domain(variable.map(OsString::from)).unwrap(), number);
        }
        for variable in ["233", "-1", "x", " 1"] {
            assert!(domain(Some(variable.into())).is_err(), "{variable}");
        }
    }

    #[test]
    fn a_router_that_is_not_there_is_named_without_paths_of_sources() {
        // Nothing listens at port 1.
        let error = ZenohSession::open("tcp/127.0.0.1:1").unwrap().get().err().unwrap().to_string();
        assert!(error.contains("tcp/127.0.0.1:1") && error.contains("--zenoh-router"), "{error}");
        assert!(!error.contains(".rs"), "{error}");
        assert!(ZenohSession::open("nonsense").is_err());
    }

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

//! Boards over Zenoh for ROS 2, as rmw_zenoh sees it: poses, heads, health.

mod publisher;

use std::env;
use std::ffi::OsString;

use ::zenoh::{Config, Session, Wait};
use anyhow::{Result, anyhow, bail};
use twox_hash::XxHash3_128;

use self::publisher::Publisher;
use crate::bridges::DEFAULT_ROUTER;
use crate::daemon::StreamPlan;
use crate::live::LiveBoard;
use crate::terminal::say;
use slitpose_tracking::ros::{MARKERS, POSE, RosType, TRANSFORMS, TWIST};
use slitpose_tracking::telemetry::DaemonReport;

/// The way to a router. A session reaches that again whenever it was away.
pub(super) struct Router {
    what: String,
    config: Config,
    pub(super) domain: u8,
}

impl Router {
    /// The router at `endpoint`, or that of the file that ZENOH_SESSION_CONFIG_URI names, as for ROS 2.
    pub(super) fn at(endpoint: &str) -> Result<Self> {
        let domain = domain(env::var_os("ROS_DOMAIN_ID"))?;
        let (what, config) = match env::var_os("ZENOH_SESSION_CONFIG_URI") {
            Some(path) => (path.display().to_string(), Config::from_file(&path)),
            None => (endpoint.to_owned(), by_router(endpoint)),
        };
        match config {
            Ok(config) => Ok(Self { what, config, domain }),
            Err(error) => {
                let reason = reason_of(&*error);
                bail!(
                    "Zenoh refuses {what} ({reason}); give an endpoint such as {DEFAULT_ROUTER}, or a file of Zenoh's own \
                     settings"
                )
            }
        }
    }

    /// A session, if the router is there. Takes a second at most.
    pub(super) fn session(&self) -> Result<Session> {
        ::zenoh::open(self.config.clone()).wait().map_err(|error| {
            let (what, reason) = (&self.what, reason_of(&*error));
            anyhow!("no router of Zenoh by {what} ({reason}); start one, or give its endpoint with --zenoh-router")
        })
    }
}

/// Publishes boards by the router at `endpoint`, with a pose each `pose_every_s` of device time. `report`: the state of the
/// daemon.
pub(crate) fn publish_by_zenoh(
    endpoint: &str,
    boards: Vec<LiveBoard>,
    pose_every_s: f64,
    report: impl Fn() -> DaemonReport + Send + 'static,
) -> Result<StreamPlan> {
    let router = Router::at(endpoint)?;
    say(format_args!("boards by Zenoh at {}", router.what));
    Ok(StreamPlan { taker: Box::new(Publisher::new(router, boards, Box::new(report))), pose_every_s })
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

#[derive(Clone, Copy, Debug)]
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
}

/// The number of a publisher: a hash of its token, the lower half first.
pub(super) fn gid(token: &str) -> [u8; 16] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_the_ros_graph_is_read_or_refused() {
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
        let error = Router::at("tcp/127.0.0.1:1").unwrap().session().err().unwrap().to_string();
        assert!(error.contains("tcp/127.0.0.1:1") && error.contains("--zenoh-router"), "{error}");
        assert!(!error.contains(".rs"), "{error}");
        assert!(Router::at("nonsense").is_err());
    }
}

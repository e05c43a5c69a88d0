//! The session.

use std::env;
use std::ffi::OsString;
use std::sync::{Arc, Mutex};

use ::zenoh::key_expr::KeyExpr;
use ::zenoh::{Config, Session, Wait};
use slitpose_head::threads::lock;

use super::ZenohError;
use super::far_board::FarBoardOpener;
use super::publisher::Publisher;
use crate::daemon::{Opener, StreamPlan, Talk};
use crate::live::LiveBoard;
use crate::telemetry::DaemonReport;

/// A session of Zenoh, which begins as soon as its router is there, and reaches that again whenever it was away.
#[derive(Clone)]
pub(crate) struct ZenohSession {
    /// The endpoint or file.
    what: String,
    config: Config,
    pub(super) domain: u8,
    session: Arc<Mutex<Option<Session>>>,
}

impl ZenohSession {
    /// A session by the router at `endpoint`, or by the file that ZENOH_SESSION_CONFIG_URI names, as ROS 2 does.
    ///
    /// # Errors
    /// Settings that Zenoh refuses.
    pub(crate) fn open(endpoint: &str) -> Result<Self, ZenohError> {
        let domain = domain(env::var_os("ROS_DOMAIN_ID"))?;
        let (what, config) = match env::var_os("ZENOH_SESSION_CONFIG_URI") {
            Some(path) => (path.display().to_string(), Config::from_file(&path)),
            None => (endpoint.to_owned(), by_router(endpoint)),
        };
        match config {
            Ok(config) => Ok(Self { what, config, domain, session: Arc::default() }),
            Err(error) => Err(ZenohError::Settings { what, reason: reason_of(&*error) }),
        }
    }

    /// The session, once its router is there. Takes a second at most.
    ///
    /// # Errors
    /// Why it does not begin.
    pub(super) fn get(&self) -> Result<Session, ZenohError> {
        let mut session = lock(&self.session);
        if let Some(session) = &*session {
            return Ok(session.clone());
        }
        let opened = ::zenoh::open(self.config.clone()).wait();
        let opened =
            opened.map_err(|error| ZenohError::Open { what: self.what.clone(), reason: reason_of(&*error) })?;
        Ok(session.insert(opened).clone())
    }

    /// Publishes boards, with a pose each `pose_every_s` of device time. `report`: the state of the daemon; `talk`
    /// tells the user.
    pub(crate) fn publisher(
        &self,
        boards: Vec<LiveBoard>,
        pose_every_s: f64,
        report: impl Fn() -> DaemonReport + Send + 'static,
        talk: Arc<Talk>,
    ) -> StreamPlan {
        talk(format_args!("boards by Zenoh at {}", self.what));
        let publisher = Publisher::new(self.clone(), boards, Box::new(report), talk);
        StreamPlan { taker: Box::new(publisher), pose_every_s }
    }

    /// Opens the board that another daemon publishes; `key` is what its topics begin with.
    ///
    /// # Errors
    /// A key that no board can have.
    pub(crate) fn opener(&self, key: &str) -> Result<Box<dyn Opener>, ZenohError> {
        Ok(Box::new(FarBoardOpener::new(self.clone(), topic_of(key)?)))
    }
}

/// What the topics of one board begin with.
fn topic_of(key: &str) -> Result<String, ZenohError> {
    let topic = key.trim_start_matches('/');
    // Of several boards at once nothing could be solved.
    if KeyExpr::new(topic).is_err() || topic.contains(['*', '$']) {
        return Err(ZenohError::Key { key: key.to_owned() });
    }
    Ok(topic.to_owned())
}

/// The number of the ROS 2 graph, from its environment variable.
fn domain(variable: Option<OsString>) -> Result<u8, ZenohError> {
    let text = variable.unwrap_or_default().to_string_lossy().into_owned();
    match text.parse() {
        Ok(domain @ 0..=232) => Ok(domain),
        _ if text.is_empty() => Ok(0),
        _ => Err(ZenohError::Domain { text }),
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
}

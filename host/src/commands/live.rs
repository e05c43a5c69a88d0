//! The live page of `run` and `replay`.

use std::net::SocketAddr;
use std::sync::{Arc, OnceLock};

use anyhow::Error;

use super::record::RecordOptions;
use super::{CommandError, talk};
use crate::daemon::Daemon;
use crate::live::{Access, Control, DEFAULT_LIVE_ADDRESS, LivePlan, LiveServer, live_address};
use slitpose_tracking::page::{Order, Refusal};
use slitpose_tracking::telemetry::RecorderState;

/// The page asked for.
#[derive(clap::Args, Debug)]
pub(super) struct LiveOptions {
    /// Show a live page: tool, cells, poses and health in a browser
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = DEFAULT_LIVE_ADDRESS, value_parser = live_address)]
    live: Option<SocketAddr>,
    #[command(flatten)]
    pub(super) access: AccessOptions,
}

/// Who may look at a page.
#[derive(clap::Args, Debug)]
pub(super) struct AccessOptions {
    /// A secret that the page asks for, 16 characters or more; needed where other hosts can reach the address
    #[arg(long, value_name = "TOKEN")]
    live_token: Option<String>,
    /// Let pages at an address that other hosts can reach start and end recordings, and move a replay
    #[arg(long)]
    live_writes: bool,
    /// Open the page in a browser
    #[arg(long)]
    open: bool,
}

impl LiveOptions {
    pub(super) fn is_wanted(&self) -> bool {
        self.live.is_some() || self.access.open
    }

    /// The rules of the page; `None` if none is asked for.
    pub(super) fn access(&self) -> Result<Option<Access>, CommandError> {
        let address = match (self.live, self.access.open) {
            (Some(address), _) => address,
            (None, true) => live_address(DEFAULT_LIVE_ADDRESS).map_err(Error::msg)?,
            (None, false) => return Ok(None),
        };
        self.access.at(address).map(Some)
    }
}

impl AccessOptions {
    /// The rules of a page at `address`.
    pub(super) fn at(&self, address: SocketAddr) -> Result<Access, CommandError> {
        Access::new(address, self.live_token.clone(), self.live_writes)
    }

    /// Serves a page, and opens it if asked.
    pub(super) fn start(&self, plan: LivePlan) -> Result<LiveServer, CommandError> {
        let server = LiveServer::start(plan)?;
        // The token is a secret, and standard error may be a journal.
        let (page, fragment) = server.url.split_once('#').unwrap_or((&server.url, ""));
        let token = if fragment.is_empty() { "" } else { " (add #token= and the secret of --live-token)" };
        talk(format_args!("live page at {page}{token}"));
        if self.open
            && let Err(error) = open::that_detached(&server.url)
        {
            talk(format_args!("no browser could be opened ({error}); open {page} yourself{token}"));
        }
        Ok(server)
    }
}

/// What the page may change in a `daemon` that records by `options`.
pub(super) fn changes(daemon: Arc<OnceLock<Arc<Daemon>>>, options: RecordOptions) -> Control {
    let refused = |reason: &str| Refusal::Recording { reason: reason.to_owned() };
    Box::new(move |order| {
        let daemon = daemon.get().ok_or_else(|| refused("the daemon is still starting; try again"))?;
        let recorder = || daemon.recorder.as_ref().ok_or(Refusal::NO_RECORDER);
        let is_recording = daemon.report().recorder.state == RecorderState::Recording;
        match (order, is_recording) {
            (Order::Record(true), false) => {
                recorder()?.begin(options.another().map_err(|error| refused(&error.to_string()))?);
            }
            (Order::Record(true), true) => return Err(refused("a recording is under way already; end it first")),
            (Order::Record(false), true) => recorder()?.end_capture(),
            (Order::Note(text, ago_s), true) => recorder()?.note(text, ago_s),
            (Order::Note(..) | Order::Record(false), false) => return Err(refused("nothing is being recorded")),
            (Order::Frame(board, over_s), _) => {
                if let Some(value) = over_s.filter(|over_s| !(*over_s > 0.0 && *over_s <= MAX_ZERO_S)) {
                    return Err(Refusal::Value { key: "over_s", value, hint: "seconds above 0, 60 at most" });
                }
                if !daemon.zero(board, over_s) {
                    let (key, value) = ("board", board as f64);
                    return Err(Refusal::Value { key, value, hint: "the number of a board, from 0" });
                }
            }
            (Order::Player(_), _) => return Err(Refusal::NO_PLAYER),
        }
        Ok(())
    })
}

/// Longest time of a zero, seconds.
const MAX_ZERO_S: f64 = 60.0;

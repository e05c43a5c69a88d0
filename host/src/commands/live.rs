//! The live page, as `run`, `replay` and `scene view` offer it.

use std::sync::{Arc, OnceLock};

use super::record::RecordOptions;
use super::{CommandError, talk};
use crate::daemon::Daemon;
use crate::live::{
    Access, Control, DEFAULT_FOXGLOVE_ADDRESS, DEFAULT_LIVE_ADDRESS, FoxgloveAddress, FoxgloveServer, LiveAddress,
    LiveBoard, LivePlan, LiveServer, Order, Refusal,
};
use crate::spacenav::SpacenavInput;
use crate::telemetry::{DaemonReport, RecorderState};

/// The page asked for.
#[derive(clap::Args, Debug)]
pub(super) struct LiveOptions {
    /// Show a live page: tool, cells, poses and health in a browser
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = DEFAULT_LIVE_ADDRESS)]
    live: Option<LiveAddress>,
    #[command(flatten)]
    access: AccessOptions,
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

/// Foxglove as a viewer. The option is hidden where the build has no server, and then says which build has it.
#[derive(clap::Args, Debug)]
pub(super) struct FoxgloveOptions {
    /// Serve poses, head and health to Foxglove on this host, by its WebSocket protocol
    #[arg(
        long,
        value_name = "ADDRESS",
        num_args = 0..=1,
        default_missing_value = DEFAULT_FOXGLOVE_ADDRESS,
        hide = !cfg!(feature = "foxglove")
    )]
    foxglove: Option<FoxgloveAddress>,
}

impl FoxgloveOptions {
    /// Serves Foxglove, if asked.
    pub(super) fn start(
        &self,
        boards: Vec<LiveBoard>,
        report: impl Fn() -> DaemonReport + Send + 'static,
    ) -> Result<Option<FoxgloveServer>, CommandError> {
        let Some(address) = self.foxglove else { return Ok(None) };
        let server = FoxgloveServer::start(address, boards, report)?;
        talk(format_args!("Foxglove connects to {}", server.url()));
        Ok(Some(server))
    }
}

impl LiveOptions {
    /// The rules of the page; `None` if none is asked for.
    pub(super) fn access(&self) -> Result<Option<Access>, CommandError> {
        let address = match (self.live, self.access.open) {
            (Some(address), _) => address,
            (None, true) => DEFAULT_LIVE_ADDRESS.parse()?,
            (None, false) => return Ok(None),
        };
        self.access.at(address).map(Some)
    }

    /// Serves the page, and opens it if asked.
    pub(super) fn start(&self, plan: LivePlan) -> Result<LiveServer, CommandError> {
        self.access.start(plan)
    }
}

impl AccessOptions {
    /// The rules of a page at `address`.
    pub(super) fn at(&self, address: LiveAddress) -> Result<Access, CommandError> {
        Ok(Access::new(address, self.live_token.clone(), self.live_writes)?)
    }

    /// Serves a page, and opens it if asked.
    pub(super) fn start(&self, plan: LivePlan) -> Result<LiveServer, CommandError> {
        let server = LiveServer::start(plan)?;
        // The token is a secret, and standard error may be a journal.
        let (page, fragment) = server.url().split_once('#').unwrap_or((server.url(), ""));
        let token = if fragment.is_empty() { "" } else { " (add #token= and the secret of --live-token)" };
        talk(format_args!("live page at {page}{token}"));
        if self.open
            && let Err(error) = open::that_detached(server.url())
        {
            talk(format_args!("no browser could be opened ({error}); open {page} yourself{token}"));
        }
        Ok(server)
    }
}

/// What the page may change in a daemon.
pub(super) struct Changes {
    pub(super) daemon: Arc<OnceLock<Arc<Daemon>>>,
    pub(super) options: RecordOptions,
    pub(super) mouse: Option<SpacenavInput>,
}

impl Control for Changes {
    fn order(&self, order: Order) -> Result<(), Refusal> {
        let refused = |reason: &str| Refusal::Recording { reason: reason.to_owned() };
        let daemon = self.daemon.get().ok_or_else(|| refused("the daemon is still starting; try again"))?;
        let is_recording = daemon.recorder_report().state == RecorderState::Recording;
        match (order, is_recording) {
            (Order::Record(true), false) => {
                let series = self.options.another().map_err(|error| refused(&error.to_string()))?;
                daemon.begin_recording(series);
                Ok(())
            }
            (Order::Record(true), true) => Err(refused("a recording is under way already; end it first")),
            (Order::Record(false), true) => {
                daemon.end_recording();
                Ok(())
            }
            (Order::Record(false), false) => Err(refused("nothing is being recorded")),
            (Order::Zero, _) => {
                self.mouse.as_ref().ok_or(Refusal::NO_MOUSE)?.zero();
                Ok(())
            }
            (Order::Player(_), _) => Err(Refusal::NO_PLAYER),
        }
    }
}

//! The server of the page: its files over HTTP, everything else over one WebSocket.

use std::net::IpAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::Body;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::{
    CACHE_CONTROL, CONNECTION, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Router};
use include_dir::{Dir, File, include_dir};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_encode};
use slitpose_head::threads::lock;
use tokio::io::AsyncReadExt;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::io::ReaderStream;

use super::control::{Access, Control};
use super::hub::{Hub, Input, LiveBoard, LiveInput};
use super::recordings::Recordings;
use super::session;
use crate::address::Address;
use crate::http::{Connection, Serving, reply};
use slitpose_tracking::page::{Refusal, SceneView};
use slitpose_tracking::telemetry::DaemonReport;

/// Most clients at a time, of those that have said hello.
pub(super) const MAX_CLIENTS: usize = 32;

/// Longest message of a client, bytes: requests have less than 200.
pub(super) const MAX_REQUEST: usize = 4096;

const REPORT_EVERY: Duration = Duration::from_millis(500);

/// Nothing but the page's own files, and no page of others around it.
const POLICY: &str = "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

pub(crate) struct LivePlan {
    pub access: Access,
    /// What it shows: `run`, `replay` or `scene`.
    pub source: &'static str,
    /// Its boards, as far as they are known.
    pub boards: Vec<LiveBoard>,
    pub scene: Option<SceneView>,
    pub control: Control,
    /// The state of the daemon, if there is one.
    pub report: Option<Box<dyn Fn() -> DaemonReport + Send + Sync>>,
    /// The recordings, if there may be any.
    pub recordings: Option<Recordings>,
}

pub(super) struct Shared {
    pub(super) plan: LivePlan,
    pub(super) hub: Hub,
    pub(super) clients: Clients,
}

impl Shared {
    fn new(plan: LivePlan) -> Self {
        Self { plan, hub: Hub::new(), clients: Clients::default() }
    }

    /// The recordings, for a client that may change something.
    pub(super) fn recordings(&self) -> Result<&Recordings, Refusal> {
        if !self.plan.access.may_write {
            return Err(Refusal::ReadOnly);
        }
        self.plan.recordings.as_ref().ok_or(Refusal::NO_RECORDER)
    }

    /// The scene whose tool may be dragged.
    pub(super) fn scene(&self) -> Result<&SceneView, Refusal> {
        let instead = "`slitpose scene view SCENE` has one";
        self.plan.scene.as_ref().ok_or(Refusal::NotHere { what: "tool to drag", instead })
    }

    /// What clients share to whom the capture `name` is played; the player ends with the last of them.
    pub(super) fn played(&self, name: &str) -> Result<Arc<Self>, Refusal> {
        self.recordings()?.played(name, |control, mut inputs| {
            let shared = Arc::new(Self::new(LivePlan {
                access: self.plan.access.clone(),
                source: "replay",
                boards: Vec::new(),
                scene: None,
                control,
                report: None,
                recordings: None,
            }));
            let played = Arc::downgrade(&shared);
            tokio::spawn(async move {
                while let Some((input, shared)) = inputs.recv().await.zip(played.upgrade()) {
                    shared.hub.accept(input);
                }
            });
            shared
        })
    }
}

/// Addresses of the clients that have said hello.
#[derive(Debug, Default)]
pub(super) struct Clients(Mutex<Vec<Option<IpAddr>>>);

impl Clients {
    /// Takes a place for a client of `address`, until dropped. The last one is kept for an address without any.
    pub(super) fn place(&self, address: Option<IpAddr>) -> Option<Place<'_>> {
        let mut clients = lock(&self.0);
        let is_free = clients.len() + usize::from(clients.contains(&address)) < MAX_CLIENTS;
        is_free.then(|| {
            clients.push(address);
            Place { clients: self, address }
        })
    }
}

#[derive(Debug)]
pub(super) struct Place<'c> {
    clients: &'c Clients,
    address: Option<IpAddr>,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let mut clients = lock(&self.clients.0);
        if let Some(number) = clients.iter().position(|client| *client == self.address) {
            clients.swap_remove(number);
        }
    }
}

pub(crate) struct LiveServer {
    /// The address of the page, for a browser.
    pub(crate) url: String,
    pub(crate) input: LiveInput,
    _serving: Serving,
}

impl LiveServer {
    pub(crate) fn start(mut plan: LivePlan) -> anyhow::Result<Self> {
        let (address, scope) = (Address::Tcp(plan.access.address), plan.access.scope());
        let (boards, report) = (std::mem::take(&mut plan.boards), plan.report.take());
        let shared = Arc::new(Shared::new(plan));
        shared.hub.accept(Input::Boards(boards));
        let (input, mut inputs) = LiveInput::new();
        let (routes, of_inputs, of_reports) = (routes(&shared), Arc::clone(&shared), Arc::clone(&shared));
        let begin = || {
            tokio::spawn(async move {
                while let Some(input) = inputs.recv().await {
                    of_inputs.hub.accept(input);
                }
            });
            if let Some(report) = report {
                tokio::spawn(async move {
                    let mut ticks = interval(REPORT_EVERY);
                    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
                    loop {
                        ticks.tick().await;
                        of_reports.hub.accept(Input::Report(Box::new(report())));
                    }
                });
            }
        };
        let refusal = "pages of other sites get no answer; open this page by 127.0.0.1, [::1] or localhost\n";
        // When it is dropped, clients see their connections end.
        let serving = Serving::http("live", &address, scope, refusal, routes, begin)?;
        Ok(Self { url: shared.plan.access.url(&serving.address), input, _serving: serving })
    }
}

fn routes(shared: &Arc<Shared>) -> Router {
    let router = Router::new().route("/live", get(upgrade)).route("/recordings/{secret}", get(fetch));
    let router = router.with_state(Arc::clone(shared)).route("/", get(async || page_file(INDEX)));
    let of_page = async |Path(name): Path<String>| if name == INDEX { nothing() } else { page_file(&name) };
    router.route("/{file}", get(of_page)).fallback(async || nothing())
}

fn nothing() -> Response {
    reply(StatusCode::NOT_FOUND, "there is / and /live\n")
}

fn page_file(name: &str) -> Response {
    let Some(text) = PAGE.get_file(name).and_then(File::contents_utf8) else { return nothing() };
    let media = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    let headers = [
        (CONTENT_TYPE, media),
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-cache"),
        (CONNECTION, "close"),
    ];
    (headers, text.replace(VERSION_MARK, env!("CARGO_PKG_VERSION"))).into_response()
}

async fn upgrade(
    State(shared): State<Arc<Shared>>,
    Extension(connection): Extension<Arc<Connection>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if shared.clients.place(connection.address).is_none() {
        return reply(StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", Refusal::Full));
    }
    let upgrade = upgrade.max_message_size(MAX_REQUEST).max_frame_size(MAX_REQUEST);
    upgrade.on_upgrade(async move |socket| session::serve(socket, shared, &connection).await)
}

/// The capture to which a client has got a ticket.
async fn fetch(
    State(shared): State<Arc<Shared>>,
    Extension(connection): Extension<Arc<Connection>>,
    Path(secret): Path<String>,
) -> Response {
    let path = shared.plan.recordings.as_ref().and_then(|recordings| recordings.fetched_by(&secret));
    let gone = || reply(StatusCode::NOT_FOUND, "no such recording; ask for it on the page again\n");
    let Some(path) = path else { return gone() };
    let (Ok(file), Some(name)) = (tokio::fs::File::open(&path).await, path.file_name()) else { return gone() };
    let Ok(bytes) = file.metadata().await.map(|metadata| metadata.len()) else { return gone() };
    // A long file takes longer than other answers.
    connection.release();
    let name = percent_encode(name.as_encoded_bytes(), PLAIN);
    let headers = [
        (CONTENT_TYPE, "application/octet-stream".to_owned()),
        // What is appended meanwhile is not sent.
        (CONTENT_LENGTH, bytes.to_string()),
        (CONTENT_DISPOSITION, format!("attachment; filename*=UTF-8''{name}")),
        (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
        (CONNECTION, "close".to_owned()),
    ];
    (headers, Body::from_stream(ReaderStream::with_capacity(file.take(bytes), 1 << 16))).into_response()
}

/// What stands for itself in the value of an extended parameter, RFC 8187.
const PLAIN: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_');

static PAGE: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/src/live/page");

/// The page itself.
const INDEX: &str = "index.html";

/// In the page's text: the version of the program.
const VERSION_MARK: &str = "SLITPOSE_VERSION";

#[cfg(test)]
mod tests {
    use super::*;

    /// All of it comes over a phone's network.
    const MAX_BYTES: usize = 200_000;

    #[test]
    fn the_page_is_small_whole_and_fetches_nothing_from_elsewhere() {
        let files = || PAGE.files().map(|file| (file.path().to_str().unwrap(), file.contents_utf8().unwrap()));
        let bytes: usize = files().map(|(_, text)| text.len()).sum();
        println!("{bytes} bytes in {} files", files().count());
        assert!(bytes <= MAX_BYTES, "{bytes}");
        for (name, text) in files() {
            for import in text.lines().filter_map(|line| line.split(" from \"./").nth(1)) {
                let module = import.split('"').next().unwrap();
                assert!(PAGE.contains(module), "{name} imports {module}");
            }
            let elsewhere = text.replace("http://www.w3.org/2000/svg", "");
            assert!(!elsewhere.contains("https://") && !elsewhere.contains("http://"), "{name}");
            if name == INDEX {
                assert!(text.contains(VERSION_MARK) && !text.contains("<style") && !text.contains(" style="), "{name}");
            }
        }
    }
}

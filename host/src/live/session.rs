//! One client of the page.
//!
//! A client acknowledges messages. At most [`WINDOW`] of them are unacknowledged, so that neither the daemon nor the
//! network holds more of a client that is slow, asleep or gone. Behind that, the newest win: a client that is far behind
//! goes on with the present, and is told how many frames it has missed.

use std::collections::VecDeque;
use std::future::ready;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, Utf8Bytes, WebSocket};
use serde_json::{Value, json};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::task::spawn_blocking;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::hub::{Event, Snapshot};
use super::recordings::Recordings;
use super::server::Shared;
use crate::http::Connection;
use slitpose_tracking::page::{FRAMES_HZ, Order, Refusal, Request, hello};

/// Most messages that a client has not acknowledged.
pub(super) const WINDOW: u64 = 64;

/// Most of these when frames of the past are sent, which are long.
const PAST_WINDOW: u64 = 4;

/// Frames of the past in one message.
const PAST: usize = 60;

/// Coarse bins in one message.
const PAST_COARSE: usize = 360;

/// A client for which more frames wait goes on with the present: half a second of one board.
const MAX_WAITING: usize = (FRAMES_HZ / 2) as usize;

/// A client from which nothing came for this long is asked whether it is there; …
const ASK_AFTER: Duration = Duration::from_secs(15);

/// … and is gone if it takes or answers nothing for this long.
const GONE_AFTER: Duration = Duration::from_secs(40);

/// Before a wrong token is answered: against guessing.
const PENALTY: Duration = Duration::from_secs(1);

struct Gone;

/// Serves a client until it goes. It has a place, and `connection` is released, once it has shown that it may look.
pub(super) async fn serve(mut socket: WebSocket, shared: Arc<Shared>, connection: &Connection) {
    let Some(Some(Ok(Message::Text(text)))) = connection.while_open(socket.recv()).await else { return };
    let Ok(Request::Hello { token, recording }) = Request::read(&text) else { return };
    let mut session = Session::new(socket, Arc::clone(&shared));
    if !shared.plan.access.admits(token.as_deref()) {
        sleep(PENALTY).await;
        let _ = session.refuse(&Refusal::Token).await;
        return;
    }
    let Some(_place) = shared.clients.place(connection.address) else {
        let _ = session.refuse(&Refusal::Full).await;
        return;
    };
    connection.release();
    if let Some(name) = recording {
        match shared.played(&name) {
            Ok(played) => session.shared = played,
            Err(refusal) => {
                let _ = session.refuse(&refusal).await;
                return;
            }
        }
    }
    let _ = session.run().await;
}

struct Session {
    socket: WebSocket,
    shared: Arc<Shared>,
    sent: u64,
    acknowledged: u64,
    missed: u64,
    history: u64,
    boards: Vec<String>,
    /// Numbers of the frames of the past that are still to be sent, by board.
    past: VecDeque<(usize, Range<u64>)>,
    /// Coarse bins that are still to be sent, by board.
    coarse: Vec<VecDeque<Utf8Bytes>>,
    /// Frames of a scene without a board.
    drawn: u64,
}

impl Session {
    fn new(socket: WebSocket, shared: Arc<Shared>) -> Self {
        let (boards, past, coarse) = (Vec::new(), VecDeque::new(), Vec::new());
        Self { socket, shared, sent: 0, acknowledged: 0, missed: 0, history: 0, boards, past, coarse, drawn: 0 }
    }

    async fn run(&mut self) -> Result<(), Gone> {
        let (mut news, snapshot) = self.shared.hub.subscribe();
        self.greet(&snapshot).await?;
        self.begin(snapshot).await?;
        let (mut heard, mut asked) = (Instant::now(), Instant::now());
        loop {
            if self.shared.hub.history() != self.history {
                let snapshot;
                (news, snapshot) = self.shared.hub.subscribe();
                if snapshot.names == self.boards {
                    for board in 0..self.boards.len() {
                        self.answer(json!({"kind": "cleared", "board": board})).await?;
                    }
                } else {
                    self.greet(&snapshot).await?;
                }
                self.begin(snapshot).await?;
            }
            let waiting = self.sent.saturating_sub(self.acknowledged);
            let has_room = waiting < WINDOW;
            if has_room {
                self.skip_to_newest(&mut news);
                self.tell_missed().await?;
            }
            let has_past = !self.past.is_empty() || self.coarse.iter().any(|bins| !bins.is_empty());
            let sends_past = waiting < PAST_WINDOW && has_past && news.is_empty();
            tokio::select! {
                request = self.socket.recv() => {
                    heard = Instant::now();
                    match request {
                        Some(Ok(Message::Text(text))) => self.accept(&text).await?,
                        Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                        _ => return Err(Gone),
                    }
                }
                event = news.recv(), if has_room => match event {
                    Ok(Event::Frame { history, text }) if history == self.history => self.send(text).await?,
                    Ok(Event::State(text)) => self.send(text).await?,
                    Ok(Event::Frame { .. } | Event::Changed) => {}
                    Err(RecvError::Lagged(count)) => self.missed += count,
                    Err(RecvError::Closed) => return Err(Gone),
                },
                () = ready(()), if sends_past => self.send_past().await?,
                () = sleep_until(asked.max(heard) + ASK_AFTER) => {
                    if heard.elapsed() >= GONE_AFTER {
                        return Err(Gone);
                    }
                    asked = Instant::now();
                    self.put(Message::Ping(Default::default())).await?;
                }
            }
        }
    }

    async fn greet(&mut self, snapshot: &Snapshot) -> Result<(), Gone> {
        let plan = &self.shared.plan;
        let mut greeting = hello(plan.source, &snapshot.names, plan.access.may_write);
        greeting["has_folder"] = plan.recordings.is_some().into();
        self.answer(greeting).await
    }

    /// What has to be known before frames of a history.
    async fn begin(&mut self, snapshot: Snapshot) -> Result<(), Gone> {
        let Snapshot { history, names, heads, states, frames, coarse } = snapshot;
        (self.history, self.boards, self.coarse) = (history, names, coarse);
        self.past = frames.into_iter().enumerate().filter(|(_, frames)| !frames.is_empty()).collect();
        for text in heads.into_iter().chain(states) {
            self.send(text).await?;
        }
        Ok(())
    }

    /// Passes over frames if too many wait. Other news come again by themselves.
    fn skip_to_newest(&mut self, news: &mut Receiver<Event>) {
        if news.len() <= MAX_WAITING * self.boards.len().max(1) {
            return;
        }
        while news.len() > self.boards.len() {
            match news.try_recv() {
                Ok(event) => self.missed += u64::from(matches!(event, Event::Frame { .. })),
                Err(TryRecvError::Lagged(count)) => self.missed += count,
                Err(_) => return,
            }
        }
    }

    async fn tell_missed(&mut self) -> Result<(), Gone> {
        match std::mem::take(&mut self.missed) {
            0 => Ok(()),
            frames => self.answer(json!({"kind": "missed", "frames": frames})).await,
        }
    }

    /// Sends some frames of the past, the oldest first, and then its coarse bins.
    async fn send_past(&mut self) -> Result<(), Gone> {
        let Some((board, mut wanted)) = self.past.pop_front() else { return self.send_coarse().await };
        let frames = self.shared.hub.past(self.history, board, &mut wanted, PAST);
        if !wanted.is_empty() {
            self.past.push_front((board, wanted));
        }
        let frames: Vec<&str> = frames.iter().map(Utf8Bytes::as_str).collect();
        let text = format!(r#"{{"kind":"history","board":{board},"frames":[{}]}}"#, frames.join(","));
        self.send(text.into()).await
    }

    async fn send_coarse(&mut self) -> Result<(), Gone> {
        let Some(board) = self.coarse.iter().position(|bins| !bins.is_empty()) else { return Ok(()) };
        let count = self.coarse[board].len().min(PAST_COARSE);
        let bins: Vec<Utf8Bytes> = self.coarse[board].drain(..count).collect();
        let bins: Vec<&str> = bins.iter().map(Utf8Bytes::as_str).collect();
        let text = format!(r#"{{"kind":"history","board":{board},"coarse":[{}]}}"#, bins.join(","));
        self.send(text.into()).await
    }

    async fn accept(&mut self, text: &str) -> Result<(), Gone> {
        let request = match Request::read(text) {
            Ok(request) => request,
            Err(error) => return self.refuse(&Refusal::Unreadable { reason: error.to_string() }).await,
        };
        let done = match request {
            Request::Hello { .. } => Ok(()),
            Request::Ack { messages } => {
                self.acknowledged = messages.min(self.sent);
                Ok(())
            }
            Request::Record { on } => self.order(Order::Record(on)),
            Request::Note { text, ago_s } => match Order::note(&text, ago_s).and_then(|order| self.order(order)) {
                Ok(()) => return self.answer(json!({"kind": "noted", "text": text})).await,
                refused => refused,
            },
            Request::Recordings {} => return self.tell_recordings(|_| Ok(())).await,
            Request::Rename { file, to } => return self.tell_recordings(move |of| of.rename(&file, &to)).await,
            Request::Calibrate { free, pivot, stage, rest } => {
                let captures = [&free[..], &pivot, &stage, &rest];
                self.shared.recordings().and_then(|of| of.calibrate(&self.shared, captures))
            }
            Request::Download { file } => match self.shared.recordings().and_then(|of| of.ticket(&file)) {
                Ok(address) => return self.answer(json!({"kind": "download", "file": file, "address": address})).await,
                Err(refusal) => Err(refusal),
            },
            Request::Player(order) => self.order(Order::Player(order)),
            Request::SetFrame { board, over_s } => self.order(Order::Frame(board, over_s)),
            Request::Pose { t_m, r_rad } => match self.drawn_at(t_m, r_rad) {
                Ok(text) => return self.send(text).await,
                Err(refusal) => Err(refusal),
            },
            Request::Map { plane, t_m, r_rad } => {
                let shared = Arc::clone(&self.shared);
                let map = spawn_blocking(move || shared.scene()?.map(plane, t_m, r_rad)).await;
                match map.map_err(|_| Gone)? {
                    Ok(map) => return self.answer(map).await,
                    Err(refusal) => Err(refusal),
                }
            }
        };
        match done {
            Ok(()) => Ok(()),
            Err(refusal) => self.refuse(&refusal).await,
        }
    }

    /// Changes the recordings, and sends their list.
    async fn tell_recordings(
        &mut self,
        change: impl FnOnce(&Recordings) -> Result<(), Refusal> + Send + 'static,
    ) -> Result<(), Gone> {
        let shared = Arc::clone(&self.shared);
        let listed = spawn_blocking(move || {
            let recordings = shared.recordings()?;
            change(recordings)?;
            Ok((recordings.folder(), recordings.list()?))
        });
        match listed.await {
            Ok(Ok((folder, files))) => {
                self.answer(json!({"kind": "recordings", "folder": folder, "files": files})).await
            }
            Ok(Err(refusal)) => self.refuse(&refusal).await,
            Err(_) => Err(Gone),
        }
    }

    fn order(&self, order: Order) -> Result<(), Refusal> {
        if !self.shared.plan.access.may_write {
            return Err(Refusal::ReadOnly);
        }
        (self.shared.plan.control)(order)
    }

    fn drawn_at(&mut self, t_m: [f64; 3], r_rad: [f64; 3]) -> Result<Utf8Bytes, Refusal> {
        self.drawn += 1;
        self.shared.scene()?.frame(self.drawn, t_m, r_rad).map(Utf8Bytes::from)
    }

    async fn refuse(&mut self, refusal: &Refusal) -> Result<(), Gone> {
        self.answer(json!({"kind": "refused", "reason": refusal.to_string()})).await
    }

    async fn answer(&mut self, answer: Value) -> Result<(), Gone> {
        self.send(answer.to_string().into()).await
    }

    async fn send(&mut self, text: Utf8Bytes) -> Result<(), Gone> {
        self.sent += 1;
        self.put(Message::Text(text)).await
    }

    async fn put(&mut self, message: Message) -> Result<(), Gone> {
        match timeout(GONE_AFTER, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(Gone),
        }
    }
}

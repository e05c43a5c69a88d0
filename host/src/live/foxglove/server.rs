//! The server, by Foxglove's own library.

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use ::foxglove::{Context, FoxgloveError as SdkError, RawChannel};
use tokio::runtime::Builder;
use tokio::sync::mpsc::Receiver;
use tokio::sync::oneshot;
use tokio::time::{MissedTickBehavior, interval};

use super::board::Board;
use super::{FoxgloveAddress, FoxgloveError};
use crate::live::hub::{Input, LiveBoard, LiveInput};
use crate::telemetry::DaemonReport;

/// Time between reports, and between copies of heads: the protocol keeps no message for those who come later.
const REPORT_EVERY: Duration = Duration::from_millis(500);

/// Messages kept for a client, half a second of a board; one that is further behind misses the oldest.
const BACKLOG: usize = 128;

/// Serves Foxglove until dropped.
pub(crate) struct FoxgloveServer {
    url: String,
    input: LiveInput,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// What is shown.
struct Shown {
    context: Arc<Context>,
    boards: Vec<Option<Board>>,
    report: Arc<RawChannel>,
}

impl FoxgloveServer {
    /// Serves Foxglove. `report`: the state of the daemon.
    ///
    /// # Errors
    /// If the address cannot be bound.
    pub(crate) fn start(
        FoxgloveAddress(address): FoxgloveAddress,
        boards: Vec<LiveBoard>,
        report: impl Fn() -> DaemonReport + Send + 'static,
    ) -> Result<Self, FoxgloveError> {
        let listen = |source| FoxgloveError::Listen { address, source };
        let start = |error| match error {
            SdkError::Bind(source) => listen(source),
            error => FoxgloveError::Start { address, source: Box::new(error) },
        };
        let runtime = Builder::new_current_thread().enable_all().build().map_err(listen)?;
        let context = Context::new();
        let server = context
            .websocket_server()
            .name("slitpose")
            .bind(address.ip().to_string(), address.port())
            .message_backlog_size(BACKLOG)
            .tokio_runtime(runtime.handle());
        let server = runtime.block_on(server.start()).map_err(start)?;
        let url = format!("ws://{}", SocketAddr::new(address.ip(), server.port()));
        let channel = context.channel_builder("/slitpose/report").message_encoding("json");
        let mut shown = Shown { report: channel.build_raw().map_err(start)?, context, boards: Vec::new() };
        shown.accept(Input::Boards(boards));
        let (input, inputs) = LiveInput::new();
        let (end, ended) = oneshot::channel();
        let thread = std::thread::Builder::new()
            .name("foxglove".to_owned())
            .spawn(move || {
                runtime.block_on(shown.follow(inputs, report, ended));
                drop(server.stop());
            })
            .map_err(listen)?;
        Ok(Self { url, input, end: Some(end), thread: Some(thread) })
    }

    /// Its address, for Foxglove's "Open connection".
    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// Where samples go.
    pub(crate) fn input(&self) -> LiveInput {
        self.input.clone()
    }
}

impl Drop for FoxgloveServer {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already been reported on standard error.
            let _ = thread.join();
        }
    }
}

impl Shown {
    async fn follow(
        mut self,
        mut inputs: Receiver<Input>,
        report: impl Fn() -> DaemonReport,
        mut ended: oneshot::Receiver<()>,
    ) {
        let mut ticks = interval(REPORT_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = &mut ended => return,
                _ = ticks.tick() => {
                    self.boards.iter().flatten().for_each(Board::show_head);
                    self.report(&report());
                }
                Some(input) = inputs.recv() => self.accept(input),
            }
        }
    }

    fn accept(&mut self, input: Input) {
        match input {
            Input::Sample(number, sample) => {
                if let Some(Some(board)) = self.boards.get_mut(number) {
                    // Channels of a topic and a schema, as all these are, can always be made.
                    let _ = board.show(&sample, &self.context);
                }
            }
            Input::Boards(boards) => {
                let shown = |(number, board): (usize, LiveBoard)| board.head.map(|head| Board::new(number, head));
                self.boards = boards.into_iter().enumerate().map(shown).collect();
            }
            Input::Report(report) => self.report(&report),
            // Captures are played for the live page only.
            Input::Player(_) => {}
        }
    }

    fn report(&self, report: &DaemonReport) {
        // Numbers and texts can always be written.
        if let Ok(text) = serde_json::to_vec(report) {
            self.report.log(&text);
        }
    }
}

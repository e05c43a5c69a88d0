//! The state that all clients share: heads, the frames of the last minute, reports.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Mutex;

use axum::extract::ws::Utf8Bytes;
use serde_json::json;
use slitpose_calibration::Head;
use slitpose_head::threads::lock;
use tokio::sync::broadcast;
use tokio::sync::mpsc::{Receiver, Sender, WeakSender, channel};

use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::{
    COARSE_HZ, COARSE_S, CalibrationState, FRAMES_HZ, HISTORY_S, Optics, PlayerState, Sample, head_message,
    report_message,
};
use slitpose_tracking::telemetry::DaemonReport;

const HISTORY: usize = (HISTORY_S * FRAMES_HZ) as usize;

const COARSE: usize = (COARSE_S * COARSE_HZ) as usize;

/// Most samples on their way to the server's thread: a quarter of a second of one board.
const INPUTS: usize = 16;

/// Most frames on their way to a client; one that is further behind misses the oldest.
const EVENTS: usize = 256;

#[derive(Clone, Debug)]
pub(crate) struct LiveBoard {
    pub name: String,
    pub head: Head,
}

#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a box would be allocated for each sample")]
pub(crate) enum Input {
    Sample(usize, Sample),
    /// The heads of all boards, anew; their histories end.
    Boards(Vec<LiveBoard>),
    Report(Box<DaemonReport>),
    Player(PlayerState),
    Calibration(CalibrationState),
    /// Why there is nothing more to show.
    Failed(String),
}

/// The server's end for samples and changes.
#[derive(Clone, Debug)]
pub(crate) struct LiveInput(Sender<Input>);

impl LiveInput {
    pub(crate) fn new() -> (Self, Receiver<Input>) {
        let (sender, receiver) = channel(INPUTS);
        (Self(sender), receiver)
    }

    /// Tells whether others still send.
    pub(super) fn downgrade(&self) -> WeakSender<Input> {
        self.0.downgrade()
    }

    /// Whether nobody looks any more.
    pub(crate) fn is_closed(&self) -> bool {
        self.0.is_closed()
    }

    /// Takes a sample of a board; `false` if the server has no time. Never blocks.
    pub(crate) fn sample(&self, board: usize, sample: &Sample) -> bool {
        self.0.try_reserve().map(|room| room.send(Input::Sample(board, sample.clone()))).is_ok()
    }

    pub(crate) fn show(&self, input: Input) {
        // The server ends after all who send.
        let _ = self.0.blocking_send(input);
    }
}

#[derive(Clone, Debug)]
pub(super) enum Event {
    Frame {
        history: u64,
        text: Utf8Bytes,
    },
    /// A message that stands for itself: a report, the state of a player.
    State(Utf8Bytes),
    Changed,
}

/// What a client has to know before the next frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Snapshot {
    /// The number of the present history; frames of others are void.
    pub(super) history: u64,
    pub(super) names: Vec<String>,
    pub(super) heads: Vec<Utf8Bytes>,
    pub(super) states: Vec<Utf8Bytes>,
    /// Numbers of the frames of each board so far.
    pub(super) frames: Vec<Range<u64>>,
    /// Coarse bins of each board.
    pub(super) coarse: Vec<VecDeque<Utf8Bytes>>,
}

pub(super) struct Hub {
    events: broadcast::Sender<Event>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    boards: Vec<Board>,
    history: u64,
    report: Option<Utf8Bytes>,
    player: Option<Utf8Bytes>,
    calibration: Option<Utf8Bytes>,
}

struct Board {
    name: String,
    head: Utf8Bytes,
    optics: Option<Optics>,
    frames: VecDeque<Utf8Bytes>,
    coarse: VecDeque<Utf8Bytes>,
    next: u64,
    time_s: f64,
}

impl Hub {
    pub(super) fn new() -> Self {
        Self { events: broadcast::channel(EVENTS).0, state: Mutex::default() }
    }

    /// The news from now on, and what was before.
    pub(super) fn subscribe(&self) -> (broadcast::Receiver<Event>, Snapshot) {
        let state = lock(&self.state);
        (self.events.subscribe(), state.snapshot())
    }

    pub(super) fn history(&self) -> u64 {
        lock(&self.state).history
    }

    /// At most `count` frames of `wanted`, whose numbers are taken out of it, as are those that are no longer kept: clients
    /// that are slow keep no frames of their own.
    pub(super) fn past(&self, history: u64, board: usize, wanted: &mut Range<u64>, count: usize) -> Vec<Utf8Bytes> {
        let state = lock(&self.state);
        let Some(board) = state.boards.get(board).filter(|_| state.history == history) else {
            wanted.start = wanted.end;
            return Vec::new();
        };
        let first_kept = board.kept().start;
        let from = wanted.start.max(first_kept);
        wanted.start = wanted.end.min(from + count as u64);
        let count = wanted.start.saturating_sub(from) as usize;
        board.frames.iter().skip((from - first_kept) as usize).take(count).cloned().collect()
    }

    pub(super) fn accept(&self, input: Input) {
        let mut state = lock(&self.state);
        let event = match input {
            Input::Sample(number, sample) => match state.frame(number, &sample) {
                Some(event) => event,
                None => return,
            },
            Input::Boards(boards) => {
                state.boards =
                    boards.into_iter().enumerate().map(|(number, board)| Board::new(number, board)).collect();
                state.history += 1;
                Event::Changed
            }
            Input::Report(report) => kept(&mut state.report, report_message(&report, HostInstant::now())),
            Input::Player(player) => kept(&mut state.player, player.message()),
            Input::Calibration(calibration) => kept(&mut state.calibration, calibration.message()),
            Input::Failed(reason) => Event::State(json!({"kind": "ended", "reason": reason}).to_string().into()),
        };
        // Without clients there is nobody to tell.
        let _ = self.events.send(event);
    }
}

/// The event of a new state, which clients that come later get, too.
fn kept(state: &mut Option<Utf8Bytes>, message: String) -> Event {
    Event::State(state.insert(message.into()).clone())
}

impl State {
    fn frame(&mut self, number: usize, sample: &Sample) -> Option<Event> {
        let board = self.boards.get_mut(number)?;
        // A board that has restarted begins a new history, so that time only goes on.
        if sample.record.device_time_s < board.time_s {
            self.clear();
        }
        let board = self.boards.get_mut(number)?;
        board.time_s = sample.record.device_time_s;
        let frame = board.optics.as_ref()?.frame(number, board.next, sample);
        board.coarse.extend(frame["coarse"].as_array()?.iter().map(|bin| Utf8Bytes::from(bin.to_string())));
        board.coarse.drain(..board.coarse.len().saturating_sub(COARSE));
        let text = Utf8Bytes::from(frame.to_string());
        board.keep(text.clone());
        Some(Event::Frame { history: self.history, text })
    }

    fn clear(&mut self) {
        self.history += 1;
        for board in &mut self.boards {
            board.frames.clear();
            board.coarse.clear();
            board.time_s = f64::NEG_INFINITY;
        }
    }

    fn snapshot(&self) -> Snapshot {
        Snapshot {
            history: self.history,
            names: self.boards.iter().map(|board| board.name.clone()).collect(),
            heads: self.boards.iter().map(|board| board.head.clone()).collect(),
            states: self.report.iter().chain(&self.player).chain(&self.calibration).cloned().collect(),
            frames: self.boards.iter().map(Board::kept).collect(),
            coarse: self.boards.iter().map(|board| board.coarse.clone()).collect(),
        }
    }
}

impl Board {
    fn keep(&mut self, text: Utf8Bytes) {
        self.next += 1;
        if self.frames.len() == HISTORY {
            self.frames.pop_front();
        }
        self.frames.push_back(text);
    }

    /// Numbers of the frames that are kept.
    fn kept(&self) -> Range<u64> {
        self.next - self.frames.len() as u64..self.next
    }

    fn new(number: usize, LiveBoard { name, head }: LiveBoard) -> Self {
        Self {
            // A scene that cannot be computed has been refused before.
            optics: Optics::of(&head).ok(),
            head: head_message(number, &head).into(),
            frames: VecDeque::with_capacity(HISTORY),
            coarse: VecDeque::new(),
            next: 0,
            time_s: f64::NEG_INFINITY,
            name,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_that_falls_behind_keeps_no_frames_of_its_own() {
        let hub = Hub::new();
        let head = slitpose_head::scene_file::WIDE.read().unwrap().into();
        hub.accept(Input::Boards(vec![LiveBoard { name: "sim".to_owned(), head }]));
        let push = |count: usize| {
            let mut state = lock(&hub.state);
            for _ in 0..count {
                let board = &mut state.boards[0];
                let text = board.next.to_string().into();
                board.keep(text);
            }
        };
        push(100);
        let (_, snapshot) = hub.subscribe();
        assert_eq!(snapshot.frames, vec![0..100]);
        let mut wanted = snapshot.frames[0].clone();
        let mut past = |count| {
            let frames = hub.past(snapshot.history, 0, &mut wanted, count);
            (frames.iter().map(|frame| frame.parse().unwrap()).collect::<Vec<u64>>(), wanted.clone())
        };
        assert_eq!(past(60), ((0..60).collect(), 60..100));
        // The first eighty are no longer kept.
        push(HISTORY - 20);
        assert_eq!(lock(&hub.state).boards[0].frames.len(), HISTORY);
        assert_eq!(past(10), ((80..90).collect(), 90..100));
        push(HISTORY);
        assert_eq!(past(10), (vec![], 100..100));
        assert_eq!(hub.past(snapshot.history + 1, 0, &mut (0..5), 5).len(), 0, "of another history");
    }
}

//! The two threads of a board.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::bounded;
use slitpose_calibration::Head;
use slitpose_model::Tier;
use slitpose_protocol::{Configuration, Stream};

use super::backlog::Backlog;
use super::buffer_pool::{Producer, buffer_pool};
use super::claims::Claims;
use super::error::BoardError;
use super::handoff::handoff;
use super::link::Link;
use super::opener::{Admit, Opener};
use super::outputs::{Outbox, Outputs};
use super::reader::Reader;
use super::real_time;
use super::scan_watch::ScanWatch;
use super::slot::BoardSlot;
use super::solver::{Solver, State};
use super::tap::{Overflow, Tap, TapEnds};
use super::{Talk, spawn};
use crate::clock::HostInstant;
use crate::datagram::DatagramServer;
use crate::link::Segment;
use crate::live::{Sampler, TakesSamples};
use crate::pipeline::{Counts, Following, Pipeline, SceneMatch};
use crate::telemetry::BoardStatistics;
use slitpose_head::threads::join;

/// Most reads on their way to the solver: a quarter of a second at one read per millisecond.
const SEGMENTS: usize = 256;

/// Most bytes of one read of a port.
const SEGMENT_BYTES: usize = 4096;

/// Events that the reader has not handled yet.
const EVENTS: usize = 4;

/// A board to follow, and how to follow it.
pub(crate) struct BoardPlan {
    /// Opens the board.
    pub opener: Box<dyn Opener>,
    /// The board's head.
    pub head: Head,
    /// The board's configuration.
    pub configuration: Configuration,
    /// What the board is to send.
    pub stream: Stream,
    /// Decides whether a board may be followed.
    pub admit: Admit,
    /// The tier of the optics.
    pub tier: Tier,
    /// Options of the tracker.
    pub following: Following,
    /// Duration of the run in device time, seconds; `None`: unlimited.
    pub until_s: Option<f64>,
    /// How long to look for a missing board; `None`: for ever.
    pub patience: Option<Duration>,
    /// Whether device time runs in real time. If not, it waits for the slowest thread.
    pub keeps_time: bool,
    /// Prints a message for the user.
    pub talk: Arc<Talk>,
}

impl BoardPlan {
    pub(super) fn slot(&self) -> Arc<BoardSlot> {
        Arc::new(BoardSlot::new(self.opener.name(), Link::new(Arc::clone(&self.talk))))
    }
}

/// State shared by the threads of all boards.
pub(super) struct Shared {
    pub(super) outboxes: Option<Producer<Outbox>>,
    /// Whether each pose has to be printed.
    pub(super) prints_each: bool,
    pub(super) recorder: Option<TapEnds>,
    pub(super) streams: Vec<TapEnds>,
    pub(super) datagrams: Option<Arc<DatagramServer>>,
    pub(super) takers: Vec<Arc<dyn TakesSamples>>,
    pub(super) real_time: Option<u8>,
    pub(super) claims: Claims,
}

/// The threads of a board.
pub(super) struct BoardThreads {
    name: String,
    reader: JoinHandle<Result<(), BoardError>>,
    solver: JoinHandle<Counts>,
    slot: Arc<BoardSlot>,
}

impl BoardThreads {
    pub(super) fn start(
        number: usize,
        plan: BoardPlan,
        shared: Shared,
        slot: &Arc<BoardSlot>,
        stop: &Arc<AtomicBool>,
    ) -> Result<Self, BoardError> {
        let name = plan.opener.name();
        let (tell, events) = bounded(EVENTS);
        let overflow = if plan.keeps_time { Overflow::Drop } else { Overflow::Wait };
        let keeps_all = shared.prints_each || plan.until_s.is_some();
        let tap = |ends| Tap::new(number, ends, overflow);
        let pipeline = Pipeline::new(plan.head.clone(), plan.tier, SceneMatch::Required)
            .until(plan.until_s)
            .following(plan.following)
            .watched();
        let solver = Solver {
            name: name.clone(),
            pipeline,
            events: tell,
            scan_watch: ScanWatch::new(Duration::from_secs_f64(plan.configuration.schedule.frame_rate_hz().recip())),
            outputs: Outputs::new(
                BoardStatistics::new(name.clone(), HostInstant::now()),
                shared.datagrams,
                shared.outboxes,
                keeps_all,
                shared.recorder.map(tap),
                shared.streams.into_iter().map(tap).collect(),
                shared.takers.into_iter().map(|taker| Sampler::new(number, taker)).collect(),
            ),
            backlog: Backlog::new(keeps_all),
            slot: Arc::clone(slot),
            stop: Arc::clone(stop),
            state: State::default(),
        };
        // A simulated board runs faster if two threads share the work.
        let segments = buffer_pool(SEGMENTS, || Segment::with_capacity(SEGMENT_BYTES));
        let (handoff, solver_end) = handoff(solver, segments, plan.keeps_time);
        let reader = Reader {
            opener: plan.opener,
            configuration: plan.configuration,
            stream: plan.stream,
            head: plan.head,
            admit: plan.admit,
            patience: plan.patience,
            handoff,
            events,
            connection: 0,
            has_scans: false,
            // A port's name may be given twice; a thread's name is unique.
            claims: shared.claims,
            claimant: format!("{name} (board {number})"),
            slot: Arc::clone(slot),
            stop: Arc::clone(stop),
        };
        let (talk_slot, priority) = (Arc::clone(slot), shared.real_time);
        let solve = move || {
            if let Some(remedy) = priority.and_then(|priority| real_time::claim(priority).err()) {
                talk_slot.link.say(format_args!("{remedy}"));
            }
            Solver::run(&solver_end)
        };
        let read = move || {
            // The solving thread reports a refusal.
            let _ = priority.map(real_time::claim);
            reader.run()
        };
        let solver = spawn(format!("solve {number}"), solve)?;
        let reader = spawn(format!("read {number}"), read)?;
        Ok(Self { name, reader, solver, slot: Arc::clone(slot) })
    }

    pub(super) fn is_finished(&self) -> bool {
        self.reader.is_finished() && self.solver.is_finished()
    }

    /// Whether the board was given up: the reader has ended with an error.
    pub(super) fn is_given_up(&self) -> bool {
        self.reader.is_finished() && self.slot.link.is_given_up()
    }

    pub(super) fn end(self) -> (String, Counts, Result<(), BoardError>) {
        let read = join(self.reader);
        let counts = join(self.solver);
        (self.name, counts, read)
    }
}

//! The two threads of a board.

use std::collections::HashMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, bail};
use crossbeam_channel::bounded;
use slitpose_calibration::Head;
use slitpose_head::threads::{join, lock};
use slitpose_model::Tier;
use slitpose_protocol::{Configuration, Pulse, Stream};

use super::backlog::Backlog;
use super::handoff::{Producer, buffer_pool, handoff};
use super::link::{Link, ScanWatch};
use super::outputs::{Outbox, Outputs, Pending};
use super::reader::{Admit, Opener, Reader};
use super::solver::{Solver, State};
use super::tap::{Tap, TapEnds};
use crate::background::{NO_THREAD, spawn};
use crate::datagram::DatagramServer;
use crate::live::LiveInput;
use crate::platform::claim_priority;
use crate::terminal::say;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::frame::View;
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::page::Sampler;
use slitpose_tracking::pipeline::{Counts, Pipeline, PipelineOptions, SceneMatch};
use slitpose_tracking::telemetry::{BoardReport, BoardStatistics};

/// Most reads on their way to the solver: a quarter of a second at one read per millisecond.
const SEGMENTS: usize = 256;

/// Most bytes of one read of a port.
const SEGMENT_BYTES: usize = 4096;

/// Events that the reader has not handled yet.
const EVENTS: usize = 4;

/// A board to follow, and how to follow it.
pub(crate) struct BoardPlan {
    pub opener: Box<dyn Opener>,
    pub head: Head,
    pub configuration: Configuration,
    pub stream: Stream,
    /// Whether scans are sent as soon as the link carries them, with few in a packet.
    pub sends_soon: bool,
    /// What the board shows of its frames to other instruments.
    pub pulse: Option<Pulse>,
    /// Decides whether a board may be followed.
    pub admit: Admit,
    pub tier: Tier,
    pub following: PipelineOptions,
    /// The frame of its poses; `None`: that of the head.
    pub view: Option<&'static View>,
    /// Duration of the run in device time, seconds; `None`: unlimited.
    pub until_s: Option<f64>,
    /// How long to look for a missing board; `None`: for ever.
    pub patience: Option<Duration>,
    /// Whether device time runs in real time. If not, it waits for the slowest thread.
    pub keeps_time: bool,
}

impl BoardPlan {
    pub(super) fn slot(&self) -> Arc<BoardSlot> {
        let report = Mutex::new(BoardReport { name: self.opener.name(), ..BoardReport::default() });
        Arc::new(BoardSlot { link: Link::new(), report, zero: Mutex::default() })
    }
}

/// State shared by the threads of all boards.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) outboxes: Option<Producer<Outbox>>,
    /// Whether each pose has to be printed.
    pub(super) prints_each: bool,
    pub(super) recorder: Option<TapEnds>,
    pub(super) datagrams: Option<Arc<DatagramServer>>,
    pub(super) live: Option<LiveInput>,
    pub(super) real_time: Option<u8>,
    pub(super) claims: Claims,
}

pub(super) struct BoardThreads {
    name: String,
    reader: JoinHandle<anyhow::Result<()>>,
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
    ) -> anyhow::Result<Self> {
        let name = plan.opener.name();
        let (tell, events) = bounded(EVENTS);
        let keeps_all = shared.prints_each || plan.until_s.is_some();
        let tap = |ends| Tap::new(number, ends, plan.keeps_time);
        let pipeline = Pipeline::new(plan.head.clone(), plan.tier, SceneMatch::Required)
            .until(plan.until_s)
            .following(plan.following)
            .in_frame(plan.view)
            .watched();
        let solver = Solver {
            name: name.clone(),
            pipeline,
            events: tell,
            scan_watch: ScanWatch::new(Duration::from_secs_f64(plan.configuration.schedule.frame_rate_hz().recip())),
            outputs: Outputs {
                statistics: BoardStatistics::new(name.clone(), HostInstant::now()),
                datagrams: shared.datagrams,
                publisher: None,
                printer: shared.outboxes,
                prints_all: keeps_all,
                capture: shared.recorder.map(tap),
                live: shared.live.map(|live| (live, number, Sampler::default())),
                pending: Pending::default(),
            },
            backlog: Backlog::new(keeps_all),
            slot: Arc::clone(slot),
            stop: Arc::clone(stop),
            state: State::default(),
        };
        // A simulated board runs faster if two threads share the work.
        let segments = buffer_pool(SEGMENTS, || Segment::with_capacity(SEGMENT_BYTES));
        let (handoff, solver_end) = handoff(solver, segments, plan.keeps_time);
        let reader = Reader {
            plan,
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
        let priority = shared.real_time;
        let solve = move || {
            if let Some(remedy) = priority.and_then(|priority| claim_priority(priority).err()) {
                say(format_args!("{remedy}"));
            }
            Solver::run(&solver_end)
        };
        let read = move || {
            // The solving thread reports a refusal.
            let _ = priority.map(claim_priority);
            reader.run()
        };
        let solver = spawn(format!("solve {number}"), solve).context(NO_THREAD)?;
        let reader = spawn(format!("read {number}"), read).context(NO_THREAD)?;
        Ok(Self { name, reader, solver, slot: Arc::clone(slot) })
    }

    pub(super) fn is_finished(&self) -> bool {
        self.reader.is_finished() && self.solver.is_finished()
    }

    /// Whether the board was given up: the reader has ended with an error.
    pub(super) fn is_given_up(&self) -> bool {
        self.reader.is_finished() && self.slot.link.is_given_up()
    }

    pub(super) fn end(self) -> (String, Counts, anyhow::Result<()>) {
        let read = join(self.reader);
        let counts = join(self.solver);
        (self.name, counts, read)
    }
}

/// The boards that readers follow, each with the name of its reader.
#[derive(Clone, Debug, Default)]
pub(super) struct Claims(Arc<Mutex<HashMap<DeviceId, String>>>);

impl Claims {
    /// Claims a board for the reader of `name`.
    pub(super) fn claim(&self, device: DeviceId, name: &str) -> anyhow::Result<()> {
        let mut claims = lock(&self.0);
        let other = claims.entry(device).or_insert_with(|| name.to_owned());
        if other != name {
            bail!(
                "{name} and {other} have one number, {device}: give only one of them if they are two ports of one board; two \
                 boards whose poses shall be told apart need different numbers"
            );
        }
        Ok(())
    }

    pub(super) fn release(&self, name: &str) {
        lock(&self.0).retain(|_, owner| owner != name);
    }
}

pub(super) struct BoardSlot {
    pub(super) link: Link,
    report: Mutex<BoardReport>,
    /// A zero that is wanted: over so many seconds, or the frame of the start. Looked at a few times per second.
    pub(super) zero: Mutex<Option<Option<f64>>>,
}

impl BoardSlot {
    /// Updates the state; called a few times per second.
    pub(super) fn account(&self, pipeline: &Pipeline, statistics: &mut BoardStatistics) {
        statistics.report.clock.drift_ppm = pipeline.drift_ppm();
        statistics.report.clock.contradicts_crystal = pipeline.contradicts_crystal();
        let report = statistics.report(&pipeline.counts(), pipeline.health(), HostInstant::now());
        *lock(&self.report) = BoardReport { board_poses: pipeline.agreement(), frame: pipeline.frame(), ..report };
    }

    pub(super) fn report(&self) -> BoardReport {
        let report = lock(&self.report).clone();
        BoardReport { link: self.link.report(), ..report }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_claimed_by_one_reader_until_it_is_released() {
        let claims = Claims::default();
        let [one, other] = [DeviceId(*b"one board   "), DeviceId(*b"another one ")];
        claims.claim(one, "A").unwrap();
        claims.claim(one, "A").unwrap();
        claims.claim(other, "B").unwrap();
        let twice = claims.claim(one, "B").unwrap_err().to_string();
        assert!(twice.contains("B and A") && twice.contains(&one.to_string()), "{twice}");
        claims.release("A");
        claims.claim(one, "B").unwrap();
        assert!(claims.claim(other, "A").is_err());
    }
}

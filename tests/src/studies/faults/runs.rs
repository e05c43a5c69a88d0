//! One fault on one board in one thread.

use slitpose_head::faults::{Faults, Injector, Link};
use slitpose_head::front_end;
use slitpose_head::simulator::{SimulatedBoard, Trajectory};
use slitpose_model::{DegradedReason, Outcome};
use slitpose_protocol::Command;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::health::Fault;
use slitpose_tracking::link::{Asked, Segment};
use slitpose_tracking::pipeline::{Counts, Item, Pipeline, PipelineError, Record, SceneMatch};

use super::{Conditions, Scan, Trace};
use crate::consistency::worst_axis;

/// Time between pings, and between looks at the health of the head, seconds.
const PING_S: f64 = 0.1;
const LOOK_S: f64 = 0.25;

/// A scan that arrives so long after it was taken is late, seconds: a batch spans a millisecond.
const LATE_S: f64 = 0.02;

/// From here on the host knows the board's clock, seconds.
const SETTLED_S: f64 = 1.0;

/// A clock this far from the host's drifts, ppm: crystals err by 50, and a ping tells the time to a quarter of a
/// millisecond.
const DRIFT_PPM: f64 = 200.0;

struct Host {
    board: SimulatedBoard,
    injector: Option<Injector>,
    pipeline: Pipeline,
    segment: Segment,
    number: u16,
    trace: Trace,
    before: Counts,
    now_s: f64,
}

/// Stack of the thread that solves, as in the daemon: scenes are large.
const STACK_BYTES: usize = 8 << 20;

/// What comes of `spec`, or of nothing where that is empty.
pub(super) fn in_memory(conditions: &Conditions, spec: &str) -> Trace {
    std::thread::scope(|scope| {
        let study = std::thread::Builder::new().stack_size(STACK_BYTES);
        let study = study.spawn_scoped(scope, || of_board(conditions, spec)).expect("a thread");
        study.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn of_board(conditions: &Conditions, spec: &str) -> Trace {
    let Conditions { file, tier, seed, spans, .. } = conditions;
    let texts = (!spec.is_empty()).then(|| format!("{spec},seed={seed}"));
    let faults = texts.iter().map(|text| text.parse().unwrap_or_else(|error| panic!("{error}"))).collect();
    let faults = Faults::new(faults, file.scene.cells.len()).unwrap_or_else(|error| panic!("{error}"));
    let configuration = front_end::configuration(file).unwrap_or_else(|error| panic!("{error}"));
    let frame_s = configuration.schedule.frame_rate_hz().recip();
    let mut host = Host {
        board: board(conditions, &faults),
        injector: Injector::of_link(&faults),
        pipeline: Pipeline::new(file.clone(), *tier, SceneMatch::Required).watched(),
        segment: Segment::default(),
        number: 0,
        trace: Trace::default(),
        before: Counts::default(),
        now_s: 0.0,
    };
    host.ask(Command::Configure(configuration));
    host.ask(Command::Start);
    let [mut ping_s, mut look_s] = [0.0, 0.0];
    let frames = (spans.duration_s() / frame_s) as u64;
    for frame in 1..=frames {
        if host.now_s >= ping_s {
            ping_s = host.now_s + PING_S;
            host.ping(frame as u32);
        }
        host.now_s = frame as f64 * frame_s;
        host.step();
        if host.now_s >= look_s {
            look_s = host.now_s + LOOK_S;
            host.look();
        }
    }
    // What the board has collected is sent, full or not.
    host.ask(Command::Stop);
    host.step();
    let Host { mut trace, before, .. } = host;
    trace.counted_lost = before.scans_lost;
    trace
}

fn board(Conditions { file, tier, motion, seed, .. }: &Conditions, faults: &Faults) -> SimulatedBoard {
    let trajectory = Trajectory::of_kind(*motion, *seed, f64::INFINITY).within(&file.workspace);
    let board = SimulatedBoard::new(file, trajectory, *tier, *seed).and_then(|it| it.with_faults(faults, file, *tier));
    board.unwrap_or_else(|error| panic!("{error}"))
}

impl Host {
    fn ask(&mut self, command: Command) {
        self.number += 1;
        self.board.ask(self.number, command);
    }

    fn at(&self) -> HostInstant {
        let ns = 1_000_000_000 + (self.now_s * 1e9) as u64;
        HostInstant { monotonic_ns: ns, utc_ns: ns }
    }

    fn ping(&mut self, token: u32) {
        self.segment.asked.push(Asked { token, at: self.at() });
        self.ask(Command::Ping { token });
    }

    fn step(&mut self) {
        let mut sent = Vec::new();
        self.board.step(&mut sent);
        let bytes = match &mut self.injector {
            Some(injector) => {
                let mut bytes = Vec::new();
                assert_eq!(injector.push(&sent, &mut bytes), Link::Open, "this fault is for a daemon");
                bytes
            }
            None => sent,
        };
        self.segment.push(&bytes, Some(self.at()));
        let Self { pipeline, segment, trace, now_s, .. } = self;
        let fed = pipeline.feed(segment, |item| {
            hear(trace, *now_s, &item);
            Ok::<_, PipelineError>(())
        });
        fed.unwrap_or_else(|error| panic!("{error}"));
        self.segment.clear();
        self.count();
    }

    /// What the counters say since the last look.
    fn count(&mut self) {
        let (now, before) = (self.pipeline.counts(), self.before);
        for (has_grown, sign) in [
            (now.scans_lost > before.scans_lost, "gap"),
            (now.scans_repeated > before.scans_repeated, "repeat"),
            (now.restarts > before.restarts, "restart"),
            (now.decoder.bytes_skipped > before.decoder.bytes_skipped, "damage"),
            (now.batches_without_hello > before.batches_without_hello, "damage"),
        ] {
            if has_grown {
                self.trace.signs.push((self.now_s, sign.to_owned()));
            }
        }
        self.before = now;
    }

    /// What the health of the head and the clock of the board say.
    fn look(&mut self) {
        for finding in self.pipeline.health().into_iter().flat_map(|health| health.findings) {
            let fault = match finding.fault {
                Fault::Cell { verdict, .. } => format!("{verdict:?}"),
                other => format!("{other:?}").split(|c: char| !c.is_alphabetic()).take(1).collect(),
            };
            self.trace.signs.push((self.now_s, format!("health:{}", fault.to_lowercase())));
        }
        if self.pipeline.drift_ppm().is_some_and(|ppm| ppm.abs() > DRIFT_PPM) {
            self.trace.signs.push((self.now_s, "drift".to_owned()));
        }
    }
}

fn hear(trace: &mut Trace, now_s: f64, item: &Item<'_>) {
    let mut sign = |has_come: bool, sign: &str| {
        if has_come {
            trace.signs.push((now_s, sign.to_owned()));
        }
    };
    match item {
        Item::Pose(record) => {
            let status = status_of(&record.solution.outcome);
            sign(status.is_some(), status.unwrap_or_default());
            sign(is_late(record), "late");
            // From the first pings on there are times.
            sign(record.host_time.is_none() && now_s > SETTLED_S, "untimed");
            trace.taken = trace.taken.max(record.sequence + 1);
            trace.scans.push(Scan {
                sequence: record.sequence,
                time_s: now_s,
                unnoticed_sigmas: record.solution.unnoticed_sigmas,
                sigmas: sigmas(record),
                is_flagged: status.is_some(),
            });
        }
        Item::Oddity { .. } => sign(true, "clock"),
        Item::Event { text, .. } => sign(!text.starts_with("injected fault"), "event"),
        _ => {}
    }
}

fn is_late(record: &Record) -> bool {
    let (Some(arrival), Some(host_time)) = (record.arrival, record.host_time) else { return false };
    arrival.monotonic_ns.saturating_sub(host_time.monotonic_ns) as f64 * 1e-9 > LATE_S
}

/// The error of a pose in σ of its worst axis; `None` without one.
fn sigmas(record: &Record) -> Option<f64> {
    Some(worst_axis(&record.solution.estimate?, &record.truth?))
}

/// The word for an outcome that is not sound.
fn status_of(outcome: &Outcome) -> Option<&'static str> {
    match outcome {
        Outcome::Converged => None,
        Outcome::Degraded(DegradedReason::FewerCells) => Some("fewer_cells"),
        Outcome::Degraded(reason) => Some(reason.as_str()),
        other => Some(other.as_str()),
    }
}

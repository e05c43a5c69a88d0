//! Publishes boards.

use std::time::{Duration, Instant};

use ::zenoh::liveliness::LivelinessToken;
use ::zenoh::qos::CongestionControl;
use ::zenoh::{Session, Wait, pubsub};
use slitpose_head::finding::{Finding, Grade};

use super::{Attachment, Node, Router, Type, gid, topic_key};
use crate::daemon::{ChunkSink, TapChunk};
use crate::live::LiveBoard;
use crate::terminal::say;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;
use slitpose_tracking::ros::{self, cdr::Encoder};
use slitpose_tracking::telemetry::DaemonReport;

/// Time between copies of what late subscribers need, too: heads, health.
const REPEAT_EVERY: Duration = Duration::from_secs(1);

pub(super) struct Publisher {
    router: Router,
    daemon: Option<DaemonTopics>,
    boards: Vec<Shown>,
    report: Box<dyn Fn() -> DaemonReport + Send>,
    repeat_at: Instant,
    is_told: bool,
    message: Vec<u8>,
}

/// The node, and the topics of all boards in common, as ROS 2 expects them.
struct DaemonTopics {
    session: Session,
    node: Node,
    _token: LivelinessToken,
    transforms: Topic,
    health: Topic,
}

struct Shown {
    board: LiveBoard,
    device: Option<DeviceId>,
    topics: Option<BoardTopics>,
}

/// The topics of a board that has introduced itself.
struct BoardTopics {
    device: DeviceId,
    tool: String,
    pose: Topic,
    twist: Topic,
    head: Topic,
    shapes: Vec<u8>,
}

/// A publisher, as ROS 2 sees it.
struct Topic {
    publisher: pubsub::Publisher<'static>,
    _token: LivelinessToken,
    gid: [u8; 16],
    sequence: i64,
}

impl Topic {
    fn new(session: &Session, node: &mut Node, topic: &str, of: Type) -> Result<Self, ::zenoh::Error> {
        let token = node.publisher_token(topic, of);
        let publisher = session
            .declare_publisher(topic_key(node.domain, topic, of))
            // A subscriber that is too slow misses messages, which their numbers show; nothing waits for it.
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        let gid = gid(&token);
        Ok(Self { publisher, _token: session.liveliness().declare_token(token).wait()?, gid, sequence: 0 })
    }

    fn put(&mut self, message: &[u8]) {
        self.sequence += 1;
        // Until the year 2262.
        let stamp_ns = HostInstant::now().utc_ns as i64;
        let attachment = Attachment { sequence: self.sequence, stamp_ns, gid: self.gid };
        // It fails at the end of the session only.
        let _ = self.publisher.put(message).attachment(&attachment.encode()[..]).wait();
    }
}

impl DaemonTopics {
    fn new(session: Session, domain: u8) -> Result<Self, ::zenoh::Error> {
        let mut node = Node::new(domain, session.zid().to_string());
        Ok(Self {
            _token: session.liveliness().declare_token(node.token()).wait()?,
            transforms: Topic::new(&session, &mut node, "/tf", Type::TRANSFORMS)?,
            health: Topic::new(&session, &mut node, "/diagnostics", Type::DIAGNOSTICS)?,
            node,
            session,
        })
    }
}

impl Publisher {
    pub(super) fn new(router: Router, boards: Vec<LiveBoard>, report: Box<dyn Fn() -> DaemonReport + Send>) -> Self {
        let shown = |board| Shown { board, device: None, topics: None };
        let mut this = Self {
            router,
            daemon: None,
            boards: boards.into_iter().map(shown).collect(),
            report,
            repeat_at: Instant::now(),
            is_told: false,
            message: Vec::new(),
        };
        this.connect();
        this
    }

    /// Begins to publish if the router is there by now.
    fn connect(&mut self) {
        match self.router.session() {
            // Declarations fail at the end of the session only.
            Ok(session) => self.daemon = DaemonTopics::new(session, self.router.domain).ok(),
            Err(error) if !self.is_told => {
                say(format_args!("{error}; looking for it"));
                self.is_told = true;
            }
            Err(_) => {}
        }
    }

    fn health(&mut self) {
        let Some(daemon) = &mut self.daemon else { return };
        let findings = (self.report)().findings(HostInstant::now());
        let devices = self.boards.iter().filter_map(|shown| Some(shown.device?.to_string()));
        encode_health(&findings, &devices.collect::<Vec<_>>().join(", "), &mut self.message);
        daemon.health.put(&self.message);
    }
}

impl ChunkSink for Publisher {
    fn chunk(&mut self, chunk: &TapChunk) {
        let Self { daemon, boards, message, .. } = self;
        let (Some(device), Some(shown)) = (chunk.device, boards.get_mut(chunk.board)) else { return };
        shown.device = Some(device);
        let Some(daemon) = daemon else { return };
        // Another board may take the place of one that was unplugged.
        if shown.topics.as_ref().is_none_or(|topics| topics.device != device) {
            shown.topics = BoardTopics::new(daemon, device, chunk.board == 0, &shown.board).ok();
        }
        let Some(topics) = &mut shown.topics else { return };
        for record in &chunk.poses {
            topics.pose(record, &mut daemon.transforms, message);
        }
    }

    fn tick(&mut self) {
        if Instant::now() < self.repeat_at {
            return;
        }
        if self.daemon.is_none() {
            self.connect();
        }
        // Without a router that took long, and chunks wait: they are all taken before it is sought again.
        self.repeat_at = Instant::now() + REPEAT_EVERY;
        for topics in self.boards.iter_mut().filter_map(|shown| shown.topics.as_mut()) {
            topics.head.put(&topics.shapes);
        }
        self.health();
    }
}

impl BoardTopics {
    fn new(
        DaemonTopics { session, node, .. }: &mut DaemonTopics,
        device: DeviceId,
        is_first: bool,
        board: &LiveBoard,
    ) -> Result<Self, ::zenoh::Error> {
        let mut topic = |name: &str, of| Topic::new(session, node, &ros::topic(device, name), of);
        let tool = ros::tool_frame(device, is_first);
        let mut shapes = Vec::new();
        ros::encode_head(&board.head.file.scene.cells, &tool, &mut shapes);
        Ok(Self {
            device,
            tool,
            pose: topic("pose", Type::POSE)?,
            twist: topic("twist", Type::TWIST)?,
            head: topic("head", Type::MARKERS)?,
            shapes,
        })
    }

    fn pose(&mut self, record: &Record, transforms: &mut Topic, message: &mut Vec<u8>) {
        let stamp_ns = ros::stamp_ns(record);
        if let Some(estimate) = &record.solution.estimate {
            ros::encode_pose(stamp_ns, ros::frame(record), estimate, message);
            self.pose.put(message);
            ros::encode_transform(stamp_ns, &self.tool, &estimate.pose, record.view, message);
            transforms.put(message);
        }
        if let Ok(twist) = &record.twist {
            ros::encode_twist(stamp_ns, ros::frame(record), twist, message);
            self.twist.put(message);
        }
    }
}

const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;

/// `diagnostic_msgs/msg/DiagnosticArray` with one status: of the daemon and all its boards.
fn encode_health(findings: &[Finding], devices: &str, bytes: &mut Vec<u8>) {
    let level = match findings.iter().map(|finding| finding.grade).max_by_key(|grade| *grade as u8) {
        Some(Grade::Failed) => ERROR,
        Some(Grade::Warning | Grade::Skipped) => WARN,
        Some(Grade::Ok) | None => OK,
    };
    let mut encoder = Encoder::new(bytes);
    ros::encode_header(&mut encoder, HostInstant::now().utc_ns, "");
    encoder.length(1);
    encoder.u8(level);
    encoder.text("slitpose");
    encoder.text(findings.first().map_or("ok", |finding| &finding.text));
    encoder.text(devices);
    encoder.length(findings.len());
    for finding in findings {
        encoder.text(&finding.place);
        match &finding.next_step {
            Some(next_step) => encoder.text(&format!("{}; {next_step}", finding.text)),
            None => encoder.text(&finding.text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_do_not_wait_for_a_router_that_is_not_there() {
        let router = Router::at("tcp/127.0.0.1:9").unwrap();
        let report = || -> DaemonReport { unreachable!("without a router nothing is published") };
        let mut publisher = Publisher::new(router, Vec::new(), Box::new(report));
        publisher.tick();
        let begun = Instant::now();
        publisher.tick();
        assert!(begun.elapsed() < REPEAT_EVERY / 2);
    }
}

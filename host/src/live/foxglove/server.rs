//! The server, by Foxglove's own library.

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use ::foxglove::{Context, FoxgloveError as SdkError, RawChannel, Schema};
use slitpose_calibration::Head;
use tokio::runtime::Builder;
use tokio::sync::mpsc::Receiver;
use tokio::sync::oneshot;
use tokio::time::{MissedTickBehavior, interval};

use super::{FoxgloveAddress, FoxgloveError};
use crate::live::frame::{Optics, Sample};
use crate::live::hub::{Input, LiveBoard, LiveInput};
use crate::telemetry::DaemonReport;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::ros::{self, MARKERS, POSE, RosType, TRANSFORMS, TWIST};

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

struct Shown {
    context: Arc<Context>,
    boards: Vec<Option<Board>>,
    report: Arc<RawChannel>,
}

impl FoxgloveServer {
    /// Serves Foxglove. `report`: the state of the daemon.
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

    pub(crate) fn url(&self) -> &str {
        &self.url
    }

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

pub(super) struct Board {
    number: usize,
    head: Head,
    optics: Option<Optics>,
    channels: Option<Channels>,
    frames: u64,
    message: Vec<u8>,
}

/// Topics and types are those of captures; only frames are JSON, as the live page has them.
struct Channels {
    device: DeviceId,
    tool: String,
    pose: Arc<RawChannel>,
    transforms: Arc<RawChannel>,
    twist: Arc<RawChannel>,
    head: Arc<RawChannel>,
    frame: Arc<RawChannel>,
    shapes: Vec<u8>,
}

impl Board {
    pub(super) fn new(number: usize, head: Head) -> Self {
        // Without optics there are no frames; poses are shown all the same.
        let optics = Optics::of(&head).ok();
        Self { number, head, optics, channels: None, frames: 0, message: Vec::new() }
    }

    pub(super) fn show(&mut self, sample: &Sample, context: &Arc<Context>) -> Result<(), SdkError> {
        let record = &sample.record;
        // Another board may take the place of one that was unplugged.
        if self.channels.as_ref().is_none_or(|channels| channels.device != record.device) {
            self.channels = Some(Channels::new(self.number, record.device, &self.head, context)?);
            self.show_head();
        }
        let Some(channels) = &self.channels else { return Ok(()) };
        let (stamp_ns, message) = (ros::stamp_ns(record), &mut self.message);
        if let Some(estimate) = &record.solution.estimate {
            ros::encode_pose(stamp_ns, estimate, message);
            channels.pose.log(message);
            ros::encode_transform(stamp_ns, &channels.tool, &estimate.pose, message);
            channels.transforms.log(message);
        }
        if let Some(twist) = &record.twist {
            ros::encode_twist(stamp_ns, twist, message);
            channels.twist.log(message);
        }
        if let Some(optics) = self.optics.as_ref().filter(|_| channels.frame.has_sinks()) {
            message.clear();
            // Numbers and texts can always be written.
            if serde_json::to_writer(&mut *message, &optics.frame(self.number, self.frames, sample)).is_ok() {
                channels.frame.log(message);
            }
        }
        self.frames += 1;
        Ok(())
    }

    pub(super) fn show_head(&self) {
        if let Some(channels) = &self.channels {
            channels.head.log(&channels.shapes);
        }
    }
}

impl Channels {
    fn new(number: usize, device: DeviceId, head: &Head, context: &Arc<Context>) -> Result<Self, SdkError> {
        let ros_channel = |of: RosType, topic: &str| {
            let schema = Schema::new(of.name, "ros2msg", of.definition.as_bytes());
            context.channel_builder(topic).message_encoding("cdr").schema(schema).build_raw()
        };
        let topic = |name: &str| ros::topic(device, name);
        let tool = ros::tool_frame(device, number == 0);
        let mut shapes = Vec::new();
        ros::encode_head(&head.file.scene.cells, &tool, &mut shapes);
        Ok(Self {
            device,
            tool,
            pose: ros_channel(POSE, &topic("pose"))?,
            // The same channel for all boards: one of this topic and schema is there once.
            transforms: ros_channel(TRANSFORMS, "/tf")?,
            twist: ros_channel(TWIST, &topic("twist"))?,
            head: ros_channel(MARKERS, &topic("head"))?,
            frame: context.channel_builder(topic("frame")).message_encoding("json").build_raw()?,
            shapes,
        })
    }
}

//! Foxglove shows boards live, by its own library.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use ::foxglove::{Context, FoxgloveError as SdkError, RawChannel, Schema, WebSocketServerHandle};
use slitpose_calibration::Head;
use tokio::sync::mpsc::Receiver;
use tokio::time::{MissedTickBehavior, interval};

use crate::address::{Address, ServeError};
use crate::http::Serving;
use crate::live::{Input, LiveBoard, LiveInput};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::page::{Optics, Sample};
use slitpose_tracking::ros::{self, MARKERS, POSE, RosType, TRANSFORMS, TWIST};
use slitpose_tracking::telemetry::DaemonReport;

/// Time between reports, and between copies of heads: the protocol keeps no message for those who come later.
const REPORT_EVERY: Duration = Duration::from_millis(500);

/// Messages kept for a client, half a second of a board; one that is further behind misses the oldest.
const BACKLOG: usize = 128;

struct Shown {
    context: Arc<Context>,
    boards: Vec<Board>,
    report: Arc<RawChannel>,
}

/// Serves `boards` at `address` until the last of what is returned is dropped: its URL, where samples go, and the server.
/// `report`: the state of the daemon.
pub(crate) fn serve_foxglove(
    address: SocketAddr,
    boards: Vec<LiveBoard>,
    report: impl Fn() -> DaemonReport + Send + 'static,
) -> anyhow::Result<(String, LiveInput, Serving)> {
    let place = Address::Tcp(address);
    let failed = |error| match error {
        SdkError::Bind(source) => ServeError::of(&place, source),
        error => ServeError::of(&place, std::io::Error::other(error)),
    };
    let (input, inputs) = LiveInput::new();
    let (serving, url) = Serving::start("foxglove", &place, async || {
        let context = Context::new();
        let server = serve(&context, address).await.map_err(failed)?;
        let address = SocketAddr::new(address.ip(), server.port());
        let channel = context.channel_builder("/slitpose/report").message_encoding("json");
        let mut shown = Shown { report: channel.build_raw().map_err(failed)?, context, boards: Vec::new() };
        shown.accept(Input::Boards(boards));
        tokio::spawn(shown.follow(inputs, report, server, address));
        Ok(format!("ws://{address}"))
    })?;
    Ok((url, input, serving))
}

async fn serve(context: &Arc<Context>, address: SocketAddr) -> Result<WebSocketServerHandle, SdkError> {
    let server = context.websocket_server().name("slitpose").message_backlog_size(BACKLOG);
    let server = server.bind(address.ip().to_string(), address.port());
    server.tokio_runtime(&tokio::runtime::Handle::current()).start().await
}

/// Whether nobody listens at `address`: the library's server ends for good when it cannot accept a connection, as when
/// others have taken all file descriptors.
fn is_deaf(address: SocketAddr) -> bool {
    TcpListener::bind(address).map_or_else(|error| error.kind() != ErrorKind::AddrInUse, |_| true)
}

impl Shown {
    /// Until nobody gives samples any more.
    async fn follow(
        mut self,
        mut inputs: Receiver<Input>,
        report: impl Fn() -> DaemonReport,
        server: WebSocketServerHandle,
        address: SocketAddr,
    ) {
        let mut server = Some(server);
        let mut ticks = interval(REPORT_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = ticks.tick() => {
                    self.boards.iter().for_each(Board::show_head);
                    self.report(&report());
                    if is_deaf(address) {
                        // Also closes what was connected, and may be in the way.
                        drop(server.take().map(WebSocketServerHandle::stop));
                        server = serve(&self.context, address).await.ok();
                    }
                }
                input = inputs.recv() => match input {
                    Some(input) => self.accept(input),
                    None => break,
                },
            }
        }
        drop(server.map(WebSocketServerHandle::stop));
    }

    fn accept(&mut self, input: Input) {
        match input {
            Input::Sample(number, sample) => {
                if let Some(board) = self.boards.get_mut(number) {
                    // Channels of a topic and a schema, as all these are, can always be made.
                    let _ = board.show(&sample, &self.context);
                }
            }
            Input::Boards(boards) => {
                let boards = boards.into_iter().enumerate();
                self.boards = boards.map(|(number, board)| Board::new(number, board.head)).collect();
            }
            Input::Report(report) => self.report(&report),
            // Captures are played for the live page only.
            Input::Player(_) | Input::Failed(_) => {}
        }
    }

    fn report(&self, report: &DaemonReport) {
        // Numbers and texts can always be written.
        if let Ok(text) = serde_json::to_vec(report) {
            self.report.log(&text);
        }
    }
}

struct Board {
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
    fn new(number: usize, head: Head) -> Self {
        // Without optics there are no frames; poses are shown all the same.
        let optics = Optics::of(&head).ok();
        Self { number, head, optics, channels: None, frames: 0, message: Vec::new() }
    }

    fn show(&mut self, sample: &Sample, context: &Arc<Context>) -> Result<(), SdkError> {
        let record = &sample.record;
        // Another board may take the place of one that was unplugged.
        if self.channels.as_ref().is_none_or(|channels| channels.device != record.device) {
            self.channels = Some(Channels::new(self.number, record.device, &self.head, context)?);
            self.show_head();
        }
        let Some(channels) = &self.channels else { return Ok(()) };
        let (stamp_ns, message) = (ros::stamp_ns(record), &mut self.message);
        if let Some(estimate) = &record.solution.estimate {
            ros::encode_pose(stamp_ns, ros::frame(record), estimate, message);
            channels.pose.log(message);
            ros::encode_transform(stamp_ns, &channels.tool, &estimate.pose, record.view, message);
            channels.transforms.log(message);
        }
        if let Ok(twist) = &record.twist {
            ros::encode_twist(stamp_ns, ros::frame(record), twist, message);
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

    fn show_head(&self) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_has_ended_is_noticed() {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = listener.local_addr().unwrap();
        assert!(!is_deaf(address));
        drop(listener);
        assert!(is_deaf(address));
    }
}

//! The channels of a board.

use std::sync::Arc;

use ::foxglove::{Context, FoxgloveError, RawChannel, Schema};
use slitpose_calibration::Head;

use crate::link::DeviceId;
use crate::live::frame::Optics;
use crate::live::sampler::Sample;
use crate::ros::{self, MARKERS, POSE, RosType, TRANSFORMS, TWIST};

/// A board that is shown.
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

    /// Shows a sample.
    pub(super) fn show(&mut self, sample: &Sample, context: &Arc<Context>) -> Result<(), FoxgloveError> {
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

    /// Shows the head.
    pub(super) fn show_head(&self) {
        if let Some(channels) = &self.channels {
            channels.head.log(&channels.shapes);
        }
    }
}

impl Channels {
    fn new(number: usize, device: DeviceId, head: &Head, context: &Arc<Context>) -> Result<Self, FoxgloveError> {
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

//! From the image to scans with their instants: what tests and figures of the whole board share.

#![allow(dead_code, reason = "each program uses its part")]

use slitpose_emulator::faults::Faults;
use slitpose_emulator::image::Image;
use slitpose_emulator::peripherals::Ticks;
use slitpose_emulator::rig::{Rig, open_image};
use slitpose_emulator::world::NoiseSource;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::Trajectory;
use slitpose_protocol::poses::TRIANGLE;
use slitpose_protocol::{AdcScaling, Decoder, MAX_MESSAGE_BYTES, Message, PoseRecord, RawScan, Schedule, Status};

/// A board with somebody at its open port, and what it has said.
#[derive(Debug)]
pub struct Chain {
    /// The board and what is around it.
    pub rig: Rig,
    /// Tick of power at which the board's clock was zero.
    pub origin: Ticks,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    /// By the last hello.
    pub schedule: Option<Schedule>,
    /// By the last hello.
    pub scaling: Option<AdcScaling>,
    /// Scans, each with the tick of power at which its packet was over.
    pub scans: Vec<(Ticks, RawScan)>,
    /// Poses of the board with sequence and tick of their scans, each with the tick of power at which its packet was over.
    pub poses: Vec<(Ticks, (u64, u64, PoseRecord))>,
    /// Covariances, each with the index of its pose.
    pub covariances: Vec<(usize, [f32; TRIANGLE])>,
    pub events: Vec<String>,
    /// Scans that the board has not solved, by the last packet of poses.
    pub missed: u32,
    /// All that has come, each with the tick of power at which it was over.
    pub packets: Vec<(Ticks, Vec<u8>)>,
    /// Packets that could not be read.
    pub damaged: usize,
    pub status: Option<Status>,
    /// Whether each command was accepted, in the order of the replies.
    pub replies: Vec<bool>,
}

impl Chain {
    /// Powers a board with the image of `firmware/build`, waits for its host, opens the port, and
    /// waits for the hello.
    pub fn open(scene: &SceneFile, trajectory: Trajectory, noise: NoiseSource, faults: Faults) -> Self {
        let image = open_image(None).expect("an image");
        Self::open_with(&image, scene, trajectory, noise, faults)
    }

    pub fn open_with(
        image: &Image,
        scene: &SceneFile,
        trajectory: Trajectory,
        noise: NoiseSource,
        faults: Faults,
    ) -> Self {
        let mut rig = Rig::boot(image, scene, trajectory, noise, faults).expect("a head for the board");
        let origin = rig.machine().device_clock_origin().expect("the program starts its clock");
        rig.set_open(true);
        let mut chain = Self {
            rig,
            origin,
            decoder: Decoder::new(),
            schedule: None,
            scaling: None,
            scans: Vec::new(),
            poses: Vec::new(),
            missed: 0,
            covariances: Vec::new(),
            events: Vec::new(),
            packets: Vec::new(),
            damaged: 0,
            status: None,
            replies: Vec::new(),
        };
        while chain.schedule.is_none() {
            assert!(chain.rig.now() < origin + 170_000_000, "no hello within a second");
            chain.run_for(1e-3);
        }
        chain
    }

    /// Lets device time pass and takes what comes meanwhile.
    pub fn run_for(&mut self, seconds: f64) {
        let stop = self.rig.run_for(seconds);
        assert_eq!(stop, slitpose_emulator::machine::Stop::Reached);
        for (at, bytes) in self.rig.take_packets() {
            let mut rest = &bytes[..];
            while let Some(message) = self.decoder.next::<Message<'_>>(&mut rest) {
                let Ok(message) = message else {
                    self.damaged += 1;
                    continue;
                };
                match message {
                    Message::Hello(hello) => {
                        self.scaling = Some(hello.scaling);
                        self.schedule = Some(hello.schedule);
                    }
                    Message::Batch(batch) => {
                        let schedule = self.schedule.as_ref().expect("a hello comes first");
                        let scans = batch.scans(schedule).expect("a batch of this schedule");
                        self.scans.extend(scans.map(|scan| (at, scan)));
                    }
                    Message::Status(status) => self.status = Some(status),
                    Message::Reply(reply) => self.replies.push(reply.outcome.is_ok()),
                    Message::Poses(poses) => {
                        let frame_ticks = self.schedule.as_ref().expect("a hello comes first").frame_ticks;
                        self.missed = poses.missed;
                        self.poses.extend(poses.iter(frame_ticks).map(|pose| (at, pose)));
                        let last = self.poses.len() - 1;
                        self.covariances.extend(poses.covariance.map(|covariance| (last, covariance)));
                    }
                    Message::Event(event) => self.events.push(event.text.to_owned()),
                    Message::Pong(_) | Message::Truth(_) => {}
                }
            }
            self.packets.push((at, bytes));
        }
    }
}

//! The `slitpose` command: boards live, captures, control loops, status. [`slitpose_tracking`] turns bytes into poses,
//! [`slitpose_head`] describes heads, [`slitpose_design`] serves their designers.
//!
//! Public for tests and fuzz targets, not for other programs:
//!
//! * [`commands`] has one file or folder for each verb;
//! * [`device`] finds boards, and exchanges bytes and commands with them;
//! * [`datagram`] sends the newest pose to control loops;
//! * [`telemetry`] counts, and reports the state of daemon, boards and heads;
//! * [`http`] decides whose requests are answered, and guards the servers;
//! * [`platform`] has what differs between operating systems.
//!
//! Behind the commands: `terminal` draws for the user, `comparison` compares poses with a reference, `sink` writes poses,
//! `daemon` follows boards live, `live` shows them on a page, `doctor` examines boards, heads and hosts.

#![forbid(unsafe_code)]

mod address;
mod background;
pub mod commands;
mod comparison;
mod daemon;
#[doc(hidden)]
pub mod datagram;
#[doc(hidden)]
pub mod device;
mod doctor;
#[doc(hidden)]
pub mod http;
mod live;
#[doc(hidden)]
pub mod platform;
mod sink;
#[doc(hidden)]
pub mod telemetry;
mod terminal;

/// Poses and messages for the tests of several modules.
#[cfg(test)]
mod samples {
    use slitpose_head::scene_file::WIDE;
    use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
    use slitpose_model::{Cells, NoTwist, Outcome, Photocurrents, Solution, Tier};
    use slitpose_protocol::{ClockSource, Command, SettingsSource, Status};
    use slitpose_tracking::link::DeviceId;
    use slitpose_tracking::pipeline::{Item, Pipeline, PipelineError, Record, SceneMatch};

    const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

    pub(crate) fn record() -> Record {
        Record {
            device: DeviceId(*b"simulated\0\0\0"),
            sequence: 0,
            device_time_s: 0.0,
            host_time: None,
            arrival: None,
            solution: Solution::reported(Outcome::Diverged, None, f64::NAN, Cells::default(), Cells::default()),
            twist: Err(NoTwist::NoPose),
            filtered: None,
            light_level: None,
            simulated: true,
            truth: None,
            view: None,
        }
    }

    /// The status of a board that has lost nothing.
    pub(crate) fn status() -> Status {
        Status {
            tick: 1,
            acquiring: true,
            scans_taken: 0,
            scans_dropped: 0,
            batches_dropped: 0,
            scans_lost: 0,
            adc_overruns: 0,
            replies_dropped: 0,
            commands_damaged: 0,
            commands_rejected: 0,
            supply_v: 3.3,
            temperature_k: 300.0,
            cpu_load_permille: 0,
            clock: ClockSource::Crystal,
            settings: SettingsSource::Stored,
        }
    }

    /// `count` poses of a simulated tool, each with its photocurrents: of the newest scans in packets.
    pub(crate) fn poses(count: usize) -> Vec<(Record, Photocurrents)> {
        let head = WIDE.read().unwrap();
        let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, 1, f64::INFINITY);
        let mut board = SimulatedBoard::new(&head, smooth, TIER, 1).unwrap();
        board.ask(1, Command::Start);
        let mut pipeline = Pipeline::new(head, TIER, SceneMatch::Required);
        let mut poses: Vec<(Record, Photocurrents)> = Vec::new();
        let mut bytes = Vec::new();
        while poses.len() < count {
            bytes.clear();
            // A board whose host is silent stops.
            board.ask(1, Command::Ping { token: 0 });
            board.step(&mut bytes);
            let mut newest = None;
            let found = pipeline.push(&bytes, |item| {
                if let Item::Pose(record) = item {
                    newest = Some(*record);
                }
                Ok::<_, PipelineError>(())
            });
            found.unwrap();
            poses.extend(newest.map(|record| (record, pipeline.last_photocurrents().unwrap().clone())));
        }
        poses
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn documents_ask_for_the_rust_that_is_declared() {
        let declared = env!("CARGO_PKG_RUST_VERSION");
        for (name, text) in
            [("README.md", include_str!("../../README.md")), ("INSTALL.md", include_str!("../INSTALL.md"))]
        {
            assert!(text.contains(&format!("Rust {declared} or newer")), "{name} does not ask for Rust {declared}");
        }
    }
}

//! Live tracking with a slit-and-detector head, and the `slitpose` command. [`slitpose_head`] describes
//! heads, [`slitpose_design`] serves their designers, [`slitpose_model`] has the optics and the solver.
//!
//! For other programs:
//!
//! * [`clock`] reads the clocks of the host;
//! * [`link`] holds the bytes that a link has delivered, and identifies boards;
//! * [`device`] finds boards, and exchanges bytes and commands with them;
//! * [`health`] monitors the cells of a head;
//! * [`pipeline`] turns bytes into poses;
//! * [`playback`] takes captures through it again, [`solving`] has the choices in common;
//! * [`measurements`] reads what calibrations rest on;
//! * [`datagram`] sends the newest pose to control loops;
//! * [`inputs`] reads what strangers can send, for fuzzing;
//! * [`telemetry`] counts, and reports the state of daemon, boards and heads;
//! * [`commands`] has one file for each verb of the `slitpose` command.
//!
//! Behind the commands: `terminal` draws for the user, `comparison` compares poses with a reference, `capture` writes
//! and reads captures, `sink` writes poses, `ros` has poses and heads as messages, `daemon` follows boards live, `live`
//! shows them on a page and to Foxglove, `spacenav` makes a mouse of the tool, `http` guards the servers,
//! `zenoh` takes boards to ROS 2 and to other machines,
//! `service` notifies the service manager, `doctor` examines boards, heads and hosts.
//!
//! Internally all units are SI. Millimetres and degrees appear in scene files, on the command line
//! and in pictures, with the unit in the name.
//!
//! # Example
//! The bytes of a simulated board, solved as `replay` solves a capture:
//! ```
//! use slitpose::pipeline::{Item, Pipeline, PipelineError, SceneMatch};
//! use slitpose_head::scene_file::WIDE;
//! use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
//! use slitpose_model::Tier;
//! use slitpose_protocol::{Command, MAX_REQUEST_BYTES, Request, encode};
//!
//! let (head, tier) = (WIDE.read()?, Tier::Exact { tolerance: 1e-6 });
//! let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, 1, f64::INFINITY);
//! let mut board = SimulatedBoard::new(&head, smooth, tier, 1)?;
//! board.write(encode(&Request { number: 1, command: Command::Start }, &mut [0; MAX_REQUEST_BYTES])?);
//! let mut bytes = Vec::new();
//! (0..400).for_each(|_| board.step(&mut bytes)); // 0.1 s at 4 kHz
//!
//! let mut errors_m = Vec::new();
//! Pipeline::new(head, tier, SceneMatch::Required).push(&bytes, |item| {
//!     if let Item::Pose(record) = item {
//!         let (found, truth) = (record.solution.estimate.expect("a pose").pose, record.truth.expect("simulated"));
//!         errors_m.push(found.translation_m.distance(truth.translation_m));
//!     }
//!     Ok::<_, PipelineError>(())
//! })?;
//! assert_eq!(errors_m.len(), 400);
//! assert!(errors_m.iter().all(|&error_m| error_m < 20e-6));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod capture;
pub mod clock;
pub mod commands;
mod comparison;
mod daemon;
pub mod datagram;
pub mod device;
mod doctor;
pub mod health;
mod http;
pub mod inputs;
pub mod link;
mod live;
pub mod measurements;
pub mod pipeline;
pub mod playback;
mod ros;
mod service;
mod sink;
pub mod solving;
mod spacenav;
pub mod telemetry;
mod terminal;
mod zenoh;

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
        let peers = include_str!("../../tests/peers/Cargo.toml");
        assert!(peers.contains(&format!("rust-version = \"{declared}\"")), "tests/peers asks for another");
    }
}

//! From the bytes of boards and captures to poses with covariance, without threads, servers, ports or a command line.
//!
//! * [`link`] holds bytes that a link has delivered, and identifies boards;
//! * [`clock`] relates a board's clock to those of the host;
//! * [`pipeline`] turns bytes into poses; [`solving`] has what can be chosen about it;
//! * [`frame`] puts poses into a frame of the user, and at the tip of the tool;
//! * [`health`] monitors the cells of a head;
//! * [`capture`] writes and reads recordings, [`playback`] takes them through the pipeline again;
//! * [`columns`] lists the quantities of a scan, for all outputs;
//! * [`telemetry`] counts what boards send, and reports it; [`page`] has the messages of the live page;
//! * [`ros`] has poses and heads as messages;
//! * [`measurements`] reads what calibrations rest on, [`tip`] finds the tip of a tool in them.
//!
//! All units are SI.
//!
//! # Example
//! The bytes of a simulated board, solved as `replay` solves a capture:
//! ```
//! use slitpose_tracking::pipeline::{Item, Pipeline, PipelineError, SceneMatch};
//! use slitpose_head::scene_file::WIDE;
//! use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
//! use slitpose_model::Tier;
//! use slitpose_protocol::Command;
//!
//! let (head, tier) = (WIDE.read()?, Tier::Exact { tolerance: 1e-6 });
//! let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, 1, f64::INFINITY);
//! let mut board = SimulatedBoard::new(&head, smooth, tier, 1)?;
//! board.ask(1, Command::Start);
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

pub mod capture;
pub mod clock;
pub mod columns;
pub mod frame;
pub mod health;
pub mod link;
pub mod measurements;
pub mod page;
pub mod pipeline;
pub mod playback;
pub mod ros;
pub mod solving;
pub mod telemetry;
pub mod tip;

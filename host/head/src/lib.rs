//! Sensor heads, and their simulation.
//!
//! * [`scene_file`] reads descriptions of heads;
//! * [`front_end`] converts counts to currents;
//! * [`simulator`] is a simulated board;
//! * [`table`] reads and writes CSV, and writes results;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`faults`] injects faults into boards, heads and links;
//! * [`finding`] states a fault and its remedy;
//! * [`foreign`] escapes text of others for a terminal;
//! * [`text_file`] opens texts, [`special_file`] pipes and devices for writing, [`replacement`] makes files that replace others when complete;
//! * [`interrupt`] handles Ctrl-C, [`threads`] panics of other threads, and work on all cores.
//!
//! Internally all units are SI. Millimetres and degrees appear in scene files, with the unit in the name.
//!
//! # Example
//! The currents measured by a simulated board with a shipped head, tool at home:
//! ```
//! use slitpose_head::{front_end::Stage, scene_file::WIDE};
//! use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
//! use slitpose_model::{Reading, Tier};
//! use slitpose_protocol::{Command, Decoder, MAX_MESSAGE_BYTES, MAX_REQUEST_BYTES, Message, Request, encode};
//!
//! let head = WIDE.read()?;
//! let still = Trajectory::of_kind(TrajectoryKind::Still, 1, f64::INFINITY);
//! let mut board = SimulatedBoard::new(&head, still, Tier::Exact { tolerance: 1e-6 }, 1)?;
//! board.write(encode(&Request { number: 1, command: Command::Start }, &mut [0; MAX_REQUEST_BYTES])?);
//! let mut bytes = Vec::new();
//! (0..40).for_each(|_| board.step(&mut bytes)); // 10 ms at 4 kHz
//!
//! let (mut decoder, mut bytes) = (Decoder::<MAX_MESSAGE_BYTES>::new(), &bytes[..]);
//! let (mut stage, mut scans) = (None, 0);
//! while let Some(message) = decoder.next::<Message>(&mut bytes) {
//!     match (message?, &stage) {
//!         (Message::Hello(hello), _) => {
//!             stage = Some((Stage::new(&head, &hello.schedule, &hello.scaling), hello.schedule));
//!         }
//!         (Message::Batch(batch), Some((stage, schedule))) => {
//!             for scan in batch.scans(schedule)? {
//!                 let Reading::Light(pair) = stage.photocurrents(&scan).cells[0] else { panic!("cell 0 is dark") };
//!                 assert!((pair.total_a() - 6.816e-6).abs() < 0.02e-6);
//!                 scans += 1;
//!             }
//!         }
//!         _ => {}
//!     }
//! }
//! assert_eq!(scans, 40);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod board_head;
pub mod causes;
pub mod faults;
pub mod finding;
pub mod foreign;
pub mod front_end;
pub mod interrupt;
pub mod pace;
pub mod replacement;
pub mod scene_file;
pub mod simulator;
pub mod special_file;
pub mod table;
pub mod text_file;
pub mod threads;

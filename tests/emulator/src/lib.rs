//! An STM32G474 in software, with light and electronics around it.
//!
//! It runs the image that is flashed to a board, unchanged, instruction by instruction, and puts
//! the head of a scene in front of it: what the program lights is what the detectors see. A USB
//! host or a serial line carries what it says to a pseudo-terminal, or to a test.
//!
//! | module | what it stands for |
//! |---|---|
//! | [`cpu`] | the core: instructions with their cycles, interrupts, faults |
//! | [`memory`], [`peripherals`] | the rest of the controller, from its reference manual (RM0440) |
//! | [`board`], [`machine`] | the controller as a whole: bus, time, resets, supply |
//! | [`faults`] | what can be wrong with silicon and board, to be switched on by name |
//! | [`boot_loader`] | the boot loader in the controller's system memory |
//! | [`world`] | emitters, optics, electronics |
//! | [`usb_wire`], [`usb_host`] | the cable and the computer at its other end |
//! | [`terminal`] | that computer's serial port, as programs open it |
//! | [`facts`] | numbers from outside the project, of which registers are made, and for tests |
//! | [`rig`] | all of it together, running an [`image`] that `firmware/build` has made |
//!
//! What a program does against the reference manual is recorded, not tolerated: see [`rig::Rig::faults`].
#![allow(missing_docs, reason = "for this project's own tests and tools: comments say what names do not")]

pub mod board;
pub mod boot_loader;
pub mod cpu;
pub mod facts;
pub mod faults;
pub mod image;
pub mod machine;
pub mod memory;
pub mod peripherals;
pub mod rig;
#[allow(non_snake_case, non_upper_case_globals, dead_code, reason = "names are ST's, and those of all facts")]
mod st {
    include!(concat!(env!("OUT_DIR"), "/st.rs"));
}
pub mod terminal;
pub mod usb_host;
pub mod usb_wire;
pub mod world;

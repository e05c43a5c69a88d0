//! The host's side of a slit-and-detector tracker: scenes, tables, pictures and commands around
//! the optics of [`slitpose_model`].
//!
//! * [`scene_file`] reads what describes a sensor head;
//! * [`capture`] writes and reads captures;
//! * [`clock`] reads the clocks of the host;
//! * [`comparison`] holds poses against a reference;
//! * [`daemon`] follows boards live;
//! * [`datagram`] hands the newest pose to control loops;
//! * [`device`] carries bytes to boards and back, and speaks with them;
//! * [`doctor`] says what may be wrong;
//! * [`foreign`] makes text of others fit for a terminal;
//! * [`front_end`] stands between counts and currents;
//! * [`health`] watches the cells of a head;
//! * [`identification`] finds an emitter's profile from currents;
//! * [`pace`] holds a stream to a multiple of device time;
//! * [`paper`] calculates the source paper's experiments;
//! * [`pipeline`] turns bytes into poses;
//! * [`plot`] draws;
//! * [`report`] studies error against run time;
//! * [`service`] tells a service manager how it goes;
//! * [`simulator`] is a board made of arithmetic;
//! * [`sink`] is where poses go;
//! * [`survey`] tells what a scene can do;
//! * [`table`] reads and writes CSV, and is where results go;
//! * [`terminal`] draws for the person who gave the command;
//! * [`telemetry`] tells how daemon, boards and heads do;
//! * [`commands`] has one file for each verb of the `slitpose` command.
//!
//! Inside, everything is SI. Millimetres and degrees appear in scene files, on the command line
//! and in pictures, with the unit in the name.

#![forbid(unsafe_code)]

pub mod capture;
pub mod clock;
pub mod commands;
pub mod comparison;
pub mod daemon;
pub mod datagram;
pub mod device;
pub mod doctor;
pub mod foreign;
pub mod front_end;
pub mod health;
pub mod identification;
mod interrupt;
pub mod pace;
pub mod paper;
pub mod pipeline;
pub mod plot;
pub mod report;
pub mod scene_file;
pub mod service;
pub mod simulator;
pub mod sink;
mod special_file;
pub mod survey;
pub mod table;
pub mod telemetry;
pub mod terminal;
mod threads;

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

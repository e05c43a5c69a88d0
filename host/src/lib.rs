//! The live side of a slit-and-detector tracker, and the `slitpose` command. What a head is stands in
//! [`slitpose_head`], what its designer asks in [`slitpose_design`], the optics and the solver in
//! [`slitpose_model`].
//!
//! * [`capture`] writes and reads captures;
//! * [`clock`] reads the clocks of the host;
//! * [`comparison`] holds poses against a reference;
//! * [`daemon`] follows boards live;
//! * [`datagram`] hands the newest pose to control loops;
//! * [`device`] carries bytes to boards and back, and speaks with them;
//! * [`doctor`] says what may be wrong;
//! * [`health`] watches the cells of a head;
//! * [`link`] is what crosses between a link to a board and those who read it;
//! * [`pipeline`] turns bytes into poses;
//! * [`service`] tells a service manager how it goes;
//! * [`sink`] is where poses go;
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
pub mod health;
pub mod link;
pub mod pipeline;
pub mod service;
pub mod sink;
pub mod telemetry;
pub mod terminal;

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

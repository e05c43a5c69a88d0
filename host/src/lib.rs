//! The live side of a slit-and-detector tracker, and the `slitpose` command. What a head is stands in
//! [`slitpose_head`], what its designer asks in [`slitpose_design`], the optics and the solver in
//! [`slitpose_model`].
//!
//! For other programs:
//!
//! * [`clock`] reads the clocks of the host;
//! * [`link`] holds the bytes that a link has delivered, and identifies boards;
//! * [`device`] carries bytes to boards and back, and speaks with them;
//! * [`health`] watches the cells of a head;
//! * [`pipeline`] turns bytes into poses;
//! * [`datagram`] hands the newest pose to control loops;
//! * [`telemetry`] counts, and reports the state of daemon, boards and heads;
//! * [`commands`] has one file for each verb of the `slitpose` command.
//!
//! Behind the commands: `terminal` draws for the user, `comparison` holds poses against a reference, `capture` writes
//! and reads captures, `sink` writes poses, `daemon` follows boards live, `service` notifies the service manager,
//! `doctor` examines boards, heads and hosts.
//!
//! Inside, everything is SI. Millimetres and degrees appear in scene files, on the command line
//! and in pictures, with the unit in the name.

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
pub mod link;
pub mod pipeline;
mod service;
mod sink;
pub mod telemetry;
mod terminal;

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

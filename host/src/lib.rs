//! The `slitpose` command: boards live, captures, control loops, status. [`slitpose_tracking`] turns bytes into poses,
//! [`slitpose_head`] describes heads, [`slitpose_design`] serves their designers.
//!
//! Public for tests and fuzz targets, not for other programs:
//!
//! * [`commands`] has one file or folder for each verb;
//! * [`device`] finds boards, and exchanges bytes and commands with them;
//! * [`datagram`] sends the newest pose to control loops;
//! * [`telemetry`] counts, and reports the state of daemon, boards and heads;
//! * [`inputs`] reads what strangers can send, for fuzzing.
//!
//! Behind the commands: `terminal` draws for the user, `comparison` compares poses with a reference, `sink` writes poses,
//! `daemon` follows boards live, `live` shows them on a page, `bridges` to Foxglove, to ROS 2 and as a mouse, `http` guards
//! the servers, `service` notifies the service manager, `doctor` examines boards, heads and hosts.

#![forbid(unsafe_code)]

mod bridges;
pub mod commands;
mod comparison;
mod daemon;
pub mod datagram;
pub mod device;
mod doctor;
mod http;
pub mod inputs;
mod live;
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

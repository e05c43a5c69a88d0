//! How the daemon, its boards and their heads do: counted, told, and served.
//!
//! [`BoardStatistics`] takes what comes out of a board's pipeline, scan by scan and without allocating,
//! and makes a [`BoardReport`] of it a few times a second. A [`DaemonReport`] holds those of all boards.
//! [`view`] is for people, [`metrics`] for Prometheus, JSON for everybody else; [`StatusServer`] offers
//! all three, and [`fetch`] gets them.

mod address;
mod client;
mod connection;
mod findings;
mod latency;
mod losses;
pub mod metrics;
mod origin;
mod process;
mod report;
mod server;
mod statistics;
#[cfg(test)]
mod tests;
pub mod view;

pub(crate) use address::{DEFAULT_STATUS_ADDRESS, StatusAddress};
pub(crate) use client::{FetchError, fetch};
pub(crate) use report::{
    BoardReport, DaemonReport, HostLosses, LagReport, LinkReport, LinkState, RecorderReport, RecorderState,
    report_schema,
};
pub(crate) use server::{Reach, StatusError, StatusServer};
pub use statistics::BoardStatistics;

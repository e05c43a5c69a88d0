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

pub use address::{AddressError, DEFAULT_STATUS_ADDRESS, StatusAddress};
pub use client::{FetchError, fetch};
pub use latency::{Latency, LatencyHistogram, Percentiles};
pub use report::{
    BoardEvent, BoardLosses, BoardReport, ClockReport, DaemonReport, HostLosses, LagReport, Latencies, LinkLosses,
    LinkReport, LinkState, Losses, ProcessReport, Rates, RecorderReport, RecorderState, Vitals, report_schema,
};
pub use server::{Reach, StatusError, StatusServer};
pub use statistics::BoardStatistics;

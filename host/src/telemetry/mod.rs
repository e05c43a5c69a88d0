//! The state of the daemon, its boards and their heads: counted, reported, and served.
//!
//! [`BoardStatistics`] counts the items of a board's pipeline, without allocating, and makes a `BoardReport` a few
//! times per second. A `DaemonReport` holds those of all boards. `view` formats it for people, `metrics` for
//! Prometheus, and JSON serves other programs; `StatusServer` offers all three, and `fetch` requests them.

mod findings;
mod losses;
pub(crate) mod metrics;
mod report;
mod server;
mod statistics;
#[cfg(test)]
mod tests;
pub(crate) mod view;

pub(crate) use report::{
    BoardReport, DaemonReport, HostLosses, LagReport, LinkReport, LinkState, RecorderReport, RecorderState,
    report_schema,
};
pub(crate) use server::{DEFAULT_STATUS_ADDRESS, StatusServer, fetch, request, status_address};
pub use statistics::BoardStatistics;

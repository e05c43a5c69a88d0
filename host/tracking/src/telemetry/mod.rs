//! The state of the program, its boards and their heads: counted and reported.
//!
//! [`BoardStatistics`] counts the items of a board's pipeline, without allocating, and makes a [`BoardReport`] a few
//! times per second. A [`DaemonReport`] holds those of all boards, and its findings explain missing or bad poses.

mod findings;
mod latency;
mod report;
mod statistics;

pub use latency::{Latency, Percentiles};
pub use report::{
    BoardEvent, BoardLosses, BoardReport, ClockReport, DaemonReport, DatagramCounts, HostLosses, LagReport, Latencies,
    LinkLosses, LinkReport, LinkState, Losses, ProcessReport, Rates, RecorderReport, RecorderState, SlowClient,
    TriggerReport, Vitals, Withheld, report_schema,
};
pub use statistics::BoardStatistics;

//! The state of the daemon, its boards and their heads, served.
//!
//! `view` formats a [`DaemonReport`](slitpose_tracking::telemetry::DaemonReport) for people, `metrics` for
//! Prometheus, and JSON serves other programs; `serve_status` offers all three, and `fetch` requests them.

pub(crate) mod metrics;
mod server;
#[cfg(test)]
mod tests;
pub(crate) mod view;

pub(crate) use server::{DEFAULT_STATUS_ADDRESS, fetch, request, serve_status, status_address};

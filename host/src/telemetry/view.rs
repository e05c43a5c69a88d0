//! Reports in lines for people: at most [`WIDTH`] columns.

use std::time::Duration;

use super::latency::Latency;
use super::report::{BoardReport, DaemonReport, LinkState, RecorderState};
use crate::clock::HostInstant;
use crate::foreign::printable;
use crate::health::{CellHealth, Verdict};
use crate::pipeline::OUTCOMES;

/// No line is longer.
pub const WIDTH: usize = 100;

/// The names at the beginnings of the lines stand in a column of their own.
const INDENT: usize = 12;

/// A text that boards or files make longer is cut.
const LONGEST_TEXT: usize = 800;

/// So are names of boards and of their firmware.
const LONGEST_NAME: usize = 60;

const KELVIN_AT_0_CELSIUS: f32 = 273.15;

/// All of a daemon, as it is `now`.
pub fn daemon_lines(report: &DaemonReport, now: HostInstant) -> Vec<String> {
    let mut lines = Vec::new();
    let memory = report.process.map_or(String::new(), |process| {
        format!(", {:.1} MB, {} threads", process.resident_bytes as f64 * 1e-6, process.threads)
    });
    put(&mut lines, report.program, &format!("{}, up {}{memory}", report.version, duration(report.uptime_s)));
    for board in &report.boards {
        lines.push(String::new());
        lines.extend(self::lines(board));
    }
    lines.push(String::new());
    let recorder = &report.recorder;
    let file = recorder.file.as_deref().unwrap_or("a capture");
    match recorder.state {
        RecorderState::Off => put(&mut lines, "recorder", "off"),
        RecorderState::Recording => put(
            &mut lines,
            "recorder",
            &format!("{file}: {:.1} MB, {} bytes not recorded", recorder.bytes as f64 * 1e-6, recorder.bytes_dropped),
        ),
        RecorderState::Failed => {
            let reason = recorder.reason.as_deref().unwrap_or("it gives no reason");
            put(&mut lines, "recorder", &format!("failed on {file}: {reason}"));
        }
    }
    let complaints = report.complaints(now);
    if complaints.is_empty() {
        put(&mut lines, "health", "ok");
    }
    // What is wrong with a head stands with its board.
    let findings: Vec<_> =
        report.boards.iter().filter_map(|board| board.head.as_ref()).flat_map(|head| &head.findings).collect();
    let is_told = |complaint: &str| findings.iter().any(|finding| complaint.ends_with(&finding.text));
    complaints.iter().filter(|complaint| !is_told(complaint)).for_each(|complaint| put(&mut lines, "wrong", complaint));
    lines
}

/// One board: link, rates, losses, outcomes, latencies, cells, findings.
pub fn lines(report: &BoardReport) -> Vec<String> {
    let mut lines = Vec::new();
    let BoardReport { link, losses, rates, .. } = report;
    let name = |text| printable(text).at_most(LONGEST_NAME);
    let board = name(if report.board.is_empty() { "not known yet" } else { &report.board });
    let id = report.device.map_or(String::new(), |device| format!(", id {device}"));
    let firmware =
        if report.firmware.is_empty() { String::new() } else { format!(", firmware {}", name(&report.firmware)) };
    let simulated = if report.simulated { ", SIMULATED" } else { "" };
    put(&mut lines, "board", &format!("{board} on {}{id}{firmware}{simulated}", report.name));
    let since_s = report.made_utc_ns.saturating_sub(link.since_utc_ns) as f64 * 1e-9;
    let reason = link.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let reconnects = match link.reconnects {
        0 => String::new(),
        1 => ", 1 reconnection".to_owned(),
        count => format!(", {count} reconnections"),
    };
    put(&mut lines, "link", &format!("{} for {}{reconnects}{reason}", link.state.as_str(), duration(since_s)));
    if report.scans == 0 && link.state != LinkState::Running {
        return lines;
    }
    let device = rates.device_hz.map_or("-".to_owned(), |rate_hz| format!("{rate_hz:.1}"));
    put(
        &mut lines,
        "rate",
        &format!("{device} scans/s by the board's clock, {:.1} by the host's; {} scans", rates.host_hz, report.scans),
    );
    put(
        &mut lines,
        "lost",
        &format!(
            "board {}, link {} scans; {} damaged, {} unreadable packets; host {} unrecorded, {} unsent",
            losses.board.scans_dropped + losses.board.scans_lost,
            losses.link.scans,
            losses.damaged(),
            losses.link.unreadable,
            losses.host.bytes_unrecorded,
            losses.host.poses_unsent,
        ),
    );
    let outcomes = OUTCOMES.iter().zip(report.outcomes.counts()).filter(|(_, count)| *count > 0);
    let outcomes: Vec<String> = outcomes.map(|(name, count)| format!("{name} {count}")).collect();
    put(&mut lines, "outcomes", &outcomes.join(", "));
    let latencies = &report.latencies;
    for (name, latency) in [("link", &latencies.link), ("host", &latencies.host), ("total", &latencies.total)] {
        if latency.total.count > 0 {
            put(&mut lines, "latency", &format!("{name:<6}{}", percentiles(latency)));
        }
    }
    if let Some(complaint) = report.lag.complaint() {
        put(&mut lines, "late", &complaint);
    }
    if let Some(uncertainty_s) = report.clock.uncertainty_s {
        let drift = report.clock.drift_ppm.map_or(String::new(), |drift_ppm| format!(", fast by {drift_ppm:+.2} ppm"));
        put(&mut lines, "clock", &format!("known to {:.1} us{drift}", uncertainty_s * 1e6));
    }
    if let Some(vitals) = &report.vitals {
        put(
            &mut lines,
            "controller",
            &format!(
                "{:.2} V, {:.1} deg C, processor {:.0} %, last reset: {}",
                vitals.supply_v,
                vitals.temperature_k - KELVIN_AT_0_CELSIUS,
                100.0 * vitals.cpu_load,
                vitals.reset_cause
            ),
        );
    }
    if let Some(complaint) = &report.complaint {
        let at = complaint.device_time_s.map_or(String::new(), |time_s| format!(" (at {time_s:.3} s)"));
        put(&mut lines, "it said", &format!("{}{at}", complaint.text));
    }
    if let Some(head) = &report.head {
        let cells: Vec<String> = head.cells.iter().map(word).collect();
        put(&mut lines, "cells", &cells.join(" "));
        head.findings.iter().for_each(|finding| put(&mut lines, "  !", &finding.text));
    }
    lines
}

/// A cell in a word.
fn word(health: &CellHealth) -> String {
    let shares = &health.shares;
    let share = match health.verdict {
        Verdict::Saturated => Some(shares.saturated),
        Verdict::Dark => Some(shares.dark),
        Verdict::Faint => Some(shares.faint),
        Verdict::Excluded => Some(shares.excluded),
        _ => None,
    };
    let share = share.map_or(String::new(), |share| format!("({:.0}%)", 100.0 * share));
    format!("{}:{}{share}", health.cell, health.verdict.as_str())
}

fn percentiles(latency: &Latency) -> String {
    let of = if latency.recent.count > 0 { &latency.recent } else { &latency.total };
    let [half, most, longest] = [of.p50_s, of.p99_s, latency.total.max_s].map(|seconds| seconds * 1e3);
    format!("median {half:>8.3} ms, 99 % {most:>8.3} ms, longest ever {longest:>8.3} ms")
}

/// To a second, or to a tenth below ten.
fn duration(seconds: f64) -> String {
    let whole =
        Duration::try_from_secs_f64(if seconds < 10.0 { (seconds * 10.0).round() / 10.0 } else { seconds.round() });
    whole.map_or_else(|_| "-".to_owned(), |duration| humantime::format_duration(duration).to_string())
}

/// Appends `text` under `name`, in as many lines as it takes. What boards and files say in it is escaped.
fn put(lines: &mut Vec<String>, name: &str, text: &str) {
    let text = printable(text).at_most(LONGEST_TEXT).to_string();
    let mut line = format!("{name:<INDENT$}");
    let mut columns = INDENT.max(name.chars().count());
    for word in text.split(' ') {
        let length = word.chars().count();
        let begins = columns <= INDENT;
        if !begins && columns + 1 + length > WIDTH {
            lines.push(std::mem::replace(&mut line, " ".repeat(INDENT)));
            columns = INDENT;
        } else if !begins {
            line.push(' ');
            columns += 1;
        }
        // A word that no line holds is cut.
        line.extend(word.chars().take(WIDTH - columns));
        columns += length.min(WIDTH - columns);
    }
    lines.push(line.trim_end().to_owned());
}

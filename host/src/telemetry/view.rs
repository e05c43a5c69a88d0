//! Reports in lines for people.

use std::time::Duration;

use crate::device::in_words;
use crate::terminal::{Line, Tone, WIDTH, layout};
use slitpose_head::finding::{Finding, Grade};
use slitpose_head::foreign::printable;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::health::{CellHealth, Verdict};
use slitpose_tracking::link::{contradicted_crystal, start_findings};
use slitpose_tracking::pipeline::Agreement;
use slitpose_tracking::telemetry::Latency;
use slitpose_tracking::telemetry::{BoardReport, DaemonReport, LinkState, Losses, RecorderReport, RecorderState};

/// Longer names of boards and firmware are cut.
const MAX_NAME: usize = 60;

const KELVIN_AT_0_CELSIUS: f32 = 273.15;

/// The whole state of a daemon, as of `now`.
pub(crate) fn daemon_lines(report: &DaemonReport, now: HostInstant) -> Vec<String> {
    layout(&daemon(report, now), WIDTH)
}

fn daemon(report: &DaemonReport, now: HostInstant) -> Vec<Line> {
    let mut lines = Vec::new();
    let memory = report.process.map_or(String::new(), |process| {
        format!(", {:.1} MB, {} threads", process.resident_bytes as f64 * 1e-6, process.threads)
    });
    put(&mut lines, report.program, &format!("{}, up {}{memory}", report.version, duration(report.uptime_s)));
    for board in &report.boards {
        lines.push(Line::blank());
        lines.extend(self::lines(board, Vec::new()));
    }
    lines.push(Line::blank());
    lines.extend(recorder(&report.recorder, None).or_else(|| Some(Line::new("recorder", "off"))));
    if report.findings(now).is_empty() {
        put(&mut lines, "health", "ok");
    }
    // A finding on a head stands with its board.
    for finding in report.findings_beside_heads(now) {
        put_finding(&mut lines, "wrong", &finding);
    }
    lines
}

/// The capture being written, with its rate of growth if known; `None` without a capture.
pub(crate) fn recorder(report: &RecorderReport, bytes_per_s: Option<f64>) -> Option<Line> {
    let file = report.file.as_deref().unwrap_or("a capture");
    let megabytes = report.bytes as f64 * 1e-6;
    let mut line = match report.state {
        RecorderState::Off => return None,
        RecorderState::Recording => {
            let rate = bytes_per_s.map_or(String::new(), |rate| format!(", {:.0} kB/s", rate * 1e-3));
            let missing = match report.bytes_dropped {
                0 => String::new(),
                dropped => format!(", {dropped} bytes not recorded"),
            };
            Line::new("recorder", &format!("{megabytes:.1} MB{rate}{missing} in {file}"))
        }
        RecorderState::Failed => {
            let reason = report.reason.as_deref().unwrap_or("it gives no reason");
            Line::new("recorder", &format!("failed on {file}: {reason}"))
        }
    };
    let is_whole = report.state == RecorderState::Recording && report.bytes_dropped == 0;
    line.tone(if is_whole { Tone::Plain } else { Tone::Wrong });
    Some(line)
}

/// One board: its last `pose`, link, rates, losses, outcomes, latencies, cells, findings.
pub(crate) fn lines(report: &BoardReport, pose: Vec<Line>) -> Vec<Line> {
    let mut lines = Vec::new();
    let BoardReport { link, losses, rates, .. } = report;
    let name = |text| printable(text).at_most(MAX_NAME);
    let board = name(if report.board.is_empty() { "not known yet" } else { &report.board });
    // A capture's board is called by its number.
    let id = report.device.map(|device| device.to_string()).filter(|id| *id != report.name);
    let id = id.map_or(String::new(), |id| format!(", id {id}"));
    let firmware =
        if report.firmware.is_empty() { String::new() } else { format!(", firmware {}", name(&report.firmware)) };
    let simulated = if report.simulated { ", SIMULATED" } else { "" };
    put(&mut lines, "board", &format!("{board} on {}{id}{firmware}{simulated}", report.name));
    lines.extend(pose);
    let since_s = report.made_utc_ns.saturating_sub(link.since_utc_ns) as f64 * 1e-9;
    let reason = link.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
    let reconnects = match link.reconnects {
        0 => String::new(),
        1 => ", 1 reconnection".to_owned(),
        count => format!(", {count} reconnections"),
    };
    let tone = match link.state {
        LinkState::Running | LinkState::Connecting | LinkState::Ended if link.reason.is_none() => Tone::Plain,
        LinkState::Searching | LinkState::Connecting => Tone::Careful,
        _ => Tone::Wrong,
    };
    let since = match (link.state, duration(since_s)) {
        (LinkState::Ended, since) => format!("{since} ago"),
        (_, since) => format!("for {since}"),
    };
    let text = format!("{} {since}{reconnects}{reason}", link.state);
    put(&mut lines, "link", &text).tone(tone).rank(1);
    if report.scans == 0 && link.state != LinkState::Running {
        return lines;
    }
    let device = rates.device_hz.map_or("-".to_owned(), |rate_hz| format!("{rate_hz:.1}"));
    let host = if rates.interval_s > 0.0 { format!("{:.1}", rates.host_hz) } else { "-".to_owned() };
    put(&mut lines, "rate", &format!("{device} Hz by the board, {host} Hz by the host; {} scans", report.scans))
        .rank(2);
    let is_whole = *losses == Losses::default();
    let text = format!(
        "on the board {} scans; on the link {} scans, {} packets damaged, {} unreadable; on the host {} bytes unrecorded, \
         {} poses unsent",
        losses.board.scans_dropped + losses.board.scans_lost,
        losses.link.scans,
        losses.link.damaged(),
        losses.link.unreadable,
        losses.host.bytes_unrecorded,
        losses.host.poses_unsent,
    );
    let (text, tone) = if is_whole { ("nothing", Tone::Plain) } else { (&*text, Tone::Careful) };
    put(&mut lines, "lost", text).tone(tone).rank(1);
    let recent = &report.recent_outcomes;
    let tone = if recent.all() > 0 && recent.poses() == 0 { Tone::Wrong } else { Tone::Plain };
    put(&mut lines, "outcomes", &report.outcomes.words()).tone(tone).rank(1);
    if let Some(poses) = &report.board_poses {
        let Agreement { compared, worst_sigmas, recent_rms_sigmas, one_sided, missed, refused, .. } = poses;
        let text = format!(
            "of the board: {compared} compared with those found here, {recent_rms_sigmas:.3} sigma apart, {worst_sigmas:.3} \
             at worst; {one_sided} found by one only, {missed} scans not solved in time, {refused} impossible"
        );
        put(&mut lines, "poses", &text).rank(1);
    }
    let latencies = &report.latencies;
    for (name, latency) in [("link", &latencies.link), ("host", &latencies.host), ("total", &latencies.total)] {
        if latency.total.count > 0 {
            let rank = if name == "total" { 2 } else { 3 };
            put(&mut lines, "latency", &format!("{name:<6}{}", percentiles(latency))).rank(rank);
        }
    }
    if let Some(finding) = report.lag.finding() {
        put_finding(&mut lines, "late", &finding);
    }
    if let Some(uncertainty_s) = report.clock.uncertainty_s {
        let drift = report.clock.drift_ppm.map_or(String::new(), |drift_ppm| format!(", fast by {drift_ppm:+.2} ppm"));
        put(&mut lines, "clock", &format!("known to {:.1} us{drift}", uncertainty_s * 1e6)).rank(3);
    }
    if report.clock.contradicts_crystal {
        put_finding(&mut lines, "clock", &contradicted_crystal()).rank(1);
    }
    if let Some(trigger) = &report.trigger {
        let level = if trigger.is_high { "high" } else { "low" };
        let lost = match (trigger.missed, trigger.dropped) {
            (0, 0) => String::new(),
            (missed, dropped) => format!("; {missed} or more came too fast for the board, {dropped} were dropped"),
        };
        let text = format!("{} edges, {level} since {:.6} s{lost}", trigger.edges, trigger.last_device_time_s);
        let tone = if lost.is_empty() { Tone::Plain } else { Tone::Careful };
        put(&mut lines, "trigger", &text).tone(tone).rank(2);
    }
    if let Some(vitals) = &report.vitals {
        put(
            &mut lines,
            "MCU",
            &format!(
                "{:.2} V, {:.1} deg C, {:.0} % CPU, last reset: {}, clock: {}, settings: {}",
                vitals.supply_v,
                vitals.temperature_k - KELVIN_AT_0_CELSIUS,
                100.0 * vitals.cpu_load,
                in_words(&vitals.reset_cause),
                vitals.clock_source.as_str().replace('_', " "),
                vitals.settings.as_str().replace('_', " ")
            ),
        )
        .rank(3);
        let start = start_findings(vitals.clock_source, vitals.settings);
        for finding in start.iter().filter(|finding| finding.grade != Grade::Ok) {
            put_finding(&mut lines, "start", finding).rank(1);
        }
    }
    if let Some(event) = &report.complaint {
        put_finding(&mut lines, "event", &event.finding()).rank(1);
    }
    if let Some(head) = &report.head {
        let cells: Vec<String> = head.cells.iter().map(word).collect();
        put(&mut lines, "cells", &cells.join(" ")).rank(2);
        for diagnosis in &head.findings {
            put_finding(&mut lines, "  !", &diagnosis.finding);
        }
    }
    lines
}

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
    format!("{}:{}{share}", health.cell, health.verdict)
}

fn percentiles(latency: &Latency) -> String {
    let (of, span) = match latency.recent.count {
        // The instant of a pose may be unknown while its arrival is known.
        0 => (&latency.total, "; none in the last second"),
        _ => (&latency.recent, ""),
    };
    let [half, most, longest] = [of.p50_s, of.p99_s, latency.total.max_s].map(|seconds| seconds * 1e3);
    format!("median {half:>8.3} ms, 99 % {most:>8.3} ms, longest ever {longest:>8.3} ms{span}")
}

/// A duration to a second, or to a tenth of a second below ten.
fn duration(seconds: f64) -> String {
    let whole =
        Duration::try_from_secs_f64(if seconds < 10.0 { (seconds * 10.0).round() / 10.0 } else { seconds.round() });
    whole.map_or_else(|_| "-".to_owned(), |duration| humantime::format_duration(duration).to_string())
}

fn put<'a>(lines: &'a mut Vec<Line>, name: &'static str, text: &str) -> &'a mut Line {
    let at = lines.len();
    lines.push(Line::new(name, text));
    &mut lines[at]
}

fn put_finding<'a>(lines: &'a mut Vec<Line>, name: &'static str, finding: &Finding) -> &'a mut Line {
    put(lines, name, &finding.to_string()).tone(finding.grade.into())
}

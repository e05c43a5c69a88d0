//! The status in Prometheus's text format, version 0.0.4.
//!
//! Written without a client library: these keep live metrics and lack summaries, while the report already has
//! percentiles.

use std::fmt::Write;

use slitpose_protocol::{ClockSource, SettingsSource};

use super::losses::Latency;
use super::report::{BoardReport, DaemonReport, LinkState, RecorderState};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::health::CellHealth;

pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

const KELVIN_AT_0_CELSIUS: f64 = 273.15;

type Labels<'a> = Vec<(&'static str, &'a str)>;

/// Reads a value of a cell, if there is one.
type Number = fn(&CellHealth) -> Option<f64>;

/// Families of samples, in the order they are written.
struct Exposition(String);

impl Exposition {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a String cannot fail, here and below.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    /// Adds a sample if there is a value.
    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: Option<f64>) {
        let Some(value) = value.filter(|value| value.is_finite()) else {
            return;
        };
        self.0.push_str(name);
        for (i, (label, text)) in labels.iter().enumerate() {
            let _ = write!(self.0, "{}{label}=\"", if i == 0 { '{' } else { ',' });
            for character in text.chars() {
                match character {
                    '\\' => self.0.push_str("\\\\"),
                    '"' => self.0.push_str("\\\""),
                    '\n' => self.0.push_str("\\n"),
                    other => self.0.push(other),
                }
            }
            self.0.push('"');
        }
        let _ = writeln!(self.0, "{} {value}", if labels.is_empty() { "" } else { "}" });
    }

    fn one(&mut self, name: &str, kind: &str, help: &str, value: Option<f64>) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }
}

/// A family with samples for each board.
struct Boards<'a> {
    out: Exposition,
    boards: Vec<(String, &'a BoardReport)>,
}

impl Boards<'_> {
    fn each(&mut self, name: &str, kind: &str, help: &str, value: impl Fn(&BoardReport) -> Option<f64>) {
        self.out.family(name, kind, help);
        for (device, board) in &self.boards {
            self.out.sample(name, &[("device", device)], value(board));
        }
    }

    /// One sample for each board and word.
    fn by<const N: usize>(
        &mut self,
        (name, label): (&str, &'static str),
        kind: &str,
        help: &str,
        values: impl Fn(&BoardReport) -> [(&'static str, f64); N],
    ) {
        self.out.family(name, kind, help);
        for (device, board) in &self.boards {
            for (word, value) in values(board) {
                self.out.sample(name, &[("device", device), (label, word)], Some(value));
            }
        }
    }

    /// One sample for each cell, with its own labels.
    fn cells<'c>(
        &'c mut self,
        name: &str,
        kind: &str,
        help: &str,
        values: impl Fn(&'c CellHealth) -> Vec<(Labels<'c>, Option<f64>)>,
    ) {
        self.out.family(name, kind, help);
        for (device, board) in &self.boards {
            for health in board.head.iter().flat_map(|head| &head.cells) {
                let cell = health.cell.to_string();
                for (more, value) in values(health) {
                    let mut labels: Labels<'_> = vec![("device", device), ("cell", &cell)];
                    labels.extend(more);
                    self.out.sample(name, &labels, value);
                }
            }
        }
    }

    fn latency(&mut self) {
        const NAME: &str = "slitpose_latency_seconds";
        const HELP: &str =
            "Age of a pose: link, from the sample's instant until read; host, from there until published; total.";
        self.out.family(NAME, "summary", HELP);
        for (device, board) in &self.boards {
            let latencies = &board.latencies;
            for (stage, Latency { total, .. }) in
                [("link", &latencies.link), ("host", &latencies.host), ("total", &latencies.total)]
            {
                if total.count == 0 {
                    continue;
                }
                for (quantile, value) in total.quantiles() {
                    let labels = [("device", device.as_str()), ("stage", stage), ("quantile", &quantile.to_string())];
                    self.out.sample(NAME, &labels, Some(value));
                }
                let labels = [("device", device.as_str()), ("stage", stage)];
                self.out.sample(&format!("{NAME}_sum"), &labels, Some(total.sum_s));
                self.out.sample(&format!("{NAME}_count"), &labels, Some(total.count as f64));
            }
        }
    }
}

/// The whole report, as of `now`.
pub(crate) fn text(report: &DaemonReport, now: HostInstant) -> String {
    let mut out = Exposition(String::with_capacity(1 << 14));
    out.family("slitpose_build_info", "gauge", "The program and its version.");
    out.sample("slitpose_build_info", &[("program", report.program), ("version", report.version)], Some(1.0));
    let started = Some(report.started_utc_ns as f64 * 1e-9);
    out.one("slitpose_start_time_seconds", "gauge", "When the daemon was started, since 1970 began, UTC.", started);
    let process = report.process;
    let resident = process.map(|process| process.resident_bytes as f64);
    out.one("slitpose_resident_memory_bytes", "gauge", "Memory of the daemon in RAM.", resident);
    out.one("slitpose_threads", "gauge", "Threads of the daemon.", process.map(|process| process.threads as f64));
    let healthy = f64::from(u8::from(report.findings(now).is_empty()));
    out.one("slitpose_healthy", "gauge", "1 if /health says ok.", Some(healthy));
    recorder(report, &mut out);
    datagrams(report, &mut out);
    let boards = report.boards.iter().map(|board| (board.label(), board)).collect();
    let mut boards = Boards { out, boards };
    stream(&mut boards, now);
    mcu(&mut boards);
    head(&mut boards);
    boards.out.0
}

fn datagrams(report: &DaemonReport, out: &mut Exposition) {
    let Some(counts) = &report.datagrams else { return };
    let gauges = [
        ("slitpose_datagram_places", "Places of followers on each board.", counts.places),
        ("slitpose_datagram_places_taken", "Places that clients have taken.", counts.places_taken),
        (
            "slitpose_datagram_clients_slow",
            "Clients that have missed poses for more than a second.",
            counts.slow_clients.len() as u64,
        ),
    ];
    let counters = [
        (
            "slitpose_datagram_places_refused_total",
            "Clients told that there is no place for them.",
            counts.places_refused,
        ),
        ("slitpose_datagram_requests_total", "Requests understood.", counts.requests),
        ("slitpose_datagram_requests_refused_total", "Requests that are none, or cannot be answered.", counts.refused),
        ("slitpose_datagram_requests_unproven_total", "Requests on UDP answered with a cookie.", counts.unproven),
        ("slitpose_datagrams_sent_total", "Poses sent.", counts.sent),
        ("slitpose_datagrams_missed_total", "Poses for which a client's queue had no room.", counts.missed),
    ];
    let all = gauges.map(|it| ("gauge", it)).into_iter().chain(counters.map(|it| ("counter", it)));
    for (kind, (name, help, count)) in all {
        out.one(name, kind, help, Some(count as f64));
    }
}

fn recorder(report: &DaemonReport, out: &mut Exposition) {
    let recorder = &report.recorder;
    out.family("slitpose_recorder_state", "gauge", "1 for the state the recorder is in.");
    for state in RecorderState::ALL {
        let is = f64::from(u8::from(state == recorder.state));
        out.sample("slitpose_recorder_state", &[("state", state.as_str())], Some(is));
    }
    let counters = [
        ("slitpose_recorder_bytes_total", "Bytes written to the capture.", recorder.bytes),
        ("slitpose_recorder_files_total", "Files begun.", recorder.files),
        ("slitpose_recorder_flushes_total", "Times that all recorded reached the disk.", recorder.flushes),
        ("slitpose_recorder_dropped_bytes_total", "Bytes of links that were not recorded.", recorder.bytes_dropped),
    ];
    for (name, help, count) in counters {
        out.one(name, "counter", help, Some(count as f64));
    }
}

fn stream(boards: &mut Boards<'_>, now: HostInstant) {
    let (gauge, counter) = ("gauge", "counter");
    boards.by(("slitpose_link_state", "state"), gauge, "1 for the state the link is in.", |board| {
        LinkState::ALL.map(|state| (state.as_str(), f64::from(u8::from(state == board.link.state))))
    });
    boards.each("slitpose_link_reconnects_total", counter, "Times a board that had run ran again.", |board| {
        Some(board.link.reconnects as f64)
    });
    boards.each("slitpose_report_age_seconds", gauge, "Age of what is said of this board.", |board| {
        Some(board.age_s(now))
    });
    boards.each("slitpose_last_scan_age_seconds", gauge, "Time since the last scan was read.", |board| {
        board.last_scan_age_s.map(|before_s| before_s + board.age_s(now))
    });
    boards.each("slitpose_scans_total", counter, "Scans that arrived.", |board| Some(board.scans as f64));
    boards.each(
        "slitpose_scans_repeated_total",
        counter,
        "Scans that came again, or behind later ones, and were not solved.",
        |board| Some(board.losses.link.scans_repeated as f64),
    );
    boards.each(
        "slitpose_scan_rate_hertz",
        gauge,
        "Scans a second by the host's clock, of the last second.",
        |board| Some(board.rates.host_hz),
    );
    boards.each("slitpose_device_rate_hertz", gauge, "Scans a second by the board's clock.", |board| {
        board.rates.device_hz
    });
    boards.by(
        ("slitpose_scans_lost_total", "place"),
        counter,
        "Scans that are missing, by where they were lost.",
        |board| {
            let losses = &board.losses;
            [
                ("board_queue", losses.board.scans_dropped as f64),
                ("board_converters", losses.board.scans_lost as f64),
                ("link", losses.link.scans as f64),
            ]
        },
    );
    boards.by(("slitpose_host_dropped_total", "place"), counter, "What the host had and did not keep.", |board| {
        let host = &board.losses.host;
        [
            ("recorder", host.bytes_unrecorded as f64),
            ("zenoh", host.bytes_unpublished as f64),
            ("subscriber", host.poses_unsent as f64),
        ]
    });
    boards.by(("slitpose_packets_damaged_total", "cause"), counter, "Packets that could not be used.", |board| {
        let link = &board.losses.link;
        [
            ("bad_checksum", link.bad_checksum as f64),
            ("misframed", link.misframed as f64),
            ("overlong", link.overlong as f64),
            ("unreadable", link.unreadable as f64),
        ]
    });
    boards.each("slitpose_bytes_skipped_total", counter, "Bytes of packets that could not be used.", |board| {
        Some(board.losses.link.bytes_skipped as f64)
    });
    boards.by(("slitpose_solutions_total", "outcome"), counter, "Scans by what the solver says of them.", |board| {
        board.outcomes.by_name().map(|(name, count)| (name, count as f64))
    });
    boards.each("slitpose_behind", gauge, "1 if control loops get the newest scans only.", |board| {
        Some(f64::from(u8::from(board.lag.is_behind)))
    });
    boards.each("slitpose_waiting_scans", gauge, "Scans that arrived and are not solved yet.", |board| {
        Some(board.lag.waiting_scans as f64)
    });
    boards.each("slitpose_waiting_seconds", gauge, "For how long the oldest of them has waited.", |board| {
        Some(board.lag.waiting_s)
    });
    boards.each("slitpose_scans_skipped_total", counter, "Scans that were given up unsolved.", |board| {
        Some(board.lag.skipped_scans as f64)
    });
    boards.each(
        "slitpose_board_pose_difference_sigmas",
        gauge,
        "The board's own poses differ by so much from those found here, root mean square.",
        |board| board.board_poses.as_ref().map(|poses| poses.recent_rms_sigmas),
    );
    boards.each("slitpose_board_poses_missed_total", counter, "Scans that the board did not solve in time.", |board| {
        board.board_poses.as_ref().map(|poses| poses.missed as f64)
    });
    boards.each("slitpose_board_poses_refused_total", counter, "Poses of the board that cannot be right.", |board| {
        board.board_poses.as_ref().map(|poses| poses.refused as f64)
    });
    boards.latency();
    boards.each("slitpose_clock_uncertainty_seconds", gauge, "The instants of scans are right to this.", |board| {
        board.clock.uncertainty_s
    });
    boards.each(
        "slitpose_clock_contradicts_crystal",
        gauge,
        "1 if the board says crystal and does not keep time as one does.",
        |board| Some(f64::from(u8::from(board.clock.contradicts_crystal))),
    );
    boards.each("slitpose_clock_drift_ratio", gauge, "By what share the board's clock is fast.", |board| {
        board.clock.drift_ppm.map(|drift_ppm| drift_ppm * 1e-6)
    });
}

fn mcu(boards: &mut Boards<'_>) {
    let gauge = "gauge";
    boards.each("slitpose_board_acquiring", gauge, "1 if the board acquires.", |board| {
        board.vitals.as_ref().map(|vitals| f64::from(u8::from(vitals.acquiring)))
    });
    let is = |it: bool| f64::from(u8::from(it));
    boards.by(
        ("slitpose_board_clock_source", "source"),
        gauge,
        "1 for what the board's ticks are counted by; no 1 before its first status.",
        |board| {
            let now = board.vitals.as_ref().map(|vitals| vitals.clock_source);
            ClockSource::ALL.map(|source| (source.as_str(), is(now == Some(source))))
        },
    );
    boards.by(
        ("slitpose_board_settings", "source"),
        gauge,
        "1 for where the board's configuration came from at its start; no 1 before its first status.",
        |board| {
            let now = board.vitals.as_ref().map(|vitals| vitals.settings);
            SettingsSource::ALL.map(|source| (source.as_str(), is(now == Some(source))))
        },
    );
    boards.each("slitpose_board_supply_volts", gauge, "Supply voltage of the board.", |board| {
        board.vitals.as_ref().map(|vitals| vitals.supply_v.into())
    });
    boards.each("slitpose_board_temperature_celsius", gauge, "Temperature of the board's MCU.", |board| {
        board.vitals.as_ref().map(|vitals| f64::from(vitals.temperature_k) - KELVIN_AT_0_CELSIUS)
    });
    boards.each("slitpose_board_cpu_ratio", gauge, "Share of the board's processor time in use.", |board| {
        board.vitals.as_ref().map(|vitals| vitals.cpu_load)
    });
    boards.each("slitpose_board_adc_overruns_total", "counter", "Overruns of the board's converters.", |board| {
        Some(board.losses.board.adc_overruns as f64)
    });
}

fn head(boards: &mut Boards<'_>) {
    let gauge = "gauge";
    boards.each("slitpose_findings", gauge, "Things that are wrong with the head: see /status.", |board| {
        board.head.as_ref().map(|head| head.findings.len() as f64)
    });
    boards.each("slitpose_unexplained_ratio", gauge, "Share of scans that contradict the scene.", |board| {
        board.head.as_ref().map(|head| head.unexplained)
    });
    boards.cells("slitpose_cell_verdict", gauge, "1, with the verdict on the cell.", |cell| {
        vec![(vec![("verdict", cell.verdict.as_str())], Some(1.0))]
    });
    boards.cells("slitpose_cell_condition_ratio", gauge, "Share of the scans of the last second.", |cell| {
        let shares = &cell.shares;
        [
            ("saturated", shares.saturated),
            ("faint", shares.faint),
            ("dark", shares.dark),
            ("clipped", shares.clipped),
            ("excluded", shares.excluded),
            ("off", shares.off),
        ]
        .into_iter()
        .map(|(condition, share)| (vec![("condition", condition)], Some(share)))
        .collect()
    });
    let numbers: [(&str, &str, Number); 5] = [
        ("slitpose_cell_light_amperes", "Mean photocurrent at nominal drive.", |cell| cell.light_a),
        ("slitpose_cell_brightness_ratio", "Photocurrent over what the pose says.", |cell| cell.brightness),
        ("slitpose_cell_stray_amperes", "Current in the dark slot.", |cell| cell.stray_a),
        ("slitpose_cell_noise_amperes", "Standard deviation of a dark word.", |cell| cell.noise_a),
        ("slitpose_cell_promised_noise_amperes", "The same by the scene's front end.", |cell| cell.promised_noise_a),
    ];
    for (name, help, value) in numbers {
        boards.cells(name, gauge, help, |cell| vec![(Vec::new(), value(cell))]);
    }
}

//! The status in Prometheus's text format, version 0.0.4: tables of metrics, each with its place in the JSON of the report.
//!
//! Written without a client library: these keep live metrics and lack summaries, while the report already has
//! percentiles.

use std::fmt::Write;

use serde_json::{Value, json};
use slitpose_protocol::{ClockSource, SettingsSource};

use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::telemetry::{BoardReport, DaemonReport, LinkState, RecorderState};

pub(crate) const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

const KELVIN_AT_0_CELSIUS: f64 = 273.15;

/// Name without `slitpose_`; label, `label=value` for one sample of a family; place in the JSON; help, empty for a further
/// sample of the family above. Those that end in `_total` are counters.
type Metric = (&'static str, &'static str, &'static str, &'static str);

const DAEMON: &[Metric] = &[
    ("start_time_seconds", "", "/started_utc_ns", "When the daemon was started, since 1970 began, UTC."),
    ("resident_memory_bytes", "", "/process/resident_bytes", "Memory of the daemon in RAM."),
    ("threads", "", "/process/threads", "Threads of the daemon."),
    ("healthy", "", "/healthy", "1 if /health says ok."),
    ("recorder_state", "state", "/recorder/state", "1 for the state the recorder is in."),
    ("recorder_bytes_total", "", "/recorder/bytes", "Bytes written to the capture."),
    ("recorder_files_total", "", "/recorder/files", "Files begun."),
    ("recorder_flushes_total", "", "/recorder/flushes", "Times that all recorded reached the disk."),
    ("recorder_dropped_bytes_total", "", "/recorder/bytes_dropped", "Bytes of links that were not recorded."),
    ("datagram_places", "", "/datagrams/places", "Places of followers on each board."),
    ("datagram_places_taken", "", "/datagrams/places_taken", "Places that clients have taken."),
    ("datagram_clients_slow", "", "/datagrams/slow_clients", "Clients that have missed poses for more than a second."),
    ("datagram_places_refused_total", "", "/datagrams/places_refused", "Clients told that there is no place for them."),
    ("datagram_requests_total", "", "/datagrams/requests", "Requests understood."),
    ("datagram_requests_refused_total", "", "/datagrams/refused", "Requests that are none, or cannot be answered."),
    ("datagram_requests_unproven_total", "", "/datagrams/unproven", "Requests on UDP answered with a cookie."),
    ("datagrams_sent_total", "", "/datagrams/sent", "Poses sent."),
    ("datagrams_missed_total", "", "/datagrams/missed", "Poses for which a client's queue had no room."),
];

const BOARD: &[Metric] = &[
    ("link_state", "state", "/link/state", "1 for the state the link is in."),
    ("link_reconnects_total", "", "/link/reconnects", "Times a board that had run ran again."),
    ("report_age_seconds", "", "/age_s", "Age of what is said of this board."),
    ("last_scan_age_seconds", "", "/last_scan_age_s", "Time since the last scan was read."),
    ("scans_total", "", "/scans", "Scans that arrived."),
    ("scans_repeated_total", "", "/losses/link/scans_repeated", "Scans that came again or too late, and are unsolved."),
    ("scan_rate_hertz", "", "/rates/host_hz", "Scans a second by the host's clock, of the last second."),
    ("device_rate_hertz", "", "/rates/device_hz", "Scans a second by the board's clock."),
    ("scans_lost_total", "place=board_queue", "/losses/board/scans_dropped", "Missing scans, by where they were lost."),
    ("scans_lost_total", "place=board_converters", "/losses/board/scans_lost", ""),
    ("scans_lost_total", "place=link", "/losses/link/scans", ""),
    ("host_dropped_total", "place=recorder", "/losses/host/bytes_unrecorded", "What the host had and did not keep."),
    ("host_dropped_total", "place=subscriber", "/losses/host/poses_unsent", ""),
    ("packets_damaged_total", "cause=bad_checksum", "/losses/link/bad_checksum", "Packets that could not be used."),
    ("packets_damaged_total", "cause=misframed", "/losses/link/misframed", ""),
    ("packets_damaged_total", "cause=overlong", "/losses/link/overlong", ""),
    ("packets_damaged_total", "cause=unreadable", "/losses/link/unreadable", ""),
    ("bytes_skipped_total", "", "/losses/link/bytes_skipped", "Bytes of packets that could not be used."),
    ("solutions_total", "outcome", "/outcomes", "Scans by what the solver says of them."),
    ("velocities_withheld_total", "reason", "/velocities_withheld", "Poses without a velocity, by the reason."),
    ("light_level_ratio", "", "/light_level", "Brightness of all light over what scene or calibration says."),
    ("behind", "", "/lag/behind", "1 if control loops get the newest scans only."),
    ("waiting_scans", "", "/lag/waiting_scans", "Scans that arrived and are not solved yet."),
    ("waiting_seconds", "", "/lag/waiting_s", "For how long the oldest of them has waited."),
    ("scans_skipped_total", "", "/lag/skipped_scans", "Scans that were given up unsolved."),
    (
        "board_pose_difference_sigmas",
        "",
        "/board_poses/recent_rms_sigmas",
        "The board's poses against the host's, rms.",
    ),
    ("board_poses_missed_total", "", "/board_poses/missed", "Scans that the board did not solve in time."),
    ("board_poses_refused_total", "", "/board_poses/refused", "Poses of the board that cannot be right."),
    ("clock_uncertainty_seconds", "", "/clock/uncertainty_s", "The instants of scans are right to this."),
    ("clock_contradicts_crystal", "", "/clock/contradicts_crystal", "1 if the board says crystal and is not as exact."),
    ("clock_drift_ratio", "", "/clock/drift_ppm", "By what share the board's clock is fast."),
    ("trigger_edges_total", "", "/trigger/edges", "Edges of the board's trigger input."),
    ("trigger_edges_missed_total", "", "/trigger/missed", "Edges that came too fast for the board, at least."),
    ("trigger_edges_dropped_total", "", "/trigger/dropped", "Edges that were dropped between board and host."),
    ("board_acquiring", "", "/vitals/acquiring", "1 if the board acquires."),
    ("board_clock_source", "source", "/vitals/clock_source", "1 for what the board's ticks are counted by."),
    ("board_settings", "source", "/vitals/settings", "1 for where the board's configuration came from at its start."),
    ("board_supply_volts", "", "/vitals/supply_v", "Supply voltage of the board."),
    ("board_temperature_celsius", "", "/vitals/temperature_k", "Temperature of the board's MCU."),
    ("board_cpu_ratio", "", "/vitals/cpu_load", "Share of the board's processor time in use."),
    ("board_adc_overruns_total", "", "/losses/board/adc_overruns", "Overruns of the board's converters."),
    ("findings", "", "/head/findings", "Things that are wrong with the head: see /status."),
    ("unexplained_ratio", "", "/head/unexplained", "Share of scans that contradict the scene."),
];

const CELL: &[Metric] = &[
    ("cell_verdict", "verdict", "/verdict", "1, with the verdict on the cell."),
    ("cell_condition_ratio", "condition", "/shares", "Share of the scans of the last second."),
    ("cell_light_amperes", "", "/light_a", "Mean photocurrent at nominal drive."),
    ("cell_brightness_ratio", "", "/brightness", "Photocurrent over what the pose says."),
    ("cell_emitter_drift_ratio", "", "/emitter_drift", "What the emitter deviates from the common light level."),
    ("cell_stray_amperes", "", "/stray_a", "Current in the dark slot."),
    ("cell_noise_amperes", "", "/noise_a", "Standard deviation of a dark word."),
    ("cell_promised_noise_amperes", "", "/promised_noise_a", "The same by the scene's front end."),
];

/// All words of a state, of which one has the value 1, also if it is not known which.
fn words(name: &str) -> Vec<String> {
    match name {
        "recorder_state" => RecorderState::ALL.map(|state| state.to_string()).into(),
        "link_state" => LinkState::ALL.map(|state| state.to_string()).into(),
        "board_clock_source" => ClockSource::ALL.map(|source| source.as_str().to_owned()).into(),
        "board_settings" => SettingsSource::ALL.map(|source| source.as_str().to_owned()).into(),
        _ => Vec::new(),
    }
}

/// A number in the unit of the metric; flags count as 0 and 1, lists by their length.
fn number(name: &str, value: &Value) -> Option<f64> {
    let number = match value {
        Value::Bool(flag) => f64::from(u8::from(*flag)),
        Value::Array(list) => list.len() as f64,
        value => value.as_f64()?,
    };
    Some(match name {
        "start_time_seconds" => number * 1e-9,
        "clock_drift_ratio" => number * 1e-6,
        "board_temperature_celsius" => number - KELVIN_AT_0_CELSIUS,
        _ => number,
    })
}

/// Families of samples, in the order they are written.
struct Exposition(String);

impl Exposition {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a String cannot fail, here and below.
        let _ = writeln!(self.0, "# HELP slitpose_{name} {help}\n# TYPE slitpose_{name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let escaped = |text: &str| text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
        let labels: Vec<_> = labels.iter().map(|(label, text)| format!("{label}=\"{}\"", escaped(text))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.0, "slitpose_{name}{labels} {value}");
    }

    /// Writes `metrics` of each of `subjects`, which have labels of their own.
    fn table(&mut self, metrics: &[Metric], subjects: &[(Vec<(&str, &str)>, &Value)]) {
        for &(name, label, place, help) in metrics {
            if !help.is_empty() {
                self.family(name, if name.ends_with("_total") { "counter" } else { "gauge" }, help);
            }
            for (labels, subject) in subjects {
                self.samples(name, label, labels, subject.pointer(place).unwrap_or(&Value::Null));
            }
        }
    }

    fn samples(&mut self, name: &str, label: &str, labels: &[(&str, &str)], value: &Value) {
        let mut with =
            |label: &str, word: &str, value: f64| self.sample(name, &[labels, &[(label, word)]].concat(), value);
        let words = words(name);
        match value {
            Value::Object(values) => values
                .iter()
                .for_each(|(word, value)| number(name, value).into_iter().for_each(|value| with(label, word, value))),
            Value::String(word) if words.is_empty() => with(label, word, 1.0),
            value if !words.is_empty() => {
                words.iter().for_each(|word| with(label, word, f64::from(u8::from(value.as_str() == Some(word)))));
            }
            value => {
                let Some(value) = number(name, value) else { return };
                match label.split_once('=') {
                    Some((label, word)) => with(label, word, value),
                    None => self.sample(name, labels, value),
                }
            }
        }
    }

    fn latencies(&mut self, boards: &[BoardReport]) {
        const HELP: &str =
            "Age of a pose: link, from the sample's instant until read; host, from there until published; total.";
        self.family("latency_seconds", "summary", HELP);
        for board in boards {
            let (device, latencies) = (&*board.label(), &board.latencies);
            for (stage, latency) in [("link", latencies.link), ("host", latencies.host), ("total", latencies.total)] {
                let (labels, total) = ([("device", device), ("stage", stage)], latency.total);
                if total.count > 0 {
                    for (quantile, value) in total.quantiles() {
                        let quantile = quantile.to_string();
                        self.sample("latency_seconds", &[&labels[..], &[("quantile", &*quantile)]].concat(), value);
                    }
                    self.sample("latency_seconds_sum", &labels, total.sum_s);
                    self.sample("latency_seconds_count", &labels, total.count as f64);
                }
            }
        }
    }
}

/// The whole report, as of `now`.
pub(crate) fn text(report: &DaemonReport, now: HostInstant) -> String {
    let mut out = Exposition(String::with_capacity(1 << 14));
    out.family("build_info", "gauge", "The program and its version.");
    out.sample("build_info", &[("program", report.program), ("version", report.version)], 1.0);
    // Numbers and texts can always be written.
    let mut daemon = json!(report);
    daemon["healthy"] = report.findings(now).is_empty().into();
    let mut boards: Vec<(String, Value)> = report.boards.iter().map(|board| (board.label(), json!(board))).collect();
    for ((_, json), board) in boards.iter_mut().zip(&report.boards) {
        let age_s = board.age_s(now);
        json["age_s"] = age_s.into();
        json["last_scan_age_s"] = board.last_scan_age_s.map(|before_s| before_s + age_s).into();
    }
    out.table(DAEMON, &[(Vec::new(), &daemon)]);
    let of_board: Vec<_> = boards.iter().map(|(device, board)| (vec![("device", &**device)], board)).collect();
    out.table(BOARD, &of_board);
    out.latencies(&report.boards);
    let cells: Vec<(&str, String, &Value)> = boards
        .iter()
        .flat_map(|(device, board)| {
            board["head"]["cells"].as_array().into_iter().flatten().map(move |cell| (device, cell))
        })
        .map(|(device, cell)| (&**device, cell["cell"].to_string(), cell))
        .collect();
    let cells: Vec<_> =
        cells.iter().map(|(device, number, cell)| (vec![("device", *device), ("cell", &**number)], *cell)).collect();
    out.table(CELL, &cells);
    out.0
}

//! The status server seen by clients, and the content of its answers.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::time::{Duration, Instant};

use slitpose_protocol::{ClockSource, SettingsSource, Severity, Status};

use super::*;
use crate::address::Address;
use crate::http::{self, Serving};
use crate::samples;
use slitpose_head::finding::Finding;
use slitpose_tracking::clock::{HostInstant, HostTime};
use slitpose_tracking::health::{CellHealth, CellTotals, Diagnosis, Fault, HeadHealth, Shares, Verdict};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::page::{Order, Refusal};
use slitpose_tracking::pipeline::{Counts, Item, Outcomes, Record};
use slitpose_tracking::telemetry::{
    BoardReport, BoardStatistics, DaemonReport, DatagramCounts, LinkReport, LinkState, RecorderReport,
};

/// A name with all characters that a label must escape.
const AWKWARD: &str = "a \"port\"\\with\nlines";

fn cell(cell: usize, verdict: Verdict) -> CellHealth {
    CellHealth {
        cell,
        verdict,
        shares: Shares { saturated: 0.34, ..Shares::default() },
        light_a: Some(3.1e-6),
        brightness: None,
        emitter_drift: None,
        emitter_drift_sigma: None,
        stray_a: Some(f64::NAN),
        stray_rise_a: None,
        noise_a: Some(1.3e-9),
        noise_lsb: Some(0.5),
        promised_noise_a: Some(1.3e-9),
        totals: CellTotals::default(),
    }
}

fn head() -> HeadHealth {
    let text = "saturated in 34 % of the scans";
    let finding = Finding::failed("cell 1", text, "lower the level of its emitter, or shade it from other light");
    let diagnosis = Diagnosis { fault: Fault::Cell { cell: 1, verdict: Verdict::Saturated }, finding };
    HeadHealth {
        unexplained: 0.0,
        cells: (0..16).map(|k| cell(k, if k == 1 { Verdict::Saturated } else { Verdict::Ok })).collect(),
        findings: vec![diagnosis],
    }
}

fn record(sequence: u64, sampled_ns: u64) -> Record {
    let host_time = HostTime { monotonic_ns: sampled_ns, utc_ns: sampled_ns, uncertainty_ns: 35_000 };
    let device_time_s = sequence as f64 / 4000.0;
    Record { sequence, device_time_s, host_time: Some(host_time), ..samples::record() }
}

/// A board that has run for 4000 scans, all of which took 1 ms to the host and 20 us through it.
fn board(name: &str, head: Option<HeadHealth>) -> BoardReport {
    let now = HostInstant::now();
    let begun = HostInstant { monotonic_ns: now.monotonic_ns - 1_000_000_000, utc_ns: now.utc_ns - 1_000_000_000 };
    let mut statistics = BoardStatistics::new(name, begun);
    for sequence in 0..4000 {
        let sampled_ns = begun.monotonic_ns + sequence * 250_000;
        let later = |ns| Some(HostInstant { monotonic_ns: sampled_ns + ns, utc_ns: 0 });
        statistics.update(&Item::Pose(&record(sequence, sampled_ns)), later(1_000_000), later(1_020_000));
    }
    let (clock, settings) = (ClockSource::CrystalFailed, SettingsSource::PassedOver);
    let status = Status { scans_taken: 4000, cpu_load_permille: 130, clock, settings, ..samples::status() };
    let event = Item::Event { severity: Severity::Warning, device_time_s: f64::NAN, text: "supply sagged" };
    statistics.update(&event, None, None);
    statistics.report.clock.drift_ppm = Some(-12.0);
    statistics.report.clock.contradicts_crystal = true;
    let mut counts = Counts::default();
    counts.scans = 4000;
    counts.scans_repeated = 2;
    counts.take_status(&status);
    counts.outcomes = Outcomes { converged: 3999, degraded: 1, ..Outcomes::default() };
    let link = LinkReport { state: LinkState::Running, ..LinkReport::default() };
    BoardReport { link, ..statistics.report(&counts, head, now) }
}

fn daemon(boards: Vec<BoardReport>) -> DaemonReport {
    let datagrams =
        Some(DatagramCounts { places: 16, places_taken: 5, places_refused: 3, ..DatagramCounts::default() });
    DaemonReport {
        datagrams,
        ..DaemonReport::of(HostInstant::now(), HostInstant::now(), boards, RecorderReport::default())
    }
}

fn serve(address: &str) -> anyhow::Result<Serving> {
    let (well, ill) = (board(AWKWARD, None), board("other", Some(head())));
    let control = |order| if order == Order::Frame(0, Some(0.25)) { Ok(()) } else { Err(Refusal::NO_FRAME) };
    let source = move || daemon(vec![well.clone(), ill.clone()]);
    serve_status(&status_address(address).unwrap(), source, Box::new(control))
}

fn refusal(address: &str) -> String {
    serve(address).unwrap_err().to_string()
}

/// The samples of Prometheus's text format by name and labels; panics if the text violates the format.
fn check(text: &str) -> HashMap<&str, f64> {
    let (mut samples, mut families, mut kind) = (HashMap::new(), HashSet::new(), "");
    for line in text.lines().filter(|line| !line.starts_with("# HELP ")) {
        if let Some(family) = line.strip_prefix("# TYPE ") {
            kind = family;
            let (name, kind) = family.split_once(' ').unwrap();
            assert!(["counter", "gauge", "summary"].contains(&kind) && families.insert(name), "{line}");
            assert_eq!(kind == "counter", name.ends_with("_total"), "{line}");
            continue;
        }
        let (sample, value) = line.rsplit_once(' ').unwrap_or_else(|| panic!("{line}"));
        let (family, kind) = kind.split_once(' ').unwrap();
        let suffix = sample.split('{').next().unwrap().strip_prefix(family).unwrap_or_else(|| panic!("{line}"));
        assert!(suffix.is_empty() || (kind == "summary" && ["_sum", "_count"].contains(&suffix)), "{line}");
        assert!(!sample.contains('{') || (sample.contains("=\"") && sample.ends_with("\"}")), "{line}");
        let value: f64 = value.parse().unwrap_or_else(|_| panic!("{line}"));
        assert!(value.is_finite() && samples.insert(sample, value).is_none(), "{line}");
    }
    samples
}

#[test]
fn metrics_are_what_prometheus_reads() {
    // Without boards the text is short but valid.
    check(&metrics::text(&daemon(Vec::new()), HostInstant::now()));
    let mut unknown = board(AWKWARD, None);
    unknown.device = None;
    let mut known = board("other", Some(head()));
    known.device = Some(DeviceId(*b"simulated\0\0\0"));
    let text = metrics::text(&daemon(vec![unknown, known.clone()]), HostInstant::now());
    let samples = check(&text);
    let awkward = r#"slitpose_scans_total{device="a \"port\"\\with\nlines"}"#;
    assert_eq!(samples.get(awkward), Some(&4000.0), "{text}");
    let id = known.label();
    for (name, labels, value) in [
        ("scans_repeated_total", "", 2.0),
        ("solutions_total", r#",outcome="degraded""#, 1.0),
        ("latency_seconds_count", r#",stage="host""#, 4000.0),
        ("clock_drift_ratio", "", -12.0 * 1e-6),
        ("board_clock_source", r#",source="crystal_failed""#, 1.0),
        ("board_clock_source", r#",source="crystal""#, 0.0),
        ("board_settings", r#",source="passed_over""#, 1.0),
        ("board_temperature_celsius", "", 300.0 - 273.15),
        ("board_settings", r#",source="stored""#, 0.0),
        ("cell_condition_ratio", r#",cell="1",condition="saturated""#, 0.34),
        ("cell_verdict", r#",cell="1",verdict="saturated""#, 1.0),
    ] {
        let sample = format!(r#"slitpose_{name}{{device="{id}"{labels}}}"#);
        assert_eq!(samples.get(&*sample), Some(&value), "{sample}: {text}");
    }
    for (stage, expected_s) in [("link", 1e-3), ("host", 20e-6), ("total", 1.02e-3)] {
        let half = samples[&*format!(r#"slitpose_latency_seconds{{device="{id}",stage="{stage}",quantile="0.5"}}"#)];
        // Two digits.
        assert!((half / expected_s - 1.0).abs() < 0.01, "{stage}: {half}");
    }
    assert!(!text.contains("slitpose_cell_stray_amperes{"), "no sample of what is not a number");
    for (name, count) in [("places", 16.0), ("places_taken", 5.0), ("places_refused_total", 3.0)] {
        assert_eq!(samples[&*format!("slitpose_datagram_{name}")], count, "{name}");
    }
}

#[test]
fn the_view_keeps_to_its_width() {
    let mut long = board(&"a name without end ".repeat(20), Some(head()));
    long.firmware = "x".repeat(300);
    long.link.reason = Some("because ".repeat(40));
    let daemon = daemon(vec![long, board("other", Some(head())), BoardReport::default()]);
    let lines = view::daemon_lines(&daemon, HostInstant::now());
    println!("{}", lines.join("\n"));
    for line in &lines {
        assert!(line.chars().count() <= crate::terminal::WIDTH, "{line}");
    }
    let has = |text: &str| assert!(lines.iter().any(|line| line.contains(text)), "{text}");
    has("converged 3999, degraded 1");
    has("1:saturated(34%)");
    has("  !         cell 1: saturated in 34 %");
    has("known to 35.0 us, fast by -12.00 ppm");
    has("clock: crystal failed, settings:");
    has("clock       board clock: the board says that it runs from a crystal");
    has("start       oscillator: internal oscillator, as the crystal did not start");
    has("start       settings: defaults of the firmware, as three starts in a row");
}

fn is_served(server: &Serving) {
    let get = |path| fetch(&server.address, path).unwrap();
    let status: serde_json::Value = serde_json::from_str(&get("/status").1).unwrap();
    assert_eq!(status["boards"][0]["name"], AWKWARD);
    assert_eq!(status["boards"][1]["head"]["cells"][1]["verdict"], "saturated");
    assert_eq!(status["boards"][1]["link"]["state"], "running");
    let vitals = &status["boards"][1]["vitals"];
    assert_eq!((&vitals["clock_source"], &vitals["settings"]), (&"crystal_failed".into(), &"passed_over".into()));
    assert!(status["boards"][1]["head"]["cells"][1]["stray_a"].is_null(), "not a number");
    assert!(get("/").1.contains("converged 3999"));
    check(&get("/metrics").1);
    let (status, text) = get("/health");
    assert!(status == 503 && text.contains("cell 1: saturated"), "{status}: {text}");
    assert_eq!(get("/nonsense").0, 404);
    // A zero is an order: no link of a page can give it.
    let order = |line: &str| request(&server.address, line).unwrap();
    assert_eq!(order("POST /zero/0/250").0, 202);
    assert_eq!(order("GET /zero/0/250").0, 405);
    assert_eq!(order("POST /zero/1/250"), (409, format!("{}\n", Refusal::NO_FRAME)));
    assert_eq!(order("POST /zero/one/250").0, 400);
}

#[test]
fn the_status_is_served_over_a_unix_socket() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status");
    let address = format!("unix:{}", path.display());
    let server = serve(&address).unwrap();
    is_served(&server);
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
    assert!(refusal(&address).contains("another program serves"), "a daemon that lives keeps its socket");
    drop(server);
    assert!(!path.exists(), "the socket is removed");

    // A socket left behind by a killed daemon.
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    assert!(path.exists());
    let server = serve(&address).unwrap();
    is_served(&server);
    // Another file in its place must not be removed.
    fs::remove_file(&path).unwrap();
    fs::write(&path, "precious").unwrap();
    drop(server);
    assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    assert!(refusal(&address).contains("is no socket and is left alone"));
}

#[test]
fn a_page_in_a_browser_is_not_answered() {
    let server = serve("127.0.0.1:0").unwrap();
    let ask = |headers: &str| {
        let mut stream = TcpStream::connect(tcp(&server)).unwrap();
        write!(stream, "GET /status HTTP/1.1\r\n{headers}Connection: close\r\n\r\n").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    };
    assert!(ask("Host: localhost:7450\r\n").starts_with("HTTP/1.1 200 "));
    for headers in ["Host: evil.example\r\n", "Host: localhost\r\nOrigin: http://evil.example\r\n"] {
        let text = ask(headers);
        assert!(text.starts_with("HTTP/1.1 403 ") && !text.contains("boards"), "{headers}: {text}");
    }
}

#[test]
fn other_hosts_are_not_let_in() {
    for address in ["0.0.0.0:0", "[::]:0"] {
        assert!(refusal(address).contains("can be reached from other hosts"), "{address}");
    }
}

fn tcp(server: &Serving) -> SocketAddr {
    match &server.address {
        Address::Tcp(address) => *address,
        other => panic!("{other}"),
    }
}

#[test]
fn clients_that_hang_keep_nobody_waiting_and_are_closed() {
    let server = serve("127.0.0.1:0").unwrap();
    let begun = Instant::now();
    let mut silent: Vec<TcpStream> = (0..50).map(|_| TcpStream::connect(tcp(&server)).unwrap()).collect();
    // Some clients send a request and do not read; some send half a request.
    for (i, stream) in silent.iter_mut().enumerate().skip(20) {
        stream
            .write_all(if i % 2 == 0 { b"GET /metrics HTTP/1.1\r\nHost: [::1]\r\n\r\n" } else { b"GET /st" })
            .unwrap();
    }
    assert!(fetch(&server.address, "/status").is_ok());
    // The server closes silent connections: reading ends long before the timeout here.
    silent[0].set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    assert!(matches!(silent[0].read(&mut [0; 16]), Ok(0) | Err(_)));
    assert!(begun.elapsed() >= http::LIFETIME - Duration::from_millis(100), "{:?}", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(55), "closed by the server, not by the time limit");
    // When dropped, the server ends in spite of hanging clients.
    let _hanging = TcpStream::connect(tcp(&server)).unwrap();
    drop(server);
}

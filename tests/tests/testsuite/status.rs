//! A daemon tells how it does, to people, programs and Prometheus.

use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::Value;
use slitpose_tests::process::{self, Finished, address_said};
use slitpose_tests::slitpose;

/// No line for people is longer.
const WIDTH: usize = 100;

/// A busy machine may take its time.
const PATIENCE: Duration = Duration::from_secs(30);

fn get(address: &str, path: &str) -> (u16, String) {
    process::get(TcpStream::connect(address).expect("listens"), path).expect("an answer")
}

fn status(address: &str) -> Value {
    let (code, body) = get(address, "/status");
    assert_eq!(code, 200, "{body}");
    serde_json::from_str(&body).expect("JSON")
}

/// Value of the first sample whose name and labels begin so.
fn sample(metrics: &str, start: &str) -> Option<f64> {
    let line = metrics.lines().find(|line| line.starts_with(start))?;
    line.rsplit_once(' ')?.1.parse().ok()
}

#[test]
fn a_daemon_tells_how_it_does() {
    let arguments = ["run", "--config", "none", "--device", "sim", "--format", "none", "--status", "127.0.0.1:0"];
    let mut daemon = slitpose!().spawn(arguments);
    let address = address_said(&mut daemon, "status at ");
    let since = Instant::now();
    while status(&address)["boards"][0]["scans"].as_u64() < Some(4000) {
        assert!(since.elapsed() < PATIENCE, "no scans: {}", status(&address));
        std::thread::sleep(Duration::from_millis(100));
    }
    let told = status(&address);
    let board = &told["boards"][0];
    assert_eq!((board["name"].as_str(), board["simulated"].as_bool()), (Some("sim"), Some(true)), "{told}");

    let (code, metrics) = get(&address, "/metrics");
    assert_eq!(code, 200);
    for line in metrics.lines().filter(|line| !line.starts_with('#')) {
        let (name, value) = line.rsplit_once(' ').expect("name and value");
        assert!(name.starts_with("slitpose_") && value.parse::<f64>().is_ok(), "{line}");
    }
    let scans = sample(&metrics, "slitpose_scans_total").expect("scans");
    assert!(scans >= 4000.0, "{scans}");

    // A busy machine may fall behind for a while, which is said, and is over in the end.
    loop {
        let (code, health) = get(&address, "/health");
        if code == 200 {
            assert_eq!(health, "ok\n");
            break;
        }
        assert!(code == 503 && health.starts_with("sim: ") && since.elapsed() < PATIENCE, "{code}: {health}");
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(get(&address, "/nothing").0, 404);

    let ask = |format: &str| slitpose!().run(["status", "--address", &address, "--format", format]).done();
    let text = ask("text");
    println!("{text}");
    for part in ["board", "SIMULATED", "rate", "last reset: power on", "recorder", "off"] {
        assert!(text.contains(part), "`{part}` is not in:\n{text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
    let json: Value = serde_json::from_str(&ask("json")).expect("JSON");
    assert!(json["boards"][0]["scans"].as_u64() >= board["scans"].as_u64(), "{json}");
    assert!(sample(&ask("prometheus"), "slitpose_scans_total") >= Some(scans));

    let finished = Finished::interrupted(daemon);
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    let silent = slitpose!().run(["status", "--address", &address]);
    silent.assert_refused(1, &[&address, "--status"]);
}

#[test]
fn a_summary_fits_a_terminal() {
    for device in ["sim", "sim,sim"] {
        let arguments = ["run", "--config", "none", "--speed", "max", "--duration", "1s", "--format", "summary"];
        let text = slitpose!().run(arguments.iter().chain(&["--device", device])).done();
        println!("{text}");
        let longest = text.lines().map(|line| line.chars().count()).max().expect("lines");
        assert!((40..=WIDTH).contains(&longest), "{longest} columns:\n{text}");
        assert_eq!(text.matches("honesty").count(), device.split(',').count(), "{text}");
        assert_eq!((text.contains("on sim 1, id"), text.contains("on sim 2, id")), (device != "sim", device != "sim"));
    }
}

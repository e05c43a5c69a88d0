//! The station in front of simulated boards and files, by a clock that the tests move.

use std::cell::Cell;
use std::rc::Rc;

use serde_json::Value;
use slitpose_head::scene_file::{FINE, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::columns::CsvRows;
use slitpose_tracking::pipeline::Item;
use slitpose_tracking::playback::{Choice, Event, Playback, PlaybackError};

use crate::station::{HeadFiles, Station};

/// Time between two ticks: as in a browser.
const TICK_NS: u64 = 4_000_000;

struct Bench {
    station: Station,
    now_ns: Rc<Cell<u64>>,
    messages: Vec<Value>,
}

impl Bench {
    fn new() -> Self {
        let now_ns = Rc::new(Cell::new(1_000_000_000));
        let clock_ns = Rc::clone(&now_ns);
        let clock = move || HostInstant { monotonic_ns: clock_ns.get(), utc_ns: clock_ns.get() };
        let mut station = Station::by(Box::new(clock));
        station.request(r#"{"kind":"hello"}"#);
        Self { station, now_ns, messages: Vec::new() }
    }

    fn simulating(faults: &str) -> Self {
        let mut bench = Self::new();
        bench.station.simulate(&wide(), "smooth", 7, faults).unwrap();
        bench
    }

    /// Lets so many seconds pass; the page acknowledges all that comes.
    fn run(&mut self, seconds: f64, mut each: impl FnMut(&mut Station, &[u8])) {
        for _ in 0..(seconds * 1e9) as u64 / TICK_NS {
            self.now_ns.set(self.now_ns.get() + TICK_NS);
            self.station.tick();
            // As the worker asks.
            let outgoing = self.station.take_outgoing();
            each(&mut self.station, &outgoing);
            while let Some(text) = self.station.take_message() {
                self.messages.push(serde_json::from_str(&text).unwrap());
            }
            self.station.request(r#"{"kind":"ack","messages":1000000}"#);
        }
    }

    fn of_kind(&self, kind: &str) -> Vec<&Value> {
        self.messages.iter().filter(|message| message["kind"] == kind).collect()
    }

    /// What the reports said of the board.
    fn boards(&self) -> Vec<&Value> {
        self.of_kind("report").iter().map(|report| &report["report"]["boards"][0]).collect()
    }
}

fn wide() -> HeadFiles {
    HeadFiles::new("wide".to_owned(), Vec::new())
}

#[test]
fn a_simulated_head_is_shown_as_a_daemon_shows_it() {
    let mut bench = Bench::simulating("");
    bench.run(2.5, |_, _| ());
    assert_eq!((&bench.of_kind("hello")[1]["boards"][0], bench.of_kind("head").len()), (&"sim".into(), 1));
    let frames = bench.of_kind("frame");
    assert!((60..=76).contains(&frames.len()), "{}", frames.len());
    assert!(frames.iter().skip(2).all(|frame| frame["status"] == "converged" && frame["simulated"] == true));
    let board = bench.boards().pop().unwrap();
    assert_eq!((&board["link"]["state"], &board["losses"]["link"]["scans"]), (&"running".into(), &0.into()));
    assert!(board["scans"].as_u64() > Some(7_000), "{board}");
    assert!(board["latencies"]["total"]["total"]["count"].as_u64() > Some(5_000), "pings are answered: {board}");
}

#[test]
fn a_page_that_is_busy_gets_fewer_frames_and_every_scan_in_them() {
    let mut bench = Bench::simulating("");
    for _ in 0..1000 {
        bench.now_ns.set(bench.now_ns.get() + TICK_NS);
        bench.station.tick();
    }
    bench.run(0.2, |_, _| ());
    let frames = bench.of_kind("frame");
    let scans: u64 = frames.iter().filter_map(|frame| frame["scans"].as_u64()).sum();
    assert!(frames.len() < 70 && scans > 16_000, "{} frames, {scans} scans", frames.len());
}

#[test]
fn a_board_that_is_lost_or_stops_is_found_again() {
    let mut bench = Bench::simulating("restart:from=500ms,for=300ms\nstop:from=2s");
    bench.run(5.0, |_, _| ());
    let states: Vec<&Value> = bench.boards().iter().map(|board| &board["link"]["state"]).collect();
    let last = bench.boards().pop().unwrap();
    assert!(states.iter().any(|state| **state == "gone") && last["link"]["state"] == "running", "{states:?}");
    assert_eq!(last["link"]["reconnects"], 2);
}

#[test]
fn a_board_of_another_head_is_refused_with_both_hashes_and_one_that_is_silent_is_reported() {
    let [fine, own] = [FINE, WIDE].map(|scene| scene.read().unwrap());
    let motion = Trajectory::of_kind(TrajectoryKind::Still, 1, 1.0);
    let mut board = SimulatedBoard::new(&fine, motion, Tier::Paper, 1).unwrap();
    let mut bench = Bench::new();
    bench.station.follow(&wide()).unwrap();
    bench.station.port_opened();
    let now_ns = Rc::clone(&bench.now_ns);
    bench.run(1.0, |station, outgoing| {
        board.write(outgoing);
        let mut bytes = Vec::new();
        (0..16).for_each(|_| board.step(&mut bytes));
        station.port_received(&bytes, now_ns.get() as f64 * 1e-6);
    });
    let reason = bench.boards().pop().unwrap()["link"].to_string();
    assert!([own.hash, fine.hash].iter().all(|hash| reason.contains(&format!("{hash:016x}"))), "{reason}");
    bench.run(4.0, |_, _| ());
    let reason = bench.boards().pop().unwrap()["link"].to_string();
    assert!(reason.contains("0 bytes came within 2.5 s"), "{reason}");
}

#[test]
fn what_is_recorded_replays_without_a_loss_and_exports_as_the_program_does() {
    let mut bench = Bench::simulating("");
    let mut bytes = Vec::new();
    bench.run(0.5, |_, _| ());
    bench.station.record("shown.mcap").unwrap();
    bench.run(2.0, |station, _| bytes.extend(station.take_recorded()));
    bench.station.request(r#"{"kind":"note","text":"now","ago_s":0.5}"#);
    bench.run(0.5, |_, _| ());
    bench.station.request(r#"{"kind":"record","on":false}"#);
    bytes.extend(bench.station.take_recorded());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture.mcap");
    std::fs::write(&path, bytes).unwrap();
    let name = path.display().to_string();

    let (rows, mut expected, mut scans) = (CsvRows::default(), Vec::new(), Vec::new());
    rows.header(&mut expected);
    let mut hear = |event: Event<'_>| {
        match event {
            Event::Item { item: Item::Pose(record), .. } => {
                scans.push(record.sequence);
                rows.row(record, &mut expected);
            }
            Event::Loss(loss) => panic!("{loss}"),
            _ => {}
        }
        Ok::<_, PlaybackError>(())
    };
    let mut playback = Playback::open(vec![path], Choice::default()).unwrap();
    while playback.step(&mut hear).unwrap() {}
    playback.end(&mut hear).unwrap();
    assert!(scans.len() > 9_800 && scans.windows(2).all(|pair| pair[1] == pair[0] + 1), "{}", scans.len());

    let mut bench = Bench::new();
    bench.station.export(vec![name.clone()]).unwrap();
    while bench.station.step_export().unwrap() < 1.0 {}
    assert!(bench.station.take_recorded() == expected);

    bench.station.play(vec![name]).unwrap();
    bench.run(1.0, |_, _| ());
    let player = bench.of_kind("player").pop().unwrap();
    assert_eq!((&player["playing"], &player["notes"][0]["text"]), (&true.into(), &"now".into()));
    assert!((player["duration_s"].as_f64().unwrap() - 2.5).abs() < 0.1, "{player}");
    bench.station.request(r#"{"kind":"player","seek_s":2.0,"speed":null}"#);
    bench.run(0.5, |_, _| ());
    assert_eq!(bench.of_kind("player").pop().unwrap()["ended"], true);
    assert!(bench.of_kind("frame").iter().any(|frame| frame["status"] == "converged"));
}

#[test]
fn what_is_no_capture_ends_with_a_reason_and_requests_out_of_place_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("noise.mcap");
    std::fs::write(&path, [0x87, 0].repeat(2500)).unwrap();
    let mut bench = Bench::new();
    bench.station.play(vec![path.display().to_string()]).unwrap();
    bench.run(0.1, |_, _| ());
    let reason = bench.of_kind("ended")[0]["reason"].to_string();
    assert!(reason.contains("holds no scan"), "{reason}");
    let requests = [r#""record","on":false"#, r#""player","playing":true"#, r#""recordings""#, r#""nonsense""#];
    requests.iter().for_each(|request| bench.station.request(&format!(r#"{{"kind":{request}}}"#)));
    bench.run(0.1, |_, _| ());
    assert_eq!(bench.of_kind("refused").len(), requests.len());
    bench.station.view(&wide()).unwrap();
    bench.station.request(r#"{"kind":"pose","t_m":[0.001,0,0],"r_rad":[0,0,0]}"#);
    bench.run(0.1, |_, _| ());
    assert_eq!(bench.of_kind("frame")[0]["t_m"][0], 0.001);
}

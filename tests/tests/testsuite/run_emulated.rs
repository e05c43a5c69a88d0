//! The programs as a user runs them: `slitpose-emulator` with the image of `firmware/build`, and
//! `slitpose run` on the terminal it names.
//!
//! The tool follows the board's clock, so where it was at the instant of a pose is known.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use slitpose_head::scene_file::BASE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_tests::consistency::Honesty;
use slitpose_tests::ndjson::{self, Line, assert_complete};
use slitpose_tests::process::{Finished, name_in, written};
use slitpose_tests::terminal::FRAME_RATE_HZ;
use slitpose_tests::{scenes, slitpose};

/// Device seconds for which the emulator plans its motions.
const HORIZON_S: f64 = 3600.0;

/// Root mean square error of all axes in smooth motion: within 15 % of what `run --device sim`
/// gives with this scene, 1.81 µm and 227 µrad.
const RMS_M: (f64, f64) = (1.54e-6, 2.09e-6);
const RMS_RAD: (f64, f64) = (193e-6, 262e-6);

/// The first line a run on a board without a stored scene prints: not an error.
const NO_SCENE_STORED: &str = "has no scene stored";

/// The poses of a run that has lost nothing, each with where the tool was.
fn poses(finished: Finished, kind: TrajectoryKind, seed: u64) -> Vec<Line> {
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    let talk: Vec<&str> = finished.stderr.lines().collect();
    assert!(talk.len() == 1 && talk[0].contains(NO_SCENE_STORED), "{talk:?}");
    let mut lines = ndjson::parse_measured(&finished.done());
    let trajectory = Trajectory::of_kind(kind, seed, HORIZON_S);
    for line in &mut lines {
        line.truth = Some(trajectory.pose(line.device_time_s));
    }
    lines
}

/// How many have converged, and how good they are.
fn honesty(lines: &[Line]) -> (usize, Honesty) {
    let converged = lines.iter().filter(|line| line.status == "converged").count();
    println!("{converged} converged");
    (converged, Honesty::of(lines.iter().filter_map(Line::beside_truth)))
}

#[test]
fn at_high_rates_with_few_scans_in_a_packet_nothing_is_lost_and_a_replay_has_the_same_poses() {
    let folder = tempfile::tempdir().expect("a folder");
    let emulator = Emulator::start(&["wide", "--seed", "23", "--speed", "max"]);
    for (rate_hz, count) in [(6e3, 12_000), (8e3, 16_000), (10e3, 20_000)] {
        let capture = &*name_in(folder.path(), &format!("{rate_hz}.mcap"));
        let ran = emulator.run(&["--duration", "2s", "--rate", &rate_hz.to_string(), "--latency", "--record", capture]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let printed = String::from_utf8(ran.stdout).expect("UTF-8");
        let mut lines = ndjson::parse_measured(&printed);
        // Frames of 6 kHz are no whole number of ticks.
        let ticks = (170e6_f64 / rate_hz).round();
        assert_complete(&lines, lines[0].sequence, lines.len(), 170e6 / ticks);
        assert!(lines.len().abs_diff(count) <= 1, "{}", lines.len());
        let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, 23, HORIZON_S);
        lines.iter_mut().for_each(|line| line.truth = Some(trajectory.pose(line.device_time_s)));
        honesty(&lines).1.assert(4.5..6.5, 3);
        let replayed = slitpose!().run(["replay", capture, "--format", "ndjson"]).done();
        let poses =
            |text: &str| text.lines().map(|line| line.split("host_").next().map(str::to_owned)).collect::<Vec<_>>();
        assert_eq!(poses(&replayed), poses(&printed));
    }
    emulator.close();
}

#[test]
fn ten_seconds_of_the_image_behind_the_programs() {
    let emulator = Emulator::start(&["wide", "--seed", "21", "--speed", "max"]);
    let lines = poses(emulator.run(&["--duration", "10s"]), TrajectoryKind::Smooth, 21);
    assert_complete(&lines, 0, 40_000, FRAME_RATE_HZ);
    let (converged, honest) = honesty(&lines);
    assert_eq!(converged, 40_000);
    honest.assert(4.5..6.5, 3);
    assert!((RMS_M.0..RMS_M.1).contains(&honest.rms_m) && (RMS_RAD.0..RMS_RAD.1).contains(&honest.rms_rad));
    // Where the tool was a frame later would not do.
    let late = lines.windows(2).map(|pair| Line { truth: pair[1].truth, ..pair[0].clone() }).collect::<Vec<_>>();
    assert!(honesty(&late).1.median_nees > 6.5);

    // The board is still there, dark, and goes on counting.
    let again = poses(emulator.run(&["--duration", "200ms"]), TrajectoryKind::Smooth, 21);
    assert!((40_000..41_000).contains(&again[0].sequence), "{}", again[0].sequence);
    assert!(again[0].device_time_s > lines[39_999].device_time_s);
    assert_complete(&again, again[0].sequence, 800, FRAME_RATE_HZ);
    honesty(&again).1.assert(4.5..6.5, 0);
    emulator.close();
}

#[test]
fn another_head_by_the_serial_port() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let text = format!("{}\n{}", BASE.text, scenes::front_end(2000.0));
    let scene = &*written(folder.path(), "head.toml", text);
    let emulator = Emulator::start(&[scene, "--seed", "24", "--speed", "max", "--link", "uart"]);
    let lines = poses(emulator.run(&["--duration", "1s", "--scene", scene]), TrajectoryKind::Smooth, 24);
    assert_complete(&lines, 0, 2_000, 2000.0);
    let (converged, honest) = honesty(&lines);
    // On its way the tool leaves one of these cells in the dark now and then, or brings one to its converter's limit.
    assert!(converged > 1_000 && lines.iter().all(|line| line.cells_used <= 6), "{converged}");
    honest.assert(4.5..6.5, 3);
    emulator.close();
}

/// What the emulator says when it cannot begin.
fn refused(arguments: &[&str]) -> Finished {
    emulator(arguments).stdin(Stdio::null()).output().expect("slitpose-emulator starts").into()
}

#[test]
fn what_cannot_be_run_is_named() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = |name: &str| name_in(folder.path(), name);
    refused(&["wide", "--elf", &path("none")]).assert_refused(1, &[&path("none"), "firmware/build", "--elf"]);
    std::fs::write(path("text"), "no program").expect("file");
    refused(&["wide", "--elf", &path("text")]).assert_refused(1, &[&path("text"), "ELF"]);
    // A head without electronics, one with more cells than the board has inputs, and finer
    // converters than the board's.
    refused(&["base"]).assert_refused(1, &["six cells, rolls 0 and 90", "[front_end]"]);
    let rolls = [45.0, -45.0, 45.0, -45.0, 45.0, -45.0, 45.0, -45.0];
    let lighting = "[lighting]\nslots = [[0], [1], [2], [3], [4], [5], [6], [7], []]\n";
    let ring = format!("{}{lighting}{}", scenes::front_end(1000.0), scenes::ring(&rolls));
    std::fs::write(path("ring.toml"), ring).expect("scene");
    refused(&[&path("ring.toml")]).assert_refused(1, &["8 cells", "inputs for 6"]);
    std::fs::write(path("fine.toml"), scenes::wide_with(&[("adc_bits = 12", "adc_bits = 16")])).expect("scene");
    refused(&[&path("fine.toml")]).assert_refused(1, &["adc_bits = 16", "12"]);
    refused(&["no-such-scene"]).assert_refused(1, &["no-such-scene"]);
    refused(&["wide", "--trajectory", &path("none.csv")]).assert_refused(1, &[&path("none.csv")]);
    refused(&["wide", "--speed", "0"]).assert_refused(2, &["--speed"]);
}

#[test]
fn it_ends_with_its_standard_input_whoever_listens() {
    let emulator = Emulator::start(&["wide", "--quiet", "--trajectory", "still"]);
    assert!(std::path::Path::new(&emulator.path).exists(), "{}", emulator.path);
    // What comes on standard input is not an end.
    (&emulator.stdin).write_all(b"words\n").expect("read");
    let mut child = slitpose!().spawn(["run", "--patience", "0s", "--device", &emulator.path]);
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    stdout.read_line(&mut String::new()).expect("line");
    let path = emulator.path.clone();
    emulator.close();
    let mut rest = String::new();
    stdout.read_to_string(&mut rest).expect("UTF-8");
    let finished = Finished::of(child);
    finished.assert_said(1, &[&path, "unplugged"]);
}

/// The program with `arguments`, its streams piped.
pub(super) fn emulator(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_slitpose-emulator-under-test"));
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(super) struct Emulator {
    child: Child,
    pub(super) stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
    /// What it printed first, without the end of the line.
    pub(super) path: String,
}

impl Emulator {
    /// Starts it; it has printed its path on return.
    pub(super) fn start(arguments: &[&str]) -> Self {
        println!("slitpose-emulator {arguments:?}");
        let mut child = emulator(arguments).spawn().expect("slitpose-emulator starts");
        let stdin = child.stdin.take().expect("piped");
        let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
        let mut path = String::new();
        stdout.read_line(&mut path).expect("UTF-8");
        let path = path.strip_suffix('\n').expect("a whole line").to_owned();
        Self { child, stdin, stdout, path }
    }

    /// `slitpose run` on its board, whose head is as its scene says.
    pub(super) fn run(&self, arguments: &[&str]) -> Finished {
        slitpose!().run(["run", "--device", &self.path, "--calibration", "none"].iter().chain(arguments))
    }

    /// Closes its standard input; gives what it said to standard error until its end. It must not
    /// have printed anything but the path, nor found the program at fault.
    pub(super) fn close(mut self) -> String {
        drop(self.stdin);
        let mut rest = String::new();
        self.stdout.read_to_string(&mut rest).expect("UTF-8");
        assert_eq!(rest, "", "more than the path on standard output");
        let finished = Finished::of(self.child);
        assert_eq!(finished.code, 0, "{}", finished.stderr);
        println!("{}", finished.stderr);
        let ratio = finished.stderr.lines().next().unwrap_or_default();
        assert!(ratio.contains("s of device time in") && ratio.contains("ratio"), "{ratio}");
        assert_eq!(finished.stderr.lines().count(), 1, "the program is at fault: {}", finished.stderr);
        finished.stderr
    }
}
